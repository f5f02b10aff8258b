"""Free runs as the second judge of what the joint filter found, until all that they leave free is determined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.joint_estimate import judge
from towtank.identification.joint_refine import Prior, Refined, refine
from towtank.identification.joint_start import size_of
from towtank.identification.parameters import DELAY, LAG, FreeParameters
from towtank.identification.samples import Samples
from towtank.vehicle import Vehicle

__all__ = ["FreeRunOutcome", "learn_free_runs"]

_ROUNDS = 3
_WIDE = 1e6  # deviation that free runs start from: none


@dataclass(frozen=True, eq=False)
class FreeRunOutcome:
    """What free runs made of it.

    Attributes:
        refined: coefficients. base: vehicle with all that is held.
        reasons: why a coefficient that the filter had free is not determined. zeroed: those that are taken as 0.
        first: the comparison with the joint filter. said: it, in plain words.
    """

    refined: Refined
    base: Vehicle
    reasons: dict[str, str]
    zeroed: tuple[str, ...]
    first: Refined
    said: str


def learn_free_runs(
    vehicle: Vehicle,
    base: Vehicle,
    samples: Sequence[Samples],
    free: FreeParameters,
    starts: Sequence[Array],
    noise: Array,
    *,
    delay: float,
    prior: Prior,
    terms: bool,
    find_lag: bool,
    always: bool,
    speeds: Array,
) -> FreeRunOutcome | None:
    """Fit free runs; None where none can be made. Arguments as `refine`.

    Args:
        always: go on even where the joint filter is the better judge.
        speeds: see `joint_estimate.judge`.
    """
    first = refine(
        vehicle, base, samples, free, starts, noise, delay=delay, prior=prior, terms=terms, find_lag=find_lag
    )
    if first is None:
        return None
    said = _sentence(first, always)
    now, reasons, zeroed = first, dict[str, str](), []
    for _ in range(_ROUNDS if terms and (first.better or always) else 0):
        findings = judge(
            now.free,
            now.theta,
            now.covariance,
            np.full(len(now.free), _WIDE),
            size_of(vehicle, now.free),
            speeds=speeds,
        )
        held = {name: hold for name, hold in findings.held.items() if name not in (DELAY, LAG, *first.added)}
        if not held or len(held) == len(now.free):
            break
        for name, hold in held.items():
            reasons[name] = findings.reasons.get(name, "not determined")
            if hold == "zero":
                zeroed.append(name)
                base = base.with_coefficients({name: 0.0})
        keep = [k for k, name in enumerate(now.free.names) if name not in held]
        left = now.free.subset([now.free.names[k] for k in keep])
        again = refine(
            vehicle,
            base,
            samples,
            left,
            [now.theta[keep]],
            noise,
            delay=now.delay,
            prior=prior,
            terms=False,
            find_lag=False,
        )
        if again is None:
            break
        now = replace(again, added=first.added)
    return FreeRunOutcome(now, base, reasons, tuple(zeroed), first, said)


def _sentence(found: Refined, always: bool) -> str:
    gain = f"{100.0 * max(found.gain, 0.0):.0f} %"
    if found.white:
        return (
            "free runs leave nothing but the sensors' noise (their residuals are white), so output error is the "
            "better judge"
        )
    if found.better:
        return (
            f"free runs of output error come closer to the data than the joint filter's coefficients (square error "
            f"{gain} less): the disturbance is not what the filter takes it for, and output error is the better judge"
        )
    text = (
        "residuals of free runs are coloured and output error comes no closer than its freedom explains "
        f"(square error {gain} less): the joint filter is the better judge"
    )
    return text + "; output error was asked for" if always else text
