"""What a recording may hold beside the model: the other damping term of an axis, water that moves.

Damping: least squares chooses early, axis by axis, from filtered samples, with couplings that it is only finding. On
recordings of all axes at once it takes linear for quadratic or the reverse although they hold a hundred times what
separates them. So the filter is run once more with both terms of every axis free, and no longer as logarithms: a term
that is not there comes out as nothing, or as less than nothing, give or take its deviation.

Current: drag acts through the water, sensors see the ground. A current of 0.18 m/s that is left out costs 40 % of the
drag of a vehicle that goes to and fro; estimated along, a random walk in north, east and down, it costs nothing. It
shows where the speed over ground, or the position, is measured together with the heading. With water at rest the
likelihood of the innovations gains no more than chance; in a current it gains hundreds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import NoiseLevels, Samples
from towtank.identification.kalman.iterated import (
    FilterProblem,
    JointFit,
    Prior,
    joint_passes,
    log_posterior,
    one_pass,
    prior_deviation,
)
from towtank.identification.kalman.state import FilterSettings, JointState
from towtank.identification.model.parameters import FreeParameters, free_parameters
from towtank.identification.model.prior import size_of
from towtank.identification.model.terms import C_LINEAR, C_QUADRATIC, candidates
from towtank.identification.posterior.assembly import Current
from towtank.vehicle import Vehicle

__all__ = ["Pair", "choose_damping", "current_of", "damping_in_question", "suspected_current"]

_BOTH = 4.0  # deviations that each term needs to stay beside the other: it is known to a quarter then
_NOTHING = 2.0  # deviations below which a term is not different from 0
_REPLACES = 10.0  # by which -2 ln L must be less for the other one to take a term's place
_WORTH, _LOSS = 2.0, 8.0  # of ln L, that each term more must gain, and each one less may lose: 4 deviations
_CHOICE_PASSES = 8
_ROOM = 20.0  # usual sizes that a term may have
_CURRENT = slice(18, 21)  # of the filter's errors
_CURRENT_GAIN = 20.0  # of the log likelihood: far beyond chance with three numbers
_SLOWEST = 0.01  # m/s
Pair = tuple[str, str]


@dataclass(frozen=True, eq=False)
class Choice:
    """A fit with what is chosen free, and why the other terms are left out."""

    fit: JointFit
    left_out: dict[str, str]


@dataclass(frozen=True, eq=False)
class _BothTerms:
    """What a run with both terms of an axis shows: values (2,) and covariance (2, 2), linear first."""

    names: Pair
    values: Array
    covariance: Array

    @property
    def std(self) -> Array:
        return np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))

    @property
    def strength(self) -> Array:
        """Deviations by which each dissipates."""
        return -self.values / self.std

    def alone(self, kept: int) -> tuple[float, float]:
        """Return what one term would be if the other were 0, and the deviations by which it then dissipates."""
        C, other = self.covariance, 1 - kept
        slope = C[kept, other] / C[other, other]
        value = float(self.values[kept] - slope * self.values[other])
        return value, -value / float(np.sqrt(max(C[kept, kept] - slope * C[kept, other], 1e-300)))

    def without(self, kept: int) -> str:
        """Why the other term is left out."""
        other = 1 - kept
        name, stays = self.names[other], f"{self.names[kept]} stands for both"
        value = f"{self.values[other]:.3g} +- {self.std[other]:.2g}"
        if abs(self.strength[other]) < _NOTHING:
            return f"{name} is {value} beside {self.names[kept]}, not different from 0; {stays}"
        if self.strength[other] < 0.0:
            return f"{name} came out as +{value} beside {self.names[kept]}, which would feed energy in; {stays}"
        r = self.covariance[0, 1] / (self.std[0] * self.std[1])
        apart = f"a wider range of {self.names[0][2:]} would separate them"
        linear, quadratic = self.names
        return f"{linear} and {quadratic} cannot be told apart in this run (correlation {r:+.3f}); {stays}, {apart}"


def damping_in_question(vehicle: Vehicle, free: Sequence[str], *, requested: bool) -> list[Pair]:
    """Return the damping terms of each axis where both may be free and one at least is, linear first.

    Args:
        free: names that are. requested: somebody named them and none else.
    """
    pairs = []
    for each in candidates(vehicle):
        pair, possible = (each.axis.linear, each.axis.quadratic), each.to_learn[C_LINEAR] and each.to_learn[C_QUADRATIC]
        among = [name in free for name in pair]
        if all(among) if requested else possible and any(among):
            pairs.append(pair)
    return pairs


def choose_damping(
    problem: FilterProblem,
    vehicle: Vehicle,
    fit: JointFit,
    pairs: Sequence[Pair],
    *,
    settings: FilterSettings,
    prior: Prior,
    requested: bool,
    most: int = _CHOICE_PASSES,
) -> Choice | None:
    """Return the fit with the damping terms that the recordings speak for; None where `fit` has them.

    Args:
        problem: its samples, delay and own noise count; what is free follows the question.
        vehicle: values of what is fixed, 0 for terms that were left out. fit: of these samples.
        pairs: names of the linear and the quadratic term of each axis in question. At least one of them is free.
        prior: mean and information of what is free.
        requested: somebody named the terms: only one that is not different from 0 is left out.
        most: passes at most, for either question.
    """
    kernel, names = np.array(vehicle.parameters), fit.free.names
    questioned = [name for pair in pairs for name in pair]

    def fitted(free: FreeParameters, theta: Array, levels: NoiseLevels) -> JointFit:
        scale = size_of(vehicle, free)
        scale = np.where([name in questioned for name in free.names], _ROOM * scale, scale)
        deviation = prior_deviation(free, scale)
        in_question = replace(problem, p=kernel, free=free, deviation=deviation, prior=prior(free))
        return joint_passes(in_question, theta, levels, settings, most=most, begin=False, inflate=False)

    both = free_parameters(vehicle, (*names, *(name for name in questioned if name not in names)))
    untransformed = both.untransformed(questioned)
    now = dict(zip(names, fit.free.untransformed(questioned).thetas(fit.free.values(fit.theta)), strict=True))
    both_fit = fitted(untransformed, np.array([now.get(name, 0.0) for name in untransformed.names]), fit.levels)
    if not (np.isfinite(both_fit.theta).all() and np.isfinite(both_fit.uninflated).all()):
        return None
    values = dict(zip(untransformed.names, untransformed.values(both_fit.theta), strict=True))
    was = dict(zip(names, fit.free.values(fit.theta), strict=True))
    left_out: dict[str, str] = {}
    for pair in pairs:
        rows = [untransformed.names.index(name) for name in pair]
        shown = _BothTerms(pair, both_fit.theta[rows], both_fit.uninflated[np.ix_(rows, rows)])
        before = tuple(k for k in (0, 1) if pair[k] in names)
        kept = _kept(shown, before, requested=requested)
        for k in (0, 1):
            if k not in kept:
                left_out[pair[k]], values[pair[1 - k]] = shown.without(1 - k), shown.alone(1 - k)[0]
        if kept == before:  # which may be no more than a guess
            values.update({pair[k]: was[pair[k]] for k in kept})
    free = both.subset([name for name in both.names if name not in left_out])
    if set(free.names) == set(names):
        return Choice(fit, left_out)
    again = fitted(free, free.thetas(np.array([values[name] for name in free.names])), both_fit.levels)
    more = sum(sum(name in free.names for name in pair) - sum(name in names for name in pair) for pair in pairs)
    least = _WORTH * more if more > 0 else _LOSS * more
    return Choice(again, left_out) if log_posterior(again, settings) > log_posterior(fit, settings) + least else None


def _kept(shown: _BothTerms, before: tuple[int, ...], *, requested: bool) -> tuple[int, ...]:
    """Return the columns, of (linear, quadratic), that stay; those that were free `before` where nothing is sure."""
    strength = shown.strength
    if (strength >= _BOTH).all():
        return 0, 1
    stays = int(np.abs(strength[1]) > np.abs(strength[0]))
    if shown.alone(stays)[1] < _BOTH:
        return before
    if requested:
        return (stays,) if strength[1 - stays] < _NOTHING and strength[stays] >= _BOTH else before
    gain = strength[stays] ** 2 - strength[1 - stays] ** 2
    return (stays,) if len(before) == 2 or gain > _REPLACES else before


def current_shows(samples: Sequence[Samples]) -> bool:
    """Return whether any recording measures position or speed over ground, and the heading."""
    return any(bool((each.measured[:3].any() or each.measured[6:9].any()) and each.measured[5]) for each in samples)


def current_of(state: JointState) -> Current:
    """Return the current that a filter has estimated."""
    variance = np.diag(state.P)[_CURRENT]
    return Current(state.current.copy(), np.sqrt(np.maximum(variance, 0.0)))


def suspected_current(problem: FilterProblem, fit: JointFit, settings: FilterSettings) -> Current | None:
    """Return the current that would explain the recordings far better than water at rest; None where none does.

    `fit` is the problem's with water at rest.
    """
    if not current_shows(problem.samples):
        return None
    at_rest, flowing = (
        one_pass(problem, fit.theta, fit.levels, replace(settings, relinearise=False, current=flows))[0]
        for flows in (False, True)
    )
    gain = float(flowing.clock[0].log_likelihood - at_rest.clock[0].log_likelihood)
    current = replace(current_of(flowing), gain=gain)
    finite = bool(np.isfinite(current.velocity).all() and np.isfinite(gain))
    return current if finite and gain > _CURRENT_GAIN and current.speed > _SLOWEST else None
