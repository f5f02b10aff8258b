"""What a log shows without a vehicle: which axes follow the inputs, and after which delay.

For each axis the acceleration is regressed on the inputs (each and its square with its sign, since thrust is about
quadratic in the command) and on the speed, both sides through the same first-order filter; the speed is measured or
derived from the pose. The delay is the one that leaves the least unexplained; the share that the inputs explain says
whether the axis was driven at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from towtank.core.arrays import Array
from towtank.identification.chain import Sources
from towtank.identification.delay import DelayScan, scan_delay
from towtank.recording import Grid

__all__ = ["DRIVEN", "FirstLook", "first_look", "velocities"]

_FILTER = 8.0  # 1/s
_EXTRA = 12.0  # 1/s, two more poles where speed is derived from the pose
_CUT = 7.0  # times the median deviation from the running mean
_LONGEST = 0.4  # s
DRIVEN = 0.3  # share explained from which an axis counts as driven
_MOST_ROWS = 60_000
_FEW = 50


@dataclass(frozen=True)
class FirstLook:
    """Delay scan (None without a driven axis), and per axis the share 0 .. 1 of its acceleration that inputs explain
    (NaN where its speed is unknown)."""

    scan: DelayScan | None
    explained: tuple[float, ...]
    sources: Sources


def velocities(grid: Grid) -> Array:
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
    derived = np.hstack([_into_body(grid, rates[:, :3]), turning])
    for i in np.flatnonzero(absent):
        found[:, i] = _without_jumps(derived[:, i], grid.dt)
    return found


def _without_jumps(speed: Array, dt: float) -> Array:
    """Return a derived speed (n,) with the spikes that a jump of the pose makes put on its running mean."""
    finite = np.isfinite(speed)
    if finite.sum() < _FEW:
        return speed
    rows = np.arange(speed.size)
    whole = np.interp(rows, rows[finite], speed[finite])
    limit = _CUT * float(np.median(np.abs(whole - _smooth(whole, dt, _EXTRA))))
    for _ in range(2):
        mean = _smooth(whole, dt, _EXTRA)
        whole = np.clip(whole, mean - limit, mean + limit)
    return np.where(finite, whole, np.nan)


def _into_body(grid: Grid, world: Array) -> Array:
    """Return vectors (n, 3) of the world in the body."""
    w, v = grid.quaternion[:, :1], grid.quaternion[:, 1:]
    return world - 2.0 * w * np.cross(v, world) + 2.0 * np.cross(v, np.cross(v, world))


def first_look(grid: Grid) -> FirstLook:
    """Look at a grid that has inputs (commands, else a wrench)."""
    sources = Sources.of(grid.pose, grid.velocity, grid.acceleration)
    nu = velocities(grid)[:_MOST_ROWS]
    axes = [i for i in range(6) if np.isfinite(nu[:, i]).sum() > _FEW]
    extra = 2 if "derived" in sources.velocity else 0
    filtered = {i: _Axis.of(nu[:, i], grid.dt, extra) for i in axes}
    n = nu.shape[0]

    def regressors(delay: float) -> Array:
        means = (grid.command_means(delay) if grid.command_t.size else grid.wrench_means(delay))[: n - 1]
        means = means[:, np.isfinite(means).any(axis=0)]
        away = np.nan_to_num(means - np.nanmedian(means, axis=0))
        size = np.abs(away).max(axis=0)
        away = away[:, size > 0.0] / size[size > 0.0]
        return _passed(np.hstack([away, away * np.abs(away)]), grid.dt, extra)

    def cost(delay: float) -> float:
        inputs = regressors(delay)
        return sum(axis.rows * np.log(axis.unexplained(inputs)) for axis in filtered.values())

    still = regressors(0.0)
    explained = [filtered[i].explained(still) if i in filtered else float("nan") for i in range(6)]
    filtered = {i: axis for i, axis in filtered.items() if explained[i] > DRIVEN}
    if not filtered or not still.shape[1]:
        return FirstLook(None, tuple(explained), sources)
    scan = scan_delay(cost, _LONGEST)
    best = regressors(scan.delay)
    for i, axis in filtered.items():
        explained[i] = axis.explained(best)
    return FirstLook(scan, tuple(explained), sources)


def _passed(x: Array, dt: float, extra: int) -> Array:
    """Pass x (n,) or its columns (n, k) through all filters."""
    for _ in range(extra):
        x = _smooth(x, dt, _EXTRA)
    return _smooth(x, dt)


def _smooth(x: Array, dt: float, a: float = _FILTER) -> Array:
    """Pass x (n,) or its columns (n, k) through a / (s + a), from rest at the first row."""
    keep = np.exp(-a * dt)
    start = keep * x[:1] if x.ndim == 2 else keep * x[0]
    smooth, _ = lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=np.atleast_1d(start))
    return np.asarray(smooth)


@dataclass(frozen=True)
class _Axis:
    """One axis, one row for each step of the grid.

    Attributes:
        acceleration: filtered, over the step (n-1,). speed: what drag may depend on, at its start (n-1, 3).
        known: False in gaps and while the filters settle (n-1,).
    """

    acceleration: Array
    speed: Array
    known: Array

    @classmethod
    def of(cls, speed: Array, dt: float, extra: int) -> _Axis:
        finite = np.isfinite(speed)
        rows = np.arange(speed.size)
        whole = np.interp(rows, rows[finite], speed[finite])
        for _ in range(extra):
            whole = _smooth(whole, dt, _EXTRA)
        smooth = _smooth(whole, dt)
        acceleration = _FILTER * (whole - smooth)
        columns = np.column_stack([smooth, _smooth(whole * np.abs(whole), dt), np.ones(speed.size)])
        settled = rows > 3.0 / (_FILTER * dt)
        return cls(acceleration[1:], columns[:-1], finite[:-1] & finite[1:] & settled[:-1])

    @property
    def rows(self) -> int:
        return int(self.known.sum())

    def unexplained(self, inputs: Array) -> float:
        """Return the sum of squares left by inputs (n-1, k) and speed together."""
        return _left(np.hstack([inputs, self.speed])[self.known], self.acceleration[self.known])

    def explained(self, inputs: Array) -> float:
        """Return the share 0 .. 1 of what the speed leaves open that the inputs explain."""
        rows = self.known
        if rows.sum() < _FEW:
            return float("nan")
        without = _left(self.speed[rows], self.acceleration[rows])
        return 1.0 - self.unexplained(inputs) / without if without > 0.0 else 0.0


def _left(columns: Array, y: Array) -> float:
    theta, *_ = np.linalg.lstsq(columns, y, rcond=None)
    return max(float(np.sum((y - columns @ theta) ** 2)), 1e-300)
