"""Hydrodynamic damping: linear and quadratic, diagonal or full matrices of SNAME derivatives.

The force on the vehicle is L nu + Q |nu| nu with L_ij = X_u .. N_r and Q_ij = X_{u|u|} .. N_{r|r|}, negative on the
diagonal of a physical vehicle. Fossen's D(nu) nu is its opposite. The printed paper's (30) lacks a velocity factor.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, kernel

__all__ = ["damping_force"]


@kernel
def damping_force(linear: Array, quadratic: Array, nu: Array) -> Array:
    """Return the damping force on the vehicle (6,) [N, N m]: L nu + Q |nu| nu."""
    out = np.zeros(6)
    for i in range(6):
        for j in range(6):
            out[i] += (linear[i, j] + quadratic[i, j] * math.fabs(nu[j])) * nu[j]
    return out
