"""Free runs as the second likelihood: with the same prior, and the better judge where they predict better.

The filter is at the bound where its picture of what is random is right. On real recordings it may not be: what the
model lacks follows the command, and a slow random force does not. A free run shows that, because nothing corrects it.
So where windows of a recording contradict each other, free runs are fitted too, from the same prior. The filter's
coefficients, which have seen every window, run freely over windows; so do those of free runs, fitted each time to the
other windows. A filter whose windows contradict each other is known to be wrong about something, so free runs speak
unless the filter predicts better by more than a deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import Sources
from towtank.identification.kalman.passes import JointFit, JointProblem, latencies_of
from towtank.identification.least_squares.velocity import drifting_attitude
from towtank.identification.model.parameters import LATENCIES, PLACES
from towtank.identification.simulation_error.cross_validation import (
    FreeRuns,
    columns_of,
    error_reduction,
    fit_percent,
)
from towtank.identification.simulation_error.segments import CandidateModel
from towtank.recording import Grid
from towtank.vehicle import Vehicle

__all__ = ["FreeRunVerdict", "free_run_verdict"]

_CONTRADICT = 1.3  # median factor by which windows differ more than they state: the filter is doubted
_SURE = 1.0  # deviations by which a doubted filter must predict better, to speak all the same
_FLOWS = 0.01  # m/s
_WEIGHINGS = 2  # fits that show what the data are worth


@dataclass(frozen=True, eq=False)
class FreeRunVerdict:
    """What free runs say.

    Attributes:
        better: whether they predict windows that they have not seen better than the filter, which has seen them.
        fit: the posterior with their coefficients. text: both in a sentence.
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
    if not always and (float(np.median(fit.disagreement)) < _CONTRADICT or _water_moves(fit)):
        return None
    names = [name for name in fit.prior.names if name not in (*LATENCIES, *PLACES)]
    prior = fit.prior.only(names)
    rows = [fit.prior.names.index(name) for name in prior.names]
    base = vehicle.with_coefficients(fit.prior.vehicle_values)
    model = CandidateModel(base, prior.free, fit.theta[rows], problem.delay)
    latency = latencies_of(fit.free, fit.theta)
    samples = [each.shifted(latency) for each in problem.samples]
    sources = [Sources.of(grid.pose, grid.velocity, grid.acceleration) for grid in grids]
    attitude = [drifting_attitude(g, s, each.t) for g, s, each in zip(grids, sources, samples, strict=True)]
    known = (prior.mean, np.asarray(np.linalg.inv(prior.covariance), dtype=np.float64))
    runs = FreeRuns.over(vehicle, samples, problem.own_noise, prior.names, known, attitude)
    if not runs.comparable and not always:
        return None
    weighed = _weighed(runs, model)
    if weighed is None:
        return None
    runs, by_runs = weighed
    fitted = runs.fit(by_runs)
    if fitted is None:
        return None
    by_runs = replace(model, theta=fitted.theta)
    theta, covariance = fit.theta.copy(), fit.covariance.copy()
    theta[rows] = fitted.theta
    covariance[rows] = 0.0
    covariance[:, rows] = 0.0
    covariance[np.ix_(rows, rows)] = _no_surer(fitted.covariance, fitted.information)
    late = [k for k in range(len(fit.free)) if k not in rows]
    covariance[np.ix_(late, late)] = fit.covariance[np.ix_(late, late)]
    posterior = replace(fit, mean=theta, theta=theta, covariance=covariance)
    if not runs.comparable:
        return FreeRunVerdict(
            True, posterior, "free runs, as asked for; too little data to compare them with the filter"
        )
    columns = columns_of(prior.names)
    unseen, before = runs.errors_unseen(by_runs), runs.errors(model)
    kept = error_reduction(before, unseen, columns).beyond(_SURE, 0.0)
    spread = runs.spread()
    fits = fit_percent(unseen, spread, columns), fit_percent(before, spread, columns)
    return FreeRunVerdict(always or not kept, posterior, _said(fits, kept=kept and not always))


def _weighed(runs: FreeRuns, model: CandidateModel) -> tuple[FreeRuns, CandidateModel] | None:
    """Return free runs whose data weigh as much as they are worth, and where these end; None where none can be made.

    What free runs leave is larger than the sensors' noise and goes on for seconds. Taken for so many independent
    samples of noise it would outweigh any prior; so each column counts with the size of what is left, and with one
    sample for each time over which that is correlated.
    """
    noise = runs.noise
    for _ in range(_WEIGHINGS):
        fitted = runs.fit(model)
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


def _water_moves(fit: JointFit) -> bool:
    """Return whether a current or waves were found, of which free runs know nothing."""
    flows = fit.state.settings["current_walk"][0] > 0.0
    variance = np.diag(fit.state.P)[18:20]
    speed = float(np.hypot(*fit.state.current[:2]))
    return bool(fit.levels.waves.any() or (flows and speed > max(_FLOWS, 2.0 * float(np.sqrt(variance.max())))))


def _said(fits: tuple[float, float], *, kept: bool) -> str:
    compared = (
        f"over windows that they were not fitted to, free runs fit the speeds by {fits[0]:.0f} %, "
        f"the filter's coefficients by {fits[1]:.0f} %"
    )
    return f"{compared}: {'the filter speaks' if kept else 'free runs speak'}"
