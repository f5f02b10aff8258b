"""Forward and inverse dynamics of (8): M nu_dot + C(nu) nu + D(nu) nu + g(eta) = tau + tau_0.

The forward form is the integrator's own (`towtank.core.rk4.stage_into`); the inverse form is put together from the
separate terms, so that each proves the other.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import gravity_direction
from towtank.core.forces import add_extra_force_into, damping_force, restoring_wrench
from towtank.core.inertia import coriolis_force
from towtank.core.layout import (
    I_CONSTANT,
    I_LINEAR,
    I_MASS,
    I_MASS_INVERSE,
    I_QUADRATIC,
    I_WEIGHT,
    N_PARAMETERS,
)
from towtank.core.rk4 import N_STATES, stage_into

__all__ = ["forward_dynamics", "inverse_dynamics", "net_wrench"]


@kernel
def forward_dynamics(p: Array, q: Array, nu: Array, tau: Array) -> Array:
    """Return nu_dot (n, 6) [m/s^2, rad/s^2].

    Args:
        p: kernel parameters (n, 170), or (1, 170) shared by all rows.
        q: attitude (n, 4). nu: velocity relative to the water (n, 6). tau: wrench (n, 6), all body FRD.
    """
    n = nu.shape[0]
    out = np.empty((n, 6))
    parameters = np.empty((N_PARAMETERS, 1))
    x = np.zeros((N_STATES, 1))
    rate = np.empty((N_STATES, 1))
    wrench = np.empty((6, 1))
    current = np.zeros(3)
    for i in range(n):
        if i == 0 or p.shape[0] > 1:
            for j in range(N_PARAMETERS):
                parameters[j, 0] = p[i, j]
        for j in range(4):
            x[3 + j, 0] = q[i, j]
        for j in range(6):
            x[7 + j, 0] = nu[i, j]
            wrench[j, 0] = tau[i, j]
        stage_into(parameters, x, wrench, current, rate, True)
        for j in range(6):
            out[i, j] = rate[7 + j, 0]
    return out


@kernel
def net_wrench(p: Array, q: Array, nu: Array) -> Array:
    """Return C(nu) nu + D(nu) nu + g(eta) - tau_0 (6,) for one vehicle p (170,), attitude q (4,), velocity nu (6,)."""
    out = coriolis_force(p[I_MASS:I_MASS_INVERSE].reshape(6, 6), nu)
    out -= damping_force(p[I_LINEAR:I_QUADRATIC].reshape(6, 6), p[I_QUADRATIC:I_WEIGHT].reshape(6, 6), nu)
    add_extra_force_into(p, nu, -1.0, out)
    out += restoring_wrench(p, gravity_direction(q))
    out -= p[I_CONSTANT : I_CONSTANT + 6]
    return out


@kernel
def inverse_dynamics(p: Array, q: Array, nu: Array, nu_dot: Array) -> Array:
    """Return the wrench tau (n, 6) [N, N m] that gives the acceleration nu_dot (n, 6); arguments as forward."""
    n = nu.shape[0]
    out = np.empty((n, 6))
    for i in range(n):
        row = p[i] if p.shape[0] > 1 else p[0]
        out[i] = net_wrench(row, q[i], nu[i])
        for j in range(6):
            for k in range(6):
                out[i, j] += row[I_MASS + 6 * j + k] * nu_dot[i, k]
    return out
