"""Learning from whole recordings, in stages from record to record.

LearningRequest -> Prepared      least squares, what to learn by it, and where that starts
                -> Rounds        the joint filter (`offline.rounds`)
                -> FreeRunOutcome  free runs as the second judge (`offline.free_runs`)
                -> Settled       whose coefficients count, and why others are not known
                -> LogLearning   estimate, model, warnings
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.identification.data.samples import Samples, samples_of
from towtank.identification.kalman.alternatives import current_of, suspected_current
from towtank.identification.kalman.iterated import JointFit
from towtank.identification.kalman.noise_adaptation import common_noise_levels, filter_settings
from towtank.identification.least_squares.batch import Progress, estimate_warnings, learn_paper
from towtank.identification.least_squares.solution import not_commanded
from towtank.identification.least_squares.velocity import drifting_attitude
from towtank.identification.model.parameters import DELAY, LAG, FreeParameters, free_parameters
from towtank.identification.model.prior import start_theta, usual_disturbance
from towtank.identification.model.terms import AXES, given_terms, paper_names
from towtank.identification.offline.free_runs import FreeRunOutcome, FreeRunTask, learn_free_runs
from towtank.identification.offline.rounds import SURE, FilterTask, Rounds, Start, doubted_inertias, run_rounds
from towtank.identification.posterior.assembly import Assembled, Current, LogLearning, Outcome, Posterior, assemble
from towtank.identification.posterior.estimate import Estimate
from towtank.identification.posterior.thrusters import learned_gains, with_thrusters
from towtank.identification.posterior.wording import as_fitted, current_estimated, current_suspected, inertia_doubted
from towtank.identification.simulation_error.segments import CandidateModel
from towtank.recording import Grid, Recording
from towtank.recording.frames.rotations import conjugate, multiply, rotate
from towtank.vehicle import Vehicle

__all__ = ["LearningRequest", "learn_joint"]

_PACE = 0.5  # s between two poses that give a speed
_IDLE = 0.3  # of the usual disturbance: a commanded force that teaches nothing
_HIDES = 6.0  # time constants of a disturbance that a run can be too short to show
_LAG = 0.05  # s, of thrusters of which nothing is known


@dataclass(frozen=True, eq=False)
class LearningRequest:
    """What is asked; see `learn_recordings`.

    Attributes:
        recordings: prepared. samples: of them, where they could be had.
        always_free_runs: output error has the last word in any case.
    """

    vehicle: Vehicle
    recordings: Sequence[Recording]
    samples: Sequence[Samples] = ()
    free: Collection[str] | None = None
    delay: float | None = None
    longest_delay: float = 0.4
    prior: Vehicle | None = None
    current: bool = False
    always_free_runs: bool = False

    @property
    def named(self) -> bool:
        """Whether somebody named the coefficients, so that there is no choosing."""
        return self.free is not None

    def least_squares(self, *, sparing: bool = False, progress: Progress | None = None) -> LogLearning:
        """Learn by the paper's method; `sparing`: of long recordings from stretches, evenly spread."""
        paper = set(paper_names())
        free = [name for name in self.free if name in paper] if self.free is not None else None
        return learn_paper(
            self.vehicle,
            self.recordings,
            free=free or None,
            delay=self.delay,
            longest_delay=self.longest_delay,
            sparing=sparing,
            progress=progress,
        )


@dataclass(frozen=True, eq=False)
class Prepared:
    """What there is before the filter begins.

    Attributes:
        first: what least squares found. to_learn: names to free.
        known: the vehicle with what least squares found, however unsure, where it is physical.
        task: of the filter; its delay [s] is that of the inputs where none is free.
    """

    request: LearningRequest
    first: LogLearning
    to_learn: tuple[str, ...]
    known: Vehicle
    task: FilterTask


