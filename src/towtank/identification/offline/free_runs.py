"""Free runs as the second likelihood: with the same prior, and the better judge where they predict better.

The filter is at the bound where its picture of what is random is right. On real recordings it may not be: what the
model lacks follows the command, and a slow random force does not. A free run shows that, because nothing corrects it.
So where windows of a recording contradict each other, free runs are fitted too, from the same prior. The filter's
coefficients, which have seen every window, run freely over windows; so do those of free runs, fitted each time to the
other windows. A filter whose windows contradict each other is known to be wrong about something, so free runs speak,
unless the filter predicts better by more than a deviation, or a window stops them, or what parts of the recording come
to apart contradicts them more than its windows contradict the filter. What both come to must agree within what both
state; where it does not, whoever speaks states too little, and its data are worth less.

Free runs leave sensors out, accelerometers above all. Of an axis whose motion they do not show themselves they know
what the filter has learned of it: from the prior alone they would make of hidden motion whatever the rest lacks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples, Sources
from towtank.identification.kalman.problem import JointFit, JointProblem, latencies_of
from towtank.identification.kalman.rivals import CONTRADICTED
from towtank.identification.least_squares.velocity import drifting_attitude
from towtank.identification.model.parameters import DVL_PLACE, LATENCIES, MARKER_PLACE, PLACES
from towtank.identification.model.prior import Prior
from towtank.identification.simulation_error.cross_validation import (
    FreeRuns,
    columns_of,
    error_reduction,
    fit_percent,
)
from towtank.identification.simulation_error.segments import CandidateModel
from towtank.recording import Grid
from towtank.recording.frames.lever_arm import origin_motion
from towtank.recording.grids.timing import interpolation_weights
from towtank.vehicle import Vehicle

__all__ = ["FreeRunVerdict", "contradiction", "free_run_verdict", "worth_less"]

_SURE = 1.0  # deviations by which a doubted filter must predict better, to speak all the same
_FLOWS, _COUNTS = 0.01, 0.1  # m/s; of the speeds over ground: a current that is less does not count
_APART = 0.02  # s: the rows of a sensor that is quicker tell the same, since what runs leave lasts for seconds
_HELD = 1e-3  # of the deviation of what is not learned
_CLAIMED = 1e-12  # of the prior's variance, which no recording can promise
_WORTHLESS = 100.0  # times the variance, at most


@dataclass(frozen=True, eq=False)
class FreeRunVerdict:
    """What free runs say.

    Attributes:
        better: whether they speak. fit: the posterior of what speaks, by both. text: both in a sentence.
    """

    better: bool
    fit: JointFit
    text: str


def free_run_verdict(
    problem: JointProblem, fit: JointFit, grids: Sequence[Grid], vehicle: Vehicle, *, always: bool = False
) -> FreeRunVerdict | None:
    """Fit free runs and compare them with the filter; None where nothing asks for it, or they cannot be made.

    Args:
        always: they have the last word in any case.
    """
    if not always and (fit.disagreement < CONTRADICTED or _water_moves(fit, problem.samples)):
        return None
    names = [name for name in fit.prior.names if name not in (*LATENCIES, *PLACES)]
    prior = fit.prior.only(names)
    rows = [fit.prior.names.index(name) for name in prior.names]
    base = vehicle.with_coefficients(fit.prior.vehicle_values)
    model = CandidateModel(base, prior.free, fit.theta[rows], problem.delay)
    latency = latencies_of(fit.free, fit.theta)
    known = dict(zip(fit.prior.names, fit.theta, strict=True))
    dvl, marker = (np.array([known.get(name, 0.0) for name in place]) for place in (DVL_PLACE, MARKER_PLACE))
    samples = [_at_origin(each.shifted(latency), dvl, marker) for each in problem.samples]
    if not always:
        samples = [each.thinned(_APART) for each in samples]
    sources = [Sources.of(grid.pose, grid.velocity, grid.acceleration) for grid in grids]
    attitude = [drifting_attitude(g, s, each.t) for g, s, each in zip(grids, sources, samples, strict=True)]
    runs = FreeRuns.over(vehicle, samples, problem.own_noise, prior.names, (prior.mean, prior.covariance), attitude)
    if not runs.comparable and not always:
        return None
    learned = problem.learned[rows]
    mean, covariance = _beforehand(prior, fit, rows, learned & ~prior.free.felt(runs.shown))
    told = replace(runs, prior=(mean, _information(covariance, learned)))
    found = _fitted(told, model, covariance, learned, np.inf if always else fit.disagreement)
    if found is None:
        return None
    own = np.ix_(learned, learned)
    both = (fit.covariance[np.ix_(rows, rows)] + found.covariance)[own]
    away = (found.theta - fit.theta[rows])[learned]
    apart = contradiction([away], both, found.covariance[own], covariance[own])
    if found.unseen is None and always:
        kept, text = False, "free runs, as asked for; too little data to compare them with the filter"
    elif found.unseen is None:
        times = f"{found.apart:.0f} times as far apart as they state"
        kept, text = True, f"free runs fitted to parts of the data lie {times}: the filter speaks"
    else:
        columns = columns_of(prior.names)
        before, spread = replace(runs, noise=found.noise).errors(model) * found.noise**2, runs.spread() * runs.noise**2
        stopped = np.isinf(found.unseen[:, columns]).any(axis=1) & np.isfinite(before[:, columns]).any(axis=1)
        kept = bool(stopped.any()) or error_reduction(before, found.unseen, columns).beyond(_SURE, 0.0)
        kept = kept and not always
        text = _said((fit_percent(found.unseen, spread, columns), fit_percent(before, spread, columns)), kept=kept)
    speaks = fit if kept else found.instead_of(fit, rows)
    return FreeRunVerdict(not kept, _weaker(speaks, problem.learned, apart), text)


def _at_origin(samples: Samples, dvl: Array, marker: Array) -> Samples:
    """Return samples with velocity and position of the body origin in place of those of a DVL and a marker (3,) [m].

    By the rates and the attitude between their samples; beyond them, and in gaps, they stay.
    """
    values = samples.values.copy()
    eulers = np.column_stack([_between(samples.t, each, np.unwrap) for each in values[:, 3:6].T])
    omega = np.column_stack([_between(samples.t, each) for each in values[:, 9:12].T])
    values[:, :3], values[:, 6:9] = origin_motion(values[:, :3], values[:, 6:9], eulers, omega, marker, dvl)
    return replace(samples, values=values)


def _between(t: Array, values: Array, whole: Callable[[Array], Array] = np.asarray) -> Array:
    """Return a number (n,) at every instant, by the samples around it; NaN where there are none."""
    shown = np.isfinite(values)
    if not shown.any():
        return values
    return interpolation_weights(t[shown], t).linear(whole(values[shown]))


def _beforehand(prior: Prior, fit: JointFit, rows: Sequence[int], hidden: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return what free runs know before they begin, mean (n,) and covariance (n, n).

    It is the prior; of what is `hidden` from them, what the filter has learned.
    """
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    mean[hidden] = fit.theta[rows][hidden]
    covariance[hidden] = 0.0
    covariance[:, hidden] = 0.0
    covariance[np.ix_(hidden, hidden)] = fit.covariance[np.ix_(rows, rows)][np.ix_(hidden, hidden)]
    return mean, covariance


