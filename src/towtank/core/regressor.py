"""The regressor of (8): Phi(q, nu, nu_dot) theta = tau for every unknown at once.

theta (103) = [M upper triangle by rows (21), L (36), Q (36), W - B, b (3), constant wrench (6)]. Kirchhoff's form of
C(nu) nu is linear in a full symmetric M, so nothing has to be diagonal. L and Q are SNAME derivatives (negative
dissipates).
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import gravity_direction
from towtank.core.layout import I_LINEAR, I_MASS, I_MOMENT, I_QUADRATIC, I_WEIGHT

__all__ = ["N_UNKNOWNS", "regressor", "unknowns_from_parameters"]

N_UNKNOWNS = 103
_TRIANGLE = 21


@kernel
def unknowns_from_parameters(p: Array) -> Array:
    """Return theta (103,) of the kernel parameters p (148,)."""
    out = np.empty(N_UNKNOWNS)
    n = 0
    for i in range(6):
        for j in range(i, 6):
            out[n] = p[I_MASS + 6 * i + j]
            n += 1
    out[_TRIANGLE : _TRIANGLE + 36] = p[I_LINEAR:I_QUADRATIC]
    out[_TRIANGLE + 36 : _TRIANGLE + 72] = p[I_QUADRATIC:I_WEIGHT]
    out[_TRIANGLE + 72] = p[I_WEIGHT]
    out[_TRIANGLE + 73 :] = p[I_MOMENT : I_MOMENT + 9]
    return out


@kernel
def _add_momentum(phi: Array, column: int, row: int, speed: float, rate: float, nu: Array) -> None:
    """Add to `phi[:, column]` the inertial wrench of a momentum h_row = speed whose derivative is `rate`."""
    u, v, w, p, q, r = nu[0], nu[1], nu[2], nu[3], nu[4], nu[5]
    phi[row, column] += rate
    if row == 0:  # omega x h1 and v x h1 with h1 = (s, 0, 0)
        phi[1, column] += r * speed
        phi[2, column] -= q * speed
        phi[4, column] += w * speed
        phi[5, column] -= v * speed
    elif row == 1:
        phi[0, column] -= r * speed
        phi[2, column] += p * speed
        phi[3, column] -= w * speed
        phi[5, column] += u * speed
    elif row == 2:
        phi[0, column] += q * speed
        phi[1, column] -= p * speed
        phi[3, column] += v * speed
        phi[4, column] -= u * speed
    elif row == 3:  # omega x h2 with h2 = (s, 0, 0)
        phi[4, column] += r * speed
        phi[5, column] -= q * speed
    elif row == 4:
        phi[3, column] -= r * speed
        phi[5, column] += p * speed
    else:
        phi[3, column] += q * speed
        phi[4, column] -= p * speed


@kernel
def regressor(q: Array, nu: Array, nu_dot: Array) -> Array:
    """Return Phi (6, 103) for one sample: attitude q (4,), velocity nu (6,), acceleration nu_dot (6,)."""
    out = np.zeros((6, N_UNKNOWNS))
    n = 0
    for i in range(6):
        for j in range(i, 6):
            _add_momentum(out, n, i, nu[j], nu_dot[j], nu)
            if j != i:
                _add_momentum(out, n, j, nu[i], nu_dot[i], nu)
            n += 1
    for i in range(6):
        for j in range(6):
            out[i, _TRIANGLE + 6 * i + j] = -nu[j]
            out[i, _TRIANGLE + 36 + 6 * i + j] = -math.fabs(nu[j]) * nu[j]
    k = gravity_direction(q)
    c = _TRIANGLE + 72
    for i in range(3):
        out[i, c] = -k[i]
    # g2 = -(b x k): columns are -(e_i x k).
    out[4, c + 1], out[5, c + 1] = k[2], -k[1]
    out[3, c + 2], out[5, c + 2] = -k[2], k[0]
    out[3, c + 3], out[4, c + 3] = k[1], -k[0]
    for i in range(6):
        out[i, c + 4 + i] = -1.0
    return out
