"""Learning from recordings by the joint estimator: least squares to begin with, passes of the filter, what is known."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.drifting_attitude import drifting_attitude
from towtank.identification.estimate import Estimate
from towtank.identification.free_run_learning import learn_free_runs
from towtank.identification.identifiability_words import as_fitted
from towtank.identification.joint import JointFit, prior_deviation
from towtank.identification.joint_current import current_of, suspected_current
from towtank.identification.joint_estimate import assemble
from towtank.identification.joint_refine import Start
from towtank.identification.joint_rounds import run_rounds
from towtank.identification.joint_start import (
    levels_of,
    prior_information,
    size_of,
    start_theta,
    tuning_for,
)
from towtank.identification.joint_wanted import (
    doubted_by_least_squares,
    doubted_inertias,
    idle,
    known_start,
    speeds_of,
    wanted_of,
)
from towtank.identification.learned_thrusters import learned_gains, with_thrusters
from towtank.identification.log_learning import LogLearning
from towtank.identification.paper_logs import estimate_warnings, learn_paper
from towtank.identification.parameters import DELAY, LAG, FreeParameters, free_parameters
from towtank.identification.passes import Progress
from towtank.identification.samples import Samples, samples_of
from towtank.identification.structure import paper_names
from towtank.recording import Recording
from towtank.vehicle import Vehicle

__all__ = ["learn_joint"]

_HIDES = 6.0  # time constants of a disturbance that a run can be too short to show


def learn_joint(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    *,
    free: Collection[str] | None = None,
    delay: float | None = None,
    longest_delay: float = 0.4,
    prior: Vehicle | None = None,
    current: bool = False,
    refine: str = "where better",
    progress: Progress | None = None,
) -> LogLearning:
    """Learn a vehicle's coefficients from recordings; see `learn_recordings`."""
    told = progress or (lambda text, share: None)
    asked = tuple(free) if free is not None else None
    paper = set(paper_names())
    for_paper = [name for name in asked if name in paper] if asked is not None else None
    least_squares = partial(
        learn_paper, vehicle, recordings, free=for_paper or None, delay=delay, longest_delay=longest_delay
    )
    first = least_squares(sparing=True, progress=lambda text, share: told(text, 0.3 * share))
    samples = [samples_of(recording, vehicle) for recording in recordings]
    wanted, held = wanted_of(vehicle, asked, first)
    if delay is None and any(each.commands for each in samples):
        wanted = (*wanted, DELAY)
    parameters = free_parameters(vehicle, wanted)
    known = known_start(vehicle, first)
    lag = float(np.mean(samples[0].lag)) if samples[0].lag.size and samples[0].lag.any() else 0.05
    found_delay = first.delay
    if LAG in wanted:
        found_delay = max(0.0, found_delay - lag)
    theta = start_theta(vehicle, known, parameters, delay=found_delay, lag=lag)
    levels = levels_of(recordings, samples, vehicle)
    own_noise = levels.noise  # the filter's may hold what its model lacks
    tuning = replace(tuning_for(vehicle), current=current)
    found = run_rounds(
        vehicle,
        samples,
        parameters,
        theta,
        levels,
        tuning,
        held=held,
        doubted=doubted_inertias(wanted, held) if asked is None else (),
        zeroed=[name for name in held if first.model.coefficient(name) == 0.0],
        delay=found_delay,
        prior=prior,
        asked=asked is not None,
        speeds=speeds_of(first),
        told=lambda share: told("joint filter", 0.3 + 0.4 * share),
    )
    fit, base, findings, unidentified = found.fit, found.base, found.findings, found.unidentified
    parameters, zeroed = fit.free, list(found.zeroed)
    chosen = [name for name in (*wanted, *found.added, *found.sure) if name not in found.dropped]
    told("free runs", 0.7)
    method, remarks, water = "joint", [], None
    doubts: tuple[str, ...] = ()
    if current:
        water = current_of(fit.state)
        remarks.append(f"the water flows: {water.said}, at the end of the last recording")
    else:
        flow = suspected_current(
            found.few,
            np.array(base.parameters),
            fit,
            prior_deviation(parameters, size_of(vehicle, parameters)),
            tuning,
            delay=found_delay,
            prior=_prior(prior, parameters),
        )
        if flow is not None:
            doubts = (
                f"a water current of {flow.said} would explain these recordings far better than water at rest, and "
                "drag is off without it; learn it along: --current",
            )
    second = (
        None
        if current
        else learn_free_runs(
            vehicle,
            base.with_coefficients({name: 0.0 for name in found.added if name in parameters.names}),
            samples,
            parameters,
            _starts(vehicle, fit, chosen if asked is None else parameters.names, known, found_delay),
            []
            if found.before is None or asked is not None
            else _starts(vehicle, found.before, wanted, known, found_delay),
            own_noise,
            [drifting_attitude(g, s, each.t) for g, s, each in zip(first.grids, first.sources, samples, strict=True)],
            (first.model, first.delay),
            delay=found_delay,
            prior=lambda chosen: _prior(prior, chosen),
            terms=asked is None,
            find_lag=asked is None and delay is None and _may_lag(samples),
            always=refine == "always",
            speeds=speeds_of(first),
            told=lambda share: told("free runs", 0.7 + 0.25 * share),
        )
    )
    if second is not None:
        remarks.append(second.said)
    if second is not None and second.least_squares and refine != "always":
        whole = first if found.few is samples else least_squares()
        return replace(whole, levels=fit.levels, remarks=(*whole.remarks, *remarks))
    if second is not None and (second.first.better or refine == "always"):
        method, found_delay, parameters = "output-error", second.refined.delay, second.refined.free
        spread = second.refined.covariance
        if fit.duration < _HIDES * tuning.time_constant:
            spread = _no_surer(parameters, spread, fit)
        fit = replace(fit, free=parameters, theta=second.refined.theta, covariance=spread, likely=spread)
        unidentified = {name: why for name, why in unidentified.items() if name not in second.refined.added}
        unidentified.update({name: held[name] for name in (*found.added, *found.sure) if name not in parameters.names})
        unidentified.update(second.reasons)
        wanted = (*wanted, *(name for name in second.refined.added if name not in wanted))
        zeroed = [name for name in (*zeroed, *found.added, *second.zeroed) if name not in parameters.names]
    else:
        unidentified = {**{n: why for n, why in findings.reasons.items() if n not in (DELAY, LAG)}, **unidentified}
    roughly: list[str] = []
    if asked is not None:
        moved_by_water = idle(vehicle, samples)
        if method == "joint":
            roughly = [f.name for f in findings.findings if f.rough and f.name in unidentified.keys() - moved_by_water]
        unidentified.update({name: as_fitted(unidentified[name]) for name in roughly})
        unidentified.update({name: why for name, why in moved_by_water.items() if name in parameters.names})
    told("what is known", 0.95)
    assembled = assemble(
        vehicle,
        parameters,
        fit.theta,
        fit.covariance,
        [name for name in wanted if name not in (DELAY, LAG)] + [name for name in held if name not in wanted],
        unidentified,
        zeroed,
        first.estimate.axes,
        fit.duration,
        fit.rows,
        roughly,
    )
    learned = _learned(vehicle, first, assembled.estimate, assembled.remarks, parameters, fit, found_delay, method)
    if asked is not None:
        doubts = (*doubts, *doubted_by_least_squares(first, assembled.estimate))
    warnings = (*learned.warnings, *doubts)
    return replace(learned, current=water, warnings=warnings, remarks=(*learned.remarks, *remarks))


