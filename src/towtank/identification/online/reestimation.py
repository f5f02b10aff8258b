"""A second look of the streaming estimator: passes over what was seen so far, from several starts.

Where a second look of the streaming filter begins: coefficients by what is known, levels by what rows show.

Still water: the supposition that nothing disturbs the vehicle, which a look of the streaming filter tries.

A level of the disturbance that is estimated never falls to nothing in a few seconds, and a slow stair of thrust looks
like a slow force: in still water a stream would wait for two times as long as it need. So beside the usual level a look
supposes that there is no disturbance, and keeps to that where it is likelier. A marker that jumps by three deviations
of its noise is mistaken for a force by the one and costs the other dear; so, where the supposition is not plainly
wrong, a free run judges as well, whose residuals are white in still water.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.noise import NoiseLevels
from towtank.identification.data.samples import Samples
from towtank.identification.data.zero_order_hold import ZeroOrderHold
from towtank.identification.kalman.iterated import (
    FilterProblem,
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
from towtank.identification.kalman.state import FilterSettings, JointState, coefficient_std
from towtank.identification.model.linearisation import N_FIXED
from towtank.identification.model.parameters import DELAY, MASS, FreeParameters
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.model.terms import candidates
from towtank.identification.posterior.estimate import Estimate
from towtank.identification.simulation_error.cross_validation import FreeRuns, columns_of
from towtank.vehicle import Vehicle

__all__ = [
    "Reestimation",
    "axes_seen",
    "bank_of_delays",
    "begun_later",
    "look",
    "names_now",
    "noise_levels_of_rows",
    "starting_points",
]

PLAINLY_WRONG = -100.0  # log likelihood ratio beyond which no free run is asked
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


def freely_white(
    stretches: Sequence[Samples],
    vehicle: Vehicle,
    free: FreeParameters,
    state: JointState,
    noise: Array,
    *,
    delay: float,
    prior: tuple[Array, Array] | None,
) -> Array | None:
    """Return coefficients (n,) of a free run, fitted from those of `state`, that leaves white residuals, or None."""
    if state.clock[0].duration < _SHOWS_FREELY * state.settings[0].time_constant:
        return None
    runs = FreeRuns.over(vehicle, stretches, noise, free.names)
    fit = runs.fit(np.array(vehicle.parameters), free, state.theta, delay=delay, prior=prior)
    if fit is None:
        return None
    return fit.theta if fit.memory.white(columns_of(free.names)) else None


@dataclass(frozen=True, eq=False)
class Reestimation:
    """The filter after the likeliest pass, its inputs, the levels that it shows, those that the next look tries, merit.

    The next look tries others where the water is taken as still: it asks again. stirred: it plainly is not.
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


