"""After the joint filter: free runs fitted to the same recordings, and which of the two judges the model better.

The filter is at the bound where its picture of the disturbance is right. On real recordings it may not be: forces that
are no random walk of one time constant, thrusters that answer late, bodies that pull to one side. A free run sees that
plainly, because nothing corrects it. So both run freely over windows of the recordings: the filter's coefficients,
which have seen them all, and output error's, fitted each time to the other windows. Output error takes over where it is
nearer all the same, by more than chance; or where what it leaves is white, for then nothing but the sensors' noise
parts the model from the data.

Where nobody said which coefficients to learn, what the first model left out is tried: constant forces, thrusters that
give more or less than their curves say, the thrusters' lag, the other damping terms, couplings between the axes. A term
stays that stands out of its deviation and brings runs nearer over windows that it was not fitted to; gains, which
contradict what somebody wrote down, only where chance does not explain that.

Terms that a model may lack, in the order in which free runs try them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples
from towtank.identification.model.parameters import (
    DELAY,
    GAIN_PREFIX,
    IN_GAIN,
    LAG,
    UNTRANSFORMED,
    FreeParameters,
    free_parameters,
)
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.simulation_error.cross_validation import FreeRuns, Gain, columns_of, fits, gain
from towtank.identification.simulation_error.fit import OutputErrorFit
from towtank.vehicle import Vehicle, configuration_matrix
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = [
    "CHANGE",
    "CHANGE_WORTH",
    "Prior",
    "Refined",
    "Start",
    "groups_of_terms",
    "prior_with_terms",
    "refine",
    "refit",
    "righting",
]

RIGHTING = "BG_z"
_FEWEST = 3  # thrusters, of which most give what their curves say
_COUPLED = {3: (4, 5), 4: (3, 5), 5: (3, 4), 1: (5,), 2: (4,)}  # rows, and the speeds that may act on them
_KEPT = 2.0  # deviations that a term needs which the first model did not have
_TERM, _TERM_WORTH = 0.5, 0.01  # deviations, and share of the square error, that such a term must save
CHANGE, CHANGE_WORTH = 2.0, 0.05  # and that a change of judge must
_LAG = 0.03  # s, to begin with
_GAIN = 0.3  # deviation of ln gain of a thruster, beforehand
_ROOM = 100.0  # usual sizes that an added term may have
_ROUNDS = 3
_LOST = 0.5  # share of the windows in which runs go nowhere
Prior = Callable[[FreeParameters], tuple[Array, Array] | None]
Start = tuple[FreeParameters, Array]


def groups_of_terms(
    vehicle: Vehicle, names: Sequence[str], samples: Sequence[Samples], *, find_lag: bool
) -> tuple[tuple[str, ...], ...]:
    """Return groups of names: constant forces, gains of thrusters, lag, other damping terms, couplings by speed.

    Args:
        names: what is free already; an axis is modelled where its inertia is or its damping.
        find_lag: whether the thrusters' lag is asked for.
    """
    axes = [i for i in range(6) if any(name in names for name in _own(i))]
    measured = np.any([each.measured for each in samples], axis=0)
    fed = [i for i in range(6) if measured[6 + i] or measured[i]]
    constants = [f"{ROWS[i]}_0" for i in axes]
    if "BG_z" in names:
        constants += ["BG_x", "BG_y"]
    damping = []
    for i in axes:
        linear, quadratic = f"{ROWS[i]}_{COLUMNS[i]}", f"{ROWS[i]}_{COLUMNS[i] * 2}"
        known = [name for name in (linear, quadratic) if vehicle.coefficient(name) != 0.0]
        damping += known or [linear, quadratic]
    couplings = [f"{ROWS[i]}_{COLUMNS[j]}" for i in axes for j in _coupled(i) if j in axes and j in fed and i in fed]
    gains = _gains(vehicle, axes, samples) if all(each.commands for each in samples) else ()
    return (tuple(constants), gains, (LAG,) if find_lag else (), tuple(damping), tuple(couplings))


def _gains(vehicle: Vehicle, axes: Sequence[int], samples: Sequence[Samples]) -> tuple[str, ...]:
    """Return the gains of the driven thrusters that act along the modelled axes, where they can be compared.

    All forces together have no scale of their own, so one thruster is told from the others, or not at all.
    """
    acts = np.any(configuration_matrix(vehicle)[list(axes)] != 0.0, axis=0)
    driven = np.any([np.nanmax(each.input_force, axis=0) > np.nanmin(each.input_force, axis=0) for each in samples], 0)
    chosen = [each.name for each, one in zip(vehicle.thrusters, acts & driven, strict=True) if one]
    return tuple(GAIN_PREFIX + name for name in chosen) if len(chosen) >= _FEWEST else ()


def righting(names: Sequence[str], samples: Sequence[Samples]) -> tuple[str, ...]:
    """Return the name of the righting moment where it is not free and the attitude is measured, else nothing.

    A vehicle stays level under its thrusters or tips: that alone tells of its righting moment, even where nothing else
    of roll and pitch can be learned, and a free run that tips over is of no use to the other axes.
    """
    measured = np.any([each.measured for each in samples], axis=0)
    return (RIGHTING,) if RIGHTING not in names and measured[3] and measured[4] else ()


def _coupled(i: int) -> tuple[int, ...]:
    both = list(_COUPLED.get(i, ()))
    both += [j for j, others in _COUPLED.items() if i in others and j not in both]
    return tuple(sorted(both))


def _own(i: int) -> tuple[str, ...]:
    row, column = ROWS[i], COLUMNS[i]
    return f"{row}_{column}dot", f"{row}_{column}", f"{row}_{column}{column}"


@dataclass(frozen=True, eq=False)
class Refined:
    """What free runs say.

    Attributes:
        free, theta, covariance: coefficients. delay: [s] where it is not free.
        better: whether free runs are the better judge. white: whether their residuals are.
        saved: share of the square error saved beside the joint filter's coefficients, over windows not seen; None where
            the recordings are too short to say. fit, joint_fit: of the speeds over these windows [%], NaN if there are
            none.
        added: terms that were not free before.
    """

    free: FreeParameters
    theta: Array
    covariance: Array
    delay: float
    better: bool
    white: bool
    saved: Gain | None
    fit: float
    joint_fit: float
    added: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Begun:
    free: FreeParameters
    theta: Array


@dataclass(frozen=True, eq=False)
class _Found:
    free: FreeParameters
    fit: OutputErrorFit
    base: Vehicle
    delay: float

    @property
    def kernel(self) -> Array:
        return np.array(self.base.parameters)

    @property
    def white(self) -> bool:
        """Whether nothing but the sensors' noise is left."""
        return self.fit.memory.white(columns_of(self.free.names))


