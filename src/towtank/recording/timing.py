"""Rates and gaps of time stamps, regular or not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array

__all__ = ["find_gaps", "gap_limit", "median_step", "sampling_rate"]

_MINIMUM_GAP = 0.15  # s; shorter holes are always bridged


def median_step(t: Array) -> float:
    """Median step [s] of the times (n,); NaN where n < 2."""
    return float(np.median(np.diff(t))) if t.size > 1 else float("nan")


def gap_limit(t: Array, gap: float | None = None) -> float:
    """Longest step [s] that is bridged: `gap`, else three median steps but at least 0.15 s."""
    if gap is not None:
        return gap
    return max(3.0 * median_step(t), _MINIMUM_GAP) if t.size > 1 else _MINIMUM_GAP


def find_gaps(t: Array, gap: float | None = None) -> NDArray[np.intp]:
    """Indices i of the samples after which a gap begins: t[i+1] - t[i] exceeds the limit."""
    limit = gap_limit(t, gap)
    return np.flatnonzero(np.diff(t) > limit * (1.0 + 1e-9))


def sampling_rate(t: Array) -> float:
    """Rate [Hz] of the times (n,): that of the usual steps, gaps left out; NaN where n < 2.

    The usual step is the mean of those within 20 % of the median one, which undoes the rounding of printed
    stamps. Stamps that come in bursts (many receive times close together, then a pause) give their mean rate
    instead.
    """
    if t.size < 2:
        return float("nan")
    steps = np.diff(t)
    median = float(np.median(steps))
    near = steps[np.abs(steps - median) <= 0.2 * median]
    usual = float(near.mean()) if near.size else median
    inside = steps[steps <= max(3.0 * median, _MINIMUM_GAP)]
    mean = float(inside.mean())
    rate = 1.0 / (mean if mean > 1.5 * usual else usual)
    whole = round(rate)
    return float(whole) if whole and abs(rate - whole) <= 1e-6 * rate else rate
