"""Learning from recordings by the joint estimator: least squares to begin with, passes of the filter, what is known.

The joint filter over recordings, round after round: until all that is free is determined, or held with a reason.

Long recordings are gone over in stretches first, evenly spread: where the coefficients are to within those stretches'
deviations, the whole needs two passes more.

What the joint estimator is to learn from logs and where it starts, by what least squares found and logs hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.identification.data.noise import NoiseLevels
from towtank.identification.data.samples import Samples, samples_of, spread_over
from towtank.identification.kalman.alternatives import (
    choose_damping,
    current_of,
    damping_in_question,
    suspected_current,
)
from towtank.identification.kalman.iterated import (
    FilterProblem,
    JointFit,
    joint_passes,
    prior_deviation,
    with_inflated_variance,
)
from towtank.identification.kalman.noise_adaptation import common_noise_levels, filter_settings
from towtank.identification.kalman.state import FilterSettings
from towtank.identification.least_squares.batch import Progress, estimate_warnings, learn_paper
from towtank.identification.least_squares.solution import not_commanded
from towtank.identification.least_squares.velocity import drifting_attitude
from towtank.identification.model.parameters import DELAY, LAG, FreeParameters, free_parameters
from towtank.identification.model.prior import prior_information, size_of, start_theta, usual_disturbance
from towtank.identification.model.terms import AXES, paper_names
from towtank.identification.offline.free_runs import learn_free_runs
from towtank.identification.posterior.assembly import LogLearning, assemble, judge
from towtank.identification.posterior.estimate import Estimate
from towtank.identification.posterior.identifiability import DETERMINED, TOLD, Identifiability
from towtank.identification.posterior.thrusters import learned_gains, with_thrusters
from towtank.identification.posterior.wording import HELD, as_fitted
from towtank.identification.simulation_error.refinement import Start
from towtank.recording import Grid, Recording
from towtank.recording.frames.rotations import conjugate, multiply, rotate
from towtank.vehicle import Vehicle

__all__ = ["Rounds", "doubted_inertias", "learn_joint", "run_rounds", "speeds_of"]

_PACE = 0.5  # s between two poses that tell a speed
SURE = 0.025  # deviation of an inertia that least squares cannot tell: on real water the filter's are too small
_IDLE = 0.3  # of the usual disturbance: a commanded force that teaches nothing
_ROUNDS = 3  # of holding what is not determined
_HIDES = 6.0  # time constants of a disturbance that a run can be too short to show


def free_names_of(requested: tuple[str, ...] | None, first: LogLearning) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the names to free and, for those that least squares could not find, why."""
    if requested is not None:
        return requested, {}
    estimate = first.estimate
    names = tuple(name for name, ok in zip(estimate.names, estimate.identified, strict=True) if ok)
    held = {
        name: reason or ""
        for name, ok, reason in zip(estimate.names, estimate.identified, estimate.reasons, strict=True)
        if not ok
    }
    return names, held


def doubted_inertias(names: Collection[str], held: Collection[str]) -> tuple[str, ...]:
    """Return the inertias that least squares could not find on axes whose damping it found."""
    return tuple(a.added_mass for a in AXES if a.added_mass in held and (a.linear in names or a.quadratic in names))


def doubted_by_least_squares(first: LogLearning, found: Estimate) -> tuple[str, ...]:
    """Return a warning for each inertia that was asked for and found, though least squares could not tell it.

    The filter's deviation is that under a slow random force; least squares supposes nothing of what disturbs.
    """
    doubts = []
    for axis in AXES:
        name = axis.added_mass
        if name not in found or name not in first.estimate:
            continue
        learned, plain = found[name], first.estimate[name]
        total = next((each for each in found.sums if each.name == axis.sum_name), None)
        if plain.identified or not learned.identified or total is None or total.std <= SURE * total.value:
            continue
        why = (plain.reason or "not determined").removesuffix(HELD)
        doubts.append(
            f"{name}: least squares cannot tell it ({why}); its deviation of {total.std:.2g} {total.unit} holds if "
            "what disturbs the vehicle is a slow random force, and may be far too small if it is not"
        )
    return tuple(doubts)


def known_start(vehicle: Vehicle, first: LogLearning) -> Vehicle:
    """Return the vehicle with what least squares found, however unsure, where it is physical."""
    changes = {}
    for learned in first.estimate.coefficients:
        if learned.identified:
            changes[learned.name] = learned.value
    return vehicle.with_coefficients(changes) if changes else vehicle