@dataclass(frozen=True, eq=False)
class _Fitted:
    """What free runs come to.

    Attributes:
        theta, covariance: (n,), (n, n). unseen: mean squares (w, 18) of what runs miss over windows that they were not
            fitted to, in the columns' units; None where there are too few windows, or parts lie too far apart. noise:
            (18,) that runs were weighed by. apart: factor by which parts of the data contradict each other; the
            covariance is widened by it.
    """

    theta: Array
    covariance: Array
    unseen: Array | None
    noise: Array
    apart: float

    def instead_of(self, fit: JointFit, rows: Sequence[int]) -> JointFit:
        """Return the filter's posterior with these of the unknowns `rows`; the others owe nothing to them."""
        theta, covariance = fit.theta.copy(), fit.covariance.copy()
        theta[rows] = self.theta
        covariance[rows] = 0.0
        covariance[:, rows] = 0.0
        covariance[np.ix_(rows, rows)] = self.covariance
        return replace(fit, mean=theta, theta=theta, covariance=covariance)


def _fitted(
    runs: FreeRuns, model: CandidateModel, prior: Array, learned: NDArray[np.bool_], most: float
) -> _Fitted | None:
    """Return what free runs come to from the model; None where they cannot be made.

    What is found without one of G folds of the windows should lie off by C G / (G - 1)^2, with C the covariance of all
    (Efron's jackknife); where it lies farther, data are worth less.

    Args:
        prior: covariance (n, n) of what is known before. learned: of which unknowns (n,); the others stay as they are.
        most: factor by which parts may contradict each other, beyond which they are not worth a comparison.
    """
    weighed = _weighed(runs, model)
    if weighed is None:
        return None
    runs, by_runs = weighed
    fitted = runs.fit(by_runs)
    if fitted is None:
        return None
    by_runs = replace(model, theta=fitted.theta)
    own = np.ix_(learned, learned)
    covariance = prior.copy()
    stated = _no_surer(fitted.covariance, fitted.information)[own]
    unseen, apart = None, 1.0
    if runs.comparable:
        folds, thetas = runs.folds, list[Array]()
        expected = stated * len(folds) / max(len(folds) - 1, 1) ** 2
        unseen = np.full((len(runs.windows), runs.noise.size), np.inf)
        for fold in folds:
            part = runs.fit(by_runs, without=fold)
            if part is not None:
                thetas.append((part.theta - fitted.theta)[learned])
                apart = contradiction(thetas, expected, stated, prior[own])
                if apart * math.sqrt(len(thetas) / len(folds)) > most:  # whatever the others come to
                    unseen = None
                    break
                unseen[fold] = runs.errors(replace(by_runs, theta=part.theta), fold) * runs.noise**2
    covariance[own] = worth_less(stated, prior[own], apart)
    if not learned.all():
        through = -np.linalg.solve(fitted.information[own], fitted.information[np.ix_(learned, ~learned)])
        common = through @ prior[np.ix_(~learned, ~learned)]
        covariance[own] += common @ through.T
        covariance[np.ix_(learned, ~learned)] = common
        covariance[np.ix_(~learned, learned)] = common.T
    return _Fitted(fitted.theta, covariance, unseen, runs.noise, apart)


