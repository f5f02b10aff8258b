"""FRD to FLU: forces, powers and full matrices are the same physics in both frames."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.core.arrays import Array
from towtank.exporters.frames import parallel_axes, turned_bilinear, turned_matrix, turned_vector

SEEDS = st.integers(0, 2**32 - 1)
HALF_TURN = np.diag([1.0, -1.0, -1.0])  # about x
TWICE = np.kron(np.eye(2), HALF_TURN)


def drawn(seed: int, *shape: int) -> Array:
    return np.random.default_rng(seed).standard_normal(shape)


@given(SEEDS)
@settings(deadline=None)
def test_a_half_turn_about_x_is_what_it_is(seed: int) -> None:
    v, x = drawn(seed, 3), drawn(seed, 4, 6)
    np.testing.assert_array_equal(turned_vector(v), HALF_TURN @ v)
    np.testing.assert_array_equal(turned_vector(x), x @ TWICE)
    assert np.linalg.det(HALF_TURN) == 1.0


@given(SEEDS)
@settings(deadline=None)
def test_forces_of_full_matrices_and_terms_turn_with_the_velocity(seed: int) -> None:
    L, Q, A, nu = drawn(seed, 6, 6), drawn(seed + 1, 6, 6), drawn(seed + 2, 6, 6, 6), drawn(seed + 3, 6)
    there = turned_vector(nu)
    for force, turned in (
        (L @ nu, turned_matrix(L) @ there),
        (Q @ (np.abs(nu) * nu), turned_matrix(Q) @ (np.abs(there) * there)),
        (np.einsum("ijk,j,k", A, nu, nu), np.einsum("ijk,j,k", turned_bilinear(A), there, there)),
    ):
        np.testing.assert_allclose(turned_vector(force), turned, rtol=0.0, atol=1e-13)
        assert abs(force @ nu - turned @ there) < 1e-12


@given(SEEDS)
@settings(deadline=None)
def test_turning_twice_changes_no_bit_and_leaves_no_negative_zero(seed: int) -> None:
    L, A = drawn(seed, 6, 6), drawn(seed, 6, 6, 6)
    np.testing.assert_array_equal(turned_matrix(turned_matrix(L)), L)
    np.testing.assert_array_equal(turned_bilinear(turned_bilinear(A)), A)
    assert not np.any(np.signbit(turned_matrix(np.zeros((6, 6)))))


def test_the_diagonal_keeps_its_signs_and_couplings_with_surge_or_roll_turn() -> None:
    turned = turned_matrix(np.ones((6, 6)))
    assert np.all(np.diag(turned) == 1.0)
    keeps = np.array([[(i in (0, 3)) == (j in (0, 3)) for j in range(6)] for i in range(6)])
    np.testing.assert_array_equal(turned, np.where(keeps, 1.0, -1.0))


@given(SEEDS)
@settings(deadline=None)
def test_parallel_axes_are_the_kinetic_energy_of_a_point(seed: int) -> None:
    r, w, m = drawn(seed, 3), drawn(seed + 1, 3), 2.5
    speed = np.cross(w, r)
    assert abs(0.5 * w @ parallel_axes(m, r) @ w - 0.5 * m * speed @ speed) < 1e-12
