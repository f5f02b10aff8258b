"""Regressor: times the unknowns it is the inverse dynamics; each of its columns is the model of one unknown alone."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from towtank.core.dynamics import inverse_dynamics
from towtank.core.layout import N_PARAMETERS
from towtank.core.regressor import N_UNKNOWNS, regressor, unknowns_from_parameters

from .independent import body, cross_matrix, derivative, quaternion, rotation
from .proof import eulers, proof, seeds, vectors


@proof
@given(seeds, eulers, vectors(6, 3.0), vectors(6, 3.0))
def test_times_unknowns_is_inverse_dynamics(seed: int, euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray) -> None:
    b, q = body(seed), quaternion(euler)
    by_columns = regressor(q, nu, nu_dot) @ unknowns_from_parameters(b.p)
    tau = inverse_dynamics(b.p[None], q[None], nu[None], nu_dot[None])[0]
    scale = 1.0 + np.abs(tau).max()
    assert np.abs(by_columns - tau).max() < 1e-12 * scale
    assert np.abs(by_columns - tau).max() < 1e-10
    assert np.abs(by_columns - newton(b.M, b, euler, nu, nu_dot)).max() < 1e-10


def newton(M: np.ndarray, b, euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray) -> np.ndarray:
    """The wrench by momenta in the inertial frame, see `test_dynamics`."""
    R0 = rotation(euler)

    def momenta(t: complex) -> np.ndarray:
        R = R0 @ (np.eye(3) + cross_matrix(nu[3:]) * t)
        h = M @ (nu + nu_dot * t)
        return np.concatenate([R @ h[:3], np.cross(R0 @ nu[:3] * t, R @ h[:3]) + R @ h[3:]])

    rate = derivative(momenta)
    return np.concatenate([R0.T @ rate[:3], R0.T @ rate[3:]]) - b.damping(nu) - b.gravity(R0) - b.constant


@proof
@given(st.integers(0, N_UNKNOWNS - 1), eulers, vectors(6, 3.0), vectors(6, 3.0))
def test_each_column_is_one_unknown(column: int, euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray) -> None:
    theta = np.zeros(N_UNKNOWNS)
    theta[column] = 1.0
    p = np.zeros(N_PARAMETERS)
    M = np.zeros((6, 6))
    M[np.triu_indices(6)] = theta[:21]
    p[:36] = (M + np.triu(M, 1).T).ravel()
    p[72:169] = theta[21:]
    assert np.array_equal(unknowns_from_parameters(p), theta)
    q = quaternion(euler)
    tau = inverse_dynamics(p[None], q[None], nu[None], nu_dot[None])[0]
    assert np.abs(regressor(q, nu, nu_dot)[:, column] - tau).max() < 1e-12


def test_random_motion_shows_every_unknown() -> None:
    """Stacked over a random motion the regressor has full rank: no two unknowns are the same thing twice."""
    rng = np.random.default_rng(0)
    rows = [regressor(quaternion(rng.uniform(-1.5, 1.5, 3)), rng.normal(size=6), rng.normal(size=6)) for _ in range(60)]
    assert np.linalg.matrix_rank(np.vstack(rows)) == N_UNKNOWNS
