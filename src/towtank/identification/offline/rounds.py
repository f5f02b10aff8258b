"""The joint filter over recordings, round after round, until all that is free is determined, or held with a reason.

First over stretches of long recordings, evenly spread: where the coefficients are to within those stretches'
deviations, the whole needs two passes more. There the inertias that least squares doubts are asked for, and the
damping terms are chosen. Then over all of it, where what is not determined is held and the rest is fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import NoiseLevels, Samples
from towtank.identification.kalman.alternatives import choose_damping, damping_in_question
from towtank.identification.kalman.iterated import (
    FilterProblem,
    JointFit,
    joint_passes,
    prior_deviation,
    with_inflated_variance,
)
from towtank.identification.kalman.state import FilterSettings
from towtank.identification.model.parameters import DELAY, LAG, FreeParameters, free_parameters
from towtank.identification.model.prior import prior_information, size_of, start_theta
from towtank.identification.model.terms import AXES
from towtank.identification.posterior.assembly import Posterior, judge
from towtank.identification.posterior.identifiability import DETECTED, DETERMINED, Criteria, Identifiability
from towtank.identification.posterior.wording import NOT_DETERMINED
from towtank.recording.grids.stretches import spread
from towtank.vehicle import Vehicle

__all__: list[str] = []

SURE = 0.025  # deviation of an inertia that least squares cannot tell: on real water the filter's are too small
_ROUNDS = 3  # of holding what is not determined
_NOTHING_YET = Identifiability((), ())


class Start(NamedTuple):
    """What is free, where it begins (n,), and the noise levels to begin with."""

    free: FreeParameters
    theta: Array
    levels: NoiseLevels


@dataclass(frozen=True, eq=False)
class FilterTask:
    """What the filter is asked.

    Attributes:
        start: what to learn of the vehicle from the samples. settings: of the filter.
        held: why other coefficients are not learned. doubted: inertias among them that the filter is asked for.
        set_to_zero: those of them that are taken as 0.
        delay: of the inputs [s] where it is not free. prior: a vehicle whose coefficients bear deviations.
        requested: somebody named the coefficients, so that none is held, and identified is what is different from 0.
        speeds: (6, 2) of the run, see `Criteria`.
    """

    vehicle: Vehicle
    samples: Sequence[Samples]
    start: Start
    settings: FilterSettings
    held: Mapping[str, str] = field(default_factory=dict)
    doubted: Sequence[str] = ()
    set_to_zero: Sequence[str] = ()
    delay: float = 0.0
    prior: Vehicle | None = None
    requested: bool = False
    speeds: Array | None = None

    @property
    def shown(self) -> Array:
        """Noise (18,) that the samples show; the filter's may hold what its model lacks."""
        return self.start.levels.noise

    def known(self, free: FreeParameters) -> tuple[Array, Array] | None:
        """Return mean (n,) and information (n, n) of what is free, known beforehand."""
        return None if self.prior is None else prior_information(self.prior, free)

    def problem(self, samples: Sequence[Samples], base: Vehicle, free: FreeParameters) -> FilterProblem:
        """Return what passes over samples are about: what is free of a vehicle, wide about where it starts."""
        deviation = prior_deviation(free, size_of(self.vehicle, free))
        p = np.array(base.parameters)
        return FilterProblem(samples, p, free, deviation, self.known(free), self.delay, self.shown)


@dataclass(frozen=True, eq=False)
class Rounds:
    """What the filter made of the recordings.

    Attributes:
        fit: with what is free in the end. findings: what the recordings tell of that.
        base: the vehicle with what is held where the result has it.
        unidentified: why a coefficient is not. set_to_zero: those taken as 0.
        few: stretches that stand for long recordings.
        added, dropped: damping terms that are free though least squares left them out, and the other way round.
        sure: inertias that least squares doubts and the filter knows.
        before: the fit to the stretches with the damping terms of least squares, None where these are what is free.
    """

    fit: JointFit
    base: Vehicle
    unidentified: Mapping[str, str]
    set_to_zero: tuple[str, ...]
    few: Sequence[Samples]
    added: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    sure: tuple[str, ...] = ()
    before: JointFit | None = None
    findings: Identifiability = _NOTHING_YET


def doubted_inertias(names: Collection[str], held: Collection[str]) -> tuple[str, ...]:
    """Return the inertias that least squares could not find on axes whose damping it found."""
    return tuple(a.added_mass for a in AXES if a.added_mass in held and (a.linear in names or a.quadratic in names))


def run_rounds(task: FilterTask, progress: Callable[[float], None]) -> Rounds:
    """Fit what is free, choose between damping terms, and hold what is not determined."""
    rounds = _over_stretches(task, lambda share: progress(0.3 * share))
    rounds = _with_doubted_inertias(task, rounds)
    rounds = _with_chosen_damping(task, rounds, lambda: progress(0.3))
    rounds = _until_determined(task, rounds, lambda share: progress(0.5 + 0.4 * share))
    progress(0.9)
    return _with_inflated_variance(task, rounds)


