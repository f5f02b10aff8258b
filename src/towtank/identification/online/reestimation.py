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
from towtank.identification.data.noise import Levels
from towtank.identification.data.samples import Samples
from towtank.identification.data.zero_order_hold import HeldInput
from towtank.identification.kalman.iterated import bounded, one_pass, prior_deviation, told_of
from towtank.identification.kalman.noise_adaptation import (
    alike,
    astray,
    at_odds,
    followed,
    level_merit,
    rows_noise,
    rows_rough,
)
from towtank.identification.kalman.state import (
    C_DURATION,
    C_LIKELIHOOD,
    O_FOLLOW,
    O_TIME_CONSTANT,
    JointState,
    Tuning,
    known_to,
)
from towtank.identification.model.linearisation import N_FIXED
from towtank.identification.model.parameters import DELAY, MASS, FreeParameters
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.model.terms import candidates
from towtank.identification.posterior.estimate import Estimate
from towtank.identification.simulation_error.cross_validation import FreeRuns, columns_of
from towtank.vehicle import Vehicle

__all__ = ["Look", "axes_seen", "bank_of_delays", "begun_later", "look", "look_levels", "look_starts", "names_now"]

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

    levels: Levels
    tuning: Tuning
    axes: tuple[int, ...]

    def kept(self, levels: Levels) -> Levels:
        """Return levels with the disturbance of these axes as it is supposed."""
        sigma = levels.sigma.copy()
        sigma[list(self.axes)] = self.levels.sigma[list(self.axes)]
        return replace(levels, sigma=sigma)


def still_water(state: JointState, levels: Levels, free: FreeParameters, tuning: Tuning) -> Still | None:
    """Return still water about all axes of which something is known; None too early.

    A random force that is still what it was at the beginning looks like any constant one.
    """
    if state.clock[C_DURATION] < _SHOWS * tuning.time_constant:
        return None
    axes = [int(code[1]) for code, s in zip(free.codes, known_to(state), strict=True) if code[0] == MASS and s < _FELT]
    if not axes:
        return None
    sigma, usual = levels.sigma.copy(), np.array(tuning.usual)
    sigma[axes] = np.minimum(sigma[axes], _STILL * usual[axes])
    usual[axes] = 0.0
    return Still(replace(levels, sigma=sigma), replace(tuning, usual=tuple(usual)), tuple(axes))


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
    if state.clock[C_DURATION] < _SHOWS_FREELY * state.options[O_TIME_CONSTANT]:
        return None
    runs = FreeRuns.over(vehicle, stretches, noise, free.names)
    fit = runs.fit(np.array(vehicle.parameters), free, state.theta, delay=delay, prior=prior)
    if fit is None:
        return None
    return fit.theta if fit.memory.white(columns_of(free.names)) else None


@dataclass(frozen=True, eq=False)
class Look:
    """The filter after the likeliest pass, its inputs, the levels that it shows, those that the next look tries, merit.

    The next look tries others where the water is taken as still: it asks again. stirred: it plainly is not.
    left_out: seconds at the beginning that hold a false start. free: the coefficients.
    damping: why damping terms are left out, None where that was not asked.
    """

    free: FreeParameters
    state: JointState
    held: HeldInput
    levels: Levels
    next: Levels
    merit: float
    stirred: bool = False
    left_out: float = 0.0
    damping: Mapping[str, str] | None = None


