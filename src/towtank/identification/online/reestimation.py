"""Re-estimation of a stream: passes of the filter over what was seen so far, from several starts.

A pass starts with coefficients by what is known, and with noise levels by what the rows show. A level of the
disturbance that is estimated never falls to nothing in a few seconds, and a slow stair of thrust looks like a slow
force: in still water a stream would wait for two times as long as it need. So beside the usual level a re-estimation
supposes that there is no disturbance, and keeps to that where it is likelier. A marker that jumps by three deviations
of its noise is mistaken for a force by the one and costs the other dear; so, where the supposition is not plainly
wrong, a free run judges as well, whose residuals are white in still water.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import ZeroOrderHold
from towtank.identification.data.samples import NoiseLevels, Samples
from towtank.identification.kalman.iterated import (
    FilterProblem,
    Prior,
    informed_or_start,
    limit_step,
    one_pass,
    prior_deviation,
)
from towtank.identification.kalman.noise_adaptation import (
    adapt_noise,
    converged,
    diverged,
    inconsistent,
    log_prior_of_levels,
    noise_of_rows,
    velocity_walk_of_rows,
)
from towtank.identification.kalman.state import (
    FilterSettings,
    JointState,
    coefficient_std,
)
from towtank.identification.model.parameters import DELAY, MASS, N_FIXED, FreeParameters
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.model.terms import candidates, given_terms
from towtank.identification.posterior.estimate import Estimate
from towtank.identification.simulation_error.cross_validation import FreeRuns, columns_of
from towtank.identification.simulation_error.segments import CandidateModel
from towtank.vehicle import Vehicle

__all__: list[str] = []

_PLAINLY_WRONG = -100.0  # log likelihood ratio beyond which no free run is asked
_STILL = 0.1  # of the usual disturbance
_SHOWS = 1.5  # time constants after which a random force has begun to show,
_SHOWS_FREELY = 2.25  # and after which free runs show it: until then coefficients bend to it
_FELT = 0.5  # deviation of the logarithm of an inertia
_BANK = (0.0, 0.06, 0.12, 0.19, 0.27, 0.37)  # s
_WORSE = 1.0  # of the logarithm of the likelihood
_SETTLED = 0.1  # deviations
_FALSE_START, _LONG_ENOUGH = 0.5, 1.5  # s; of a stretch that may begin later
_ROUNDS, _ROUNDS_ELSEWHERE = 1, 3  # passes more at most, with the levels that the last one shows
_ROUNDS_AT_ODDS = 4
_ROUNDS_STILL = 4  # the less there is beside the coefficients, the more they bend the motion
_LAG = 0.05  # s, to begin with


@dataclass(frozen=True, eq=False)
class Still:
    """Levels in still water, what is usual there, and the axes that it is supposed of."""

    levels: NoiseLevels
    settings: FilterSettings
    axes: tuple[int, ...]

    def kept(self, levels: NoiseLevels) -> NoiseLevels:
        """Return levels with the disturbance of these axes as it is supposed."""
        disturbance = levels.disturbance.copy()
        disturbance[list(self.axes)] = self.levels.disturbance[list(self.axes)]
        return replace(levels, disturbance=disturbance)


def still_water(state: JointState, levels: NoiseLevels, free: FreeParameters, settings: FilterSettings) -> Still | None:
    """Return still water about all axes of which something is known; None too early.

    A random force that is still what it was at the beginning looks like any constant one.
    """
    if state.clock[0].duration < _SHOWS * settings.time_constant:
        return None
    axes = [
        int(code[1])
        for code, s in zip(free.codes, coefficient_std(state), strict=True)
        if code[0] == MASS and s < _FELT
    ]
    if not axes:
        return None
    disturbance, usual = levels.disturbance.copy(), np.array(settings.usual)
    disturbance[axes] = np.minimum(disturbance[axes], _STILL * usual[axes])
    usual[axes] = 0.0
    return Still(replace(levels, disturbance=disturbance), replace(settings, usual=tuple(usual)), tuple(axes))


@dataclass(frozen=True, eq=False)
class Task:
    """What every pass of a re-estimation goes over, and what is known beforehand.

    delay: of the inputs [s] where it is not free. prior: mean and information of coefficients, if any.
    """

    stretches: Sequence[Samples]
    vehicle: Vehicle
    settings: FilterSettings
    delay: float
    prior: Prior


@dataclass(frozen=True, eq=False)
class Start:
    """Where the passes begin.

    own: theta (n,) of the filter by now. A pass from there stays linear: it does not deceive itself.
    others: thetas (n,), followed as they become known. levels: that the first pass tries.
    reserve: a start (n,) for where a pass from `own` rejects much of what it sees: it has diverged.
    """

    free: FreeParameters
    own: Array | None
    others: Sequence[Array]
    levels: NoiseLevels
    reserve: Array | None = None


@dataclass(frozen=True, eq=False)
class Reestimation:
    """The filter after the likeliest pass, its inputs, the levels that it shows, those that the next one tries.

    The next one tries others where the water is taken as still: it asks again. stirred: it plainly is not.
    left_out: seconds at the beginning that hold a false start. free: the coefficients.
    damping: why damping terms are left out, None where that was not asked.
    """

    free: FreeParameters
    state: JointState
    held: ZeroOrderHold
    levels: NoiseLevels
    next: NoiseLevels
    log_posterior: float
    stirred: bool = False
    left_out: float = 0.0
    damping: Mapping[str, str] | None = None


class _Pass(NamedTuple):
    """The filter and its inputs at the end of a pass."""

    state: JointState
    held: ZeroOrderHold

    @property
    def likelihood(self) -> float:
        """Its logarithm."""
        return float(self.state.clock[0].log_likelihood)


class _Passes:
    """Passes over the same data with the same free coefficients; noise (18,) is what the rows show."""

    def __init__(self, task: Task, free: FreeParameters, noise: Array) -> None:
        self._task, self._free, self._noise = task, free, noise
        p, deviation = np.array(task.vehicle.parameters), prior_deviation(free, size_of(task.vehicle, free))
        self._problem = FilterProblem(task.stretches, p, free, deviation, task.prior(free), task.delay)

    def once(self, theta: Array, levels: NoiseLevels, *, relinearise: bool) -> _Pass | None:
        """Return one pass; None where it fails."""
        settings = replace(self._task.settings, relinearise=relinearise)
        state, held = one_pass(self._problem, theta, levels, settings)
        healthy = np.isfinite(state.theta).all() and np.isfinite(state.P).all() and (np.diag(state.P) >= 0.0).all()
        return _Pass(state, held) if healthy else None

    def settled(self, last: _Pass, levels: NoiseLevels, rounds: int, calm: Still | None = None) -> Reestimation:
        """Pass again, `rounds` times at most, with the levels that the last pass shows, until they stay."""
        settings = self._task.settings if calm is None else calm.settings

        def shown() -> NoiseLevels:
            adapted = adapt_noise(last.state, levels, settings, self._noise)
            return adapted if calm is None else calm.kept(adapted)

        for _ in range(rounds):
            shows, state = shown(), last.state
            about = self.next_point(state)
            std = coefficient_std(state)
            if converged(shows, levels) and np.all(np.abs(about - state.linearised_at) <= _SETTLED * std):
                break
            again, least = self.once(about, shows, relinearise=False), _log_posterior(last, levels, settings) - _WORSE
            if again is None or _log_posterior(again, shows, settings) < least:
                break
            last, levels = again, shows
        shows = shown()
        return Reestimation(self._free, last.state, last.held, shows, shows, _log_posterior(last, levels, settings))

    def still(self, theta: Array, calm: Still) -> Reestimation | None:
        """Return passes that suppose still water, from theta (n,); None where the first fails."""
        begun = self.once(theta, calm.levels, relinearise=False)
        return None if begun is None else self.settled(begun, calm.levels, _ROUNDS_STILL, calm)

    def next_point(self, state: JointState) -> Array:
        """Return what the pass after this one is linearised about (n,)."""
        return limit_step(self._free, state.theta, state.linearised_at, linear=state.settings[0].relinearise == 0.0)

    def white_free_run(self, state: JointState) -> Array | None:
        """Return coefficients (n,) of a free run, fitted from those of `state`, whose residuals are white, or None."""
        if state.clock[0].duration < _SHOWS_FREELY * state.settings[0].time_constant:
            return None
        vehicle, delay = self._task.vehicle, self._task.delay
        prior = self._problem.prior
        runs = FreeRuns.over(vehicle, self._task.stretches, self._noise, self._free.names, prior=lambda _: prior)
        fit = runs.fit(CandidateModel(vehicle, self._free, state.theta, delay))
        if fit is None:
            return None
        return fit.theta if fit.autocorrelation.white(columns_of(self._free.names)) else None


def reestimate(task: Task, start: Start, *, still: bool = False, may_begin_later: bool = False) -> Reestimation | None:
    """Pass over all stretches from each start, from the likeliest once more with the levels it shows; None if all fail.

    Args:
        still: also suppose that nothing disturbs the vehicle, and keep to that where it is likelier.
        may_begin_later: leave the first half second out where a pass from the other starts diverges with it and not
            without, however healthy one from `own` is: it may have raised the disturbance to explain what it saw.
    """
    free, own, others, levels = start.free, start.own, start.others, start.levels
    passes, usual, rounds = _Passes(task, free, levels.noise), np.array(task.settings.usual), _ROUNDS
    tried: list[_Pass | None] = []
    if own is not None:
        tried.append(passes.once(own, levels, relinearise=False))
        if not others and start.reserve is not None and (tried[0] is None or diverged(tried[0].state)):
            others = [start.reserve]
    least = replace(levels, disturbance=np.minimum(levels.disturbance, np.where(usual > 0.0, usual, np.inf)))
    elsewhere = [each for each in (passes.once(theta, least, relinearise=True) for theta in others) if each is not None]
    if elsewhere:  # likelihoods of passes that follow and of linear ones do not compare
        followed = max(elsewhere, key=lambda each: each.likelihood)
        theta = followed.state.theta
        tried.append(passes.once(limit_step(free, theta, theta), least, relinearise=False) or followed)
    healthy = [each for each in tried if each is not None]
    if not healthy:
        return None
    if may_begin_later and elsewhere and diverged(healthy[-1].state) and task.stretches[0].duration > _LONG_ENOUGH:
        later = replace(task, stretches=begun_later(task.stretches, _FALSE_START))
        again = reestimate(later, Start(free, None, others, levels), still=still)
        if again is not None and not diverged(again.state):
            return replace(again, left_out=_FALSE_START)
    best = max(healthy, key=lambda each: each.likelihood)
    if own is None or healthy[0] is not best:
        levels = least
        rounds = max(rounds, _ROUNDS_ELSEWHERE)  # linearised about what may be far away
    if inconsistent(best.state):
        rounds = max(rounds, _ROUNDS_AT_ODDS)
    usually = passes.settled(best, levels, rounds)
    calm = still_water(usually.state, usually.levels, free, task.settings) if still else None
    if calm is None:
        return usually
    other = passes.still(passes.next_point(usually.state), calm)
    if other is None or other.log_posterior < usually.log_posterior + _PLAINLY_WRONG:
        return replace(usually, stirred=True)
    if other.log_posterior < usually.log_posterior:
        fitted = passes.white_free_run(other.state)
        other = None if fitted is None else passes.still(fitted, calm)
    return usually if other is None else replace(other, next=usually.levels)


def begun_later(stretches: Sequence[Samples], seconds: float) -> list[Samples]:
    """Return the stretches, rows of the first `seconds` left out; what was commanded then still counts.

    A recording may begin while a marker is where it does not belong. What is taken for the first speed then is none,
    and the filter, sure of it, refuses what comes.
    """
    first = stretches[0]
    return [first.taken(slice(int(np.searchsorted(first.t, first.t[0] + seconds)), None), slice(None)), *stretches[1:]]


def _log_posterior(last: _Pass, levels: NoiseLevels, settings: FilterSettings) -> float:
    return last.likelihood + log_prior_of_levels(levels, settings)


def bank_of_delays(free: FreeParameters, theta: Array) -> list[Array]:
    """Return theta (n,) with every delay of the bank."""
    k = free.names.index(DELAY)
    return [np.concatenate([theta[:k], [delay], theta[k + 1 :]]) for delay in _BANK]


def measured_axes(stretches: Sequence[Samples]) -> list[bool]:
    """Return whether the pose or the speed of each of the six axes is measured."""
    measured = np.any([each.measured for each in stretches], axis=0)
    return [bool(measured[i] or measured[6 + i]) for i in range(6)]


def names_to_learn(
    vehicle: Vehicle,
    requested: Sequence[str] | None,
    regression: Estimate | None,
    measured: Sequence[bool],
    *,
    with_delay: bool,
) -> list[str]:
    """Return what is free: as asked, or of the axes that are measured what least squares has not put aside.

    Terms that are free where the file has a value of them follow (`model.terms.given_terms`).
    """
    if requested is not None:
        names = list(requested)
    else:
        names = []
        for candidate in candidates(vehicle, None):
            axis = candidate.axis
            if not measured[axis.index]:
                continue
            columns = (*axis.columns, axis.added_mass)
            for c in (4, 0, 1, 2, 3):
                name = columns[c]
                if not candidate.to_learn[c] or name in names:
                    continue
                by_rows = regression[name] if regression is not None and name in regression else None
                known = by_rows is not None and by_rows.identified
                put_aside = by_rows is not None and not known and by_rows.value == 0.0
                if (c == 3 and not known) or (c in (0, 1) and put_aside and _partner_known(regression, columns, c)):
                    continue
                names.append(name)
        names += given_terms(vehicle, [i for i in range(6) if measured[i]])
    if with_delay and DELAY not in names:
        names.append(DELAY)
    return names


def _partner_known(regression: Estimate | None, columns: tuple[str, ...], c: int) -> bool:
    partner = columns[1 - c]
    return regression is not None and partner in regression and regression[partner].identified


def starting_points(
    vehicle: Vehicle,
    known: tuple[FreeParameters, JointState] | None,
    free: FreeParameters,
    regression: Estimate | None,
    delay: float,
) -> tuple[Array | None, Array]:
    """Return what the filter knows by now (n,), None before it knows anything, and what least squares says (n,).

    Args:
        known: coordinates of the filter by now, and the filter. free: coordinates (n,) of the re-estimation.
        regression: by least squares. delay: [s] where it is not free.
    """
    informed = vehicle
    if regression is not None:
        changes = {each.name: each.value for each in regression.coefficients if each.identified}
        informed = vehicle.with_coefficients(changes) if changes else vehicle
    cold = start_theta(vehicle, informed, free, delay=delay, lag=_LAG)
    if known is None:
        return None, cold
    names, state = known[0].names, known[1]
    theta = dict(zip(names, state.theta, strict=True))
    linearised_at = dict(zip(names, state.linearised_at, strict=True))
    own = np.array([theta.get(name, cold[k]) for k, name in enumerate(free.names)])
    about = np.array([linearised_at.get(name, own[k]) for k, name in enumerate(free.names)])
    std = dict(zip(names, np.sqrt(np.diag(state.P)[N_FIXED:]), strict=False))
    known_std = np.array([std.get(name, np.inf) for name in free.names])
    return informed_or_start(free, limit_step(free, own, about, linear=True), known_std, cold), cold


def noise_levels_of_rows(rows: Samples, levels: NoiseLevels, *, first: bool) -> NoiseLevels:
    """Return the levels that a re-estimation starts with: noise as the rows show it, the rest as before."""
    noise, velocity_walk = noise_of_rows(rows.t, rows.values), levels.velocity_walk
    beside = rows.measured[6:12] if not first else np.zeros(6, dtype=bool)
    noise[:6] = np.where(beside, np.maximum(noise[:6], levels.noise[:6]), noise[:6])
    unknown = np.isnan(velocity_walk)
    if unknown.any():
        velocity_walk = np.where(unknown, velocity_walk_of_rows(rows.t, rows.values), velocity_walk)
    return NoiseLevels(noise, levels.disturbance, velocity_walk)
