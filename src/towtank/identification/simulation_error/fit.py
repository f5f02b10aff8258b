"""Output error: the coefficients whose free run, nothing measured correcting it on the way, fits a log best.

Gauss and Newton's steps, damped after Levenberg and Marquardt where one does not help, over the coefficients and the
initial state of every segment at once (`simulation_error.trajectory`). First over short segments, in which not much can
go wrong whatever the coefficients: an unstable vehicle's free run is soon anywhere. From there the whole runs. Each
column is weighed by its noise, or by the robust size of its own residuals where that is larger, from the first step on:
were the data worth less at first, the prior alone would lead the coefficients off. Huber's weights begin at 2 of these;
once the run is near the data, what is beyond 4.5 is left out.

It is the best judge where nothing but the sensors' noise parts the model from the data; a random force, which a free
run cannot follow, spoils it: `OutputErrorFit.autocorrelation` says so.

The covariance honours residuals that are not white,

    Cov = kappa^2 I^-1 S I^-1,   I the information that is left once the initial states are unknown,

S the long-run covariance of the score, a prewhitened Bartlett sum over blocks of time
(`posterior.statistics.long_run`) that reaches as far as the residuals are correlated, and kappa = sum of weights / sum
of psi' (Huber, Robust Statistics, section 7.6). The sum varies itself, the more the fewer of its reaches the run is
long: intervals are widened by the share of the run that it takes in (Kiefer and Vogelsang, Econometric Theory 21, 2005,
at 95 %). No coefficient is taken to be better known than white residuals of their own size would have it. Of a random
force slower than the run, the run takes most for motion: nothing of it is left in the residuals, and no sum over them
can tell. Residuals correlated over more than about a twentieth of the run mean intervals that are too short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_product
from towtank.core.layout import I_INFLOW, INFLOW
from towtank.core.zero_order_hold import new_zero_order_hold
from towtank.errors import InputError
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.model.parameters import IN_GAIN, IN_LAG, UNTRANSFORMED, put_parameters
from towtank.identification.posterior.physical import Region
from towtank.identification.posterior.statistics import long_run
from towtank.identification.simulation_error.residuals import (
    GATE,
    NORMAL_MEDIAN,
    Autocorrelation,
    RobustMoments,
    autocorrelation_of,
    jumps,
    robust_cost,
    robust_moments,
)
from towtank.identification.simulation_error.segments import (
    CandidateModel,
    FreeRun,
    Indices,
    Knowledge,
    free_run_of,
    starting_states,
    warm_up_of,
)
from towtank.identification.simulation_error.trajectory import (
    Arrowhead,
    NormalEquations,
    Step,
    Unknowns,
    Within,
    Workspace,
    free_run_into,
    inverse_information,
    new_equations,
    new_workspace,
)

__all__ = ["OutputErrorFit"]

_FACTOR = 1.7  # times what it is, and a deviation of the prior more, that damping may grow in one step
_LOG_STEP = 1.0  # that the logarithm of a coefficient may go in one step
_LAG_SHARE, _LAG_STEP = 0.5, 0.02  # that a lag may lose in one step; s, that it may gain, or as much as it is
_SHORTEST = 0.002  # s, below which a lag no longer matters
_ROWS_FOR_SCALE = 2000  # residuals that a scale is taken from
_NOTHING = 1e-12  # information on an initial state, and size of a sensitivity, that is rounding
_NEAR = 1.0  # decrease of the cost from which the gate is in force
_NEAR_SCALE, _NEAR_SHARE = 1.5, 0.05  # or the size of the residuals, and a decrease of this share of the cost
_FIXED = 2  # steps within the gate after which the scales stay as they are
_SETTLED = 0.03  # decrease of the cost, half of a squared deviation, whose step is taken without another run
_UNSURE = 1.0  # decrease within the coefficients' deviations: not borne out by a run, it is the derivatives' own error
_TOLERATED = 1e-3  # increase of the cost that a step may cause: the derivatives are of second order in the step
_MOST_DAMPED = 1e6
_WARM, _WARM_RUNS = 0.3, 12  # share of the cost that a step still lowers, and runs, after which the warm-up ends
_STATES = 2  # of each segment, a position and a velocity, that share in a coefficient's own axis
_CONTAMINATED = 1.5  # largest kappa


@dataclass(frozen=True, eq=False)
class Point:
    """The runs of all recordings from one set of coefficients and initial states."""

    theta: Array
    states: list[Array]
    sums: list[NormalEquations]


class FreeRunProblem:
    """The recordings, and what is estimated from them.

    Attributes:
        estimated: which of the 12 initial errors are. moving: which of the 12 error states answer to anything.
        left_out: measured numbers that belong to jumps.
    """

    def __init__(self, runs: list[FreeRun], model: CandidateModel, prior: Knowledge) -> None:
        self.runs, self.free, self.prior, self.delay = runs, model.free, prior, model.delay
        self.parameters = model.parameters
        self.region = Region(model.vehicle, model.free)
        self.lags: NDArray[np.bool_] = self.free.codes[:, 0] == IN_LAG
        self.logarithmic: NDArray[np.bool_] = self.free.codes[:, 3] != UNTRANSFORMED
        self.left_out = 0
        self.estimated: Indices = np.arange(12)
        self.moving: Indices = np.arange(12)
        self.space: list[Workspace] = []
        self.spare: list[NormalEquations] = []
        self._allocate()

    def _allocate(self) -> None:
        n = len(self.free)
        columns = self.estimated.size + n
        self.space = [new_workspace(columns, n, run.B.shape[1]) for run in self.runs]
        self.spare = self._new_sums()

    def _new_sums(self) -> list[NormalEquations]:
        columns = self.estimated.size + len(self.free)
        return [new_equations(run.first.size, int(run.block.max()) + 1, run.t.size, columns) for run in self.runs]

    def evaluate(self, theta: Array, states: list[Array], scale: Array, gated: bool) -> Point | None:
        """Return the runs from here; None where they are impossible or diverge."""
        sums = self.spare
        for run, start, out, space in zip(self.runs, states, sums, self.space, strict=True):
            hold = new_zero_order_hold(run.lag.size, run.lag, self.delay)
            unknowns = Unknowns(self.free.codes, theta, start, self.estimated, self.moving)
            if not free_run_into(run, self.parameters, unknowns, hold, scale, gated, out, space):
                return None
            if not (np.isfinite(out.normal).all() and np.isfinite(out.scores).all()):
                return None
        self.spare = self._new_sums()
        return Point(theta, states, sums)

    def weighed(self, theta: Array, states: list[Array]) -> tuple[Point, Array] | None:
        """Return the runs from here, weighed by the size (18,) of what they miss, and it; None where they fail.

        From here on only the initial states that the data show are estimated, and only what answers moves.
        """
        start = self.evaluate(theta, states, np.ones(N_MEASURED), False)
        if start is None:
            return None
        k = self.estimated.size
        information = np.sum([np.einsum("scc->c", each.normal) for each in start.sums], axis=0)
        keep = np.flatnonzero(information[:k] > _NOTHING)
        reach = np.sum([each.reach for each in start.sums], axis=0)
        reach = reach[:, np.concatenate([keep, k + np.arange(len(self.free))])]
        self.moving = np.flatnonzero((reach > _NOTHING).any(axis=1)).astype(np.int64)
        self.estimated = self.estimated[keep]
        self._allocate()
        scale = residual_scale(start)
        point = self.evaluate(theta, states, scale, False)
        return None if point is None else (point, scale)

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
        """Return the least and the most (n,) that a step from theta within its bounds may be; the lag only moves where
        `lag`.
        """
        most = np.where(self.logarithmic, _LOG_STEP, np.inf)
        least = -most
        now = theta[self.lags]
        least[self.lags] = np.maximum(-_LAG_SHARE * now, np.minimum(_SHORTEST - now, 0.0)) if lag else 0.0
        most[self.lags] = np.maximum(now, _LAG_STEP) if lag else 0.0
        low, high = self.free.bounds
        known = np.diag(self.prior[1]) > 0.0
        farthest = _FACTOR * np.abs(theta) + np.where(known, np.diag(self.prior[1]), np.inf) ** -0.5
        farthest[farthest == 0.0] = np.inf
        least = np.where(high == 0.0, np.maximum(least, -farthest), least)  # of damping
        return np.maximum(least, np.minimum(low - theta, 0.0)), np.minimum(most, np.maximum(high - theta, 0.0))

    def within(self, theta: Array) -> Within:
        """Return what makes a step from theta (n,) end where the coefficients are physical."""
        return lambda step, covariance: self.region.nearest(theta + step, covariance) - theta

    def cost(self, point: Point, scale: Array, gated: bool) -> float:
        """Return the robust cost of a point, the prior included."""
        away = point.theta - self.prior[0]
        data = sum(robust_cost(each.residuals, scale, gated) for each in point.sums)
        return float(data + 0.5 * away @ self.prior[1] @ away)

    def moved(self, point: Point, step: Step) -> tuple[Array, list[Array]]:
        """Return coefficients and initial states after a step."""
        states = []
        begin = 0
        for start in point.states:
            states.append(_moved(start, step.states[begin : begin + len(start)]))
            begin += len(start)
        return point.theta + step.theta, states

    def possible(self, theta: Array) -> bool:
        """Whether the mass matrix is positive definite."""
        return bool(put_parameters(self.parameters.copy(), self.free.codes, theta, np.empty((6, 6))))


def residual_scale(point: Point) -> Array:
    """Return the robust size of each column's residuals (18,), never below that of the noise."""
    residuals = np.concatenate([each.residuals for each in point.sums])
    out = np.ones(N_MEASURED)
    for j in range(N_MEASURED):
        x = residuals[:, j]
        x = x[:: max(1, x.size // _ROWS_FOR_SCALE)]
        x = x[~np.isnan(x)]
        if x.size:
            out[j] = max(1.0, float(np.median(np.abs(x))) / NORMAL_MEDIAN)
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


@dataclass(frozen=True, eq=False)
class Descent:
    """Where the steps ended.

    Attributes:
        point: the last runs. step: the small one that would come next. scale: of the residuals (18,).
        runs: how many were made. converged: whether nothing was left to gain.
    """

    point: Point
    step: Step
    scale: Array
    runs: int
    converged: bool


def warm_up(problem: FreeRunProblem, theta: Array, states: list[Array]) -> tuple[Array, list[Array]]:
    """Return coefficients (n,) and initial states after some steps over short segments.

    The lag is held: while nothing else is right it would run away, and the delay does for it.
    """
    weighed = problem.weighed(theta, states)
    if weighed is None:
        return theta, states
    point, scale = weighed
    runs, damping = 0, 0.0
    while True:
        arrowhead, cost = problem.arrowhead(point), problem.cost(point, scale, False)
        step = arrowhead.step(damping, *problem.bounds(point.theta, lag=False), problem.within(point.theta))
        if step.decrease < _WARM * cost or runs >= _WARM_RUNS:
            break
        trial = problem.evaluate(*problem.moved(point, step), scale, False)
        runs += 1
        if trial is not None and problem.cost(trial, scale, False) < cost:
            point, damping = trial, 0.1 * damping
        else:
            damping = max(1e-3, 100.0 * damping)
    return problem.moved(point, step)


def descend(problem: FreeRunProblem, theta: Array, states: list[Array], most: int) -> Descent | None:
    """Return the best fit within `most` runs; None where already the first run is impossible."""
    weighed = problem.weighed(theta, states)
    if weighed is None:
        return None
    point, scale = weighed
    gated, fixed = False, 0
    damping, runs = 0.0, 2
    while True:
        arrowhead = problem.arrowhead(point)
        step = arrowhead.step(damping, *problem.bounds(point.theta), problem.within(point.theta))
        if gated and step.decrease < _SETTLED:
            return Descent(point, step, scale, runs, True)
        if runs >= most:
            return Descent(point, step, scale, runs, False)
        # The next run is weighed anew; whether its step helped is judged by what it was meant to lower.
        old_scale, old_gated = scale, gated
        if fixed < _FIXED:
            fixed += gated
            scale = residual_scale(point)
            if gated:
                problem.leave_out_jumps(point, scale)
            decrease = step.decrease * float(np.min(old_scale / scale)) ** 2
            near = scale.max() < _NEAR_SCALE and decrease < _NEAR_SHARE * problem.cost(point, scale, gated)
            gated = gated or near or decrease < _NEAR
        cost = problem.cost(point, old_scale, old_gated)
        while True:
            trial = problem.evaluate(*problem.moved(point, step), scale, gated)
            runs += 1
            gained = -np.inf if trial is None else cost - problem.cost(trial, old_scale, old_gated)
            if old_gated and step.decrease < _UNSURE and gained <= _TOLERATED:
                nowhere = Step(np.zeros_like(step.theta), np.zeros_like(step.states), 0.0)
                return Descent(point, nowhere, old_scale, runs, True)
            if trial is not None and gained >= -_TOLERATED:
                point, damping = trial, (0.0 if damping < 1e-6 else 0.1 * damping)
                break
            damping = max(1e-3, 10.0 * damping)
            if runs >= most or damping > _MOST_DAMPED:
                return Descent(point, step, old_scale, runs, False)
            step = arrowhead.step(damping, *problem.bounds(point.theta), problem.within(point.theta))


@dataclass(frozen=True, eq=False)
class _Scores:
    """The scores of a run that is done.

    Attributes:
        blocks: (b, n) of blocks of time, the initial states eliminated. length: of a block [s].
        reach: time [s] that the residuals are correlated over. segments: number of free runs.
    """

    blocks: Array
    length: float
    reach: float
    segments: int


def _covariance(information: Array, prior: Array, scores: _Scores, moments: RobustMoments) -> Array:
    """Return the covariance (n, n) of the coefficients.

    Args:
        information: (n, n) of the run and the prior together. prior: (n, n).
    """
    n = len(information)
    inverse = inverse_information(information)
    number, weights, slopes, squares, _ = moments
    kappa = min(weights / slopes, _CONTAMINATED) if slopes > 0.0 else _CONTAMINATED
    size = squares / max(number - n - 12.0 * scores.segments, 1.0) * number / weights if weights > 0.0 else 1.0
    white = kappa**2 * size
    plain: Array = white * inverse + (1.0 - white) * inverse @ prior @ inverse
    count, unknown = len(scores.blocks), n + _STATES * scores.segments
    if count < 2 * unknown + 2:
        return plain
    S = long_run(scores.blocks, int(np.ceil(scores.reach / scores.length)))
    wide = _widening(2.0 * scores.reach / (scores.length * count)) ** 2 * kappa**2 * count / (count - unknown)
    honest: Array = inverse @ (wide * S + prior) @ inverse
    variance, least = np.diag(honest), np.diag(plain)
    grow = np.sqrt(np.maximum(1.0, least / np.where(variance > 0.0, variance, np.inf)))
    return honest * np.outer(grow, grow) if np.all(variance > 0.0) else plain


def _widening(share: float) -> float:
    """Return the factor of an interval whose long-run sum takes in this share of the run."""
    b = min(share, 1.0)
    return (1.96 + 2.9694 * b + 0.4160 * b**2 - 0.5324 * b**3) / 1.96


@dataclass(frozen=True, eq=False)
class OutputErrorFit:
    """What a free run fitted to the data says.

    Attributes:
        theta: coefficients (n,) as `FreeParameters` writes them. covariance: (n, n), residuals not taken to be white.
        information: (n, n), the initial states being unknown, residuals taken to be white; the prior included.
        states: initial state (s, 13) of every segment of every recording in turn.
        cost: sum of the robust squares, halved.
        residual_std: (18,) in the columns' units, outliers left out; NaN for columns that are not measured.
        autocorrelation: of the residuals.
        iterations: free runs made, but for those over short segments. converged: whether nothing was left to gain.
        rejected: share of the measured numbers beyond the gate.
    """

    theta: Array
    covariance: Array
    information: Array
    states: Array
    cost: float
    residual_std: Array
    autocorrelation: Autocorrelation
    iterations: int
    converged: bool
    rejected: float


def fit_output_error(
    samples: Sequence[Samples],
    model: CandidateModel,
    noise: Array,
    *,
    prior: Knowledge | None = None,
    segment: float | None = None,
    gap: float = 0.5,
    iterations: int = 20,
) -> OutputErrorFit:
    """Fit free runs to recordings.

    Args:
        samples: one for each recording.
        model: where the coefficients start.
        noise: standard deviation (18,) of the columns of `Samples.values`; those that are not measured do not matter.
        prior: mean (n,) and information (n, n) of theta.
        segment: length [s] after which the run starts anew from a state of its own; None for one run per recording.
        gap: time [s] between rows over which no run goes.
        iterations: free runs at most; those over a few short segments to begin with come on top.

    Raises:
        InputError: nothing is free, nothing is measured, or sizes and deviations that do not fit.
    """
    theta = np.clip(np.array(model.theta, dtype=np.float64), *model.free.bounds)
    noise = np.array(noise, dtype=np.float64)
    n = len(model.free)
    known = prior or (np.zeros(n), np.zeros((n, n)))
    _check(samples, model, noise, known)
    noise[~np.isfinite(noise)] = 1.0
    single = np.isin(model.free.codes[:, 0], (IN_GAIN, INFLOW)).any() or model.parameters[I_INFLOW] != 0.0
    runs = [free_run_of(each, noise, segment, gap, bool(single)) for each in samples]
    kept = [each for each, run in zip(samples, runs, strict=True) if run.first.size]
    runs = [run for run in runs if run.first.size]
    if not runs:
        raise InputError("output error: found no three measured rows without a gap between them")
    states = [starting_states(run) for run in runs]
    short = [warm_up_of(each, run, segment, gap) for each, run in zip(kept, runs, strict=True)]
    if any(part is not run for part, run in zip(short, runs, strict=True)):
        theta, begin = warm_up(FreeRunProblem(short, model, known), theta, [starting_states(run) for run in short])
        for run, start, other, fitted in zip(runs, states, short, begin, strict=True):
            _, here, there = np.intersect1d(run.first, other.first, return_indices=True)
            start[here] = fitted[there]
    problem = FreeRunProblem(runs, model, known)
    descent = descend(problem, theta, states, iterations)
    return _failed(theta, states) if descent is None else _result(problem, descent)


def _check(samples: Sequence[Samples], model: CandidateModel, noise: Array, prior: Knowledge) -> None:
    n, theta, (mean, information) = len(model.free), np.asarray(model.theta), prior
    if not n:
        raise InputError("output error: no coefficient is free, so there is nothing to fit")
    if theta.shape != (n,) or not np.isfinite(theta).all():
        raise InputError(f"output error: found theta {theta}, expected {n} finite numbers")
    if mean.shape != (n,) or information.shape != (n, n) or not np.isfinite([*mean, *information.ravel()]).all():
        raise InputError(f"output error: the prior needs {n} finite means and a finite {n} x {n} information")
    if noise.shape != (N_MEASURED,):
        raise InputError(f"output error: found noise of shape {noise.shape}, expected {N_MEASURED} deviations")
    if not samples:
        raise InputError("output error: no recording")
    measured = np.any([each.measured for each in samples], axis=0)
    if not measured.any():
        raise InputError("output error: nothing is measured")
    if not (noise[measured] > 0.0).all() or not np.isfinite(noise[measured]).all():
        raise InputError("output error: every measured column needs a positive noise deviation")


def _result(problem: FreeRunProblem, descent: Descent) -> OutputErrorFit:
    point, scale = descent.point, descent.scale
    k, n = problem.estimated.size, len(problem.free)
    information, eliminated = problem.arrowhead(point).information()
    scores, total, begin = [], np.zeros(5), 0
    for run, each in zip(problem.runs, point.sums, strict=True):
        counts = np.diff(np.append(run.block[run.first], len(each.scores)))
        of_block = begin + np.repeat(np.arange(run.first.size), counts)
        scores.append(each.scores[:, k : k + n] - np.einsum("bk,bkn->bn", each.scores[:, :k], eliminated[of_block]))
        begin += run.first.size
        total += robust_moments(each.residuals, scale)
    moments = RobustMoments(*total)
    residuals = [(run.t, each.residuals) for run, each in zip(problem.runs, point.sums, strict=True)]
    correlation = autocorrelation_of(residuals, GATE * scale)
    lag = np.where(correlation.decorrelation_lag > correlation.step, correlation.decorrelation_lag, 0.0)
    seconds = sum(float(np.sum(run.t[run.last - 1] - run.t[run.first])) for run in problem.runs)
    length = seconds / sum(len(each) for each in scores)
    of_run = _Scores(np.concatenate(scores), length, float(np.nanmax(lag, initial=0.0)), begin)
    covariance = _covariance(information, problem.prior[1], of_run, moments)
    theta, states = point.theta, point.states
    if descent.converged and problem.possible(theta + descent.step.theta):
        theta, states = problem.moved(point, descent.step)
    return OutputErrorFit(
        theta=theta,
        covariance=covariance,
        information=information,
        states=np.concatenate(states),
        cost=problem.cost(point, scale, True),
        residual_std=correlation.std * problem.runs[0].noise,
        autocorrelation=correlation,
        iterations=descent.runs,
        converged=descent.converged,
        rejected=float((moments.beyond + problem.left_out) / max(moments.number + problem.left_out, 1.0)),
    )


def _failed(theta: Array, states: list[Array]) -> OutputErrorFit:
    """Return the start, of which nothing is known: already its free run is impossible."""
    n, unknown = len(theta), np.full(N_MEASURED, np.nan)
    return OutputErrorFit(
        theta=theta,
        covariance=np.diag(np.full(n, np.inf)),
        information=np.zeros((n, n)),
        states=np.concatenate(states),
        cost=np.inf,
        residual_std=unknown,
        autocorrelation=Autocorrelation(unknown, unknown, unknown, unknown),
        iterations=1,
        converged=False,
        rejected=0.0,
    )
