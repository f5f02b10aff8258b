"""Thrusters: from commands to the wrench on the vehicle, and back.

The wrench is the sum of r x f over the thrusters, from their positions and directions alone:
tau = T f with the columns [e_k ; r_k x e_k].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.vehicle.files import AnyVehicle, vehicle_of
from towtank.vehicle.motion import last_axis
from towtank.vehicle.thrusters import curves
from towtank.vehicle.vehicle import Vehicle

__all__ = [
    "allocatable_axes",
    "allocate",
    "configuration_matrix",
    "thruster_commands",
    "thruster_forces",
    "thruster_wrench",
]

_ORDER = (0, 1, 2, 5, 3, 4)  # X Y Z N K M
_INDEPENDENT = 1e-3


def configuration_matrix(vehicle: AnyVehicle) -> Array:
    """Return T (6, n): the wrench [N, N m] per newton of each thruster, body FRD about the origin."""
    vehicle = vehicle_of(vehicle)
    r = np.reshape([each.position for each in vehicle.thrusters], (-1, 3))
    e = np.reshape([each.direction for each in vehicle.thrusters], (-1, 3))
    return np.ascontiguousarray(np.hstack([e, np.cross(r, e)]).T) + 0.0  # no negative zeros


def thruster_forces(vehicle: AnyVehicle, commands: ArrayLike, voltage: ArrayLike | None = None) -> Array:
    """Return the force [N] of each thruster at steady state.

    Args:
        commands: (..., n), in the units of the thrusters' curves; NaN gives NaN.
        voltage: supply voltage [V], (...) without the thruster axis.

    Raises:
        InputError: the last axis is not one command per thruster, or the vehicle has no thrusters.
    """
    vehicle = vehicle_of(vehicle)
    c = last_axis(commands, _count(vehicle), "commands", f"one for each thruster of {vehicle.name}")
    out = np.empty(c.shape if voltage is None else np.broadcast_shapes(c.shape, (*np.shape(voltage), c.shape[-1])))
    for k, thruster in enumerate(vehicle.thrusters):
        out[..., k] = thruster.gain * curves.force(thruster.curve, c[..., k], voltage)
    return out


def thruster_wrench(vehicle: AnyVehicle, commands: ArrayLike, voltage: ArrayLike | None = None) -> Array:
    """Return the wrench [X Y Z K M N] (..., 6) [N, N m] of thruster commands (..., n) at steady state, body FRD.

    Args:
        vehicle: or its name in the catalog, or the path of its file. commands, voltage: as of `thruster_forces`.

    Raises:
        InputError: as `thruster_forces`.
    """
    vehicle = vehicle_of(vehicle)
    return np.asarray(thruster_forces(vehicle, commands, voltage) @ configuration_matrix(vehicle).T)


def thruster_commands(vehicle: Vehicle, forces: ArrayLike, voltage: float | None = None) -> Array:
    """Return the commands (..., n), in the units of the curves, with which the thrusters give forces (..., n) [N].

    The inverse of `thruster_forces`: a force beyond what a thruster can do gives the command of its largest force, one
    smaller than half the step at a dead band the neutral command.
    """
    f: Array = np.asarray(forces, dtype=np.float64) / np.array([each.gain for each in vehicle.thrusters])
    commands = np.empty_like(f)
    same: dict[curves.Curve, list[int]] = {}  # a curve is inverted once for all thrusters that have it
    for k, thruster in enumerate(vehicle.thrusters):
        same.setdefault(thruster.curve, []).append(k)
    for curve, columns in same.items():
        commands[..., columns] = curves.command(curve, f[..., columns], voltage)
    return commands


def allocatable_axes(vehicle: Vehicle) -> tuple[int, ...]:
    """Return the rows of the wrench (0..5) that the thrusters can set independently of each other.

    Rows are taken in the order X Y Z N K M while they add something: where the pitching moment is nothing but
    z_H X (all horizontal thrusters in one plane), M is left out and does not fight X.
    """
    T = configuration_matrix(vehicle)
    norms = np.linalg.norm(T, axis=1)
    largest = np.repeat([norms[:3].max(initial=0.0), norms[3:].max(initial=0.0)], 3)
    basis: list[Array] = []
    axes = []
    for i in _ORDER:
        rest = T[i].copy()
        for _ in range(2):  # twice is enough to be orthogonal to rounding
            for b in basis:
                rest -= (b @ rest) * b
        size = float(np.linalg.norm(rest))
        if size > _INDEPENDENT * largest[i]:
            basis.append(rest / size)
            axes.append(i)
    return tuple(axes)


def allocate(vehicle: AnyVehicle, wrench: ArrayLike, voltage: float | None = None) -> Array:
    """Return the commands (..., n) that make a wrench (..., 6) with the least thruster forces.

    Forces are the pseudo-inverse of the configuration matrix over `allocatable_axes` times the wrench; the other axes
    follow from geometry. Where a force is beyond what its thruster can do, all forces of that instant are scaled down
    together, so that the wrench keeps its direction. Forces become commands by the inverse curves; those smaller than
    half the step at a dead band become neutral.

    Raises:
        InputError: the last axis is not 6, or the vehicle has no thrusters.
    """
    vehicle = vehicle_of(vehicle)
    _count(vehicle)
    tau = last_axis(wrench, 6, "wrench", "X Y Z K M N")
    axes = list(allocatable_axes(vehicle))
    forces = tau[..., axes] @ np.linalg.pinv(configuration_matrix(vehicle)[axes]).T
    forces[np.abs(forces) < 1e-12 * np.abs(forces).max(axis=-1, keepdims=True, initial=0.0)] = 0.0
    share = np.ones(tau.shape[:-1])
    for k, thruster in enumerate(vehicle.thrusters):
        low, high = curves.force_range(thruster.curve, voltage)
        f = forces[..., k] / thruster.gain
        with np.errstate(divide="ignore", invalid="ignore"):
            possible = np.where(f > high, high / f, np.where(f < low, low / f, 1.0))
        share = np.minimum(share, possible)
    return thruster_commands(vehicle, forces * share[..., None], voltage)


def _count(vehicle: Vehicle) -> int:
    if not vehicle.thrusters:
        raise InputError(f"{vehicle.name} has no thrusters; add [[thrusters]] to its file or give a wrench instead")
    return len(vehicle.thrusters)