def refine(
    runs: FreeRuns,
    base: Vehicle,
    free: FreeParameters,
    starts: Sequence[Start],
    instead: Sequence[Start] = (),
    *,
    delay: float,
    prior: Prior,
    terms: bool,
    find_lag: bool,
    progress: Callable[[float], None],
) -> Refined | None:
    """Fit free runs to recordings and say whether they are the better judge; None where they cannot be made.

    Args:
        base: what is held. free: what the joint filter had free.
        starts: what is free and where it begins: the joint filter's coefficients, those of least squares.
        instead: the same with the damping terms that least squares chose, where the filter chose others: they take
            their place where their runs are nearer over windows not seen, by more than the deviation of that.
        delay: of the inputs [s] where it is not free.
        prior: mean and information of what is free, known beforehand; `prior_with_terms`, where terms may be added.
        terms: whether others may be added. find_lag: the thrusters' lag too. told: gets the share done.
    """
    begun = _begun(runs, base, starts, delay, prior, terms=terms)
    others = _begun(runs, base, instead, delay, prior, terms=terms)
    if not begun:
        begun, others = others, []
    if not begun:
        return None
    if not runs.comparable:
        found = _without_early_delay(runs, begun[0], prior)
        return _refined(found, free, found.white, found.white, None)
    progress(0.2)
    columns = columns_of(free.names)
    found, errors = _steady(runs, begun, prior)
    if others and not found.white:
        other, theirs = _steady(runs, others, prior)
        if gain(theirs, errors, columns).beyond(1.0, 0.0):
            found, errors = other, theirs
    white = found.white
    if terms and not white:
        groups = groups_of_terms(runs.vehicle, free.names, runs.samples, find_lag=find_lag)
        for k, group in enumerate(groups):
            progress(0.3 + 0.6 * k / len(groups))
            longer = _tried(runs, found, [name for name in group if name not in found.free.names], prior)
            if longer is not None:
                now = _unseen(runs, longer, prior)
                needed = CHANGE if group[0].startswith(GAIN_PREFIX) else _TERM
                if gain(now, errors, columns_of(longer.free.names)).beyond(needed, _TERM_WORTH):
                    found, errors = longer, now
    progress(0.9)
    before = runs.errors(np.array(base.parameters), free, starts[0][1], delay=delay)
    saved = gain(errors, before, columns)
    better, spread = white or saved.beyond(CHANGE, CHANGE_WORTH), runs.spread()
    return replace(
        _refined(found, free, better, white, saved),
        fit=fits(errors, spread, columns),
        joint_fit=fits(before, spread, columns),
    )


