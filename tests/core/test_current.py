"""Current: a vehicle in flowing water is the same vehicle seen from the drifting water."""

from __future__ import annotations

import numpy as np
from hypothesis import given

from towtank.core.dynamics import forward_dynamics
from towtank.core.forces import current_acceleration, current_in_body
from towtank.core.inertia import coriolis_matrix
from towtank.core.rk4 import simulate_run

from .independent import body, cross_matrix, derivative, quaternion, rotation, state
from .proof import eulers, proof, seeds, sized, vectors


@proof
@given(eulers, vectors(3), vectors(3, 3.0))
def test_current_as_the_turning_body_sees_it(euler: np.ndarray, omega: np.ndarray, current: np.ndarray) -> None:
    q = np.array(quaternion(euler))
    R = rotation(euler)
    seen = current_in_body(q, current)
    assert np.abs(seen[:3] - R.T @ current).max() < 1e-14 * 10
    assert not seen[3:].any()
    change = current_acceleration(q, omega, current)
    turned = derivative(lambda t: (R @ (np.eye(3) + cross_matrix(omega) * t)).T @ current)
    assert np.abs(change[:3] - turned).max() < 1e-13 * 10
    assert not change[3:].any()


@proof
@given(seeds, eulers, vectors(6, 2.0), vectors(3, 2.0), vectors(6, 50.0))
def test_explicit_form_with_two_velocities_is_the_form_in_the_relative_one(
    seed: int, euler: np.ndarray, nu: np.ndarray, current: np.ndarray, tau: np.ndarray
) -> None:
    """M_RB nu_dot + C_RB(nu) nu + M_A nu_r_dot + C_A(nu_r) nu_r + D(nu_r) nu_r + g = tau, Fossen (10.140)."""
    b, q = body(seed), np.array(quaternion(euler))
    nu_c, nu_c_dot = current_in_body(q, current), current_acceleration(q, nu[3:], current)
    nu_r = nu - nu_c
    nu_r_dot = forward_dynamics(b.p[None], q[None], nu_r[None], tau[None])[0]
    nu_dot = nu_r_dot + nu_c_dot
    terms = [
        b.M_RB @ nu_dot,
        coriolis_matrix(b.M_RB, nu) @ nu,
        b.M_A @ nu_r_dot,
        coriolis_matrix(b.M_A, nu_r) @ nu_r,
        -b.damping(nu_r),
        -b.gravity(rotation(euler)),
        -b.constant,
        -tau,
    ]
    scale = 1.0 + max(np.abs(t).max() for t in terms)
    assert np.abs(np.sum(terms, axis=0)).max() < 1e-12 * scale


def test_drifting_with_the_water_nothing_changes() -> None:
    n, dt = sized(2000, 300), 0.01
    rng = np.random.default_rng(2)
    b, current = body(1), np.array([0.4, -0.3, 0.1])
    tau = 20.0 * np.cos(np.arange(n)[:, None, None] * dt + rng.uniform(0, 6, 6)) * [1, 1, 1, 0.05, 0.05, 0.05]
    eta0, nu_r0 = np.array([1.0, 2.0, 3.0, 0.3, -0.2, 2.0]), np.array([0.5, 0.1, -0.2, 0.1, 0.2, -0.3])
    nu0 = nu_r0.copy()
    nu0[:3] += rotation(eta0[3:]).T @ current
    still = simulate_run(b.p, state(eta0, nu_r0), tau, dt, np.zeros(3))
    flowing = simulate_run(b.p, state(eta0, nu0), tau, dt, current)
    t = dt * np.arange(n + 1)[:, None]
    assert np.abs(flowing[:, :3] - current * t - still[:, :3]).max() < 1e-11
    assert np.abs(flowing[:, 3:7] - still[:, 3:7]).max() < 1e-12
    carried = np.array([current_in_body(q, current) for q in still[:, 3:7]])
    assert np.abs(flowing[:, 7:] - carried - still[:, 7:]).max() < 1e-12


def test_left_alone_a_neutral_vehicle_ends_up_drifting_with_the_water() -> None:
    b, current = body(3), np.array([0.3, 0.2, 0.0])
    p = b.p.copy()
    p[144] = 0.0
    p[145:148] = [0.0, 0.0, 20.0]
    p[148:154] = 0.0
    n = sized(6000, 800)
    end = simulate_run(p, state(np.zeros(6), np.zeros(6)), np.zeros((n, 1, 6)), 0.1, current)[-1]
    speed = (end[:3] - simulate_run(p, end, np.zeros((1, 1, 6)), 0.1, current)[-1][:3]) / -0.1
    assert np.abs(speed - current).max() < 1e-3
