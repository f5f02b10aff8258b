"""Several recordings and what is estimated from them: runs from a point, normal equations, where a step leads.

Where free runs begin: a recording cut into segments, and the state at the start of each by its first samples.

The state only has to be near: it is estimated with the coefficients. A line through a column's first samples (Theil and
Sen: the median of the slopes of all pairs, which a third of outliers does not move) gives its value and its rate.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import euler_rates_matrix, quaternion_product, quaternions_from_eulers, rotation_from_euler
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.data.zero_order_hold import new_zero_order_hold
from towtank.identification.model.parameters import IN_LAG, UNTRANSFORMED, FreeParameters, put_parameters
from towtank.identification.simulation_error.residuals import jumps, robust_cost
from towtank.identification.simulation_error.trajectory import (
    Arrowhead,
    FreeRun,
    Indices,
    NormalEquations,
    Step,
    Workspace,
    free_run,
    new_equations,
    new_workspace,
)

__all__ = ["Point", "Problem", "free_run_of", "residual_scale", "starting_states", "warm_up_of"]

_LOG_STEP = 1.0  # that the logarithm of a coefficient may go in one step
_LAG_STEP, _SHORTEST = -0.5, 0.002  # share that a lag may lose in one step; s, below which it no longer matters
_SEEN = 2000  # residuals that a scale is taken from
_MEDIAN = 0.6744897501960817  # of |x| for a standard normal x
_NOTHING = 1e-12  # information on an initial state, and size of a sensitivity, that is rounding
_WINDOW = 0.5  # s that a line is drawn through
_POINTS = 15  # at most; pairs grow with the square
_FEWEST_ROWS = 3
_WARM_UP, _WARM_UP_ROWS, _WARM_UP_SEGMENTS = 3.0, 25, 8  # s; rows of a segment at least; segments at most
_BLOCK = 0.25  # s, a block of time
_UPRIGHT = 0.05  # cosine of pitch


@dataclass(eq=False)
class Point:
    """The runs of all recordings from one set of coefficients and initial states."""

    theta: Array
    states: list[Array]
    sums: list[NormalEquations]


class Problem:
    """The recordings, and what is estimated from them.

    Attributes:
        estimated: which of the 12 initial errors are. moving: which of the 12 error states answer to anything.
        left_out: measured numbers that belong to jumps.
    """

    def __init__(
        self,
        runs: list[FreeRun],
        p: Array,
        free: FreeParameters,
        prior: tuple[Array, Array],
        delay: float,
    ) -> None:
        self.runs, self.p, self.free, self.prior, self.delay = runs, p, free, prior, delay
        self.lags: NDArray[np.bool_] = free.codes[:, 0] == IN_LAG
        self.logarithmic: NDArray[np.bool_] = free.codes[:, 3] != UNTRANSFORMED
        self.left_out = 0
        self.estimated: Indices = np.arange(12)
        self.moving: Indices = np.arange(12)
        self.space: list[Workspace] = []
        self.spare: list[NormalEquations] = []
        self._allocate()

    def _allocate(self) -> None:
        n = len(self.free)
        columns = self.estimated.size + n
        self.space = [new_workspace(columns, n, run.shape.shape[1]) for run in self.runs]
        self.spare = self._new_sums()

    def _new_sums(self) -> list[NormalEquations]:
        columns = self.estimated.size + len(self.free)
        return [new_equations(run.first.size, int(run.block.max()) + 1, run.t.size, columns) for run in self.runs]

    def evaluate(self, theta: Array, states: list[Array], scale: Array, gated: bool) -> Point | None:
        """Return the runs from here; None where they are impossible or diverge."""
        sums = self.spare
        for run, start, out, space in zip(self.runs, states, sums, self.space, strict=True):
            held = new_zero_order_hold(run.lag.size, run.lag, self.delay)
            if not free_run(
                run, self.p, self.free.codes, theta, held, start, self.estimated, self.moving, scale, gated, out, space
            ):
                return None
            if not (np.isfinite(out.normal).all() and np.isfinite(out.scores).all()):
                return None
        self.spare = self._new_sums()
        return Point(theta, states, sums)

    def narrow(self, point: Point) -> None:
        """From here on estimate only the initial states that the data tell of, and move only what answers."""
        told = np.sum([np.einsum("scc->c", each.normal) for each in point.sums], axis=0)
        k = self.estimated.size
        keep = np.flatnonzero(told[:k] > _NOTHING)
        columns = np.concatenate([keep, k + np.arange(len(self.free))])
        reach = np.sum([each.reach for each in point.sums], axis=0)
        self.moving = np.flatnonzero((reach[:, columns] > _NOTHING).any(axis=1)).astype(np.int64)
        self.estimated = self.estimated[keep]
        old = point.sums
        self._allocate()
        point.sums, self.spare = self.spare, self._new_sums()
        c = columns.size
        for before, after in zip(old, point.sums, strict=True):
            after.normal[:, :c, :c] = before.normal[:, columns[:, None], columns]
            after.scores[:, :c] = before.scores[:, columns]
            after.residuals[:] = before.residuals

    def leave_out_jumps(self, point: Point, scale: Array) -> None:
        """From here on leave out the samples that are off together."""
        for i, (run, each) in enumerate(zip(self.runs, point.sums, strict=True)):
            off = jumps(each.residuals, scale)
            if off.any():
                each.residuals[off] = np.nan
                q = run.q.copy()
                q[off[:, 3:6].any(axis=1)] = np.nan
                self.left_out += int(off.sum())
                self.runs[i] = run._replace(values=np.where(off, np.nan, run.values), q=q)

    def arrowhead(self, point: Point) -> Arrowhead:
        """Return the normal equations at a point, the prior included."""
        k, n = self.estimated.size, len(self.free)
        normal = np.concatenate([each.normal for each in point.sums])
        gx = np.concatenate(
            [
                np.add.reduceat(each.scores[:, :k], run.block[run.first], axis=0)
                for run, each in zip(self.runs, point.sums, strict=True)
            ]
        )
        g = sum((each.scores[:, k : k + n].sum(axis=0) for each in point.sums), np.zeros(n))
        mean, information = self.prior
        return Arrowhead(
            X=normal[:, :k, :k],
            C=normal[:, :k, k : k + n],
            T=normal[:, k : k + n, k : k + n].sum(axis=0) + information,
            gx=gx,
            g=g + information @ (mean - point.theta),
            estimated=self.estimated,
        )

    def bounds(self, theta: Array, *, lag: bool = True) -> tuple[Array, Array]:
        """Return the least and the most (n,) that a step from theta may be; the lag only moves where `lag`."""
        most = np.where(self.logarithmic, _LOG_STEP, np.inf)
        least = -most
        with np.errstate(over="ignore"):
            shortest = np.maximum(_LAG_STEP, np.minimum(_SHORTEST * np.exp(-theta) - 1.0, 0.0))
        least[self.lags] = shortest[self.lags] if lag else 0.0
        most[self.lags] = _LOG_STEP if lag else 0.0
        return least, most

    def cost(self, point: Point, scale: Array, gated: bool) -> float:
        """Return the robust cost of a point, the prior included."""
        away = point.theta - self.prior[0]
        data = sum(robust_cost(each.residuals, scale, gated) for each in point.sums)
        return float(data + 0.5 * away @ self.prior[1] @ away)

    def moved(self, point: Point, step: Step) -> tuple[Array, list[Array]]:
        """Return coefficients and initial states after a step.

        The lag goes by a share of itself, not by a factor: what can be told best is its sum with the delay.
        """
        states = []
        begin = 0
        for start in point.states:
            states.append(_moved(start, step.states[begin : begin + len(start)]))
            begin += len(start)
        theta = np.where(self.lags, np.log1p(np.where(self.lags, step.theta, 0.0)), step.theta)
        return point.theta + theta, states

    def possible(self, theta: Array) -> bool:
        """Whether the mass matrix is positive definite."""
        return bool(put_parameters(self.p.copy(), self.free.codes, theta, np.empty((6, 6))))


def residual_scale(point: Point) -> Array:
    """Return the robust size of each column's residuals (15,), never below that of the noise."""
    residuals = np.concatenate([each.residuals for each in point.sums])
    out = np.ones(N_MEASURED)
    for j in range(N_MEASURED):
        x = residuals[:, j]
        x = x[:: max(1, x.size // _SEEN)]
        x = x[~np.isnan(x)]
        if x.size:
            out[j] = max(1.0, float(np.median(np.abs(x))) / _MEDIAN)
    return out


def _moved(states: Array, errors: Array) -> Array:
    """Return states (s, 13) moved by errors (s, 12)."""
    out = states.copy()
    out[:, :3] += errors[:, :3]
    out[:, 7:] += errors[:, 6:]
    for state, e in zip(out, errors[:, 3:6], strict=True):
        half = 0.5 * float(np.sqrt(e @ e))
        turn = np.concatenate([[np.cos(half)], 0.5 * np.sinc(half / np.pi) * e])
        state[3:7] = quaternion_product(np.ascontiguousarray(state[3:7]), turn)
    return out


def free_run_of(samples: Samples, noise: Array, segment: float | None, gap: float, gains: bool) -> FreeRun:
    """Return a recording as the kernel takes it; thrusters with the same lag are taken together as their wrench.

    Args:
        noise: standard deviation (15,) of every column.
        segment: length [s] that segments are cut to, about; None for no cuts but at gaps.
        gap: time between rows [s] beyond which a new segment begins; at least four times the usual one.
        gains: whether gains of single thrusters are free.
    """
    t, step = samples.t, _usual_step(samples.t)
    first, last = _segments(t, segment, max(gap, 4.0 * step))
    force, shape, lag = samples.input_force, np.ascontiguousarray(samples.B), samples.lag
    if not gains and lag.size and np.all(lag == lag[0]):
        wrench = force @ shape.T
        acting = np.flatnonzero(np.any(wrench != 0.0, axis=0))
        force, shape = np.ascontiguousarray(wrench[:, acting]), np.ascontiguousarray(np.eye(6)[:, acting])
        lag = np.full(acting.size, lag[0])
    new = np.append(True, np.any(force[1:] != force[:-1], axis=1))[: len(force)]
    return FreeRun(
        t=t,
        values=samples.values,
        q=quaternions_from_eulers(np.ascontiguousarray(samples.values[:, 3:6])),
        noise=noise,
        input_t=samples.input_t[new],
        input_force=force[new],
        shape=shape,
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
    """Return the states (s, 13) at the first row of each segment; what nothing tells is zero."""
    out = np.zeros((run.first.size, 13))
    for s, (a, b) in enumerate(zip(run.first, run.last, strict=True)):
        value, slope = np.full(15, np.nan), np.full(15, np.nan)
        for j in range(15):
            x = run.values[a:b, j]
            if 3 <= j < 6:
                x = _without_turns(x)
            value[j], slope[j] = _line(run.t[a:b], x, _WINDOW)
        out[s] = _state(value, slope)
    return out


def _state(value: Array, slope: Array) -> Array:
    """Return the state (13,) of values and rates of the 15 columns at one instant, NaN where unknown."""
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
    derived = np.concatenate([speed, turning])
    state[7:13] = np.where(np.isnan(value[6:12]), derived, value[6:12])
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