@dataclass(frozen=True, eq=False)
class Settled:
    """Whose coefficients count, and what is to be said of the others.

    Attributes:
        fit: theta and covariance of what counts. delay: [s] where it is not free. method: that it comes from.
        unidentified: why a name is not. set_to_zero: those taken as 0. roughly: those that are as fitted all the same.
    """

    fit: JointFit
    delay: float
    method: str
    to_learn: tuple[str, ...]
    unidentified: dict[str, str]
    set_to_zero: Sequence[str]
    roughly: Sequence[str] = ()

    @property
    def posterior(self) -> Posterior:
        """The coefficients."""
        return Posterior(self.fit.free, self.fit.theta, self.fit.covariance)


@dataclass(frozen=True, eq=False)
class _Water:
    """The current, where it was estimated, and what is to be said of it."""

    current: Current | None = None
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def learn_joint(request: LearningRequest, progress: Progress | None = None) -> LogLearning:
    """Learn a vehicle's coefficients from recordings; see `learn_recordings`."""
    progress = progress or (lambda text, share: None)
    prepared = _prepared(request, progress)
    rounds = run_rounds(prepared.task, lambda share: progress("joint filter", 0.3 + 0.4 * share))
    progress("free runs", 0.7)
    water = _water(prepared.task, rounds)
    runs = None if request.current else _free_runs(prepared, rounds, progress)
    remarks = water.remarks if runs is None else (*water.remarks, runs.remark)
    if runs is not None and runs.least_squares and not request.always_free_runs:
        whole = prepared.first if rounds.few is prepared.task.samples else request.least_squares()
        return replace(whole, levels=rounds.fit.levels, remarks=(*whole.remarks, *remarks))
    if runs is not None and (runs.first.better or request.always_free_runs):
        settled = _settled_by_free_runs(prepared, rounds, runs)
    else:
        settled = _settled_by_filter(prepared, rounds)
    settled = _with_idle_axes(prepared, rounds, settled)
    progress("what is known", 0.95)
    assembled = _assembled(prepared, settled)
    learned = _learned(prepared, settled, assembled)
    doubts = _doubts(prepared.first, assembled.estimate) if request.named else ()
    warnings = (*learned.warnings, *water.warnings, *doubts)
    return replace(learned, current=water.current, warnings=warnings, remarks=(*learned.remarks, *remarks))


def _prepared(request: LearningRequest, progress: Progress) -> Prepared:
    """Learn by least squares, and choose by that what to learn, and where it starts."""
    vehicle = request.vehicle
    first = request.least_squares(sparing=True, progress=lambda text, share: progress(text, 0.3 * share))
    samples = request.samples or tuple(samples_of(recording, vehicle) for recording in request.recordings)
    coefficients = first.estimate.coefficients
    to_learn, held = tuple(request.free or ()), dict[str, str]()
    if not request.named:
        to_learn = tuple(each.name for each in coefficients if each.identified)
        moved = [axis.index for axis in AXES if {axis.added_mass, axis.linear, axis.quadratic} & set(to_learn)]
        to_learn += given_terms(vehicle, moved)
        held = {each.name: each.reason or "" for each in coefficients if not each.identified}
    if request.delay is None and any(each.commands for each in samples):
        to_learn = (*to_learn, DELAY)
    free = free_parameters(vehicle, to_learn)
    changes = {each.name: each.value for each in coefficients if each.identified}
    known = vehicle.with_coefficients(changes) if changes else vehicle
    lag = float(np.mean(samples[0].lag)) if samples[0].lag.size and samples[0].lag.any() else _LAG
    delay = max(0.0, first.delay - lag) if LAG in to_learn else first.delay
    theta = start_theta(vehicle, known, free, delay=delay, lag=lag)
    task = FilterTask(
        vehicle,
        samples,
        Start(free, theta, common_noise_levels(request.recordings, samples, vehicle)),
        replace(filter_settings(vehicle), current=request.current),
        held=held,
        doubted=() if request.named else doubted_inertias(to_learn, held),
        set_to_zero=[name for name in held if first.model.coefficient(name) == 0.0],
        delay=delay,
        prior=request.prior,
        requested=request.named,
        speeds=speeds_of(first),
    )
    return Prepared(request, first, to_learn, known, task)