def look(
    stretches: Sequence[Samples],
    vehicle: Vehicle,
    free: FreeParameters,
    own: Array | None,
    starts: Sequence[Array],
    levels: NoiseLevels,
    settings: FilterSettings,
    *,
    delay: float,
    prior: tuple[Array, Array] | None,
    reserve: Array | None = None,
    still: bool = False,
    may_begin_later: bool = False,
) -> Reestimation | None:
    """Pass over all stretches from each start, from the likeliest once more with the levels it shows; None if all fail.

    Args:
        own: theta (n,) of the filter by now. A pass from there stays linear: it does not deceive itself.
        starts: other thetas (n,), followed as they become known.
        delay: of the inputs [s] where it is not free. prior: mean and information.
        reserve: a start (n,) for where a pass from `own` refuses much of what it sees: it has gone astray.
        still: also suppose that nothing disturbs the vehicle, and keep to that where it is likelier.
        may_begin_later: leave the first half second out where a pass from the other starts goes astray with it and not
            without, however sound one from `own` is: it may have raised the disturbance to explain what it saw.
    """
    p, shown, usual, rounds = np.array(vehicle.parameters), levels.noise, np.array(settings.usual), _ROUNDS
    deviation = prior_deviation(free, size_of(vehicle, free))
    problem = FilterProblem(stretches, p, free, deviation, prior, delay)

    def passed(theta: Array, levels: NoiseLevels, *, follow: bool) -> tuple[JointState, ZeroOrderHold] | None:
        state, held = one_pass(problem, theta, levels, replace(settings, relinearise=follow))
        sound = np.isfinite(state.theta).all() and np.isfinite(state.P).all() and (np.diag(state.P) >= 0.0).all()
        return (state, held) if sound else None

    found = []
    if own is not None:
        found.append(passed(own, levels, follow=False))
        if not starts and reserve is not None and (found[0] is None or diverged(found[0][0])):
            starts = [reserve]
    least = replace(levels, disturbance=np.minimum(levels.disturbance, np.where(usual > 0.0, usual, np.inf)))
    others = [each for each in (passed(start, least, follow=True) for start in starts) if each is not None]
    if others:  # likelihoods of passes that follow and of linear ones do not compare
        state, held = max(others, key=_likelihood)
        found.append(passed(limit_step(free, state.theta, state.theta), least, follow=False) or (state, held))
    sound = [each for each in found if each is not None]
    if not sound:
        return None
    if may_begin_later and others and diverged(sound[-1][0]) and stretches[0].duration > _LONG_ENOUGH:
        later = begun_later(stretches, _FALSE_START)
        again = look(later, vehicle, free, None, starts, levels, settings, delay=delay, prior=prior, still=still)
        if again is not None and not diverged(again.state):
            return replace(again, left_out=_FALSE_START)
    state, held = max(sound, key=_likelihood)
    if own is None or sound[0][0] is not state:
        levels = least
        rounds = max(rounds, _ROUNDS_ELSEWHERE)  # linearised about what may be far away
    if inconsistent(state):
        rounds = max(rounds, _ROUNDS_AT_ODDS)

    def settled(
        seen: tuple[JointState, ZeroOrderHold], levels: NoiseLevels, rounds: int, calm: Still | None
    ) -> Reestimation:
        (state, held), way = seen, settings if calm is None else calm.settings

        def following() -> NoiseLevels:
            found = adapt_noise(state, levels, way, shown)
            return found if calm is None else calm.kept(found)

        for _ in range(rounds):
            shows = following()
            about = limit_step(free, state.theta, state.linearised_at, linear=state.settings[0].relinearise == 0.0)
            std = coefficient_std(state)
            if converged(shows, levels) and np.all(np.abs(about - state.linearised_at) <= _SETTLED * std):
                break
            again = passed(about, shows, follow=False)
            if again is None or _log_posterior(again[0], shows, way) < _log_posterior(state, levels, way) - _WORSE:
                break
            (state, held), levels = again, shows
        shows = following()
        return Reestimation(free, state, held, shows, shows, _log_posterior(state, levels, way))

    usually = settled((state, held), levels, rounds, None)
    calm = still_water(usually.state, usually.levels, free, settings) if still else None
    if calm is None:
        return usually

    def calmly(theta: Array) -> Reestimation | None:
        begun = passed(theta, calm.levels, follow=False)
        return None if begun is None else settled(begun, calm.levels, _ROUNDS_STILL, calm)

    linear = usually.state.settings[0].relinearise == 0.0
    other = calmly(limit_step(free, usually.state.theta, usually.state.linearised_at, linear=linear))
    if other is None or other.log_posterior < usually.log_posterior + PLAINLY_WRONG:
        return replace(usually, stirred=True)
    if other.log_posterior < usually.log_posterior:
        theta = freely_white(stretches, vehicle, free, other.state, shown, delay=delay, prior=prior)
        other = None if theta is None else calmly(theta)
    return usually if other is None else replace(other, next=usually.levels)


