"""Output error: the coefficients whose free run, nothing measured correcting it on the way, fits a log best.

Gauss and Newton's steps, damped after Levenberg and Marquardt where one does not help, over the coefficients and the
initial state of every segment at once (`simulation_error.trajectory`). First over short segments, in which not much can
go wrong whatever the coefficients: an unstable vehicle's free run is soon anywhere. From there the whole runs. At first
all columns are weighed alike; then each by its noise, or by the robust size of its own residuals where that is larger,
with Huber's weights at 2 of these; once the run is near the data, what is beyond 4.5 is left out.

It is the best judge where nothing but the sensors' noise parts the model from the data. A random force, which a free
run cannot follow, spoils it: `OutputErrorFit.autocorrelation` says so. The autocorrelation time of n samples dt apart
is dt (1 + 2 sum r_k), up to the lag at which r_k has died: so many seconds of data say once what white samples would
say every dt. A marker that jumps by two deviations of its noise, too little for any gate, is in one place for half a
second; what a model lacks is elsewhere too. So residuals that are not white are judged once more without the bursts,
seconds, a tenth of all at most, whose sum chance does not explain; of what is left more is asked, since that choice
makes it look whiter.

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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.model.parameters import IN_GAIN
from towtank.identification.posterior.statistics import long_run
from towtank.identification.simulation_error.problem import (
    CandidateModel,
    FreeRunProblem,
    Knowledge,
    Point,
    free_run_of,
    residual_scale,
    starting_states,
    warm_up_of,
)
from towtank.identification.simulation_error.residuals import GATE, RobustMoments, robust_moments
from towtank.identification.simulation_error.trajectory import Step, inverse_information

__all__ = ["OutputErrorFit", "autocorrelation_of", "fit_output_error"]

_FAR = 1e3  # standard deviations of the noise: scale of residuals of which nothing is known yet
_NEAR = 1.0  # decrease of the cost from which the gate is in force
_NEAR_SCALE, _NEAR_SHARE = 1.5, 0.05  # or the size of the residuals, and a decrease of this share of the cost
_FIXED = 2  # steps within the gate after which the scales stay as they are
_SETTLED = 0.03  # decrease of the cost, half of a squared deviation, whose step is taken without another run
_UNSURE = 0.5  # decrease within the coefficients' deviations: not borne out by a run, it is the derivatives' own error
_TOLERATED = 1e-3  # increase of the cost that a step may cause: the derivatives are of second order in the step
_MOST_DAMPED = 1e6
_WARM, _WARM_RUNS = 0.3, 12  # share of the cost that a step still lowers, and runs, after which the warm-up ends
_STATES = 2  # of each segment, a position and a velocity, that share in a coefficient's own axis
_CONTAMINATED = 1.5  # largest kappa
_BAND = 2.0  # standard deviations of r_k of a white series
_FEWEST = 20
_SECOND, _BURSTS, _CHANCE = 1.0, 0.1, 4.0  # s; share of these that may be bursts; deviations of the sum of one
_MANY = 10  # samples that a second needs to have
_WHITE, _WHITER = 2.0, 1.3  # samples that white residuals may be correlated over; and without the bursts


Kept = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Descent:
    """Where the steps ended.

    Attributes:
        point: the last runs. step: the small one that would come next. scale: of the residuals (15,).
        runs: how many were made. converged: whether nothing was left to gain.
    """

    point: Point
    step: Step
    scale: Array
    runs: int
    converged: bool


def warm_up(problem: FreeRunProblem, theta: Array, states: list[Array]) -> tuple[Array, list[Array], int]:
    """Return coefficients (n,) and initial states after some steps over short segments, and the runs made.

    The lag is held: while nothing else is right it would run away, and the delay does for it.
    """
    scale = np.full(15, _FAR)
    point = problem.evaluate(theta, states, scale, False)
    runs, damping = 1, 0.0
    if point is None:
        return theta, states, runs
    point = problem.narrow(point)
    while True:
        arrowhead, cost = problem.arrowhead(point), problem.cost(point, scale, False)
        step = arrowhead.step(damping, *problem.bounds(point.theta, lag=False))
        if step.decrease < _WARM * cost or runs >= _WARM_RUNS:
            break
        trial = problem.evaluate(*problem.moved(point, step), scale, False)
        runs += 1
        if trial is not None and problem.cost(trial, scale, False) < cost:
            point, damping = trial, 0.1 * damping
        else:
            damping = max(1e-3, 100.0 * damping)
    return *problem.moved(point, step), runs


def descend(problem: FreeRunProblem, theta: Array, states: list[Array], most: int) -> Descent | None:
    """Return the best fit within `most` runs; None where already the first run is impossible."""
    scale, gated, fixed = np.full(15, _FAR), False, 0
    point = problem.evaluate(theta, states, scale, gated)
    if point is None:
        return None
    point = problem.narrow(point)
    damping, runs = 0.0, 1
    while True:
        arrowhead = problem.arrowhead(point)
        step = arrowhead.step(damping, *problem.bounds(point.theta))
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
            elif runs == 1:
                scale = np.full(15, scale.max())
            decrease = step.decrease * float(np.min(old_scale / scale)) ** 2
            near = scale.max() < _NEAR_SCALE and decrease < _NEAR_SHARE * problem.cost(point, scale, gated)
            gated = gated or near or decrease < _NEAR
        cost = problem.cost(point, old_scale, old_gated)
        while True:
            trial = problem.evaluate(*problem.moved(point, step), scale, gated)
            runs += 1
            if trial is not None and problem.cost(trial, old_scale, old_gated) <= cost + _TOLERATED:
                point, damping = trial, (0.0 if damping < 1e-6 else 0.1 * damping)
                break
            if old_gated and step.decrease < _UNSURE:
                nowhere = Step(np.zeros_like(step.theta), np.zeros_like(step.states), 0.0)
                return Descent(point, nowhere, old_scale, runs, True)
            damping = max(1e-3, 10.0 * damping)
            if runs >= most or damping > _MOST_DAMPED:
                return Descent(point, step, old_scale, runs, False)
            step = arrowhead.step(damping, *problem.bounds(point.theta))


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
class Autocorrelation:
    """Of the residuals of each of the 15 columns; NaN where too little is measured.

    Attributes:
        std: standard deviation (15,), in that of the noise. lag_one: correlation of neighbouring samples (15,).
        time: integrated autocorrelation time (15,) [s]. decorrelation_lag: (15,) [s] at which the correlation has died.
        step: usual time between samples (15,) [s]. time_without_bursts: as `time`, without the seconds that are off.
    """

    std: Array
    lag_one: Array
    time: Array
    decorrelation_lag: Array
    step: Array
    time_without_bursts: Array

    def white(self, columns: Sequence[int]) -> bool:
        """Whether those of these columns that are measured are nothing but noise; no where none is."""
        step, time, steady = (each[list(columns)] for each in (self.step, self.time, self.time_without_bursts))
        known = np.isfinite(time)
        return bool(known.any() and np.all((time <= _WHITE * step) | (steady <= _WHITER * step) | ~known))


def autocorrelation_of(runs: Sequence[tuple[Array, Array]], limits: Array) -> Autocorrelation:
    """Return the autocorrelation of residuals.

    Args:
        runs: times (n,) [s] and residuals (n, 15) of each recording, NaN where nothing was measured.
        limits: (15,) beyond which a residual is an outlier and left out.
    """
    columns = [_column(runs, j, limits[j]) for j in range(N_MEASURED)]
    return Autocorrelation(*np.array(columns).T)


def _column(runs: Sequence[tuple[Array, Array]], j: int, limit: float) -> tuple[float, ...]:
    """Return of column j what `Autocorrelation` holds, in its order."""
    parts = []
    for t, residuals in runs:
        there = np.isfinite(residuals[:, j])
        if there.any():
            parts.append((t[there], residuals[there, j]))
    if sum(x.size for _, x in parts) < _FEWEST:
        return (np.nan,) * 6
    kept = [np.abs(x) <= limit for _, x in parts]
    whole = _correlation(parts, kept)
    coloured = whole.time > _WHITE * whole.step and whole.step * _MANY <= _SECOND
    return *whole, _correlation(parts, _without_bursts(parts, kept)).time if coloured else whole.time


class _Correlation(NamedTuple):
    """The first five of `Autocorrelation`, of one column."""

    std: float
    lag_one: float
    time: float
    decorrelation_lag: float
    step: float


def _correlation(parts: Sequence[tuple[Array, Array]], kept: Sequence[Kept]) -> _Correlation:
    """Return the correlation of the samples that are kept of times (n,) and residuals (n,)."""
    longest = max(x.size for _, x in parts)
    products, pairs = np.zeros(longest), np.zeros(longest)
    for (_, x), good in zip(parts, kept, strict=True):
        size = 1 << (2 * x.size - 1).bit_length()
        for into, series in ((products, np.where(good, x, 0.0)), (pairs, good.astype(np.float64))):
            spectrum = np.fft.rfft(series, size)
            into[: x.size] += np.fft.irfft(spectrum.real**2 + spectrum.imag**2, size)[: x.size]
    pairs = np.rint(pairs)
    step = float(np.median(np.concatenate([np.diff(t) for t, _ in parts])))
    if not (products[0] > 0.0 and pairs[0] >= _FEWEST):
        return _Correlation(np.nan, np.nan, np.nan, np.nan, step)
    covariance = products / np.maximum(pairs, 1.0)
    r = covariance[: max(2, longest // 2)] / covariance[0]
    pairwise = 0.5 * (r[1:-1] + r[2:]) if r.size > 2 else r[1:]
    dead = np.flatnonzero(pairwise < _BAND / np.sqrt(2.0 * pairs[0]))
    lags = int(dead[0]) if dead.size else pairwise.size
    time = step * (1.0 + 2.0 * float(r[1 : lags + 1].sum()))
    return _Correlation(float(np.sqrt(covariance[0])), float(r[1]), time, step * lags, step)


def _without_bursts(parts: Sequence[tuple[Array, Array]], kept: Sequence[Kept]) -> list[Kept]:
    """Return what is left of `kept` without the seconds whose residuals would least likely add up so by chance."""
    size = np.sqrt(np.mean(np.concatenate([x[good] for (_, x), good in zip(parts, kept, strict=True)]) ** 2))
    seconds = [np.unique(((t - t[0]) / _SECOND).astype(np.int64), return_inverse=True)[1] for t, _ in parts]
    sums = []
    for (_, x), good, at in zip(parts, kept, seconds, strict=True):
        total = np.abs(np.bincount(at, np.where(good, x, 0.0)))
        sums.append(total / (size * np.sqrt(np.maximum(np.bincount(at, good), 1.0))))
    off = np.concatenate(sums)
    worst = np.argsort(-off, kind="stable")[: int(_BURSTS * off.size)]
    left = np.ones(off.size, dtype=np.bool_)
    left[worst[off[worst] > _CHANCE]] = False
    edges = np.cumsum([each.size for each in sums])[:-1]
    return [good & own[at] for good, own, at in zip(kept, np.split(left, edges), seconds, strict=True)]


@dataclass(frozen=True, eq=False)
class OutputErrorFit:
    """What a free run fitted to the data says.

    Attributes:
        theta: coefficients (n,) as `FreeParameters` writes them. covariance: (n, n), residuals not taken to be white.
        information: (n, n), the initial states being unknown, residuals taken to be white; the prior included.
        states: initial state (s, 13) of every segment of every recording in turn.
        cost: sum of the robust squares, halved.
        residual_std: (15,) in the columns' units, outliers left out; NaN for columns that are not measured.
        autocorrelation: of the residuals.
        iterations: free runs made. converged: whether nothing was left to gain.
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
        noise: standard deviation (15,) of the columns of `Samples.values`; those that are not measured do not matter.
        prior: mean (n,) and information (n, n) of theta.
        segment: length [s] after which the run starts anew from a state of its own; None for one run per recording.
        gap: time [s] between rows over which no run goes.
        iterations: free runs at most; those over a few short segments to begin with come on top.

    Raises:
        InputError: nothing is free, nothing is measured, or sizes and deviations that do not fit.
    """
    theta = np.array(model.theta, dtype=np.float64)
    noise = np.array(noise, dtype=np.float64)
    n = len(model.free)
    known = prior or (np.zeros(n), np.zeros((n, n)))
    _check(samples, model, noise, known)
    noise[~np.isfinite(noise)] = 1.0
    gains = bool((model.free.codes[:, 0] == IN_GAIN).any())
    runs = [free_run_of(each, noise, segment, gap, gains) for each in samples]
    kept = [each for each, run in zip(samples, runs, strict=True) if run.first.size]
    runs = [run for run in runs if run.first.size]
    if not runs:
        raise InputError("output error: found no three measured rows without a gap between them")
    states, made = [starting_states(run) for run in runs], 0
    short = [warm_up_of(each, run, segment, gap) for each, run in zip(kept, runs, strict=True)]
    if any(part is not run for part, run in zip(short, runs, strict=True)):
        begin = [starting_states(run) for run in short]
        theta, begin, made = warm_up(FreeRunProblem(short, model, known), theta, begin)
        for run, start, other, fitted in zip(runs, states, short, begin, strict=True):
            _, here, there = np.intersect1d(run.first, other.first, return_indices=True)
            start[here] = fitted[there]
    problem = FreeRunProblem(runs, model, known)
    descent = descend(problem, theta, states, max(iterations, 1))
    return _failed(theta, states, made + 1) if descent is None else _result(problem, descent, made)


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


def _result(problem: FreeRunProblem, descent: Descent, made: int) -> OutputErrorFit:
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
        iterations=made + descent.runs,
        converged=descent.converged,
        rejected=float((moments.beyond + problem.left_out) / max(moments.number + problem.left_out, 1.0)),
    )


def _failed(theta: Array, states: list[Array], made: int) -> OutputErrorFit:
    """Return the start, of which nothing is known: already its free run is impossible."""
    n, unknown = len(theta), np.full(N_MEASURED, np.nan)
    return OutputErrorFit(
        theta=theta,
        covariance=np.diag(np.full(n, np.inf)),
        information=np.zeros((n, n)),
        states=np.concatenate(states),
        cost=np.inf,
        residual_std=unknown,
        autocorrelation=Autocorrelation(unknown, unknown, unknown, unknown, unknown, unknown),
        iterations=made,
        converged=False,
        rejected=0.0,
    )
