"""The manoeuvre of the coupled experiments: every axis of the vehicle at once, switched at random."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.simulation import manoeuvre
from towtank.vehicle import Vehicle

__all__ = ["REST", "coupled_commands"]

REST = 0.5  # s, before any manoeuvre, as in the paper's runs
_FORM = "all-telegraph"
_SEED = 39  # of sixty tried: the least travel, 4.5 m in any direction without random wrenches; tilt up to 46 degrees


def coupled_commands(vehicle: Vehicle, duration: float, dt: float) -> Array:
    """Return the commands (n, m): rest, then full ahead or full astern on every axis, each switched at its own times.

    The vLBV300 has no thrusters for pitch; the surge thrusters, 8 cm below the origin, pitch it. "Full" is what
    `usual_amplitudes` finds gentle, about half of what the thrusters' limits allow.
    """
    plan = manoeuvre(_FORM, vehicle, duration=duration - REST, dt=dt, seed=_SEED).commands
    if plan is None:
        raise ValueError(f"{vehicle.name} has no thrusters")
    return np.vstack([np.zeros((round(REST / dt), plan.shape[1])), plan])