def _information(covariance: Array, learned: NDArray[np.bool_]) -> Array:
    """Return the information (n, n) of a covariance (n, n), that of what is not `learned` far larger: it stays."""
    held = np.where(learned, 1.0, _HELD)
    return np.asarray(np.linalg.inv(covariance * np.outer(held, held)), dtype=np.float64)


def contradiction(moved: Sequence[Array], expected: Array, covariance: Array, prior: Array) -> float:
    """Return how many times as far differences lie apart as they should: 1 on average where all is right.

    Args:
        moved: differences (n,). expected: covariance (n, n) of one, in what the data tell. covariance, prior: (n, n)
            after the data and before; the data tell as many directions as the trace of 1 - C P^-1.
    """
    _, size, _ = _in_units_of(prior, covariance)
    told = float(np.maximum(1.0 - size, 0.0).sum())
    if not moved or not told > 0.0:
        return 1.0
    root, scale, axes = _in_units_of(prior, expected)
    squares = [float(np.sum((axes.T @ np.linalg.solve(root, each)) ** 2 / scale)) for each in moved]
    return math.sqrt(float(np.mean(squares)) / told)


def worth_less(covariance: Array, prior: Array, factor: float) -> Array:
    """Return a posterior covariance (n, n) with data worth less, by the square of a factor where that is above 1.

    What the data do not tell stays with the prior (n, n).
    """
    root, size, axes = _in_units_of(prior, covariance)
    ratio = min(max(factor, 1.0) ** 2, _WORTHLESS)
    left = np.where(size < 1.0, 1.0 / (1.0 + (1.0 / size - 1.0) / ratio), size)
    wide = root @ axes * np.sqrt(left)
    return np.asarray(wide @ wide.T)