def speeds_of(first: LogLearning) -> Array:
    """Return root mean square and largest size (6, 2) of the speeds, measured or from pose to pose; NaN if unknown."""
    out = np.full((6, 2), np.nan)
    between = [_paces(grid) for grid in first.grids]
    for i in range(6):
        columns = [grid.velocity[:, i] for grid in first.grids]
        columns = [v if np.isfinite(v).any() else pace[:, i] for v, pace in zip(columns, between, strict=True)]
        values = np.concatenate([column[np.isfinite(column)] for column in columns])
        if values.size:
            out[i] = np.sqrt(np.mean(values**2)), np.abs(values).max()
    return out


def _paces(grid: Grid) -> Array:
    """Return mean body velocities (k, 6) from pose to pose, `_PACE` apart: noise and jumps matter little."""
    step = max(2, round(_PACE / grid.dt))
    pose = grid.pose[::step]
    q, middle = quaternions_from_eulers(pose[:, 3:]), quaternions_from_eulers(grid.pose[step // 2 :: step, 3:])
    moved = rotate(conjugate(middle[: len(q) - 1]), np.diff(pose[:, :3], axis=0))
    turn = multiply(conjugate(q[:-1]), q[1:])
    size = np.linalg.norm(turn[:, 1:], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.where(size > 0.0, 2.0 * np.arctan2(size, np.abs(turn[:, 0])) / size, 2.0) * np.sign(turn[:, 0])
    return np.asarray(np.hstack([moved, turn[:, 1:] * angle[:, None]]) / (step * grid.dt))


def idle(vehicle: Vehicle, samples: Sequence[Samples]) -> dict[str, str]:
    """Return the inertias and dampings of axes that nothing but the water moved, and what is to be said of them.

    How much they are beside the water's force is told, and of that no size. They are free all the same: the others
    would pay for what they are held at.
    """
    moments, counted = np.zeros((2, 6)), 0
    for each in samples:
        forces = each.input_force[np.isfinite(each.input_force).all(axis=1)]
        moments[0] += each.B @ forces.sum(axis=0)
        moments[1] += np.einsum("ij,jk,ik->i", each.B, forces.T @ forces, each.B)
        counted += len(forces)
    if not counted:
        return {}
    mean, square = moments / counted
    still = square - mean**2 < (_IDLE * usual_disturbance(vehicle)) ** 2
    return {
        name: not_commanded(axis) for axis in AXES for name in (*axis.columns[:2], axis.added_mass) if still[axis.index]
    }


@dataclass(frozen=True, eq=False)
class Rounds:
    """What the filter made of the recordings.

    Attributes:
        fit: with what is free in the end. findings: what the recordings tell of that.
        base: the vehicle with what is held where the result has it.
        unidentified: why a coefficient is not. zeroed: those taken as 0.
        added, dropped: damping terms that are free though least squares left them out, and the other way round.
        sure: inertias that least squares doubts and the filter knows.
        few: stretches that stand for long recordings.
        before: the fit to them with the damping terms of least squares, None where these are what is free.
    """

    fit: JointFit
    findings: Identifiability
    base: Vehicle
    unidentified: dict[str, str]
    set_to_zero: tuple[str, ...]
    added: tuple[str, ...]
    dropped: tuple[str, ...]
    sure: tuple[str, ...]
    few: Sequence[Samples]
    before: JointFit | None


def run_rounds(
    vehicle: Vehicle,
    samples: Sequence[Samples],
    free: FreeParameters,
    theta: Array,
    levels: NoiseLevels,
    settings: FilterSettings,
    *,
    held: Mapping[str, str],
    doubted: Sequence[str],
    set_to_zero: Sequence[str],
    delay: float,
    prior: Vehicle | None,
    requested: bool,
    speeds: Array,
    progress: Callable[[float], None],
) -> Rounds:
    """Fit what is free, choose between damping terms, and hold what is not determined.

    Args:
        free, theta: what to learn, and where it begins (n,). levels: to begin with.
        held: why other coefficients are not learned. doubted: inertias among them that the filter is asked for.
        zeroed: those of them that are taken as 0.
        delay: of the inputs [s] where it is not free. prior: a vehicle whose coefficients bear deviations.
        asked: somebody named the coefficients, so that none is held, and identified is what is told from 0.
        speeds: see `judge`. told: gets the share done.
    """

    def known(chosen: FreeParameters) -> tuple[Array, Array] | None:
        return None if prior is None else prior_information(prior, chosen)

    def problem(of: Sequence[Samples], holding: Vehicle, chosen: FreeParameters) -> FilterProblem:
        deviation = prior_deviation(chosen, size_of(vehicle, chosen))
        return FilterProblem(of, np.array(holding.parameters), chosen, deviation, known(chosen), delay, own_noise)

    def passes(
        of: Sequence[Samples],
        holding: Vehicle,
        chosen: FreeParameters,
        theta: Array,
        levels: NoiseLevels,
        *,
        begin: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> JointFit:
        return joint_passes(
            problem(of, holding, chosen), theta, levels, settings, begin=begin, inflate=False, progress=progress
        )

    own_noise = levels.noise  # the filter's may hold what its model lacks
    unidentified, left_out = dict(held), list(set_to_zero)
    base = vehicle.with_coefficients(dict.fromkeys(left_out, 0.0))
    few = spread_over(samples)
    fit = passes(few, base, free, theta, levels, begin=True, progress=lambda share: progress(0.3 * share))
    sure: tuple[str, ...] = ()
    if doubted:
        wide = free_parameters(vehicle, (*free.names, *doubted))
        guess = dict(zip(wide.names, start_theta(vehicle, vehicle, wide, delay=delay, lag=0.0), strict=True))
        guess |= dict(zip(free.names, fit.theta, strict=True))
        start = np.array([guess[name] for name in wide.names])
        more = passes(few, base, wide, start, fit.levels, begin=True)
        sure = tuple(name for name in doubted if more.std[wide.names.index(name)] <= SURE)
        if sure:
            keep = [k for k, name in enumerate(wide.names) if name in (*free.names, *sure)]
            free = wide.subset([wide.names[k] for k in keep])
            fit = passes(few, base, free, more.theta[keep], more.levels)
            unidentified = {name: why for name, why in unidentified.items() if name not in sure}
            left_out = [name for name in left_out if name not in sure]
    added: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    before: JointFit | None = None
    if pairs := damping_in_question(vehicle, free.names, requested=requested):
        progress(0.3)
        choice = choose_damping(
            problem(few, base, free), base, fit, pairs, settings=settings, prior=known, requested=requested
        )
        if choice is not None:
            added = tuple(name for name in choice.fit.free.names if name not in free.names)
            dropped = tuple(name for name in choice.left_out if name in free.names)
            before = fit if added or dropped else None
            fit, free = choice.fit, choice.fit.free
            unidentified = {name: why for name, why in unidentified.items() if name not in free.names}
            unidentified.update(choice.left_out)
            left_out = [name for name in left_out if name not in free.names]
            left_out += [name for name in choice.left_out if name not in left_out]
            base = vehicle.with_coefficients(dict.fromkeys(left_out, 0.0))
    theta, levels = fit.theta, fit.levels
    for _ in range(_ROUNDS):
        scale, information = size_of(vehicle, free), known(free)
        fit = passes(samples, base, free, theta, levels, progress=lambda share: progress(0.5 + 0.4 * share))
        deviation = prior_deviation(free, scale)
        findings = judge(
            free,
            fit.theta,
            fit.uninflated,
            deviation,
            scale,
            prior=None if information is None else information[1],
            speeds=speeds,
            enough=TOLD if requested else DETERMINED,
        )
        held_now = {name: hold for name, hold in findings.held.items() if name not in (DELAY, LAG)}
        if requested or not held_now:
            break
        unidentified.update({name: findings.reasons.get(name, "not determined") for name in held_now})
        left_out += [name for name, hold in held_now.items() if hold == "zero"]
        base = vehicle.with_coefficients(dict.fromkeys(left_out, 0.0))
        keep = [k for k, name in enumerate(free.names) if name not in held_now]
        free, theta, levels = free.subset([free.names[k] for k in keep]), fit.theta[keep], fit.levels
    progress(0.9)
    fit = with_inflated_variance(problem(samples, base, fit.free), fit, settings)
    return Rounds(fit, findings, base, unidentified, tuple(left_out), added, dropped, sure, few, before)


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
    progress = progress or (lambda text, share: None)
    requested = tuple(free) if free is not None else None
    paper = set(paper_names())
    for_paper = [name for name in requested if name in paper] if requested is not None else None
    least_squares = partial(
        learn_paper, vehicle, recordings, free=for_paper or None, delay=delay, longest_delay=longest_delay
    )
    first = least_squares(sparing=True, progress=lambda text, share: progress(text, 0.3 * share))
    samples = [samples_of(recording, vehicle) for recording in recordings]
    to_learn, held = free_names_of(requested, first)
    if delay is None and any(each.commands for each in samples):
        to_learn = (*to_learn, DELAY)
    parameters = free_parameters(vehicle, to_learn)
    known = known_start(vehicle, first)
    lag = float(np.mean(samples[0].lag)) if samples[0].lag.size and samples[0].lag.any() else 0.05
    found_delay = first.delay
    if LAG in to_learn:
        found_delay = max(0.0, found_delay - lag)
    theta = start_theta(vehicle, known, parameters, delay=found_delay, lag=lag)
    levels = common_noise_levels(recordings, samples, vehicle)
    own_noise = levels.noise  # the filter's may hold what its model lacks
    settings = replace(filter_settings(vehicle), current=current)
    found = run_rounds(
        vehicle,
        samples,
        parameters,
        theta,
        levels,
        settings,
        held=held,
        doubted=doubted_inertias(to_learn, held) if requested is None else (),
        set_to_zero=[name for name in held if first.model.coefficient(name) == 0.0],
        delay=found_delay,
        prior=prior,
        requested=requested is not None,
        speeds=speeds_of(first),
        progress=lambda share: progress("joint filter", 0.3 + 0.4 * share),
    )
    fit, base, findings, unidentified = found.fit, found.base, found.findings, found.unidentified
    parameters, set_to_zero = fit.free, list(found.set_to_zero)
    chosen = [name for name in (*to_learn, *found.added, *found.sure) if name not in found.dropped]
    progress("free runs", 0.7)
    method, remarks, water = "joint", [], None
    doubts: tuple[str, ...] = ()
    if current:
        water = current_of(fit.state)
        remarks.append(f"the water flows: {water.said}, at the end of the last recording")
    else:
        flow = suspected_current(
            FilterProblem(
                found.few,
                np.array(base.parameters),
                fit.free,
                prior_deviation(parameters, size_of(vehicle, parameters)),
                _prior(prior, parameters),
                found_delay,
            ),
            fit,
            settings,
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
            _starts(vehicle, fit, chosen if requested is None else parameters.names, known, found_delay),
            []
            if found.before is None or requested is not None
            else _starts(vehicle, found.before, to_learn, known, found_delay),
            own_noise,
            [drifting_attitude(g, s, each.t) for g, s, each in zip(first.grids, first.sources, samples, strict=True)],
            (first.model, first.delay),
            delay=found_delay,
            prior=lambda chosen: _prior(prior, chosen),
            terms=requested is None,
            find_lag=requested is None and delay is None and _may_lag(samples),
            always=refine == "always",
            speeds=speeds_of(first),
            progress=lambda share: progress("free runs", 0.7 + 0.25 * share),
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
        if fit.duration < _HIDES * settings.time_constant:
            spread = _no_surer(parameters, spread, fit)
        fit = replace(fit, free=parameters, theta=second.refined.theta, covariance=spread, uninflated=spread)
        unidentified = {name: why for name, why in unidentified.items() if name not in second.refined.added}
        unidentified.update({name: held[name] for name in (*found.added, *found.sure) if name not in parameters.names})
        unidentified.update(second.reasons)
        to_learn = (*to_learn, *(name for name in second.refined.added if name not in to_learn))
        set_to_zero = [
            name for name in (*set_to_zero, *found.added, *second.set_to_zero) if name not in parameters.names
        ]
    else:
        unidentified = {**{n: why for n, why in findings.reasons.items() if n not in (DELAY, LAG)}, **unidentified}
    roughly: list[str] = []
    if requested is not None:
        moved_by_water = idle(vehicle, samples)
        if method == "joint":
            roughly = [f.name for f in findings.findings if f.rough and f.name in unidentified.keys() - moved_by_water]
        unidentified.update({name: as_fitted(unidentified[name]) for name in roughly})
        unidentified.update({name: why for name, why in moved_by_water.items() if name in parameters.names})
    progress("what is known", 0.95)
    assembled = assemble(
        vehicle,
        parameters,
        fit.theta,
        fit.covariance,
        [name for name in to_learn if name not in (DELAY, LAG)] + [name for name in held if name not in to_learn],
        unidentified,
        set_to_zero,
        first.estimate.axes,
        fit.duration,
        fit.rows,
        roughly,
    )
    learned = _learned(vehicle, first, assembled.estimate, assembled.remarks, parameters, fit, found_delay, method)
    if requested is not None:
        doubts = (*doubts, *doubted_by_least_squares(first, assembled.estimate))
    warnings = (*learned.warnings, *doubts)
    return replace(learned, current=water, warnings=warnings, remarks=(*learned.remarks, *remarks))


def _starts(
    vehicle: Vehicle, fit: JointFit, to_learn: Sequence[str], least_squares: Vehicle, delay: float
) -> list[Start]:
    """Return where free runs may begin: the joint filter's coefficients, and all that least squares found."""
    whole = free_parameters(vehicle, to_learn)
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
