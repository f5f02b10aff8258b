"""How numbers went over hours, in constant memory: when there is no room, every second one is given up."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array

__all__ = ["Course"]


class Course:
    """Rows over time, at most `most` of them.

    Attributes:
        step: least time [s] between two rows; it doubles whenever the room is full.
    """

    def __init__(self, width: int, *, step: float, most: int = 2048) -> None:
        self.step = step
        self._t, self._rows, self._count = np.empty(most), np.empty((most, width), dtype=np.float32), 0

    def __len__(self) -> int:
        return self._count

    def add(self, t: float, row: Array) -> bool:
        """Take a row of time t [s] unless the last one is nearer than `step`; return whether it was taken."""
        if self._count and not t - self._t[self._count - 1] >= self.step:
            return False
        if self._count == self._t.size:
            half = self._t[::2].size
            self._t[:half], self._rows[:half] = self._t[::2].copy(), self._rows[::2].copy()
            self._count, self.step = half, 2.0 * self.step
        self._t[self._count], self._rows[self._count] = t, row
        self._count += 1
        return True

    @property
    def t(self) -> Array:
        """Times (n,) [s]."""
        return self._t[: self._count]

    @property
    def rows(self) -> Array:
        """Values (n, width), single precision."""
        return self._rows[: self._count].astype(np.float64)
