"""From FRD (x forward, y to starboard, z down) to FLU (y to port, z up) and back: both are the same turn about x.

A turn by pi about x changes the sign of v, w, q, r and of Y, Z, M, N: t = (1, -1, -1, 1, -1, -1). With T = diag(t) a
force F(nu) in one frame is T F(T nu) in the other, so that

    matrices        L_ij nu_j               t_i t_j L_ij           (mass and Q_ij |nu_j| alike)
    bilinear terms  a_ijk nu_j nu_k         t_i t_j t_k a_ijk

The turn is its own inverse, and exact: it changes signs, never digits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array

__all__ = ["TURN", "folded", "parallel_axes", "turned_bilinear", "turned_matrix", "turned_vector"]

TURN = (1.0, -1.0, -1.0, 1.0, -1.0, -1.0)


def turned_vector(values: ArrayLike) -> Array:
    """Return a vector (..., 3) or a twist or wrench (..., 6) in the other frame."""
    array = np.asarray(values, dtype=np.float64)
    return np.asarray(array * np.array(TURN[: array.shape[-1]]) + 0.0)  # no negative zeros


def turned_matrix(matrix: ArrayLike) -> Array:
    """Return a matrix (3, 3) or (6, 6) of mass, inertia, linear or quadratic damping in the other frame."""
    array = np.asarray(matrix, dtype=np.float64)
    t = np.array(TURN[: array.shape[-1]])
    return np.asarray(array * np.outer(t, t) + 0.0)


def turned_bilinear(terms: ArrayLike) -> Array:
    """Return a_ijk (6, 6, 6) of forces a_ijk nu_j nu_k in the other frame."""
    t = np.array(TURN)
    return np.asarray(np.asarray(terms, dtype=np.float64) * np.einsum("i,j,k->ijk", t, t, t) + 0.0)


def folded(terms: Array) -> Array:
    """Return a_ijk (6, 6, 6) with j <= k alone: nu_j nu_k and nu_k nu_j are one."""
    upper = np.triu(np.ones((6, 6)))
    return np.asarray((terms + terms.transpose(0, 2, 1)) * upper - terms * np.eye(6))


def parallel_axes(mass: float, offset: Array) -> Array:
    """Return the inertia (3, 3) [kg m^2] that a mass [kg] has about a point at a distance (3,) [m]."""
    return np.asarray(mass * (offset @ offset * np.eye(3) - np.outer(offset, offset)))
