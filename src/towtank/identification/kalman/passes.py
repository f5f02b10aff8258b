"""The joint filter over whole recordings: from the prior, pass after pass, until nothing moves any more.

Every pass starts from the prior itself, linearised about what the last pass found, so that data count once however
many passes there are: Gauss and Newton's way to the mode of the posterior. Where motion does not follow the prior's
mean, a first pass takes the disturbance for far larger than it will be, so that it is led by the data's large features
alone; what that misleads has other beginnings, and the likelier speaks (`settled`). Between passes the levels of noise
and disturbance follow what the pass shows (`kalman.noise_adaptation`), sensors that are late are moved back by what
their latency is found to be, and no step is longer than the prior allows. What a pass finds is brought to the likeliest
point that physics allows (`posterior.physical`): a delay of -0.2 s undoes a lag of 0.2 s to first order, and only so.

Drag is far from linear in a current. So the motion is linearised about the current of each recording, too, as far as
the last pass has found that it surely flows.

Where a sensor sees the ground, waves are among the unknowns: water that goes to and fro. They stay where the likelihood
gains by far more than chance. When passes have ended, one each tells whether what was measured is far likelier in other
water, beside a heading that wanders, or with speeds that walk less; passes go on from the likeliest, and ask again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import ZeroOrderHold
from towtank.identification.data.samples import NoiseLevels, Samples
from towtank.identification.kalman.filter import hold_inputs, joint_events, rows_of
from towtank.identification.kalman.noise_adaptation import (
    adapt_noise,
    converged,
    diverged,
    follows,
    most_disturbed,
    rejected_share,
)
from towtank.identification.kalman.problem import ROUGH, JointFit, JointProblem, inputs_of, latencies_of
from towtank.identification.kalman.state import (
    JointState,
    coefficient_block,
    coefficient_std,
    forget_surroundings,
    new_joint_state,
    surely_flows,
)
from towtank.identification.model.measurements import SPEEDS
from towtank.identification.model.parameters import IN_DELAY, IN_LAG, linearised_about, seen_about, told
from towtank.identification.posterior.physical import Region
from towtank.identification.posterior.statistics import Reading, widened
from towtank.recording.grids.stretches import spread
from towtank.recording.standard import MEASURED

__all__ = [
    "FAR_LIKELIER",
    "WAVE_PERIODS",
    "first_passes",
    "joint_fit",
    "next_recording",
    "one_pass",
    "settled",
    "since_last",
]

_SAME_WATER = 600.0  # s after which a stretch of one session may be in another current

_WINDOWS, _LEAST_WINDOW = 16, 25  # of a pass, that must agree; rows
_PASSES = 16
_LONGEST_STEP = 1.5  # deviations of the prior
_PATIENCE, _CHANCE = 4, 5.0  # passes after one that gained; of the log likelihood, by which two are alike
_SOONEST = 0.2  # of the delay and the lag that are supposed, in a second beginning
_TOO_SOON = 0.1  # deviations of both in the prior, by which data ask for less of them than physics allows
_DAMPED = 0.5  # share of a step that goes back on the last one
_STILL = 0.05  # deviations of the posterior that a coefficient may still move
_MUCH_WORSE = 100.0  # of the log likelihood, that a pass may lose on the one before
WAVE_PERIODS = (3.5, 4.2, 5.0, 6.0, 7.2, 8.6)  # s, of waves that are tried beside that of the settings
_WAVE = 0.03  # m/s: their size to begin with
_LESS_WALK = (0.5, 0.2, 0.05)  # times the velocity walk that passes have come to
_HEADINGS = (0.03, 0.12)  # rad: of the bias of a heading that wanders
_ATTITUDE, _R = slice(MEASURED.index("phi"), MEASURED.index("psi") + 1), MEASURED.index("r")
_WALKS, _WATER_GAIN = (3e-3, 1e-2, 3e-2), 10.0  # m/s per sqrt(s), of a current; of the log likelihood
_PIECE = 10.0  # s of a recording that are linearised about one current
FAR_LIKELIER = 20.0  # of the log likelihood: far beyond chance with two numbers for each axis
_WAVES_GAIN = 20.0  # of the log likelihood: far beyond chance with four numbers
_WAVES_SHOW = 20.0  # s: of shorter data a wave is no more than a slow force
_SMALLEST_WAVE = 0.015  # m/s: below, a wave stands for what the model lacks
_CALM_AFTER = 1  # passes after which waves that have become so small are given up
Progress = Callable[[float], None]


def since_last(state: JointState, t: Array) -> float | None:
    """Return how long [s] after the filter's last row a stretch of times t (n,) begins, where the water is the same."""
    if not state.clock[0].duration > 0.0:
        return None
    elapsed = float(t[0] - state.clock[0].time) if t.size else 0.0
    return elapsed if 0.0 <= elapsed <= _SAME_WATER else None


