"""Thruster curves backwards: force -> command.

Each side of the neutral command is one branch. On a branch the smallest command that reaches the force is taken, so a
polynomial that dips is no trouble. A force beyond the end saturates at the command of the largest force. Within the
dead band nothing can be had: a force smaller than half of the first step gives the neutral command, a larger one the
edge of the dead band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.vehicle.curves import Curve, TableCurve, voltage_factor

__all__ = ["command", "force_range"]

_SAMPLES = 1025
_BISECTIONS = 56
_DOUBLINGS = 60


@dataclass(frozen=True)
class _Branch:
    """One side of a curve: distances a from the neutral command, and the largest |force| up to each."""

    side: int  # +1 above the neutral command, -1 below
    sign: int  # of the force
    a: Array
    reached: Array
    bounded: bool


def _branch(curve: Curve, side: int, demand: float) -> _Branch | None:
    """Return the branch on one side, long enough for `demand` [N]; None where it has no length or no force."""
    start = curve.dead_band
    end = _end(curve, side)
    bounded = end is not None
    if end is None:
        end = max(2.0 * start, 1.0)
        for _ in range(_DOUBLINGS):
            if abs(float(curve.static(np.array(curve.rest + side * end)))) >= demand:
                break
            end *= 2.0
    if end <= start:
        return None
    a = np.linspace(start, end, _SAMPLES)
    if isinstance(curve, TableCurve):
        knots = side * (np.array(curve.command) - curve.rest)
        a = np.unique(np.concatenate(([start, end], knots[(knots > start) & (knots < end)])))
    f = curve.static(curve.rest + side * a)
    sign = 1 if f[np.argmax(np.abs(f))] > 0.0 else -1
    reached = np.maximum.accumulate(np.maximum(sign * f, 0.0))
    return _Branch(side, sign, a, reached, bounded) if reached[-1] > 0.0 else None


def _end(curve: Curve, side: int) -> float | None:
    """Return how far from neutral the commands go on one side; None without limits."""
    ends = []
    if curve.limits is not None:
        ends.append(side * (curve.limits[(side + 1) // 2] - curve.rest))
    if isinstance(curve, TableCurve):
        ends.append(side * (curve.command[-1 if side > 0 else 0] - curve.rest))
    return max(min(ends), 0.0) if ends else None


def _branches(curve: Curve, demand: float) -> dict[int, _Branch]:
    """Return the branch that serves each sign of force (above the neutral command first)."""
    found: dict[int, _Branch] = {}
    for side in (1, -1):
        branch = _branch(curve, side, demand)
        if branch is not None:
            found.setdefault(branch.sign, branch)
    return found


def force_range(curve: Curve, voltage: float | None = None) -> tuple[float, float]:
    """Return the most negative and the most positive force [N] of a curve; infinite without limits."""
    ends = {-1: 0.0, 1: 0.0}
    for sign, branch in _branches(curve, 0.0).items():
        reach = float(branch.reached[-1]) if branch.bounded else np.inf
        ends[sign] = sign * reach * float(voltage_factor(curve, np.array(float(sign)), voltage))
    return ends[-1], ends[1]


def command(curve: Curve, force: ArrayLike, voltage: ArrayLike | None = None) -> Array:
    """Return the command that makes `force` [N], nearest where it cannot be had.

    Args:
        force: any shape; NaN gives NaN.
        voltage: supply voltage [V], broadcast against `force`; ignored by a curve without `voltage`.
    """
    f = np.asarray(force, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(f == 0.0, f, f / voltage_factor(curve, f, voltage))
    out = np.where(np.isnan(f), np.nan, curve.rest)
    finite = np.abs(f[np.isfinite(f)])
    for sign, branch in _branches(curve, float(finite.max(initial=0.0))).items():
        wanted = (sign * f) > 0.0
        if np.any(wanted):
            out[wanted] = curve.rest + branch.side * _distance(curve, branch, np.abs(f[wanted]))
    return np.asarray(out)


def _distance(curve: Curve, branch: _Branch, demand: Array) -> Array:
    """Return how far from neutral to go for each |force| in `demand` (k,)."""
    k = np.searchsorted(branch.reached, demand, side="left")
    saturated = k == branch.a.size
    below = k == 0
    full = branch.a[np.searchsorted(branch.reached, branch.reached[-1])]
    k = np.clip(k, 1, branch.a.size - 1)
    low, high = branch.a[k - 1], branch.a[k]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        enough = branch.sign * curve.static(curve.rest + branch.side * middle) >= demand
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    step = np.where(demand > 0.5 * branch.reached[0], branch.a[0], 0.0)
    return np.where(saturated, full, np.where(below, step, high))