def _starts(
    vehicle: Vehicle, fit: JointFit, wanted: Sequence[str], least_squares: Vehicle, delay: float
) -> list[Start]:
    """Return where free runs may begin: the joint filter's coefficients, and all that least squares found."""
    whole = free_parameters(vehicle, wanted)
    return [(fit.free, fit.theta), (whole, start_theta(least_squares, least_squares, whole, delay=delay, lag=0.05))]


def _may_lag(samples: Sequence[Samples]) -> bool:
    """Whether thrusters are told what to do, and nobody says how fast they answer."""
    return all(each.commands and not each.lag.any() for each in samples)


def _no_surer(free: FreeParameters, covariance: Array, joint: JointFit) -> Array:
    """Return the covariance (n, n) of free runs, no deviation smaller than the joint filter's.

    In a short run the initial state and the coefficients can take on a disturbance, and leave residuals that are white.
    """
    std = dict(zip(joint.free.names, joint.std, strict=True))
    own = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    grown = np.array([max(1.0, std.get(name, 0.0) / own[k]) for k, name in enumerate(free.names)])
    return np.asarray(covariance * np.outer(grown, grown))


def _prior(prior: Vehicle | None, free: FreeParameters) -> tuple[Array, Array] | None:
    return None if prior is None else prior_information(prior, free)


def _learned(
    vehicle: Vehicle,
    first: LogLearning,
    estimate: Estimate,
    remarks: tuple[str, ...],
    free: FreeParameters,
    fit: JointFit,
    delay: float,
    method: str,
) -> LogLearning:
    lag = None
    for k, name in enumerate(free.names):
        if name == DELAY:
            delay = max(0.0, float(fit.theta[k]))
        elif name == LAG:
            lag = float(np.exp(fit.theta[k]))
    model = estimate.model(vehicle, f"learned by towtank, method {method}")
    gains = learned_gains(vehicle, free, fit.theta, fit.std)
    if vehicle.thrusters:
        model = with_thrusters(model, lag=math.nan if lag is None else lag, gains=gains)
        model = model.model_copy(update={"command_delay": max(0.0, delay)})
    stds = dict(zip(free.names, fit.std, strict=True))
    outdated = estimate_warnings(vehicle, first.estimate)
    about_logs = [text for text in first.warnings if text not in outdated]
    return replace(
        first,
        estimate=estimate,
        model=model,
        delay=delay,
        delay_std=float(stds.get(DELAY, np.nan)),
        lag=float("nan") if lag is None else lag,
        lag_std=float(stds[LAG]) * lag if lag is not None else float("nan"),
        levels=fit.levels,
        gains=gains,
        method=method,
        warnings=(*about_logs, *estimate_warnings(vehicle, estimate), *remarks),
    )