def _water(task: FilterTask, rounds: Rounds) -> _Water:
    """Return the current that was learned, or a warning where one is suspected."""
    fit = rounds.fit
    if task.settings.current:
        water = current_of(fit.state)
        return _Water(water, (current_estimated(water.said),))
    flow = suspected_current(task.problem(rounds.few, rounds.base, fit.free), fit, task.settings)
    return _Water() if flow is None else _Water(warnings=(current_suspected(flow.said),))


def _free_runs(prepared: Prepared, rounds: Rounds, progress: Progress) -> FreeRunOutcome | None:
    """Ask free runs, which begin at the joint filter's coefficients and at all that least squares found."""
    request, first, samples, fit = prepared.request, prepared.first, prepared.task.samples, rounds.fit
    task, free = prepared.task, fit.free
    base = rounds.base.with_coefficients({name: 0.0 for name in rounds.added if name in free.names})
    names = [name for name in (*prepared.to_learn, *rounds.added, *rounds.sure) if name not in rounds.dropped]

    def starts(fit: JointFit, names: Sequence[str]) -> list[CandidateModel]:
        whole, known, delay = free_parameters(request.vehicle, names), prepared.known, task.delay
        theta = start_theta(known, known, whole, delay=delay, lag=_LAG)
        return [CandidateModel(base, fit.free, fit.theta, delay), CandidateModel(base, whole, theta, delay)]

    by_least_squares = free.theta(first.model, delay=first.delay, lag=0.0)
    lagging = all(each.commands and not each.lag.any() for each in samples)  # nobody says how fast thrusters answer
    runs_task = FreeRunTask(
        starts=starts(fit, free.names if request.named else names),
        instead=[] if rounds.before is None or request.named else starts(rounds.before, prepared.to_learn),
        least_squares=CandidateModel(first.model, free, by_least_squares, first.delay),
        terms=not request.named,
        find_lag=not request.named and request.delay is None and lagging,
        always=request.always_free_runs,
        speeds=task.speeds,
    )
    attitude = [drifting_attitude(g, s, each.t) for g, s, each in zip(first.grids, first.sources, samples, strict=True)]
    runs = runs_task.runs_over(request.vehicle, samples, task.shown, attitude, task.known)
    return learn_free_runs(runs_task, runs, lambda share: progress("free runs", 0.7 + 0.25 * share))


def _settled_by_filter(prepared: Prepared, rounds: Rounds) -> Settled:
    reasons = {name: why for name, why in rounds.findings.reasons.items() if name not in (DELAY, LAG)}
    unidentified = {**reasons, **rounds.unidentified}
    return Settled(rounds.fit, prepared.task.delay, "joint", prepared.to_learn, unidentified, rounds.set_to_zero)


def _settled_by_free_runs(prepared: Prepared, rounds: Rounds, runs: FreeRunOutcome) -> Settled:
    model, covariance, added = runs.refined.model, runs.refined.covariance, runs.refined.added
    names, task = model.free.names, prepared.task
    if rounds.fit.duration < _HIDES * task.settings.time_constant:
        covariance = _no_surer(model.free, covariance, rounds.fit)
    unidentified = {name: why for name, why in rounds.unidentified.items() if name not in added}
    unidentified |= {name: task.held[name] for name in (*rounds.added, *rounds.sure) if name not in names}
    zeros = (*rounds.set_to_zero, *rounds.added, *runs.set_to_zero)
    return Settled(
        fit=replace(rounds.fit, free=model.free, theta=model.theta, covariance=covariance, uninflated=covariance),
        delay=model.delay,
        method="output-error",
        to_learn=(*prepared.to_learn, *(name for name in added if name not in prepared.to_learn)),
        unidentified=unidentified | runs.reasons,
        set_to_zero=[name for name in zeros if name not in names],
    )


def _no_surer(free: FreeParameters, covariance: Array, joint: JointFit) -> Array:
    """Return the covariance (n, n) of free runs, no deviation smaller than the joint filter's.

    In a short run the initial state and the coefficients can take on a disturbance, and leave residuals that are white.
    """
    std = dict(zip(joint.free.names, joint.std, strict=True))
    own = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    grown = np.array([max(1.0, std.get(name, 0.0) / own[k]) for k, name in enumerate(free.names)])
    return np.asarray(covariance * np.outer(grown, grown))


