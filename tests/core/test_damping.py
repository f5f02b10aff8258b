"""Damping: odd, dissipating, linear and quadratic parts, with coupling."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from towtank.core.forces import damping_force

from .proof import numbers, proof, vectors

matrices = hnp.arrays(np.float64, (6, 6), elements=numbers(50.0))
drags = hnp.arrays(np.float64, 6, elements=st.floats(0.0, 50.0, allow_subnormal=False))


@proof
@given(matrices, matrices, vectors(6))
def test_sum_of_linear_and_quadratic_parts(L: np.ndarray, Q: np.ndarray, nu: np.ndarray) -> None:
    expected = L @ nu + Q @ (np.sign(nu) * nu**2)
    assert np.abs(damping_force(L, Q, nu) - expected).max() <= 1e-12 * (1.0 + np.abs(expected).max())


@proof
@given(matrices, matrices, vectors(6))
def test_opposite_motion_gives_opposite_force(L: np.ndarray, Q: np.ndarray, nu: np.ndarray) -> None:
    assert np.array_equal(damping_force(L, Q, -nu), -damping_force(L, Q, nu))


@proof
@given(drags, drags, matrices, vectors(6))
def test_negative_derivatives_dissipate(lin: np.ndarray, quad: np.ndarray, A: np.ndarray, nu: np.ndarray) -> None:
    none = np.zeros((6, 6))
    assert nu @ damping_force(np.diag(-lin), np.diag(-quad), nu) <= 0.0
    assert nu @ damping_force(-A @ A.T, none, nu) <= 1e-12 * np.abs(A).max() ** 2 * (nu @ nu)


def test_names_of_rows_and_columns() -> None:
    """Row X, column r: a yaw rate of -2 rad/s with X_r = 3 and X_rr = 5 pushes by -6 and by -20 N, in surge alone."""
    L, Q = np.zeros((6, 6)), np.zeros((6, 6))
    L[0, 5], Q[0, 5] = 3.0, 5.0
    nu = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -2.0])
    assert damping_force(L, Q, nu).tolist() == [-26.0, 0.0, 0.0, 0.0, 0.0, 0.0]
