"""The delay between a command and its force, by scanning: the delay that explains the recordings best.

Every delay costs one pass of least squares with all columns and a fast filter (slow ones let disturbances answer for
the commands and pull the delay to zero). The criterion is -2 ln L = sum n ln(SSE) over the axes; a parabola through
its least three values gives the delay between the steps. Residuals are alike over seconds where disturbances are slow,
so the deviation comes from the long-run variance of the criterion's slope over blocks of time, not from its curvature
alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.axis_solution import long_run

__all__ = ["DelayCost", "DelayScan", "scan_delay"]

_COARSE = 0.02
_FINE = 0.005
_LAGS = 8  # blocks over which slopes are taken to be alike


@dataclass(frozen=True)
class DelayCost:
    """-2 ln L of one delay, and its parts (b,) over blocks of time for every axis."""

    value: float
    blocks: Sequence[Array] = field(default=())


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


def scan_delay(cost: Callable[[float], DelayCost], longest: float) -> DelayScan:
    """Return the delay in [0, longest] [s] of least cost.

    Args:
        cost: of the recordings for a delay [s].
        longest: end of the range scanned [s].
    """
    found: dict[float, DelayCost] = {}

    def at(delay: float) -> DelayCost:
        key = round(float(delay), 6)
        if key not in found:
            found[key] = cost(key)
        return found[key]

    coarse = np.arange(0.0, longest + 0.5 * _COARSE, _COARSE)
    best = coarse[int(np.argmin([at(d).value for d in coarse]))]
    fine = np.arange(max(0.0, best - _COARSE), min(longest, best + _COARSE) + 0.5 * _FINE, _FINE)
    values = np.array([at(d).value for d in fine])
    i = int(values.argmin())
    delays = np.array(sorted(found))
    costs = np.array([found[d].value for d in delays])
    if len(fine) < 3:
        return DelayScan(float(fine[i]), float("nan"), delays, costs)
    centre = min(max(i, 1), len(fine) - 2)
    low, mid, high = values[centre - 1], values[centre], values[centre + 1]
    bend = low - 2.0 * mid + high
    if not bend > 0.0:
        return DelayScan(float(fine[i]), float("nan"), delays, costs)
    delay = float(fine[i])
    if i == centre:
        delay += 0.5 * _FINE * (low - high) / bend
    std = _deviation(at(fine[centre - 1]).blocks, at(fine[centre + 1]).blocks, bend / _FINE**2)
    return DelayScan(delay, std, delays, costs)


def _deviation(before: Sequence[Array], after: Sequence[Array], curvature: float) -> float:
    """Return the deviation [s] of the delay from the slopes' long-run variance and the criterion's curvature."""
    if not before:
        return float("nan")
    variance = 0.0
    for low, high in zip(before, after, strict=True):
        slope = (high - low) / (2.0 * _FINE)
        slope = slope[slope != 0.0]
        if len(slope) > 4:
            variance += float(long_run((slope - slope.mean())[:, None], _LAGS)[0, 0])
    return float(np.sqrt(variance) / curvature)