def _passes(
    task: FilterTask,
    samples: Sequence[Samples],
    base: Vehicle,
    start: Start,
    *,
    begin: bool = False,
    progress: Callable[[float], None] | None = None,
) -> JointFit:
    problem = task.problem(samples, base, start.free)
    return joint_passes(
        problem, start.theta, start.levels, task.settings, begin=begin, inflate=False, progress=progress
    )


def _holding(vehicle: Vehicle, set_to_zero: Sequence[str]) -> Vehicle:
    return vehicle.with_coefficients(dict.fromkeys(set_to_zero, 0.0))


def _over_stretches(task: FilterTask, progress: Callable[[float], None]) -> Rounds:
    few, base = spread(task.samples), _holding(task.vehicle, task.set_to_zero)
    fit = _passes(task, few, base, task.start, begin=True, progress=progress)
    return Rounds(fit, base, dict(task.held), tuple(task.set_to_zero), few)


def _with_doubted_inertias(task: FilterTask, rounds: Rounds) -> Rounds:
    """Return the fit with those inertias free of which the filter is sure."""
    if not task.doubted:
        return rounds
    vehicle, fit, base = task.vehicle, rounds.fit, rounds.base
    wide = free_parameters(vehicle, (*fit.free.names, *task.doubted))
    guess = dict(zip(wide.names, start_theta(vehicle, vehicle, wide, delay=task.delay, lag=0.0), strict=True))
    guess |= dict(zip(fit.free.names, fit.theta, strict=True))
    start = Start(wide, np.array([guess[name] for name in wide.names]), fit.levels)
    more = _passes(task, rounds.few, base, start, begin=True)
    sure = tuple(name for name in task.doubted if more.std[wide.names.index(name)] <= SURE)
    if not sure:
        return rounds
    keep = [k for k, name in enumerate(wide.names) if name in (*fit.free.names, *sure)]
    start = Start(wide.subset([wide.names[k] for k in keep]), more.theta[keep], more.levels)
    return replace(
        rounds,
        fit=_passes(task, rounds.few, base, start),
        unidentified={name: why for name, why in rounds.unidentified.items() if name not in sure},
        set_to_zero=tuple(name for name in rounds.set_to_zero if name not in sure),
        sure=sure,
    )


def _with_chosen_damping(task: FilterTask, rounds: Rounds, progress: Callable[[], None]) -> Rounds:
    """Return the fit with linear damping, quadratic or both free on each axis, as the recordings speak for it."""
    was = rounds.fit.free.names
    pairs = damping_in_question(task.vehicle, was, requested=task.requested)
    if not pairs:
        return rounds
    progress()
    problem = task.problem(rounds.few, rounds.base, rounds.fit.free)
    choice = choose_damping(
        problem, rounds.base, rounds.fit, pairs, settings=task.settings, prior=task.known, requested=task.requested
    )
    if choice is None:
        return rounds
    free = choice.fit.free.names
    added, dropped = (tuple(name for name in free if name not in was), tuple(n for n in choice.left_out if n in was))
    unidentified = {name: why for name, why in rounds.unidentified.items() if name not in free}
    set_to_zero = [name for name in rounds.set_to_zero if name not in free]
    set_to_zero += [name for name in choice.left_out if name not in set_to_zero]
    return replace(
        rounds,
        fit=choice.fit,
        base=_holding(task.vehicle, set_to_zero),
        unidentified=unidentified | choice.left_out,
        set_to_zero=tuple(set_to_zero),
        added=added,
        dropped=dropped,
        before=rounds.fit if added or dropped else None,
    )


def _until_determined(task: FilterTask, rounds: Rounds, progress: Callable[[float], None]) -> Rounds:
    """Return the fit to all samples, and what it holds of what was free."""
    fit, base, findings = rounds.fit, rounds.base, rounds.findings
    unidentified, set_to_zero = dict(rounds.unidentified), list(rounds.set_to_zero)
    criteria = Criteria(speeds=task.speeds, enough=DETECTED if task.requested else DETERMINED)
    start = Start(fit.free, fit.theta, fit.levels)
    for _ in range(_ROUNDS):
        free = start.free
        scale, information = size_of(task.vehicle, free), task.known(free)
        fit = _passes(task, task.samples, base, start, progress=progress)
        findings = judge(
            Posterior(free, fit.theta, fit.uninflated),
            prior_deviation(free, scale),
            scale,
            prior=None if information is None else information[1],
            criteria=criteria,
        )
        held = {name: hold for name, hold in findings.held.items() if name not in (DELAY, LAG)}
        if task.requested or not held:
            break
        unidentified.update({name: findings.reasons.get(name, NOT_DETERMINED) for name in held})
        set_to_zero += [name for name, hold in held.items() if hold == "zero"]
        base = _holding(task.vehicle, set_to_zero)
        keep = [k for k, name in enumerate(free.names) if name not in held]
        start = Start(free.subset([free.names[k] for k in keep]), fit.theta[keep], fit.levels)
    return replace(
        rounds, fit=fit, base=base, findings=findings, unidentified=unidentified, set_to_zero=tuple(set_to_zero)
    )


def _with_inflated_variance(task: FilterTask, rounds: Rounds) -> Rounds:
    problem = task.problem(task.samples, rounds.base, rounds.fit.free)
    return replace(rounds, fit=with_inflated_variance(problem, rounds.fit, task.settings))
