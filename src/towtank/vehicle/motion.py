"""Forward and inverse dynamics of a vehicle, for any leading shape.

M nu_dot + C(nu) nu + D(nu) nu + g(eta) = tau. The shells check shapes and turn Euler angles into quaternions;
the kernels do the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from towtank.core import dynamics
from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.vehicle.shapes import broadcast_rows, last_axis
from towtank.vehicle.vehicle import Vehicle

__all__ = ["forward_dynamics", "inverse_dynamics"]

_ETA = "x y z phi theta psi"
_NU = "u v w p q r"


def forward_dynamics(vehicle: Vehicle, eta: ArrayLike, nu: ArrayLike, tau: ArrayLike) -> Array:
    """Return the acceleration nu_dot (..., 6) [m/s^2, rad/s^2], body FRD.

    Args:
        eta: pose (..., 6) [m, rad], NED position and Euler angles zyx.
        nu: velocity (..., 6) [m/s, rad/s], body FRD, in still water.
        tau: wrench X Y Z K M N (..., 6) [N, N m], body FRD about the origin.

    The leading shapes broadcast against each other.

    Raises:
        InputError: a last axis that is not 6, leading shapes that do not fit, or a singular mass matrix.
    """
    shape, (poses, velocities, wrenches) = broadcast_rows(
        {
            "eta": last_axis(eta, 6, "eta", _ETA),
            "nu": last_axis(nu, 6, "nu", _NU),
            "tau": last_axis(tau, 6, "tau", "X Y Z K M N"),
        }
    )
    q = quaternions_from_eulers(np.ascontiguousarray(poses[:, 3:]))
    return np.asarray(dynamics.forward_dynamics(_parameters(vehicle), q, velocities, wrenches).reshape(*shape, 6))


def inverse_dynamics(vehicle: Vehicle, eta: ArrayLike, nu: ArrayLike, nu_dot: ArrayLike) -> Array:
    """Return the wrench tau (..., 6) [N, N m] that makes the acceleration nu_dot (..., 6); arguments as forward."""
    shape, (poses, velocities, accelerations) = broadcast_rows(
        {
            "eta": last_axis(eta, 6, "eta", _ETA),
            "nu": last_axis(nu, 6, "nu", _NU),
            "nu_dot": last_axis(nu_dot, 6, "nu_dot", "the derivatives of u v w p q r"),
        }
    )
    q = quaternions_from_eulers(np.ascontiguousarray(poses[:, 3:]))
    return np.asarray(dynamics.inverse_dynamics(_parameters(vehicle), q, velocities, accelerations).reshape(*shape, 6))


def _parameters(vehicle: Vehicle) -> Array:
    """Return the kernel vector as one writable row, for which the kernels are already compiled."""
    return np.array(vehicle.parameters)[None, :]
