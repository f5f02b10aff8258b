"""The regressor of (8): Phi(q, nu, nu_dot) theta = tau for every unknown at once, or the wrench of one of them.

theta (118) = [M upper triangle by rows (21), L (36), Q (36), W - B, b (3), constant wrench (6), forward speed (9),
asymmetric drag (6)], all but M as in the kernel vector. Kirchhoff's form of C(nu) nu is linear in a full symmetric M,
so nothing has to be diagonal. L and Q are SNAME derivatives (negative dissipates). The loss of thrust with inflow is no
force of the motion alone and has no column.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.attitude import gravity_direction
from towtank.core.layout import (
    ASYMMETRY,
    CONSTANT,
    FORWARD,
    FORWARD_COLUMNS,
    FORWARD_ROWS,
    I_INFLOW,
    I_LINEAR,
    I_MASS,
    LINEAR,
    MASS,
    MOMENT,
    N_FORWARD,
    QUADRATIC,
    WEIGHT,
)

__all__ = ["N_UNKNOWNS", "regressor", "unit_wrench_into", "unknowns_from_parameters"]

N_UNKNOWNS = 118
_TRIANGLE = 21


@kernel
def unknowns_from_parameters(p: Array) -> Array:
    """Return theta (118,) of the kernel parameters p (170,)."""
    out = np.empty(N_UNKNOWNS)
    n = 0
    for i in range(6):
        for j in range(i, 6):
            out[n] = p[I_MASS + 6 * i + j]
            n += 1
    out[_TRIANGLE:] = p[I_LINEAR:I_INFLOW]
    return out


@kernel
def _add_momentum_into(row: int, speed: float, rate: float, nu: Array, factor: float, w: Array) -> None:
    """Add to `w` (6,) `factor` times the inertial wrench of a momentum h_row = speed with derivative `rate`."""
    u, v, ww, p, q, r = nu[0], nu[1], nu[2], nu[3], nu[4], nu[5]
    s = factor * speed
    w[row] += factor * rate
    if row == 0:  # omega x h1 and v x h1 with h1 = (s, 0, 0)
        w[1] += r * s
        w[2] -= q * s
        w[4] += ww * s
        w[5] -= v * s
    elif row == 1:
        w[0] -= r * s
        w[2] += p * s
        w[3] -= ww * s
        w[5] += u * s
    elif row == 2:
        w[0] += q * s
        w[1] -= p * s
        w[3] += v * s
        w[4] -= u * s
    elif row == 3:  # omega x h2 with h2 = (s, 0, 0)
        w[4] += r * s
        w[5] -= q * s
    elif row == 4:
        w[3] -= r * s
        w[5] += p * s
    else:
        w[3] += q * s
        w[4] -= p * s


@inlined_kernel
def unit_wrench_into(kind: int, i: int, j: int, nu: Array, nu_dot: Array, k: Array, out: Array) -> None:
    """Write the wrench (6,) on the vehicle that one coefficient makes per unit: the derivative of all forces by it.

    None of the loss of thrust with inflow, which asks for the thrusters' forces.

    Args:
        kind, i, j: the coefficient (`towtank.core.layout`); an added mass stands for its mirrored element too.
        nu, nu_dot: velocity through the water and its derivative (6,).
        k: direction of gravity in the body (3,).
    """
    for m in range(6):
        out[m] = 0.0
    if kind == MASS:
        _add_momentum_into(i, nu[j], nu_dot[j], nu, -1.0, out)
        if j != i:
            _add_momentum_into(j, nu[i], nu_dot[i], nu, -1.0, out)
    elif kind == LINEAR:
        out[i] = nu[j]
    elif kind == QUADRATIC:
        out[i] = math.fabs(nu[j]) * nu[j]
    elif kind == WEIGHT:
        out[0], out[1], out[2] = k[0], k[1], k[2]
    elif kind == MOMENT:  # e_i x k
        if i == 0:
            out[4], out[5] = -k[2], k[1]
        elif i == 1:
            out[3], out[5] = k[2], -k[0]
        else:
            out[3], out[4] = -k[1], k[0]
    elif kind == CONSTANT:
        out[i] = 1.0
    elif kind == FORWARD:
        out[i] = nu[0] * nu[j]
    elif kind == ASYMMETRY:
        out[i] = nu[j] * nu[j]


@kernel
def _column(kind: int, i: int, j: int, n: int, nu: Array, nu_dot: Array, k: Array, w: Array, phi: Array) -> int:
    """Write column n of `phi` (6, 118), the wrench that the unknown asks of the thrusters; return n + 1. w: (6,)."""
    unit_wrench_into(kind, i, j, nu, nu_dot, k, w)
    for m in range(6):
        phi[m, n] = -w[m]
    return n + 1


@kernel
def regressor(q: Array, nu: Array, nu_dot: Array) -> Array:
    """Return Phi (6, 118) for one sample: attitude q (4,), velocity nu (6,), acceleration nu_dot (6,)."""
    out, w, k = np.zeros((6, N_UNKNOWNS)), np.empty(6), gravity_direction(q)
    n = 0
    for i in range(6):
        for j in range(i, 6):
            n = _column(MASS, i, j, n, nu, nu_dot, k, w, out)
    for kind in (LINEAR, QUADRATIC):
        for i in range(6):
            for j in range(6):
                n = _column(kind, i, j, n, nu, nu_dot, k, w, out)
    n = _column(WEIGHT, 0, 0, n, nu, nu_dot, k, w, out)
    for i in range(3):
        n = _column(MOMENT, i, 0, n, nu, nu_dot, k, w, out)
    for i in range(6):
        n = _column(CONSTANT, i, 0, n, nu, nu_dot, k, w, out)
    for m in range(N_FORWARD):
        n = _column(FORWARD, FORWARD_ROWS[m], FORWARD_COLUMNS[m], n, nu, nu_dot, k, w, out)
    for i in range(6):
        n = _column(ASYMMETRY, i, i, n, nu, nu_dot, k, w, out)
    return out
