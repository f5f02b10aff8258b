"""How the estimates of a stream went, kept for its report in constant memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.identification import Estimate, Learner
from towtank.identification.convergence import Convergence

__all__ = ["LearnedCourse"]

_STEP, _MOST = 0.5, 800  # s between two readings at first; readings


class LearnedCourse:
    """Reads a learner from time to time; called, by its own thread, with time [s] and arguments of every instant."""

    def __init__(self, learner: Learner) -> None:
        self._learner, self._step = learner, _STEP
        self._rows: list[tuple[float, dict[str, tuple[float, float]]]] = []

    def __call__(self, t: float, arguments: Mapping[str, Any]) -> None:
        """Take note of the estimate where that is due."""
        if self._rows and 0.0 <= t - self._rows[-1][0] < self._step:
            return
        if len(self._rows) == _MOST:
            self._rows, self._step = self._rows[::2], 2.0 * self._step
        known = {each.name: (each.value, each.std) for each in self._learner.estimate.coefficients if each.identified}
        self._rows.append((t, known))

    def convergence(self, estimate: Estimate) -> Convergence:
        """Return how what is identified by now came about."""
        names = tuple(each.name for each in estimate.coefficients if each.identified)
        rows, nothing = self._rows.copy(), (np.nan, np.nan)
        pairs: Array = np.array([[known.get(name, nothing) for name in names] for _, known in rows])
        pairs = pairs.reshape(len(rows), len(names), 2)
        return Convergence(names, np.array([t for t, _ in rows]), pairs[:, :, 0], pairs[:, :, 1])
