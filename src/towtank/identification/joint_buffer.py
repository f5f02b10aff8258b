"""What a streaming learner has seen, kept for as long as it may still go over it again."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.samples import N_MEASURED, Samples

__all__ = ["Buffer"]

_FIRST = 1024


class Buffer:
    """Rows and inputs in growing arrays, in stretches that owe nothing to each other.

    Args:
        shape: wrench (6, m) of each input. lag: time constants (m,) [s]. commands: whether inputs are commands.
    """

    def __init__(self, shape: Array, lag: Array, *, commands: bool) -> None:
        self.shape, self.lag, self.commands = shape, lag, commands
        self.t, self.values = np.empty(_FIRST), np.empty((_FIRST, N_MEASURED))
        self.input_t, self.input_force = np.empty(_FIRST), np.empty((_FIRST, shape.shape[1]))
        self.rows = self.inputs = 0
        self._starts: list[tuple[int, int]] = [(0, 0)]

    def add_row(self, t: float, z: Array) -> None:
        """Add a row z (15,) of time t [s]."""
        if self.rows == self.t.size:
            self.t, self.values = _doubled(self.t), _doubled(self.values)
        self.t[self.rows], self.values[self.rows] = t, z
        self.rows += 1

    def add_input(self, t: float, force: Array) -> None:
        """Add the forces (m,) asked for from t [s] on."""
        if self.inputs == self.input_t.size:
            self.input_t, self.input_force = _doubled(self.input_t), _doubled(self.input_force)
        self.input_t[self.inputs], self.input_force[self.inputs] = t, force
        self.inputs += 1

    def break_off(self) -> None:
        """Begin a new stretch."""
        if (self.rows, self.inputs) != self._starts[-1]:
            self._starts.append((self.rows, self.inputs))

    @property
    def stretches(self) -> list[Samples]:
        """All stretches with rows in them; views, not copies."""
        ends = [*self._starts[1:], (self.rows, self.inputs)]
        return [
            Samples(
                self.t[a:b],
                self.values[a:b],
                self.input_t[c:d],
                self.input_force[c:d],
                self.shape,
                self.lag,
                self.commands,
            )
            for (a, c), (b, d) in zip(self._starts, ends, strict=True)
            if b > a
        ]


def _doubled(array: Array) -> Array:
    out = np.empty((2 * array.shape[0], *array.shape[1:]))
    out[: array.shape[0]] = array
    return out