def begun_later(stretches: Sequence[Samples], seconds: float) -> list[Samples]:
    """Return the stretches, rows of the first `seconds` left out; what was commanded then still counts.

    A recording may begin while a marker is where it does not belong. What is taken for the first speed then is none,
    and the filter, sure of it, refuses what comes.
    """
    first = stretches[0]
    return [first.part(int(np.searchsorted(first.t, first.t[0] + seconds)), 0), *stretches[1:]]


def _likelihood(passed: tuple[JointState, ZeroOrderHold]) -> float:
    return float(passed[0].clock[0].log_likelihood)


def _log_posterior(state: JointState, levels: NoiseLevels, settings: FilterSettings) -> float:
    return float(state.clock[0].log_likelihood) + log_prior_of_levels(levels, settings)


def bank_of_delays(free: FreeParameters, theta: Array) -> list[Array]:
    """Return theta (n,) with every delay of the bank."""
    k = free.names.index(DELAY)
    return [np.concatenate([theta[:k], [delay], theta[k + 1 :]]) for delay in _BANK]


def axes_seen(stretches: Sequence[Samples]) -> list[bool]:
    """Return whether the pose or the speed of each of the six axes is measured."""
    measured = np.any([each.measured for each in stretches], axis=0)
    return [bool(measured[i] or measured[6 + i]) for i in range(6)]


def names_now(
    vehicle: Vehicle,
    requested: Sequence[str] | None,
    found: Estimate | None,
    seen: Sequence[bool],
    *,
    with_delay: bool,
) -> list[str]:
    """Return what is free: as asked, or of the axes that are seen what least squares has not put aside."""
    if requested is not None:
        names = list(requested)
    else:
        names = []
        for candidate in candidates(vehicle, None):
            axis = candidate.axis
            if not seen[axis.index]:
                continue
            columns = (*axis.columns, axis.added_mass)
            for c in (4, 0, 1, 2, 3):
                name = columns[c]
                if not candidate.to_learn[c] or name in names:
                    continue
                known = found is not None and name in found and found[name].identified
                put_aside = found is not None and name in found and not known and found[name].value == 0.0
                if (c == 3 and not known) or (c in (0, 1) and put_aside and _partner_known(found, columns, c)):
                    continue
                names.append(name)
    if with_delay and DELAY not in names:
        names.append(DELAY)
    return names


def _partner_known(found: Estimate | None, columns: tuple[str, ...], c: int) -> bool:
    partner = columns[1 - c]
    return found is not None and partner in found and found[partner].identified


def starting_points(
    vehicle: Vehicle,
    known: tuple[FreeParameters, JointState] | None,
    free: FreeParameters,
    found: Estimate | None,
    delay: float,
) -> tuple[Array | None, Array]:
    """Return what the filter knows by now (n,), None before it knows anything, and what least squares says (n,).

    Args:
        known: coordinates of the filter by now, and the filter. free: coordinates (n,) of the look.
        found: by least squares. delay: [s] where it is not free.
    """
    velocity_walk = vehicle
    if found is not None:
        changes = {each.name: each.value for each in found.coefficients if each.identified}
        velocity_walk = vehicle.with_coefficients(changes) if changes else vehicle
    cold = start_theta(vehicle, velocity_walk, free, delay=delay, lag=_LAG)
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
    """Return the levels that a look starts with: noise as the rows show it, the rest as found before."""
    noise, velocity_walk = noise_of_rows(rows.t, rows.values), levels.velocity_walk
    beside = rows.measured[6:12] if not first else np.zeros(6, dtype=bool)
    noise[:6] = np.where(beside, np.maximum(noise[:6], levels.noise[:6]), noise[:6])
    unknown = np.isnan(velocity_walk)
    if unknown.any():
        velocity_walk = np.where(unknown, velocity_walk_of_rows(rows.t, rows.values), velocity_walk)
    return NoiseLevels(noise, levels.disturbance, velocity_walk)
