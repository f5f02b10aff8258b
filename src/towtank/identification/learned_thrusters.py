"""What was learned of the thrusters themselves: their lag, and gains of single ones, put into a vehicle."""

from __future__ import annotations

import math
from collections.abc import Mapping

from towtank.core.arrays import Array
from towtank.identification.parameters import GAIN_PREFIX, FreeParameters
from towtank.vehicle import Vehicle

__all__ = ["learned_gains", "with_gains_of", "with_thrusters"]


def learned_gains(vehicle: Vehicle, free: FreeParameters, theta: Array, std: Array) -> dict[str, tuple[float, float]]:
    """Return the gain of each thruster that has one free, and its deviation, as multiples of its curve."""
    before = {each.name: each.gain for each in vehicle.thrusters}
    out = {}
    for k, name in enumerate(free.names):
        if name.startswith(GAIN_PREFIX):
            thruster = name.removeprefix(GAIN_PREFIX)
            gain = before[thruster] * math.exp(float(theta[k]))
            out[thruster] = (gain, gain * float(std[k]))
    return out


def with_thrusters(vehicle: Vehicle, *, lag: float, gains: Mapping[str, tuple[float, float]]) -> Vehicle:
    """Return the vehicle with this lag [s] of all thrusters, unless it is NaN, and these gains."""
    thrusters = []
    for each in vehicle.thrusters:
        changes = {} if math.isnan(lag) else {"time_constant": lag}
        if each.name in gains:
            changes["gain"] = gains[each.name][0]
        thrusters.append(each.model_copy(update=changes))
    return vehicle.model_copy(update={"thrusters": tuple(thrusters)})


def with_gains_of(vehicle: Vehicle, prior: Vehicle) -> tuple[Vehicle, tuple[str, ...]]:
    """Return the vehicle with the gains of those thrusters that the prior has otherwise, and what is to be said of it.

    The prior's inertias and drags were learned with these gains, and mean nothing without them.
    """
    known = {each.name: each.gain for each in prior.thrusters}
    other = {each.name: known[each.name] for each in vehicle.thrusters if known.get(each.name, each.gain) != each.gain}
    if not other:
        return vehicle, ()
    told = ", ".join(f"{name} {gain:.3g}" for name, gain in other.items())
    changed = with_thrusters(vehicle, lag=math.nan, gains={name: (gain, 0.0) for name, gain in other.items()})
    return changed, (f"gains of thrusters taken from the prior, whose coefficients were learned with them: {told}",)
