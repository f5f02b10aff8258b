"""Learning from whole recordings: what was supposed, narrowed by what they show.

LearningRequest -> JointProblem   samples, prior, noise (`joint_problem`)
                -> JointFit       the joint filter, pass after pass (`kalman.passes`)
                -> JointFit       free runs with the same prior, where they predict better (`offline.free_runs`)
                -> JointFit       less sure, where another picture is likelier and contradicts it (`kalman.rivals`)
                -> LogLearning    estimate, model with its posterior, what is to be said of both

Nothing is chosen. Where somebody names what to learn, everything else stays at the prior's mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from towtank.digits import estimate_text
from towtank.errors import InputError
from towtank.identification.data.samples import NoiseLevels, Samples, Sources, samples_of
from towtank.identification.kalman.noise_adaptation import filter_settings
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.kalman.problem import JointFit, JointProblem, settings_for
from towtank.identification.kalman.rivals import apart_from, as_looked_at, likeliest_rival
from towtank.identification.model.measurements import LEAST_NOISE, TYPICAL_NOISE
from towtank.identification.model.parameters import DELAY, LATENCIES, PLACES
from towtank.identification.model.prior import further_unknowns, prior_of
from towtank.identification.model.terms import AHEAD, AXES
from towtank.identification.offline.free_runs import free_run_verdict
from towtank.identification.posterior.assembly import Current, LogLearning, Mode
from towtank.identification.posterior.plausibility import whose_place
from towtank.identification.posterior.result import estimate_of, model_of, with_posterior, without_data
from towtank.identification.posterior.thrusters import learned_gains, scale_remarks
from towtank.recording import Grid, Recording, align
from towtank.recording.consistency.wander import noise_of_smooth_speeds, smooth_speeds
from towtank.recording.noise import noise_of_rows
from towtank.vehicle import Vehicle
from towtank.vehicle.posterior import surely_placed

__all__ = ["LearningRequest", "joint_problem", "learn_joint"]

_CURRENT = slice(18, 21)  # of the filter's errors
_WORTH_SAYING = 0.02  # m/s, and so many deviations of a current
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class LearningRequest:
    """What is asked; see `learn_recordings`.

    Attributes:
        recordings: prepared. samples: of them, where they could be had.
        free_runs: whether they are fitted, too, and then have the last word; None: where windows contradict each other,
            and they speak where they predict better.
    """

    vehicle: Vehicle
    recordings: Sequence[Recording]
    samples: Sequence[Samples] = ()
    free: Collection[str] | None = None
    delay: float | None = None
    longest_delay: float = 0.4
    prior: Vehicle | None = None
    free_runs: bool | None = None


def learn_joint(request: LearningRequest, progress: Progress | None = None) -> LogLearning:
    """Learn a vehicle's coefficients from recordings; see `learn_recordings`."""
    report = progress or (lambda text, share: None)
    report("aligning", 0.0)
    grids = tuple(align(recording) for recording in request.recordings)
    problem = joint_problem(request)
    by_filter = joint_fit(problem, lambda share: report("joint filter", 0.05 + 0.6 * share))
    verdict, said = None, list[str]()
    looked = as_looked_at(problem, by_filter)
    if looked is not None:
        problem, by_filter = looked
        said.append("commands are outputs that were looked at now and then: going on smoothly is likelier than held")
    report("free runs", 0.65)
    if request.free_runs is not False:
        verdict = free_run_verdict(problem, by_filter, grids, request.vehicle, always=bool(request.free_runs))
    fit = by_filter if verdict is None else verdict.fit
    if verdict is not None:
        said.append(verdict.text)
    report("other pictures of the data", 0.85)
    rival = likeliest_rival(problem, by_filter)
    undoubted = fit.covariance
    if rival is not None:
        apart, texts = apart_from(problem, fit, rival)
        fit = replace(fit, covariance=fit.covariance + np.outer(apart, apart))
        said += texts
    report("what is known", 0.95)
    better = verdict is not None and verdict.better
    return _learned(request, problem, fit, undoubted, grids, said, free_runs=better, looked_at=looked is not None)


def joint_problem(request: LearningRequest) -> JointProblem:
    """Return what the joint filter is asked.

    Raises:
        InputError: no recording, nothing to learn from in one, a name that is no coefficient.
    """
    vehicle = request.vehicle
    if not request.recordings:
        raise InputError("no recording given, expected at least one")
    samples = tuple(request.samples or (samples_of(recording, vehicle) for recording in request.recordings))
    settings = settings_for(samples, filter_settings())
    commands = all(each.commands for each in samples)
    named = [name for name in request.free or () if name in AHEAD]
    more = (*further_unknowns(samples), *named)
    whole = prior_of(vehicle, commands=commands, more=more, beside=request.prior)
    prior = whole.narrowed_to(request.free, delay_given=request.delay is not None)
    base = vehicle.with_coefficients(whole.vehicle_values)
    noise = np.median([noise_of_rows(each.t, each.values, TYPICAL_NOISE, LEAST_NOISE) for each in samples], axis=0)
    noise = np.maximum(noise, noise_of_smooth_speeds(request.recordings))
    return JointProblem(samples, base, prior, settings, noise, request.delay or 0.0).in_steps()


