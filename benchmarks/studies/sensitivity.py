"""How the noise-free motion of a vehicle answers to its coefficients: central differences of whole simulations."""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.standard import POSE
from towtank.simulation import simulate
from towtank.vehicle import Vehicle, index

__all__ = ["STEP", "changed", "motion", "pose_sensitivity"]

STEP = 1e-4  # of ln coefficient, and in s, m, m/s


def changed(vehicle: Vehicle, name: str, step: float) -> Vehicle:
    """Return the vehicle with one quantity changed: a coefficient or the lag by a factor exp(step), the delay by step.

    The name of an added mass stands for the total inertia.
    """
    if name == "delay":
        return vehicle.model_copy(update={"command_delay": vehicle.command_delay + step})
    if name == "lag":
        slower = [t.model_copy(update={"time_constant": t.time_constant * math.exp(step)}) for t in vehicle.thrusters]
        return vehicle.model_copy(update={"thrusters": tuple(slower)})
    kind, i, j = index(name)
    body = float(vehicle.rigid_body_matrix[i, j]) if kind == "mass" else 0.0
    return vehicle.with_coefficients({name: body + (vehicle.coefficient(name) - body) * math.exp(step)})


def motion(vehicle: Vehicle, commands: Array, dt: float, eta0: Array | None = None, nu0: Array | None = None) -> Array:
    """Return the noise-free pose (n + 1, 6)."""
    run = simulate(vehicle, commands=commands, dt=dt, eta0=eta0, nu0=nu0)
    return np.column_stack([run[name].values for name in POSE])


def pose_sensitivity(vehicle: Vehicle, commands: Array, dt: float, names: tuple[str, ...], axis: int) -> Array:
    """Return d pose / d (names, initial pose and velocity of one axis) (n + 1, len(names) + 2) of that axis (0..5)."""
    columns = []
    for name in names:
        ends = [motion(changed(vehicle, name, side * STEP), commands, dt)[:, axis] for side in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * STEP))
    for which in ("eta0", "nu0"):
        start = STEP * np.eye(6)[axis]
        ends = [motion(vehicle, commands, dt, **{which: side * start})[:, axis] for side in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * STEP))
    return np.column_stack(columns)
