"""Free runs as the second judge of what the joint filter found, until all that they leave free is determined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples
from towtank.identification.model.parameters import CONSTANT, DELAY, LAG, FreeParameters
from towtank.identification.model.prior import size_of
from towtank.identification.posterior.assembly import judge
from towtank.identification.posterior.identifiability import Hold
from towtank.identification.simulation_error.cross_validation import FreeRuns, Gain, columns_of, gain
from towtank.identification.simulation_error.refinement import (
    CHANGE,
    CHANGE_WORTH,
    Prior,
    Refined,
    Start,
    prior_with_terms,
    refine,
    refit,
    righting,
)
from towtank.vehicle import Vehicle

__all__ = ["FreeRunOutcome", "learn_free_runs"]

_ROUNDS = 3
_KEPT = 2.0  # deviations that a constant force needs
_WIDE = 1e6  # deviation that free runs start from: none


@dataclass(frozen=True, eq=False)
class FreeRunOutcome:
    """What free runs made of it.

    Attributes:
        refined: coefficients. base: vehicle with all that is held.
        reasons: why a coefficient that the filter had free is not determined. zeroed: those that are taken as 0.
        first: the comparison with the joint filter. said: it, in plain words.
        least_squares: whether the coefficients of least squares are nearer than those chosen.
    """

    refined: Refined
    base: Vehicle
    reasons: dict[str, str]
    set_to_zero: tuple[str, ...]
    first: Refined
    said: str
    least_squares: bool


def learn_free_runs(
    vehicle: Vehicle,
    base: Vehicle,
    samples: Sequence[Samples],
    free: FreeParameters,
    starts: Sequence[Start],
    instead: Sequence[Start],
    noise: Array,
    attitude: Sequence[Array],
    plain: tuple[Vehicle, float],
    *,
    delay: float,
    prior: Prior,
    terms: bool,
    find_lag: bool,
    always: bool,
    speeds: Array,
    progress: Callable[[float], None] | None = None,
) -> FreeRunOutcome | None:
    """Fit free runs; None where none can be made. Arguments as `refine`.

    Args:
        always: go on even where the joint filter is the better judge.
        attitude: see `FreeRuns`. plain: what least squares found, and its delay [s].
        speeds: see `posterior.assembly.judge`. told: gets the share done.
    """
    begun = {name for each, _ in (*starts, *instead) for name in each.names}
    names = (*begun, *(righting(free.names, samples) if terms else ()))
    runs = FreeRuns.over(vehicle, samples, noise, names, attitude)
    silent, prior = progress or (lambda share: None), prior_with_terms(vehicle, free, prior)
    first = refine(
        runs, base, free, starts, instead, delay=delay, prior=prior, terms=terms, find_lag=find_lag, progress=silent
    )
    if first is None:
        return None
    proved = tuple(name for name in first.added if name not in begun)  # by windows held out
    now, reasons, set_to_zero = first, dict[str, str](), []
    begin, compare = base, terms and not always and not first.white and runs.comparable

    def nearer(base: Vehicle, free_: FreeParameters, theta: Array, late: float) -> Gain | None:
        """What least squares saves beside these coefficients; None where it does not stand out."""
        theirs = free.theta(plain[0], delay=plain[1], lag=0.0)
        errors = runs.errors(np.array(plain[0].parameters), free, theirs, delay=plain[1])
        beside = runs.errors(np.array(base.parameters), free_, theta, delay=late)
        saved = gain(errors, beside, columns_of(free.names))
        return saved if saved.beyond(CHANGE, CHANGE_WORTH) else None

    joint = (begin, free, starts[0][1], delay)
    if compare and not first.better and nearer(*joint) and not nearer(base, now.free, now.theta, now.delay):
        now = first = replace(first, better=True)  # least squares beats the filter, but not what free runs found
    for _ in range(_ROUNDS if terms and (first.better or always) else 0):
        tried = _held(runs, base, now, prior, proved, speeds)
        if tried is None:
            break
        for stays in tried.stand_for_two:
            other = _held(runs, base, now, prior, proved, speeds, yielding=(*tried.yielding, stays))
            if other is not None and other.nearer(runs, tried, columns_of([stays])):
                tried = other
        base, now = tried.base, tried.found
        set_to_zero += [name for name, hold in tried.held.items() if hold == "zero"]
        reasons.update(tried.reasons)
    said = _sentence(first, always, runs.thinned)
    saved = nearer(*((base, now.free, now.theta, now.delay) if first.better else joint)) if compare else None
    if saved is not None:
        share = f"{100.0 * saved.mean:.0f} +- {100.0 * saved.std:.0f} % less square error"
        said += f"; but free runs with the coefficients of least squares are nearer than either ({share})"
    return FreeRunOutcome(now, base, reasons, tuple(set_to_zero), first, said, saved is not None)


@dataclass(frozen=True, eq=False)
class _Held:
    """A fit with less free: what is held, why, and the vehicle that holds it.

    stand_for_two: damping terms whose mate is taken as 0. yielding: see `identifiability`.
    """

    found: Refined
    base: Vehicle
    held: dict[str, Hold]
    reasons: dict[str, str]
    stand_for_two: tuple[str, ...]
    yielding: tuple[str, ...]

    def nearer(self, runs: FreeRuns, other: _Held, columns: Sequence[int]) -> bool:
        """Whether runs come nearer than with the other choice, in some columns."""
        one, two = (
            runs.errors(np.array(each.base.parameters), each.found.free, each.found.theta, delay=each.found.delay)
            for each in (self, other)
        )
        return gain(one, two, columns).mean > 0.0


def _held(
    runs: FreeRuns,
    base: Vehicle,
    found: Refined,
    prior: Prior,
    proved: Sequence[str],
    speeds: Array,
    *,
    yielding: tuple[str, ...] = (),
) -> _Held | None:
    """Return the fit without what these recordings do not determine; None where they do, or nothing would be left.

    proved: names that stay, since runs over windows not seen came nearer with them. yielding: see `identifiability`.
    """
    free = found.free
    wide, size = np.full(len(free), _WIDE), size_of(runs.vehicle, free)
    findings = judge(free, found.theta, found.covariance, wide, size, speeds=speeds, yielding=yielding)
    shown = (DELAY, LAG, *proved, *(name for name in free.names if _shows(found, name)))
    held = {name: hold for name, hold in findings.held.items() if name not in shown}
    if not held or len(held) == len(free):
        return None
    without = base.with_coefficients({name: 0.0 for name, hold in held.items() if hold == "zero"})
    keep = [k for k, name in enumerate(free.names) if name not in held]
    left = free.subset([free.names[k] for k in keep])
    again = refit(runs, without, left, found.theta[keep], found, prior)
    if again is None:
        return None
    reasons = {name: findings.reasons.get(name, "not determined") for name in held}
    stay = [each.partner for each in findings.findings if held.get(each.name) == "zero" and each.partner]
    return _Held(again, without, held, reasons, tuple(stay), yielding)


def _shows(found: Refined, name: str) -> bool:
    """Whether a constant force stands out, however roughly its size is known: without it the rest is off."""
    k = found.free.names.index(name)
    return bool(found.free.codes[k, 0] == CONSTANT and abs(found.theta[k]) > _KEPT * np.sqrt(found.covariance[k, k]))


def _sentence(found: Refined, always: bool, thinned: bool) -> str:
    where = "windows spread over the recordings" if thinned else "windows of the recordings"
    if found.white:
        return (
            "free runs leave nothing but the sensors' noise (their residuals are white), so output error is the "
            "better judge"
        )
    if found.saved is None:
        text = "the recordings are too short to compare free runs over windows held out, so the joint filter judges"
    else:
        shares = f"{100.0 * found.saved.mean:.0f} +- {100.0 * found.saved.std:.0f} % less square error"
        if not np.isfinite(found.saved.mean):
            shares = "the runs of the other one go nowhere"
        elif np.isfinite(found.fit) and np.isfinite(found.joint_fit):
            shares = f"{found.fit:.0f} % against {found.joint_fit:.0f} %, {shares}"
        if found.better:
            added = f" (with {', '.join(found.added)})" if found.added else ""
            return f"output error{added} predicts {where} that it has not seen better than the joint filter: {shares}"
        text = f"output error does not predict {where} that it has not seen better than the joint filter: {shares}"
    return text + "; output error was asked for" if always else text