def _in_units_of(prior: Array, covariance: Array) -> tuple[Array, Array, Array]:
    """Return S of the prior S S^T, and eigenvalues (n,) and vectors (n, n) of a covariance in these units."""
    root = np.linalg.cholesky(prior)
    unit = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    size, axes = np.linalg.eigh(0.5 * (unit + unit.T))
    return np.asarray(root), np.maximum(size, _CLAIMED), np.asarray(axes)


def _weaker(fit: JointFit, learned: NDArray[np.bool_], factor: float) -> JointFit:
    """Return a posterior whose data are worth less by the square of a factor, in what was learned."""
    own, covariance = np.ix_(learned, learned), fit.covariance.copy()
    covariance[own] = worth_less(covariance[own], fit.prior.covariance[own], factor)
    return replace(fit, covariance=covariance)


def _weighed(runs: FreeRuns, model: CandidateModel) -> tuple[FreeRuns, CandidateModel] | None:
    """Return free runs whose data weigh as much as they are worth, and where these end; None where none can be made.

    What free runs leave is larger than the sensors' noise and goes on for seconds. Taken for so many independent
    samples of noise it would outweigh any prior; so each column counts with the size of what is left, and with one
    sample for each time over which that is correlated: first by what the model leaves as it is, then by what a fit
    leaves.
    """
    noise = runs.noise
    for made in (FreeRuns.held, FreeRuns.fit):
        fitted = made(runs, model)
        if fitted is None:
            return None
        shown = fitted.autocorrelation
        with np.errstate(invalid="ignore"):
            own = fitted.residual_std * np.sqrt(np.maximum(shown.time / shown.step, 1.0))
        runs = replace(runs, noise=np.where(np.isfinite(own), np.maximum(own, noise), runs.noise))
        model = replace(model, theta=fitted.theta)
    return runs, model


def _no_surer(covariance: Array, information: Array) -> Array:
    """Return the covariance (n, n), no deviation smaller than the information (n, n), prior included, allows."""
    least = np.diag(np.linalg.pinv(information))
    grow = np.sqrt(np.maximum(1.0, least / np.maximum(np.diag(covariance), 1e-300)))
    return np.asarray(covariance * np.outer(grow, grow))


def _water_moves(fit: JointFit, samples: Sequence[Samples]) -> bool:
    """Return whether waves were found, or a current that counts beside the speeds: free runs know nothing of either."""
    flows = fit.state.settings["current_walk"][0] > 0.0
    variance = np.diag(fit.state.P)[18:20]
    least = max(_FLOWS, 2.0 * float(np.sqrt(variance.max())))
    over_ground = np.concatenate([each.values[:, 6:8] for each in samples])
    if (measured := np.isfinite(over_ground).all(axis=1)).any():
        least = max(least, _COUNTS * math.sqrt(float(np.mean(np.sum(over_ground[measured] ** 2, axis=1)))))
    return bool(fit.levels.waves.any() or (flows and float(np.hypot(*fit.state.current[:2])) > least))


def _said(fits: tuple[float, float], *, kept: bool) -> str:
    speaks = "the filter speaks" if kept else "free runs speak"
    if not np.isfinite(fits).all():
        return f"free runs that were not fitted to a window lose it: {speaks}"
    compared = f"free runs fit the motion by {fits[0]:.0f} %, the filter's coefficients by {fits[1]:.0f} %"
    return f"over windows that they were not fitted to, {compared}: {speaks}"
