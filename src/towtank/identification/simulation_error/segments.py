"""A recording as free runs take it: cut into segments, each of which starts from a state of its own.

The state only has to be near: it is estimated with the coefficients. A line through a column's first samples (Theil and
Sen: the median of the slopes of all pairs, which a third of outliers does not move) gives its value and its rate.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import euler_rates_matrix, quaternions_from_eulers, rotation_from_euler
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.model.measurements import SPEEDS
from towtank.identification.model.parameters import FreeParameters
from towtank.vehicle import Vehicle

__all__ = ["CandidateModel", "Knowledge"]

_WINDOW = 0.5  # s that a line is drawn through
_POINTS = 15  # at most; pairs grow with the square
_FEWEST_ROWS = 3
_WARM_UP, _WARM_UP_ROWS, _WARM_UP_SEGMENTS = 3.0, 25, 8  # s; rows of a segment at least; segments at most
_BLOCK = 0.25  # s, a block of time
_UPRIGHT = 0.05  # cosine of pitch
Indices = NDArray[np.int64]
Knowledge = tuple[Array, Array]  # mean (n,) and information (n, n) of theta, known beforehand


@dataclass(frozen=True, eq=False)
class CandidateModel:
    """A vehicle, which of its coefficients are free, and where these stand.

    Attributes:
        vehicle: what is held. free: what is not. theta: its values (n,) as `FreeParameters` writes them.
        delay: of the inputs [s], where it is not free.
    """

    vehicle: Vehicle
    free: FreeParameters
    theta: Array
    delay: float = 0.0

    @property
    def parameters(self) -> Array:
        """Parameters of the vehicle's kernels (170,)."""
        return np.array(self.vehicle.parameters)


class FreeRun(NamedTuple):
    """One recording, cut into segments that each start from a state of their own."""

    t: Array  # (n,) [s]
    values: Array  # (n, 18) as `Samples`
    q: Array  # (n, 4) measured attitude, NaN where not all three angles are
    noise: Array  # (18,) standard deviations
    input_t: Array  # (k,) [s]
    input_force: Array  # (k, m)
    B: Array  # (6, m) wrench of a unit of each input
    lag: Array  # (m,) [s], where it is not free
    first: Indices  # (s,) first row of each segment
    last: Indices  # (s,) one past its last row
    block: Indices  # (n,) block of time of each row


def free_run_of(samples: Samples, noise: Array, segment: float | None, gap: float, single: bool) -> FreeRun:
    """Return a recording as the kernel takes it; thrusters with the same lag are taken together as their wrench.

    Args:
        noise: standard deviation (18,) of every column.
        segment: length [s] that segments are cut to, about; None for no cuts but at gaps.
        gap: time between rows [s] beyond which a new segment begins; at least four times the usual one.
        single: whether single thrusters count: their gains, or their losses by inflow.
    """
    t, step = samples.t, _usual_step(samples.t)
    first, last = _segments(t, segment, max(gap, 4.0 * step))
    force, B, lag = samples.input_force, np.ascontiguousarray(samples.B), samples.lag
    if not single and lag.size and np.all(lag == lag[0]):
        wrench = force @ B.T
        acting = np.flatnonzero(np.any(wrench != 0.0, axis=0))
        force, B = np.ascontiguousarray(wrench[:, acting]), np.ascontiguousarray(np.eye(6)[:, acting])
        lag = np.full(acting.size, lag[0])
    new = np.append(True, np.any(force[1:] != force[:-1], axis=1))[: len(force)]
    return FreeRun(
        t=t,
        values=samples.values,
        q=quaternions_from_eulers(np.ascontiguousarray(samples.values[:, 3:6])),
        noise=noise,
        input_t=samples.input_t[new],
        input_force=force[new],
        B=B,
        lag=lag,
        first=np.array(first, dtype=np.int64),
        last=np.array(last, dtype=np.int64),
        block=_blocks(t, first, last, max(_BLOCK, 4.0 * step)),
    )


def warm_up_of(samples: Samples, run: FreeRun, segment: float | None, gap: float) -> FreeRun:
    """Return some short segments of a run, in which not much can go wrong; the run itself where it is short anyhow."""
    step = _usual_step(samples.t)
    length = max(_WARM_UP, _WARM_UP_ROWS * step)
    whole = samples.duration if segment is None else min(segment, samples.duration)
    if whole < 2.0 * length:
        return run
    first, last = _segments(samples.t, length, max(gap, 4.0 * step))
    some = np.unique(np.linspace(0, len(first) - 1, _WARM_UP_SEGMENTS).astype(np.int64))
    first, last = [first[i] for i in some], [last[i] for i in some]
    return run._replace(
        first=np.array(first, dtype=np.int64),
        last=np.array(last, dtype=np.int64),
        block=_blocks(samples.t, first, last, length),
    )


