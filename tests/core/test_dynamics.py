"""Forward and inverse dynamics against each other and against the rate of change of inertial momentum."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from towtank.core.dynamics import forward_dynamics, inverse_dynamics, net_wrench
from towtank.core.layout import (
    ASYMMETRY,
    FORWARD,
    INFLOW,
    LINEAR,
    MASS,
    N_PARAMETERS,
    QUADRATIC,
    address,
    pack_parameters,
)

from .independent import body, cross_matrix, derivative, quaternion, rotation
from .proof import eulers, proof, seeds, vectors


@proof
@given(seeds, eulers, vectors(6, 3.0), vectors(6, 100.0))
def test_there_and_back(seed: int, euler: np.ndarray, nu: np.ndarray, tau: np.ndarray) -> None:
    p, q = body(seed).p, quaternion(euler)
    nu_dot = forward_dynamics(p[None], q[None], nu[None], tau[None])
    again = inverse_dynamics(p[None], q[None], nu[None], nu_dot)
    scale = 1.0 + np.abs(tau).max() + np.abs(net_wrench(p, q, nu)).max()
    assert np.abs(again[0] - tau).max() < 1e-11 * scale


@proof
@given(seeds, eulers, vectors(6, 3.0), vectors(6, 100.0))
def test_forces_change_the_momentum(seed: int, euler: np.ndarray, nu: np.ndarray, tau: np.ndarray) -> None:
    """d/dt of inertial linear and angular momentum equals the forces in the inertial frame: no Coriolis matrix."""
    b, R0 = body(seed), rotation(euler)
    nu_dot = forward_dynamics(b.p[None], quaternion(euler)[None], nu[None], tau[None])[0]

    def momenta(t: complex) -> np.ndarray:
        R = R0 @ (np.eye(3) + cross_matrix(nu[3:]) * t)
        h = b.M @ (nu + nu_dot * t)
        return np.concatenate([R @ h[:3], np.cross(R0 @ nu[:3] * t, R @ h[:3]) + R @ h[3:]])

    rate = derivative(momenta)
    wrench = tau + b.damping(nu) + b.gravity(R0) + b.constant
    expected = np.concatenate([R0 @ wrench[:3], R0 @ wrench[3:]])
    scale = 1.0 + np.abs(wrench).max() + np.abs(b.M @ nu_dot).max()
    assert np.abs(rate - expected).max() < 1e-11 * scale


def test_rows_are_independent_and_one_vehicle_may_be_shared() -> None:
    rng = np.random.default_rng(0)
    n = 9
    p = np.array([body(i).p for i in range(n)])
    q = np.array([quaternion(rng.uniform(-1, 1, 3)) for _ in range(n)])
    nu, tau = rng.normal(size=(n, 6)), rng.normal(size=(n, 6))
    inputs = [a.copy() for a in (p, q, nu, tau)]
    for kernel in (forward_dynamics, inverse_dynamics):
        each = np.array([kernel(p[i : i + 1], q[i : i + 1], nu[i : i + 1], tau[i : i + 1])[0] for i in range(n)])
        assert np.abs(kernel(p, q, nu, tau) - each).max() < 1e-12
        shared = kernel(p[:1], q, nu, tau)
        repeated = kernel(np.repeat(p[:1], n, axis=0), q, nu, tau)
        assert np.abs(shared - repeated).max() < 1e-12
    assert all(np.array_equal(a, b) for a, b in zip((p, q, nu, tau), inputs, strict=True))


def test_layout_of_the_parameters() -> None:
    b = body(4)
    assert b.p.shape == (N_PARAMETERS,)
    assert N_PARAMETERS == 170
    assert np.array_equal(b.p[:36].reshape(6, 6), b.M)
    assert np.abs(b.p[36:72].reshape(6, 6) @ b.M - np.eye(6)).max() < 1e-12
    assert np.array_equal(b.p[72:108].reshape(6, 6), b.L)
    assert np.array_equal(b.p[108:144].reshape(6, 6), b.Q)
    assert b.p[144] == b.W - b.B
    assert np.array_equal(b.p[145:148], b.W * b.r_G - b.B * b.r_B)
    assert np.array_equal(b.p[148:154], b.constant)
    assert np.array_equal(b.p[154:163], b.lift)
    assert np.array_equal(b.p[163:169], b.asymmetry)
    assert b.p[169] == 0.0
    assert not pack_parameters(b.M, b.L, b.Q, 0.0, np.zeros(3))[148:].any()
    kinds = {MASS: b.M, LINEAR: b.L, QUADRATIC: b.Q}
    for kind, matrix in kinds.items():
        assert b.p[address(kind, 4, 2)] == matrix[4, 2]
    assert [b.p[address(FORWARD, i, j)] for i, j in ((1, 5), (5, 1), (4, 4))] == [b.lift[1], b.lift[2], b.lift[8]]
    assert [address(ASYMMETRY, i, i) for i in range(6)] == list(range(163, 169))
    assert address(ASYMMETRY, 0, 1) == -1  # on the diagonal only
    assert address(INFLOW, 0, 0) == 169
    assert address(FORWARD, 0, 1) == -1  # no X_uv: what a hull symmetric to port and starboard does not have
    with pytest.raises(np.linalg.LinAlgError):
        pack_parameters(np.zeros((6, 6)), b.L, b.Q, 0.0, np.zeros(3))
