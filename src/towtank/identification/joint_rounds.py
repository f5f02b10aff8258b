"""The joint filter over recordings, round after round: until all that is free is determined, or held with a reason.

Long recordings are gone over in stretches first, evenly spread: where the coefficients are to within those stretches'
deviations, the whole needs two passes more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.findings import Identifiability
from towtank.identification.identifiability import DETERMINED, TOLD
from towtank.identification.joint import JointFit, cautiously, joint_passes, prior_deviation
from towtank.identification.joint_damping import choose_damping, damping_in_question
from towtank.identification.joint_estimate import judge
from towtank.identification.joint_start import prior_information, size_of, start_theta
from towtank.identification.joint_state import Tuning
from towtank.identification.joint_wanted import SURE
from towtank.identification.log_learning import Levels
from towtank.identification.parameters import DELAY, LAG, FreeParameters, free_parameters
from towtank.identification.samples import Samples
from towtank.identification.stretches import spread_over
from towtank.vehicle import Vehicle

__all__ = ["Rounds", "run_rounds"]

_ROUNDS = 3  # of holding what is not determined


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
    zeroed: tuple[str, ...]
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
    levels: Levels,
    tuning: Tuning,
    *,
    held: Mapping[str, str],
    doubted: Sequence[str],
    zeroed: Sequence[str],
    delay: float,
    prior: Vehicle | None,
    asked: bool,
    speeds: Array,
    told: Callable[[float], None],
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

    def passes(
        of: Sequence[Samples],
        holding: Vehicle,
        chosen: FreeParameters,
        theta: Array,
        levels: Levels,
        *,
        begin: bool = False,
        told: Callable[[float], None] | None = None,
    ) -> JointFit:
        return joint_passes(
            of,
            np.array(holding.parameters),
            chosen,
            theta,
            levels,
            tuning,
            scale=size_of(vehicle, chosen),
            delay=delay,
            prior=known(chosen),
            shown=shown,
            begin=begin,
            cautious=False,
            told=told,
        )

    shown = levels.noise  # the filter's may hold what its model lacks
    unidentified, left_out = dict(held), list(zeroed)
    base = vehicle.with_coefficients(dict.fromkeys(left_out, 0.0))
    few = spread_over(samples)
    fit = passes(few, base, free, theta, levels, begin=True, told=lambda share: told(0.3 * share))
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
    if pairs := damping_in_question(vehicle, free.names, asked=asked):
        told(0.3)
        choice = choose_damping(
            few, base, fit, pairs, tuning=tuning, delay=delay, prior=known, shown=shown, asked=asked
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
        fit = passes(samples, base, free, theta, levels, told=lambda share: told(0.5 + 0.4 * share))
        deviation = prior_deviation(free, scale)
        findings = judge(
            free,
            fit.theta,
            fit.likely,
            deviation,
            scale,
            prior=None if information is None else information[1],
            speeds=speeds,
            enough=TOLD if asked else DETERMINED,
        )
        held_now = {name: hold for name, hold in findings.held.items() if name not in (DELAY, LAG)}
        if asked or not held_now:
            break
        unidentified.update({name: findings.reasons.get(name, "not determined") for name in held_now})
        left_out += [name for name, hold in held_now.items() if hold == "zero"]
        base = vehicle.with_coefficients(dict.fromkeys(left_out, 0.0))
        keep = [k for k, name in enumerate(free.names) if name not in held_now]
        free, theta, levels = free.subset([free.names[k] for k in keep]), fit.theta[keep], fit.levels
    told(0.9)
    p = np.array(base.parameters)
    fit = cautiously(samples, p, fit, tuning, deviation, delay=delay, prior=information)
    return Rounds(fit, findings, base, unidentified, tuple(left_out), added, dropped, sure, few, before)