def _with_idle_axes(prepared: Prepared, rounds: Rounds, settled: Settled) -> Settled:
    """Return what is settled where somebody named the coefficients: all are as fitted, and it is said how surely."""
    if not prepared.request.named:
        return settled
    moved_by_water = _idle(prepared.request.vehicle, prepared.task.samples)
    unidentified, roughly = dict(settled.unidentified), list[str]()
    if settled.method == "joint":
        unsure = unidentified.keys() - moved_by_water
        roughly = [each.name for each in rounds.findings.findings if each.rough and each.name in unsure]
    unidentified.update({name: as_fitted(unidentified[name]) for name in roughly})
    unidentified.update({name: why for name, why in moved_by_water.items() if name in settled.fit.free.names})
    return replace(settled, unidentified=unidentified, roughly=roughly)


def _idle(vehicle: Vehicle, samples: Sequence[Samples]) -> dict[str, str]:
    """Return the inertias and dampings of axes that nothing but the water moved, and what is to be said of them.

    How much they are beside the water's force can be seen, and of that no size. They are free all the same: the others
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


def _assembled(prepared: Prepared, settled: Settled) -> Assembled:
    to_learn, fit = settled.to_learn, settled.fit
    names = [name for name in to_learn if name not in (DELAY, LAG)]
    names += [name for name in prepared.task.held if name not in to_learn]
    outcome = Outcome(
        settled.posterior,
        names,
        settled.unidentified,
        settled.set_to_zero,
        prepared.first.estimate.axes,
        fit.duration,
        fit.rows,
        settled.roughly,
    )
    return assemble(prepared.request.vehicle, outcome)


def _learned(prepared: Prepared, settled: Settled, assembled: Assembled) -> LogLearning:
    """Return the estimate as a model, with what was learned of the inputs."""
    vehicle, first, fit, estimate = prepared.request.vehicle, prepared.first, settled.fit, assembled.estimate
    theta = dict(zip(fit.free.names, fit.theta, strict=True))
    stds = dict(zip(fit.free.names, fit.std, strict=True))
    delay = max(0.0, float(theta[DELAY])) if DELAY in theta else settled.delay
    lag = float(np.exp(theta[LAG])) if LAG in theta else math.nan
    model = estimate.model(vehicle, f"learned by towtank, method {settled.method}")
    gains = learned_gains(vehicle, fit.free, fit.theta, fit.std)
    if vehicle.thrusters:
        model = with_thrusters(model, lag=lag, gains=gains)
        model = model.model_copy(update={"command_delay": max(0.0, delay)})
    outdated = estimate_warnings(vehicle, first.estimate)
    about_logs = [text for text in first.warnings if text not in outdated]
    return replace(
        first,
        estimate=estimate,
        model=model,
        delay=delay,
        delay_std=float(stds.get(DELAY, np.nan)),
        lag=lag,
        lag_std=float(stds[LAG]) * lag if LAG in stds else math.nan,
        levels=fit.levels,
        gains=gains,
        method=settled.method,
        warnings=(*about_logs, *estimate_warnings(vehicle, estimate), *assembled.remarks),
    )


def _doubts(first: LogLearning, estimate: Estimate) -> tuple[str, ...]:
    """Return a warning for each inertia that was asked for and found, though least squares could not tell it.

    The filter's deviation is that under a slow random force; least squares supposes nothing of what disturbs.
    """
    doubts = []
    for axis in AXES:
        name = axis.added_mass
        if name not in estimate or name not in first.estimate:
            continue
        learned, plain = estimate[name], first.estimate[name]
        total = next((each for each in estimate.sums if each.name == axis.sum_name), None)
        if not plain.identified and learned.identified and total is not None and total.std > SURE * total.value:
            doubts.append(inertia_doubted(name, plain.reason, total.std, total.unit))
    return tuple(doubts)


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