def _begun(
    runs: FreeRuns, base: Vehicle, starts: Sequence[Start], delay: float, prior: Prior, *, terms: bool
) -> list[_Found]:
    """Return the fits from all starts, those first whose runs come nearest."""
    begun = [_Begun(*start) for start in starts]
    if terms and begun and (level := righting(begun[0].free.names, runs.samples)):
        begun += [_Begun(*_extended(runs.vehicle, each, base, delay, list(level))) for each in begun]
    kernel = np.array(base.parameters)
    tried = [
        (each.free, runs.fit(kernel, each.free, each.theta, delay=delay, prior=prior(each.free))) for each in begun
    ]
    sound = [_Found(free, fit, base, delay) for free, fit in tried if fit is not None]
    informed_or_start = sorted({j for each in sound for j in columns_of(each.free.names)})
    return sorted(sound, key=lambda each: _distance(each.fit, informed_or_start))


def _steady(runs: FreeRuns, begun: Sequence[_Found], prior: Prior) -> tuple[_Found, Array]:
    """Return the nearest fit whose runs go somewhere over windows not seen, too, and its errors (w, 15) there."""
    first: tuple[_Found, Array] | None = None
    for each in begun:
        found = _without_early_delay(runs, each, prior)
        errors = _unseen(runs, found, prior)
        if np.mean(np.isposinf(errors).any(axis=1)) < _LOST:
            return found, errors
        first = first or (found, errors)
    assert first is not None
    return first


def refit(
    runs: FreeRuns, base: Vehicle, free: FreeParameters, theta: Array, found: Refined, prior: Prior
) -> Refined | None:
    """Return what was found with fewer coefficients free, the others held at those of `base`."""
    fit = runs.fit(np.array(base.parameters), free, theta, delay=found.delay, prior=prior(free))
    if fit is None:
        return None
    again = _without_early_delay(runs, _Found(free, fit, base, found.delay), prior)
    return replace(found, free=again.free, theta=again.fit.theta, covariance=again.fit.covariance, delay=again.delay)


def _refined(found: _Found, free: FreeParameters, better: bool, white: bool, saved: Gain | None) -> Refined:
    added = tuple(name for name in found.free.names if name not in free.names)
    fit = found.fit
    none = float("nan")
    return Refined(found.free, fit.theta, fit.covariance, found.delay, better, white, saved, none, none, added)


def _distance(fit: OutputErrorFit, columns: Sequence[int]) -> float:
    """Return how far the runs are from the data: the mean logarithm of what they miss."""
    missed = fit.residual_std[list(columns)]
    known = missed[np.isfinite(missed) & (missed > 0.0)]
    return float(np.mean(np.log(known))) if known.size else np.inf


def _unseen(runs: FreeRuns, found: _Found, prior: Prior) -> Array:
    return runs.unseen(found.kernel, found.free, found.fit.theta, delay=found.delay, prior=prior(found.free))