def _usual_step(t: Array) -> float:
    return float(np.median(np.diff(t))) if t.size > 1 else 1.0


def _segments(t: Array, length: float | None, gap: float) -> tuple[list[int], list[int]]:
    """Return the first row of each segment and one past its last: between gaps [s], about as long as `length` [s]."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(t) > gap) + 1, [t.size]])
    first: list[int] = []
    last: list[int] = []
    for a, b in itertools.pairwise(edges):
        parts = 1 if length is None else max(1, round((t[b - 1] - t[a]) / length))
        cuts = a + np.searchsorted(t[a:b], np.linspace(t[a], t[b - 1], parts + 1)[1:-1])
        for c, d in zip([a, *cuts], [*cuts, b], strict=True):
            if d - c >= _FEWEST_ROWS:
                first.append(int(c))
                last.append(int(d))
    return first, last


def _blocks(t: Array, first: list[int], last: list[int], length: float) -> Indices:
    """Return the block of each row (n,): segments are divided evenly, rows of none are in block 0."""
    block = np.zeros(t.size, dtype=np.int64)
    begin = 0
    for a, b in zip(first, last, strict=True):
        span = float(t[b - 1] - t[a])
        count = max(1, round(span / length))
        within = (t[a:b] - t[a]) * (count / span) if span > 0.0 else np.zeros(b - a)
        block[a:b] = begin + np.minimum(within.astype(np.int64), count - 1)
        begin += count
    return block


def starting_states(run: FreeRun) -> Array:
    """Return the states (s, 13) at the first row of each segment; what nothing shows is zero."""
    out = np.zeros((run.first.size, 13))
    for s, (a, b) in enumerate(zip(run.first, run.last, strict=True)):
        value, slope = np.full(N_MEASURED, np.nan), np.full(N_MEASURED, np.nan)
        for j in range(N_MEASURED):
            x = run.values[a:b, j]
            if 3 <= j < 6:
                x = _without_turns(x)
            value[j], slope[j] = _line(run.t[a:b], x, _WINDOW)
        out[s] = _state(value, slope)
    return out


def _state(value: Array, slope: Array) -> Array:
    """Return the state (13,) of values and rates of the 18 columns at one instant, NaN where unknown."""
    angles = value[3:6].copy()
    f = value[12:15]
    if np.isnan(angles[:2]).any() and np.isfinite(f).all():
        tilt = (math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2])))
        angles[:2] = np.where(np.isnan(angles[:2]), tilt, angles[:2])
    angles[np.isnan(angles)] = 0.0
    state = np.zeros(13)
    state[:3] = np.nan_to_num(value[:3])
    state[3:7] = quaternions_from_eulers(angles[None, :])[0]
    speed = rotation_from_euler(*angles).T @ np.nan_to_num(slope[:3])
    turning: Array = np.zeros(3)
    if math.cos(angles[1]) > _UPRIGHT:
        turning[:] = np.linalg.solve(euler_rates_matrix(angles[0], angles[1]), np.nan_to_num(slope[3:6]))
    for shown in (value[3 * sensor : 3 * sensor + 3] for sensor in reversed(SPEEDS)):
        speed = np.where(np.isnan(shown), speed, shown)
    state[7:10], state[10:] = speed, np.where(np.isnan(value[9:12]), turning, value[9:12])
    return state


def _without_turns(angles: Array) -> Array:
    known = np.isfinite(angles)
    out = angles.copy()
    out[known] = np.unwrap(angles[known])
    return out


@kernel
def _line(t: Array, x: Array, window: float) -> tuple[float, float]:
    """Return value at t[0] and slope of the line through the first samples of x (n,), NaN where there are none."""
    end = 0
    known = 0
    for i in range(t.shape[0]):
        if math.isfinite(x[i]):
            if t[i] - t[0] > window and known >= 5:
                break
            known += 1
            end = i + 1
    if known == 0:
        return math.nan, math.nan
    every = (known + _POINTS - 1) // _POINTS
    ts, xs = np.empty(_POINTS), np.empty(_POINTS)
    n, seen = 0, 0
    for i in range(end):
        if math.isfinite(x[i]):
            if seen % every == 0:
                ts[n], xs[n] = t[i] - t[0], x[i]
                n += 1
            seen += 1
    if n == 1:
        return xs[0], math.nan
    slopes = np.empty(n * (n - 1) // 2)
    k = 0
    for i in range(n):
        for j in range(i):
            slopes[k] = (xs[i] - xs[j]) / (ts[i] - ts[j])
            k += 1
    slope = float(np.median(slopes))
    return float(np.median(xs[:n] - slope * ts[:n])), slope
