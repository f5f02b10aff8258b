"""What a streaming learner has seen, kept for as long as it may still go over it again."""

from __future__ import annotations

from collections.abc import Sequence

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

    def fresh(self) -> Buffer:
        """Return an empty one of the same inputs."""
        return Buffer(self.shape, self.lag, commands=self.commands)

    def clear(self) -> None:
        """Forget everything."""
        self.rows = self.inputs = 0
        self._starts = [(0, 0)]

    def break_off(self) -> None:
        """Begin a new stretch."""
        if (self.rows, self.inputs) != self._starts[-1]:
            self._starts.append((self.rows, self.inputs))

    def since(self, rows: int, inputs: int) -> list[tuple[bool, Samples]]:
        """Return what came after so many rows and inputs: whether it begins a new stretch, and views of it."""
        out = []
        ends = [*self._starts[1:], (self.rows, self.inputs)]
        for (a, c), (b, d) in zip(self._starts, ends, strict=True):
            first, put = max(a, rows), max(c, inputs)
            if b > first or d > put:
                out.append((a >= rows and (a, c) != (0, 0), self._part(first, b, put, d)))
        return out

    def _part(self, a: int, b: int, c: int, d: int) -> Samples:
        return Samples(
            self.t[a:b],
            self.values[a:b],
            self.input_t[c:d],
            self.input_force[c:d],
            self.shape,
            self.lag,
            self.commands,
        )

    @property
    def starts(self) -> list[tuple[int, int]]:
        """First row and first input of each stretch."""
        return list(self._starts)

    @property
    def whole(self) -> Samples:
        """Everything in one, whatever its stretches."""
        return self._part(0, self.rows, 0, self.inputs)

    def restore(
        self, t: Array, values: Array, input_t: Array, input_force: Array, starts: Sequence[Sequence[int]]
    ) -> None:
        """Put in what `whole` and `starts` of another buffer gave."""
        self.t, self.values, self.input_t, self.input_force = (
            _roomy(each) for each in (t, values, input_t, input_force)
        )
        self.rows, self.inputs = t.shape[0], input_t.shape[0]
        self._starts = [(int(a), int(b)) for a, b in starts]

    @property
    def stretches(self) -> list[Samples]:
        """All stretches with rows in them; views, not copies."""
        ends = [*self._starts[1:], (self.rows, self.inputs)]
        return [self._part(a, b, c, d) for (a, c), (b, d) in zip(self._starts, ends, strict=True) if b > a]


def _roomy(array: Array) -> Array:
    out = np.empty((max(_FIRST, 2 * array.shape[0]), *array.shape[1:]))
    out[: array.shape[0]] = array
    return out


def _doubled(array: Array) -> Array:
    out = np.empty((2 * array.shape[0], *array.shape[1:]))
    out[: array.shape[0]] = array
    return out
