"""The model to first order about straight and level motion, for targets that work with matrices.

States are deviations x = [eta; nu] (12) from a trim, straight and level motion at a constant surge u0 with the wrench
tau_0 that this takes; inputs are deviations of the thrusters' forces, or of the wrench, from those of the trim. With
M nu_dot = tau - n(eta, nu) and eta_dot = J(eta) nu, at phi = theta = psi = 0 and nu_0 = [u0 0 0 0 0 0]:

    nu_dot  = M^-1 (tau - (dn/dnu) nu - (dn/deta) eta)
    eta_dot = nu + u0 [0 psi -theta 0 0 0]

The derivative of |nu_j| nu_j is 2 |nu_j|, which is 0 at rest: what damping is left there is the linear one. All is
exact, not by differences.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.inertia import skew
from towtank.digits import short
from towtank.errors import InputError
from towtank.exporters.programs.mss import matrices_of
from towtank.exporters.request import Request
from towtank.vehicle import Vehicle, configuration_matrix, force_range, inverse_dynamics, thruster_commands
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["STATES", "STATE_UNITS", "Linear", "linearised", "remarks", "slope", "tangent"]

STATES = ("x", "y", "z", "phi", "theta", "psi", *COLUMNS)
STATE_UNITS = (*("m",) * 3, *("rad",) * 3, *("m/s",) * 3, *("rad/s",) * 3)


class Linear(NamedTuple):
    """The model to first order.

    Attributes:
        speed: u0 [m/s]. wrench: that the trim takes (6,) [N, N m].
        forces: of the thrusters (n,) [N] that make it, the least ones. commands: that make these (n,).
        rest: of the wrench (6,), which thrusters in their places cannot make. beyond: thrusters that are too weak.
        A: (12, 12) with the thrusters at these forces, which lose thrust with inflow. B: (12, n) for forces.
        A_wrench: (12, 12), B_wrench: (12, 6) for a wrench on the vehicle, of which inflow takes nothing.
    """

    speed: float
    wrench: Array
    forces: Array
    commands: Array
    rest: Array
    beyond: tuple[str, ...]
    A: Array
    B: Array
    A_wrench: Array
    B_wrench: Array


def linearised(vehicle: Vehicle, speed: float) -> Linear:
    """Return the model to first order about straight and level motion at a surge [m/s].

    Raises:
        InputError: loss with inflow leaves a thruster no thrust at this speed.
    """
    nu = np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0])
    wrench = inverse_dynamics(vehicle, np.zeros(6), nu, np.zeros(6))
    T = configuration_matrix(vehicle)
    loss, inflow = vehicle.coefficient("inflow_loss"), T.T @ nu
    effective = np.linalg.pinv(T) @ wrench if vehicle.thrusters else np.zeros(0)
    effective[np.abs(effective) < 1e-12 * np.abs(effective).max(initial=0.0)] = 0.0
    left = 1.0 - loss * np.sign(effective) * inflow
    if np.any(left <= 0.0):
        name = vehicle.thrusters[int(np.argmin(left))].name
        raise InputError(
            f"--at-speed: at {speed:g} m/s the thruster {name} has lost all its thrust; take a lower speed"
        )
    forces = effective / left
    inverse = np.linalg.inv(vehicle.mass_matrix)
    of = matrices_of(vehicle)
    A = np.zeros((12, 12))
    A[:6, 6:] = np.eye(6)
    A[1, 5], A[2, 4] = speed, -speed
    for column, turned in ((3, [0.0, 1.0, 0.0]), (4, [-1.0, 0.0, 0.0])):  # of R^T e_z by phi and by theta
        A[6:, column] = inverse @ np.concatenate([of["W_minus_B"] * turned, np.cross(of["BG"], turned)])
    A[6:, 6:] = inverse @ (slope(vehicle, nu) - _coriolis_slope(vehicle.mass_matrix, nu))
    B = np.zeros((12, len(vehicle.thrusters)))
    B[6:] = inverse @ T * left
    B_wrench = np.zeros((12, 6))
    B_wrench[6:] = inverse
    A_forces = A.copy()
    A_forces[6:, 6:] -= loss * inverse @ (T * np.abs(forces)) @ T.T
    commands, beyond = _commands(vehicle, forces)
    rest = wrench - T @ effective
    rest[np.abs(rest) <= 1e-12 * np.abs(wrench).max()] = 0.0
    each = (wrench, forces, commands, rest, beyond, A_forces, B, A, B_wrench)
    return Linear(speed, *(part if isinstance(part, tuple) else part + 0.0 for part in each))  # type: ignore[arg-type]


def _commands(vehicle: Vehicle, forces: Array) -> tuple[Array, tuple[str, ...]]:
    beyond = []
    for k, thruster in enumerate(vehicle.thrusters):
        force = float(forces[k]) / thruster.gain
        low, high = force_range(thruster.curve)
        if not low - 1e-9 * abs(force) <= force <= high + 1e-9 * abs(force):
            beyond.append(thruster.name)
    return thruster_commands(vehicle, forces), tuple(beyond)


def slope(vehicle: Vehicle, nu: Array) -> Array:
    """Return the derivative (6, 6) of damping and forward-speed forces by the velocity, at nu (6,)."""
    of = matrices_of(vehicle)
    out = -of["D"] - 2.0 * of["Dn"] * np.abs(nu) + nu[0] * of["F"] + np.diag(2.0 * of["A"] * nu)
    out[:, 0] += of["F"] @ nu
    return np.asarray(out)


def _coriolis_slope(M: Array, nu: Array) -> Array:
    """Return the derivative (6, 6) of C(nu) nu = [omega x h1; v x h1 + omega x h2], h = M nu, by nu."""
    h, v, omega = M @ nu, skew(nu[:3]), skew(nu[3:])
    h1, h2 = skew(h[:3]), skew(h[3:])
    out = np.vstack([omega @ M[:3], v @ M[:3] + omega @ M[3:]])
    out[:3, 3:] -= h1
    out[3:, :3] -= h1
    out[3:, 3:] -= h2
    return np.asarray(out)


def tangent(request: Request) -> Vehicle:
    """Return the vehicle whose damping is the tangent of this one's at the trim, without lag and delay.

    Its Coriolis and restoring forces are those of the whole model: no vehicle has them to first order only.
    """
    vehicle, linear = request.vehicle, linearised(request.vehicle, request.at_speed or 0.0)
    nu = np.array([linear.speed, 0.0, 0.0, 0.0, 0.0, 0.0])
    of, T = matrices_of(vehicle), configuration_matrix(vehicle)
    drag = -of["D"] @ nu - of["Dn"] @ (np.abs(nu) * nu) + nu[0] * (of["F"] @ nu) + of["A"] * nu * nu
    by_speed = slope(vehicle, nu)
    constant = of["tau_0"] + drag - by_speed @ nu
    by_speed = by_speed - vehicle.coefficient("inflow_loss") * (T * np.abs(linear.forces)) @ T.T
    values = {f"{ROWS[i]}_{COLUMNS[j]}": float(by_speed[i, j]) for i in range(6) for j in range(6)}
    values |= {f"{ROWS[i]}_0": float(constant[i]) for i in range(6)}
    masses = {name: each for name, each in vehicle.hydrodynamics.items() if name.endswith("dot")}
    thrusters = tuple(each.model_copy(update={"time_constant": 0.0}) for each in vehicle.thrusters)
    return vehicle.model_copy(
        update={
            "hydrodynamics": {**masses, **{name: {"value": value} for name, value in values.items() if value != 0.0}},
            "thrusters": thrusters,
            "command_delay": 0.0,
        }
    )


def remarks(linear: Linear) -> tuple[str, ...]:
    """Return what a linear model cannot say, and what of its trim cannot be had."""
    said = [
        f"A, B, C, D: what is beyond first order about straight and level motion at u = {linear.speed:g} m/s; Coriolis"
        " and restoring forces beyond it are not in the error below"
    ]
    if linear.beyond:
        said.append(f"the trim takes more than these thrusters can do: {', '.join(linear.beyond)}")
    if linear.forces.size and linear.rest.any():
        each = ", ".join(f"{row} {short(value, 3)}" for row, value in zip(ROWS, linear.rest, strict=True) if value)
        said.append(f"the trim takes a wrench beside the thrusters, which they cannot make: {each} (N, N m)")
    return tuple(said)