def look(
    stretches: Sequence[Samples],
    vehicle: Vehicle,
    free: FreeParameters,
    own: Array | None,
    starts: Sequence[Array],
    levels: Levels,
    tuning: Tuning,
    *,
    delay: float,
    prior: tuple[Array, Array] | None,
    reserve: Array | None = None,
    still: bool = False,
    may_begin_later: bool = False,
) -> Look | None:
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
    p, shown, usual, rounds = np.array(vehicle.parameters), levels.noise, np.array(tuning.usual), _ROUNDS
    deviation = prior_deviation(free, size_of(vehicle, free))

    def passed(theta: Array, levels: Levels, *, follow: bool) -> tuple[JointState, HeldInput] | None:
        way = replace(tuning, follow=follow)
        state, held = one_pass(stretches, p, free, theta, deviation, levels, way, delay=delay, prior=prior)
        sound = np.isfinite(state.theta).all() and np.isfinite(state.P).all() and (np.diag(state.P) >= 0.0).all()
        return (state, held) if sound else None

    found = []
    if own is not None:
        found.append(passed(own, levels, follow=False))
        if not starts and reserve is not None and (found[0] is None or astray(found[0][0])):
            starts = [reserve]
    least = replace(levels, sigma=np.minimum(levels.sigma, np.where(usual > 0.0, usual, np.inf)))
    others = [each for each in (passed(start, least, follow=True) for start in starts) if each is not None]
    if others:  # likelihoods of passes that follow and of linear ones do not compare
        state, held = max(others, key=_likelihood)
        found.append(passed(bounded(free, state.theta, state.theta), least, follow=False) or (state, held))
    sound = [each for each in found if each is not None]
    if not sound:
        return None
    if may_begin_later and others and astray(sound[-1][0]) and stretches[0].duration > _LONG_ENOUGH:
        later = begun_later(stretches, _FALSE_START)
        again = look(later, vehicle, free, None, starts, levels, tuning, delay=delay, prior=prior, still=still)
        if again is not None and not astray(again.state):
            return replace(again, left_out=_FALSE_START)
    state, held = max(sound, key=_likelihood)
    if own is None or sound[0][0] is not state:
        levels = least
        rounds = max(rounds, _ROUNDS_ELSEWHERE)  # linearised about what may be far away
    if at_odds(state):
        rounds = max(rounds, _ROUNDS_AT_ODDS)

    def settled(seen: tuple[JointState, HeldInput], levels: Levels, rounds: int, calm: Still | None) -> Look:
        (state, held), way = seen, tuning if calm is None else calm.tuning

        def following() -> Levels:
            found = followed(state, levels, way, shown)
            return found if calm is None else calm.kept(found)

        for _ in range(rounds):
            shows = following()
            about = bounded(free, state.theta, state.anchor, linear=state.options[O_FOLLOW] == 0.0)
            std = known_to(state)
            if alike(shows, levels) and np.all(np.abs(about - state.anchor) <= _SETTLED * std):
                break
            again = passed(about, shows, follow=False)
            if again is None or _merit(again[0], shows, way) < _merit(state, levels, way) - _WORSE:
                break
            (state, held), levels = again, shows
        shows = following()
        return Look(free, state, held, shows, shows, _merit(state, levels, way))

    usually = settled((state, held), levels, rounds, None)
    calm = still_water(usually.state, usually.levels, free, tuning) if still else None
    if calm is None:
        return usually

    def calmly(theta: Array) -> Look | None:
        begun = passed(theta, calm.levels, follow=False)
        return None if begun is None else settled(begun, calm.levels, _ROUNDS_STILL, calm)

    linear = usually.state.options[O_FOLLOW] == 0.0
    other = calmly(bounded(free, usually.state.theta, usually.state.anchor, linear=linear))
    if other is None or other.merit < usually.merit + PLAINLY_WRONG:
        return replace(usually, stirred=True)
    if other.merit < usually.merit:
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


def _likelihood(passed: tuple[JointState, HeldInput]) -> float:
    return float(passed[0].clock[C_LIKELIHOOD])


def _merit(state: JointState, levels: Levels, tuning: Tuning) -> float:
    return float(state.clock[C_LIKELIHOOD]) + level_merit(levels, tuning)


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
    asked: Sequence[str] | None,
    found: Estimate | None,
    seen: Sequence[bool],
    *,
    with_delay: bool,
) -> list[str]:
    """Return what is free: as asked, or of the axes that are seen what least squares has not put aside."""
    if asked is not None:
        names = list(asked)
    else:
        names = []
        for candidate in candidates(vehicle, None):
            axis = candidate.axis
            if not seen[axis.index]:
                continue
            columns = (*axis.columns, axis.added_mass)
            for c in (4, 0, 1, 2, 3):
                name = columns[c]
                if not candidate.wanted[c] or name in names:
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


def look_starts(
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
    rough = vehicle
    if found is not None:
        changes = {each.name: each.value for each in found.coefficients if each.identified}
        rough = vehicle.with_coefficients(changes) if changes else vehicle
    cold = start_theta(vehicle, rough, free, delay=delay, lag=_LAG)
    if known is None:
        return None, cold
    names, state = known[0].names, known[1]
    theta = dict(zip(names, state.theta, strict=True))
    anchor = dict(zip(names, state.anchor, strict=True))
    own = np.array([theta.get(name, cold[k]) for k, name in enumerate(free.names)])
    about = np.array([anchor.get(name, own[k]) for k, name in enumerate(free.names)])
    std = dict(zip(names, np.sqrt(np.diag(state.P)[N_FIXED:]), strict=False))
    known_std = np.array([std.get(name, np.inf) for name in free.names])
    return told_of(free, bounded(free, own, about, linear=True), known_std, cold), cold


def look_levels(rows: Samples, levels: Levels, *, first: bool) -> Levels:
    """Return the levels that a look starts with: noise as the rows show it, the rest as found before."""
    noise, rough = rows_noise(rows.t, rows.values), levels.rough
    beside = rows.measured[6:12] if not first else np.zeros(6, dtype=bool)
    noise[:6] = np.where(beside, np.maximum(noise[:6], levels.noise[:6]), noise[:6])
    unknown = np.isnan(rough)
    if unknown.any():
        rough = np.where(unknown, rows_rough(rows.t, rows.values), rough)
    return Levels(noise, levels.sigma, rough)