def _tried(runs: FreeRuns, found: _Found, names: list[str], prior: Prior) -> _Found | None:
    """Return the fit with as many of the names as stand out of their deviations, None where none does."""
    gains = [name for name in names if name.startswith(GAIN_PREFIX)]
    for _ in range(_ROUNDS if names else 0):
        begun = _Begun(found.free, found.fit.theta)
        free, theta = _extended(runs.vehicle, begun, found.base, found.delay, names)
        fit = runs.fit(found.kernel, free, theta, delay=found.delay, prior=prior(free))
        if fit is None:
            return None
        kept = [name for name in names if _stands_out(free, fit, name, gains)]
        if kept == names:
            return _without_early_delay(runs, replace(found, free=free, fit=fit), prior)
        names = kept
        if not names:
            return None
    return None


def _stands_out(free: FreeParameters, fit: OutputErrorFit, name: str, gains: Sequence[str]) -> bool:
    """Whether a term differs from 0 by its deviations, a gain from the usual one: the median of all, held ones too."""
    pick = np.zeros(len(free))
    k = free.names.index(name)
    pick[k] = 1.0
    if name in gains:
        theta = dict(zip(free.names, fit.theta, strict=True))
        usual = sorted(gains, key=lambda each: theta.get(each, 0.0))[len(gains) // 2]
        if usual in free.names:
            pick[free.names.index(usual)] -= 1.0
    size = abs(float(pick @ fit.theta)) if free.codes[k, 3] == UNTRANSFORMED or name in gains else 1.0
    return bool(size > _KEPT * max(float(pick @ fit.covariance @ pick), 0.0) ** 0.5)


def _extended(
    vehicle: Vehicle, begun: _Begun, base: Vehicle, delay: float, names: list[str]
) -> tuple[FreeParameters, Array]:
    """Return the free parameters with `names` beside them, and where they start (n,)."""
    free = free_parameters(vehicle, (*begun.free.names, *names))
    now = dict(zip(begun.free.names, begun.theta, strict=True))
    usual = start_theta(vehicle, base, free, delay=delay, lag=_LAG)
    size = size_of(vehicle, free)
    theta = np.array([now.get(name, usual[k]) for k, name in enumerate(free.names)])
    if LAG in names and DELAY in now:
        k = free.names.index(DELAY)
        theta[k] = max(0.0, float(theta[k]) - _LAG)
    if RIGHTING in names:
        k = free.names.index(RIGHTING)
        theta[k] = max(float(theta[k]), float(size[k]))
    return free, theta


def prior_with_terms(vehicle: Vehicle, first: FreeParameters, prior: Prior) -> Prior:
    """Return what is known beforehand: the prior, and a usual size for the terms that `first` has not."""

    def known(free: FreeParameters) -> tuple[Array, Array]:
        n = len(free)
        mean, information = prior(free) or (np.zeros(n), np.zeros((n, n)))
        information = np.array(information)
        scale = size_of(vehicle, free)
        for k, name in enumerate(free.names):
            if name in first.names:
                continue
            if free.codes[k, 3] == UNTRANSFORMED and name != DELAY:
                information[k, k] += (_ROOM * scale[k]) ** -2.0
            elif free.codes[k, 0] == IN_GAIN:
                information[k, k] += _GAIN**-2.0
        return mean, information

    return known


def _without_early_delay(runs: FreeRuns, found: _Found, prior: Prior) -> _Found:
    """Return the fit with no delay where thrusters would have to act before they are told."""
    if DELAY not in found.free.names:
        return found
    k = found.free.names.index(DELAY)
    if found.fit.theta[k] >= 0.0:
        return found
    free = found.free.subset([name for name in found.free.names if name != DELAY])
    if not len(free):
        return found
    theta = np.delete(found.fit.theta, k)
    fit = runs.fit(found.kernel, free, theta, delay=0.0, prior=prior(free))
    if fit is None:
        left = np.delete(np.delete(found.fit.covariance, k, axis=0), k, axis=1)
        fit = replace(found.fit, theta=theta, covariance=left)
    return _Found(free, fit, found.base, 0.0)
