"""Forward and inverse dynamics of a vehicle, for any leading shape.

M nu_dot + C(nu) nu + D(nu) nu + g(eta) = tau. The shells check shapes and turn Euler angles into quaternions;
the kernels do the rest. Shapes of arrays at the public edge: wrong ones are told in one line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from towtank.core import dynamics
from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.vehicle.files import AnyVehicle, vehicle_of

__all__ = ["forward_dynamics", "inverse_dynamics", "last_axis"]

_ETA = "x y z phi theta psi"
_NU = "u v w p q r"


def forward_dynamics(vehicle: AnyVehicle, eta: ArrayLike, nu: ArrayLike, tau: ArrayLike) -> Array:
    """Return the acceleration nu_dot (..., 6) [m/s^2, rad/s^2], body FRD.

    Args:
        vehicle: or its name in the catalog, or the path of its file.
        eta: pose (..., 6) [m, rad], NED position and Euler angles zyx.
        nu: velocity (..., 6) [m/s, rad/s], body FRD, in still water.
        tau: wrench X Y Z K M N (..., 6) [N, N m], body FRD about the origin.

    The leading shapes broadcast against each other.

    Raises:
        InputError: a last axis that is not 6, leading shapes that do not fit, or a singular mass matrix.
    """
    shape, (poses, velocities, wrenches) = _broadcast_rows(
        {
            "eta": last_axis(eta, 6, "eta", _ETA),
            "nu": last_axis(nu, 6, "nu", _NU),
            "tau": last_axis(tau, 6, "tau", "X Y Z K M N"),
        }
    )
    q = quaternions_from_eulers(np.ascontiguousarray(poses[:, 3:]))
    return np.asarray(dynamics.forward_dynamics(_parameters(vehicle), q, velocities, wrenches).reshape(*shape, 6))


def inverse_dynamics(vehicle: AnyVehicle, eta: ArrayLike, nu: ArrayLike, nu_dot: ArrayLike) -> Array:
    """Return the wrench tau (..., 6) [N, N m] that makes the acceleration nu_dot (..., 6); arguments as forward."""
    shape, (poses, velocities, accelerations) = _broadcast_rows(
        {
            "eta": last_axis(eta, 6, "eta", _ETA),
            "nu": last_axis(nu, 6, "nu", _NU),
            "nu_dot": last_axis(nu_dot, 6, "nu_dot", "the derivatives of u v w p q r"),
        }
    )
    q = quaternions_from_eulers(np.ascontiguousarray(poses[:, 3:]))
    return np.asarray(dynamics.inverse_dynamics(_parameters(vehicle), q, velocities, accelerations).reshape(*shape, 6))


def _parameters(vehicle: AnyVehicle) -> Array:
    """Return the kernel vector as one writable row, for which the kernels are already compiled."""
    return np.array(vehicle_of(vehicle).parameters)[None, :]


def last_axis(values: ArrayLike, count: int, name: str, meaning: str) -> Array:
    """Return `values` as float64 (..., count). Raises InputError for another last axis or for what is not numbers."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: not an array of numbers; expected shape (..., {count}): {meaning}") from None
    if array.ndim == 0 or array.shape[-1] != count:
        raise InputError(f"{name}: found shape {array.shape}, expected (..., {count}): {meaning}")
    return array


def _broadcast_rows(arrays: dict[str, Array]) -> tuple[tuple[int, ...], list[Array]]:
    """Return the common leading shape and the arrays as rows (n, k), laid out as kernels expect them.

    Raises:
        InputError: no shape fits all.
    """
    try:
        shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays.values()))
    except ValueError:
        found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise InputError(f"leading shapes do not fit together: {found}") from None
    rows = [
        np.array(np.broadcast_to(array, (*shape, array.shape[-1])), order="C").reshape(-1, array.shape[-1])
        for array in arrays.values()
    ]
    return shape, rows
