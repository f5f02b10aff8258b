"""Body speeds of a grid, derived from the pose where they were not measured, and the filter that makes them usable."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.recording import Grid
from towtank.recording.rotations import conjugate, rotate

__all__ = ["DERIVED_CORNER", "filled", "lowpass", "speeds"]

DERIVED_CORNER = 12.0  # 1/s, of the low-pass that a derived speed needs
_CUT = 7.0  # times the median deviation from the running mean


def lowpass(x: Array, dt: float, a: float) -> Array:
    """Pass x (n,) or its columns (n, k) through a / (s + a), from rest at the first row."""
    from scipy.signal import lfilter  # slow to import, seldom needed

    keep = np.exp(-a * dt)
    start = keep * x[:1] if x.ndim == 2 else keep * x[0]
    smooth, _ = lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=np.atleast_1d(start))
    return np.asarray(smooth)


def filled(x: Array) -> Array:
    """Return x (n,) with its NaN interpolated; zeros where it has no value."""
    finite = np.isfinite(x)
    rows = np.arange(x.size)
    return np.interp(rows, rows[finite], x[finite]) if finite.any() else np.zeros(x.size)


def speeds(grid: Grid) -> Array:
    """Return u v w p q r (n, 6), measured, or else derived from the pose by central differences; NaN if unknown."""
    found = np.array(grid.velocity)
    absent = ~np.isfinite(found).any(axis=0)
    if not absent.any() or not grid.attitude_known.any() or len(grid) < 3:
        return found
    phi, theta = grid.pose[:, 3], grid.pose[:, 4]
    rates = np.gradient(grid.pose, grid.dt, axis=0)
    p, q, r = rates[:, 3], rates[:, 4], rates[:, 5]
    turning = np.column_stack(
        [
            p - r * np.sin(theta),
            q * np.cos(phi) + r * np.cos(theta) * np.sin(phi),
            r * np.cos(theta) * np.cos(phi) - q * np.sin(phi),
        ]
    )
    derived = np.hstack([rotate(conjugate(grid.quaternion), rates[:, :3]), turning])
    for i in np.flatnonzero(absent):
        found[:, i] = _without_jumps(derived[:, i], grid.dt)
    return found


def _without_jumps(speed: Array, dt: float) -> Array:
    """Return a derived speed (n,) with the spikes that a jump of the pose makes cut to its running mean."""
    whole = filled(speed)
    limit = _CUT * float(np.median(np.abs(whole - lowpass(whole, dt, DERIVED_CORNER))))
    for _ in range(2):
        mean = lowpass(whole, dt, DERIVED_CORNER)
        whole = np.clip(whole, mean - limit, mean + limit)
    return np.where(np.isfinite(speed), whole, np.nan)