def _learned(
    request: LearningRequest,
    problem: JointProblem,
    fit: JointFit,
    undoubted: NDArray[np.float64],
    grids: tuple[Grid, ...],
    said: Sequence[str],
    *,
    free_runs: bool,
    looked_at: bool,
) -> LogLearning:
    """Return the posterior as a model, with what was learned of inputs, sensors and water, and what was said of it.

    undoubted: covariance (n, n) without what another picture of the data contradicts.
    """
    vehicle, free = request.vehicle, fit.free
    duration = sum(each.duration for each in problem.samples)
    rows = sum(map(len, problem.of_each.samples))
    levels = replace(fit.levels, noise=fit.levels.noise / problem.quieter)
    estimate, messages = estimate_of(
        problem.vehicle, fit.prior, fit.theta, fit.covariance, duration, rows, problem.learned, undoubted
    )
    theta, std = dict(zip(free.names, fit.theta, strict=True)), dict(zip(free.names, fit.std, strict=True))
    method = "output-error" if free_runs else "joint"
    delay = max(0.0, float(theta[DELAY])) if DELAY in theta else problem.delay
    lag = float(theta["lag"]) if "lag" in theta else math.nan
    gains = learned_gains(vehicle, free, fit.theta, fit.std)
    source = f"learned by towtank, method {method}"
    model = model_of(problem.vehicle, estimate, source, delay=delay, lag=lag, gains=gains)
    current = _current(fit)
    latency = {
        name.removeprefix("latency_"): (float(theta[name]), float(std[name])) for name in LATENCIES if name in theta
    }
    repaired = [f"{grid.source or 'recording'}: {grid.repairs.summary}" for grid in grids if grid.repairs]
    places = {name: (float(theta[name]), float(std[name])) for name in PLACES if name in theta}
    return LogLearning(
        vehicle=vehicle,
        estimate=estimate,
        model=with_posterior(model, fit.prior, fit.mean, fit.covariance),
        delay=delay,
        delay_scan=None,
        delay_given=request.delay is not None,
        grids=grids,
        sources=tuple(Sources.of(grid.pose, grid.velocity, grid.acceleration) for grid in grids),
        warnings=(*repaired, *messages, *scale_remarks(vehicle)),
        method=method,
        delay_std=float(std.get(DELAY, math.nan)),
        lag=lag,
        lag_std=float(std.get("lag", math.nan)),
        levels=replace(levels, disturbance=levels.disturbance * np.diag(model.mass_matrix)),  # N, N m
        current=current,
        gains=gains,
        latency=latency,
        places=places,
        mode=Mode(fit.prior, fit.theta, levels, looked_at),
        wave_period=fit.wave_period if fit.levels.waves.any() else math.nan,
        narrowed=dict(zip(free.names, (fit.std / without_data(fit.prior, fit.theta)).tolist(), strict=True)),
        remarks=(*_remarks(request, problem, fit, current), *said),
    )


def _current(fit: JointFit) -> Current | None:
    """Return the current that the filter has estimated, where it could."""
    if not fit.state.settings["current_walk"][0] > 0.0:
        return None
    variance: NDArray[np.float64] = np.diag(fit.state.P)[_CURRENT]
    return Current(fit.state.current.copy(), np.sqrt(np.maximum(variance, 0.0)))


def _remarks(
    request: LearningRequest, problem: JointProblem, fit: JointFit, current: Current | None
) -> tuple[str, ...]:
    out = [f"{len(fit.free)} unknowns, all free from the prior; passes of the joint filter: {fit.passes}"]
    if request.free is not None:
        out = [f"free: {', '.join(fit.free.names)}; everything else is fixed at the prior's mean"]
    if not problem.learned.all():
        still = [axis.name for axis, moves in zip(AXES, problem.moving, strict=True) if not moves]
        out.append(f"nothing measures or drives {', '.join(still)}: the prior of what acts there is kept")
    if fit.disagreement > 1.2:
        times = f"{fit.disagreement:.1f} times"
        out.append(f"windows of the data differ {times} as much as they should: deviations are widened by that")
    out += [each.said for each in smooth_speeds(request.recordings)]
    if current is not None and current.speed > max(_WORTH_SAYING, 3.0 * float(current.std[:2].max())):
        out.append(f"the water flows: {current.said}")
    if current is not None and fit.levels.current_walk > NoiseLevels.current_walk:
        changed = 100.0 * fit.levels.current_walk * math.sqrt(60.0)
        out.append(f"the current changes along the way, by some {changed:.2g} cm/s in a minute")
    out += fit.levels.heading_said
    if fit.levels.waves.any():
        size = ", ".join(f"{level:.2g}" for level in fit.levels.waves)
        out.append(f"waves of about {fit.wave_period:.2g} s: the water goes to and fro with {size} m/s (N, E, D)")
    return (*out, *_placed(fit))


def _placed(fit: JointFit) -> list[str]:
    """Return a sentence for each sensor that is surely not at the body's origin."""
    off: dict[str, list[str]] = {}
    for name, (value, std) in surely_placed(fit.free.names, fit.theta, fit.std).items():
        said = f"{estimate_text(100.0 * value, 100.0 * std)} cm along {name[-1]}"
        off.setdefault(whose_place(name), []).append(said)
    return [f"{sensor} is not at the body's origin: {', '.join(said)}" for sensor, said in off.items()]
