"""The delay between a command and its force, by scanning: the delay that explains the recordings best.

Every delay costs one pass of least squares with all columns and a fast filter (slow ones let disturbances answer for
the commands and pull the delay to zero). The criterion is -2 ln L = sum n ln(SSE) over the axes; a parabola through
its least three values gives the delay between the steps, its curvature the deviation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array

__all__ = ["DelayScan", "scan_delay"]

_COARSE = 0.02
_FINE = 0.005


@dataclass(frozen=True)
class DelayScan:
    """The delay found [s], its deviation [s] (NaN at an end of the range), and the criterion scanned."""

    delay: float
    std: float
    delays: Array
    cost: Array

    @property
    def at_limit(self) -> bool:
        """The best delay lies at the upper end of the range scanned: the true one may be longer."""
        return bool(self.cost.argmin() == len(self.cost) - 1)


def scan_delay(cost: Callable[[float], float], longest: float, *, spread: float = 5.0) -> DelayScan:
    """Return the delay in [0, longest] [s] of least cost.

    Args:
        cost: -2 ln L of the recordings for a delay [s].
        longest: end of the range scanned [s].
        spread: samples over which residuals are alike; widens the deviation.
    """
    found: dict[float, float] = {}

    def at(delay: float) -> float:
        key = round(float(delay), 6)
        if key not in found:
            found[key] = cost(key)
        return found[key]

    coarse = np.arange(0.0, longest + 0.5 * _COARSE, _COARSE)
    best = coarse[int(np.argmin([at(d) for d in coarse]))]
    fine = np.arange(max(0.0, best - _COARSE), min(longest, best + _COARSE) + 0.5 * _FINE, _FINE)
    values = np.array([at(d) for d in fine])
    i = int(values.argmin())
    delays = np.array(sorted(found))
    costs = np.array([found[d] for d in delays])
    if i in (0, len(fine) - 1):
        return DelayScan(float(fine[i]), float("nan"), delays, costs)
    low, mid, high = values[i - 1], values[i], values[i + 1]
    bend = low - 2.0 * mid + high
    if not bend > 0.0:
        return DelayScan(float(fine[i]), float("nan"), delays, costs)
    delay = float(fine[i]) + 0.5 * _FINE * (low - high) / bend
    std = float(np.sqrt(2.0 * spread / (bend / _FINE**2)))
    return DelayScan(delay, std, delays, costs)
