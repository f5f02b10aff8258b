"""A water current, constant in the inertial frame and irrotational.

nu_r = nu - [R^T v_c ; 0] enters the hydrodynamic terms. Because the current is constant, an observer drifting with the
water is inertial too and sees the same rigid body: M_RB nu_r_dot + C_RB(nu_r) nu_r = M_RB nu_dot + C_RB(nu) nu, so the
whole of (8) holds in nu_r with the total mass matrix. Fossen (2021), section 8.1 and property 10.1.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import rotation_from_quaternion

__all__ = ["current_acceleration", "current_in_body"]


@kernel
def current_in_body(q: Array, current: Array) -> Array:
    """Return nu_c (6,) = [R^T v_c ; 0] for the attitude q (4,) and the current v_c (3,) [m/s], NED."""
    R = rotation_from_quaternion(q)
    out = np.zeros(6)
    for i in range(3):
        for j in range(3):
            out[i] += R[j, i] * current[j]
    return out


@kernel
def current_acceleration(q: Array, omega: Array, current: Array) -> Array:
    """Return nu_c_dot (6,) = [-omega x R^T v_c ; 0]: a constant current turns in a turning body."""
    c = current_in_body(q, current)
    out = np.zeros(6)
    out[0] = -(omega[1] * c[2] - omega[2] * c[1])
    out[1] = -(omega[2] * c[0] - omega[0] * c[2])
    out[2] = -(omega[0] * c[1] - omega[1] * c[0])
    return out
