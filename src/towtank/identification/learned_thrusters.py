"""What was learned of the thrusters themselves: their lag, and gains of single ones, put into a vehicle."""

from __future__ import annotations

import math
from collections.abc import Mapping

from towtank.core.arrays import Array
from towtank.identification.parameters import GAIN_PREFIX, FreeParameters
from towtank.vehicle import Vehicle

__all__ = ["learned_gains", "with_thrusters"]


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