def next_recording(state: JointState, samples: Samples, elapsed: float | None = None) -> JointState:
    """Return the filter, to go on with another recording: its motion begins anew, in other water.

    Args:
        elapsed: since the last row [s], where the water is the same.
    """
    state.clock["started"] = 0.0
    forget_surroundings(state, elapsed)
    return state._replace(B=np.ascontiguousarray(samples.B), mean_force=np.zeros((3, samples.B.shape[1])))


def one_pass(
    problem: JointProblem,
    about: Array,
    levels: NoiseLevels,
    progress: Progress | None = None,
    *,
    windows: int = _WINDOWS,
) -> tuple[JointState, ZeroOrderHold, list[Reading], Array]:
    """Run the filter once over all recordings, linearised about theta (n,) `about`, `linearised_about`.

    Returns its state and the inputs' at the end; the prior, and what was known at the ends of so many windows; and the
    `currents` of `NoiseLevels`.
    """
    free, samples = problem.free, problem.samples
    about = linearised_about(free, about)
    prior = Reading(0.0, *seen_about(free, about, *problem.prior.seen_from(about)))
    parameters, B, settings = np.array(problem.vehicle.parameters), samples[0].B, problem.settings
    state = new_joint_state(
        parameters, free, prior.theta, prior.covariance, B, levels, settings, about, problem.learned
    )
    latency = latencies_of(free, about)
    total, done, passed = max(sum(len(each) for each in samples), 1), 0, 0.0
    window, readings, currents = max(_LEAST_WINDOW, total // windows), [prior], list[list[Array]]()
    piece = max(_LEAST_WINDOW, int(_PIECE * total / max(sum(each.duration for each in samples), _PIECE)))
    for k, recorded in enumerate(samples):
        each = recorded.shifted(latency)
        elapsed = since_last(state, each.t) if problem.session else None
        if elapsed is None or not currents:
            currents.append([])
        state = next_recording(state, each, elapsed)
        speeds = (each.values[:, 3 * sensor : 3 * sensor + 2] for sensor in SPEEDS)
        state.clock["speeds"] = any(np.isfinite(u_and_v).all(axis=1).any() for u_and_v in speeds)
        held = inputs_of(each, free, about, problem.delay)
        rows, taken = rows_of(each), 0
        ends = sorted({*range(window, len(each), window), *range(piece, len(each), piece), len(each)} - {0})
        for first, last in pairwise((0, *ends)):
            begin, end = float(each.t[first]), float(each.t[last - 1])
            current = levels.current_at(0.5 * (begin + end), k, len(samples))
            state.current_at[:] = state.current_at if current is None else current
            taken = joint_events(state, held, rows, first, last, taken)
            currents[-1].append(np.array([k, begin, end, *state.current, *np.diag(state.P)[18:21]]))
            if progress is not None:
                progress(min(1.0, (done + last) / total))
            if last % window == 0 or last == len(each):
                t = passed + end - float(each.t[0])
                readings.append(Reading(t, state.theta.copy(), coefficient_block(state).copy()))
        hold_inputs(held, each, taken)
        done += len(each)
        passed += each.duration
    found = [row for water in currents for row in _smoothed(water, levels.current_walk)]
    return state, held, readings, np.array(found).reshape(-1, 6)


def _smoothed(water: Sequence[Array], walk: float) -> list[Array]:
    """Return pieces in one water, as `NoiseLevels.currents` has them: of what later ones say of earlier ones, too.

    Args:
        water: number, beginning, end, current (3,) as the filter has it at the end, and its variances.
        walk: of the current between two ends (Rauch, Tung and Striebel's backward pass).
    """
    out: list[Array] = []
    end, later, left = 0.0, np.zeros(3), np.full(3, np.inf)
    for row in reversed(water):
        mean, variance = row[3:6], row[6:9]
        if out:
            ahead = variance + walk**2 * max(end - row[2], 0.0)
            gain = variance / np.maximum(ahead, 1e-12)
            mean, variance = mean + gain * (later - mean), variance + gain**2 * (left - ahead)
        end, later, left = float(row[2]), mean, variance
        out.insert(0, np.concatenate([row[:3], surely_flows(mean, variance)]))
    return out


def joint_fit(
    problem: JointProblem, progress: Progress | None = None, since: tuple[Array, NoiseLevels] | None = None
) -> JointFit:
    """Return the posterior of a problem.

    Args:
        progress: gets the share done.
        since: theta (n,) that the first pass is linearised about, and levels, where fewer data have told both: the
            prior's mean is not gone back to, and waves are not looked for where there are none.
    """
    progress = progress or (lambda share: None)
    few = problem.over(spread(problem.samples))
    if since is not None:
        return _likeliest_surroundings(few, settled(few, *since, progress), progress)
    whole = few.samples is problem.samples
    fit = _with_waves(few, lambda share: progress(share if whole else 0.7 * share))
    if not whole:
        found = replace(problem, settings=replace(problem.settings, wave_period=fit.wave_period))
        fit = settled(found, fit.theta, fit.levels, lambda share: progress(0.7 + 0.3 * share), anew=False)
    progress(1.0)
    return fit


def first_passes(problem: JointProblem, passes: int, since: tuple[Array, NoiseLevels] | None = None) -> JointFit:
    """Return the likeliest of at most so many passes: whereabouts the posterior is, in the water that is supposed.

    Args:
        since: as of `joint_fit`; the prior's mean and rough levels without.
    """
    return _passes(problem, *(since or (problem.prior.mean, problem.rough)), passes=passes)[0]


def _with_waves(problem: JointProblem, progress: Progress) -> JointFit:
    """Return the posterior in water with waves of the likeliest period, or in water without any.

    Passes in waves begin with what was found without, but for a usual disturbance and the slowest current, for either
    may stand for waves and hide them; and where there are waves, at the prior's mean, too.
    """
    mean, usual, waves = problem.prior.mean, problem.usual, np.full(3, _WAVE)
    if not problem.settings.current or sum(each.duration for each in problem.samples) < _WAVES_SHOW:
        return _likeliest_surroundings(problem, settled(problem, mean, usual, progress, tentative=True), progress)
    calm = settled(problem, mean, usual, lambda share: progress(0.4 * share), tentative=True)
    calm = _likeliest_surroundings(problem, calm, lambda share: progress(0.4 + 0.1 * share))
    wavy = replace(calm.levels, disturbance=usual.disturbance, current_walk=usual.current_walk, waves=waves)
    fit = settled(problem, calm.theta, wavy, lambda share: progress(0.5 + 0.2 * share), only_in_waves=True, stiff=False)
    if not (fit.likelihood > calm.likelihood + _WAVES_GAIN and fit.levels.waves.max() > _SMALLEST_WAVE):
        return calm
    wavy = replace(usual, waves=waves)
    anew = settled(problem, mean, wavy, lambda share: progress(0.7 + 0.1 * share), tentative=True, stiff=False)
    likelier = anew if _likelier(anew, fit) else fit
    return _likeliest_surroundings(problem, likelier, lambda share: progress(0.8 + 0.2 * share))


def _likeliest_surroundings(problem: JointProblem, fit: JointFit, progress: Progress) -> JointFit:
    """Return the posterior where it is far likelier than a fit, by one pass each and then by all.

    A current may walk faster, from place to place or with the tide; waves have another period, or be none but such a
    current; the heading of a compass wander beside a gyro.
    """
    best, likeliest = (enough := fit.likelihood + _WATER_GAIN), None
    for row in _other_surroundings(problem, fit.levels):
        for other, levels in row:
            found = float(one_pass(other, fit.theta, levels)[0].clock[0].log_likelihood)
            if found > best:
                best, likeliest = found, (other, levels)
            elif levels.waves.any() == fit.levels.waves.any():
                break  # what lies farther from the water of the fit is less likely yet
    if likeliest is None:
        return fit
    other, levels = likeliest
    there = settled(other, fit.theta, levels, progress, stiff=other is not problem)
    return _likeliest_surroundings(other, there, progress) if there.likelihood > enough else fit


def _other_surroundings(problem: JointProblem, levels: NoiseLevels) -> list[list[tuple[JointProblem, NoiseLevels]]]:
    noise = levels.noise.copy()
    own = problem.own_noise[_ATTITUDE]
    noise[_ATTITUDE] = np.minimum(noise[_ATTITUDE], own)  # a heading that wanders has passed for noise
    rows = [[(problem, replace(levels, heading_bias=each, noise=noise))] for each in _headings(problem, levels)]
    if np.nan_to_num(levels.velocity_walk).any() and not problem.session:  # a stream looks back again soon
        rows.append([(problem, replace(levels, velocity_walk=share * levels.velocity_walk)) for share in _LESS_WALK])
    if not problem.settings.current:
        return rows
    walks, now = [replace(levels, current_walk=walk) for walk in _WALKS], problem.settings.wave_period
    rows.append([(problem, each) for each in walks if each.current_walk > levels.current_walk])
    if levels.waves.any():
        rows.append([(problem, replace(each, waves=np.zeros(3))) for each in walks])
        for sign, periods in ((1, WAVE_PERIODS), (-1, WAVE_PERIODS[::-1])):  # longer ones, then shorter ones
            others = [replace(problem.settings, wave_period=each) for each in periods if sign * each > sign * now]
            rows.append([(replace(problem, settings=each), levels) for each in others])
    return rows


def _headings(problem: JointProblem, levels: NoiseLevels) -> list[float]:
    """Return the deviations [rad], larger than is supposed, that a heading may be off by, beside a gyro and a tilt."""
    measured = np.any([each.measured for each in problem.samples], axis=0)
    supposed = max(levels.heading_bias, float(problem.settings.record["attitude_bias"][0, 2]))
    return [each for each in _HEADINGS if measured[_ATTITUDE].all() and measured[_R] and each > supposed]


def settled(
    problem: JointProblem,
    about: Array,
    levels: NoiseLevels,
    progress: Progress = lambda share: None,
    *,
    tentative: bool = False,
    only_in_waves: bool = False,
    anew: bool = True,
    stiff: bool = True,
) -> JointFit:
    """Return what passes from theta (n,) `about` come to; with `only_in_waves` they may end where there are none.

    With `tentative` levels they begin with rough ones where motion about theta does not follow the data. With `anew`,
    where the first one rejects much of a sensor, or inputs should act sooner than physics allows, they begin a second
    time, with inputs that act a deviation sooner than is supposed; with `stiff`, from such a vehicle, too, which need
    not be asked again where levels alone differ. The likelier speaks.
    """
    run = partial(_passes, problem, tentative=tentative, progress=progress, only_in_waves=only_in_waves)
    fit, lost = run(about, levels)
    if only_in_waves and fit.levels.waves.max() <= _SMALLEST_WAVE:
        return fit
    others = [(problem.stiff, problem.rough)] if anew and stiff and problem.stiff is not None else []
    late = np.isin(problem.free.codes[:, 0], (IN_DELAY, IN_LAG))
    most_asked = -_TOO_SOON * math.sqrt(np.sum(problem.prior.std[late] ** 2))
    too_soon = bool((fit.mean - fit.theta)[late].sum() < most_asked)  # a vehicle of much drag lags as thrusters do
    too_soon = too_soon or fit.forbidden > FAR_LIKELIER
    sooner = np.where(late, np.maximum(about - problem.prior.std, _SOONEST * about), about)
    if anew and (lost or too_soon) and (sooner != about).any():
        others.append((sooner, levels))
    for other_about, other_levels in others:
        other, _ = run(other_about, other_levels)
        fit = other if _likelier(other, fit, as_allowed=too_soon) else fit
    return fit


def _likelier(one: JointFit, other: JointFit, *, as_allowed: bool = False) -> bool:
    """Return whether a fit, or what physics allows of it, is likelier than another; what came to nothing is not."""
    found = [each.likelihood - (each.forbidden if as_allowed else 0.0) for each in (one, other)]
    return bool(np.greater(*np.nan_to_num(found, nan=-np.inf)))


def _passes(
    problem: JointProblem,
    about: Array,
    levels: NoiseLevels,
    *,
    tentative: bool = False,
    progress: Progress = lambda share: None,
    only_in_waves: bool = False,
    passes: int = _PASSES,
) -> tuple[JointFit, bool]:
    """Run passes from theta (n,) `about` until nothing moves any more, else the likeliest of `passes`.

    Where none can be computed, nothing was learned. Where one is far less likely than the one before, its levels go
    half way back, then all the way, and only then does theta. No disturbance rises above the most that motion allows.
    Waves that become too small to be any go from the levels; with `only_in_waves` the passes end there. Returns, too,
    whether the first rejected much of a sensor. A disturbance does not begin rough without need: far too large, it is a
    large push on heavy damping, where nothing else pushes.
    """
    most = most_disturbed(problem.samples, np.array(problem.vehicle.parameters))
    levels, rough = _bounded(problem, levels, most), np.minimum(problem.rough.disturbance, most)
    before: JointFit | None = None
    likeliest: JointFit | None = None
    highest, improved, failed, last = -math.inf, 0, 0, np.zeros(len(problem.free))
    region = Region(problem.vehicle, problem.free)
    at_before, about = about, region.nearest(about, _movable(problem.prior.covariance, problem.learned))
    lost = rests = False
    for k in range(passes):
        done = partial(lambda k, share: progress((k + share) / _PASSES), k)
        state, _, readings, currents = one_pass(problem, about, levels, done)
        if k == 0 and tentative and (levels.disturbance < rough).any() and not follows(state):
            levels = replace(levels, disturbance=rough)
            state, _, readings, currents = one_pass(problem, about, levels)
        lost = lost or (k == 0 and diverged(state))
        fit = _fit_of(problem, region, state, levels, k + 1, readings)
        finite = bool(np.isfinite(fit.theta).all() and np.isfinite(fit.std).all() and np.isfinite(fit.likelihood))
        if not finite and before is None:  # no motion can be computed with these coefficients, or none so smooth
            if np.allclose(about, problem.prior.mean):
                levels = replace(levels, disturbance=ROUGH * levels.disturbance)
            about = 0.5 * (about + problem.prior.mean) if k < passes // 2 else problem.prior.mean
            continue
        if before is not None and not (finite and fit.likelihood > before.likelihood - _MUCH_WORSE):
            failed += 1
            if rests and failed > 1:  # what levels come to explains less, and nothing else moves
                return replace(before, still=True), lost
            levels = levels.midway_to(before.levels) if finite and failed == 1 else before.levels
            about = about if failed <= (2 if finite else 1) else 0.5 * (about + at_before)
            continue
        adapted = adapt_noise(state, levels, problem.settings, problem.own_noise)
        adapted = replace(adapted, disturbance=np.minimum(adapted.disturbance, most))
        moved = np.abs(fit.theta - about) / (fit.std + 1e-9)
        rests, still = bool((moved <= _STILL).all()), False
        if before is not None:
            alike = abs(fit.likelihood - before.likelihood) <= _CHANCE
            still = rests and (alike or converged(adapted, levels, before.levels))
            adapted = adapted.turning(levels, before.levels)
        before, at_before, failed = fit, about, 0
        calms = k >= _CALM_AFTER and levels.waves.any() and adapted.waves.max() < _SMALLEST_WAVE
        if still or (calms and only_in_waves):
            return replace(fit, still=still), lost
        if likeliest is None or fit.likelihood > highest - _CHANCE:
            likeliest = fit
        if fit.likelihood > highest + _CHANCE:
            highest, improved = fit.likelihood, k
        elif k - improved >= _PATIENCE:
            return likeliest, lost
        step = fit.theta - about
        longest = float(np.max(np.abs(step) / problem.prior.std, initial=0.0))
        turned = float(np.sum(step * last / (fit.std + 1e-9) ** 2)) < 0.0
        share = min(_DAMPED if turned else 1.0, _LONGEST_STEP / max(longest, 1e-9))
        last = step
        about = about + share * step
        levels = replace(adapted, currents=currents)
        if calms:
            levels, highest = replace(levels, waves=np.zeros(3)), -math.inf
    if likeliest is None:
        prior = problem.prior
        return replace(fit, mean=prior.mean, theta=prior.mean, covariance=prior.covariance), lost
    return likeliest, lost


def _bounded(problem: JointProblem, levels: NoiseLevels, most: Array) -> NoiseLevels:
    """Return levels with waves where any can show, and no disturbance above (6,) the most that motion allows."""
    waves = np.where(problem.waving, levels.waves, 0.0)
    return replace(levels, disturbance=np.minimum(levels.disturbance, most), waves=waves)


def _movable(covariance: Array, learned: NDArray[np.bool_]) -> Array:
    """Return the covariance (n, n) without that of what is not learned: it stays where it is."""
    return np.asarray(covariance * np.outer(learned, learned), dtype=np.float64)


def _fit_of(
    problem: JointProblem,
    region: Region,
    state: JointState,
    levels: NoiseLevels,
    passes: int,
    readings: Sequence[Reading],
) -> JointFit:
    """Return the result of a pass with these levels from the filter at its end."""
    rows = np.flatnonzero(problem.learned)
    block, covariance = np.ix_(rows, rows), coefficient_block(state).copy()
    covariance[block], disagreement = widened([Reading(t, x[rows], P[block]) for t, x, P in readings])
    wider = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / np.maximum(coefficient_std(state), 1e-300)
    mean, theta, forbidden = state.theta.copy(), state.theta.copy(), 0.0
    if np.isfinite(state.P).all() and np.isfinite(state.theta).all():
        own, about = coefficient_block(state), state.linearised_at
        theta = region.nearest(mean, _movable(own, problem.learned))
        away = (mean - theta)[rows]
        forbidden = 0.5 * float(away @ np.linalg.solve(own[block], away))
        theta, mean, covariance = told(problem.free, about, theta, mean, covariance)
    return JointFit(
        prior=problem.prior,
        mean=mean,
        theta=theta,
        covariance=covariance,
        wider=np.maximum(wider, 1.0),
        forbidden=forbidden,
        disagreement=disagreement,
        levels=levels,
        wave_period=problem.settings.wave_period,
        likelihood=float(state.clock[0].log_likelihood),
        passes=passes,
        rejected=rejected_share(state),
        state=state,
    )
