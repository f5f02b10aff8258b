"""The motion against integrations that share nothing with the kernels: other variables, other method, other code."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from towtank.core.rk4 import simulate_run

from .independent import (
    Body,
    body,
    cross_matrix,
    pose_difference,
    rates_to_omega,
    rotation,
    state,
)
from .proof import sized

DT = 0.001
SECONDS = sized(2.5, 1.0)
ETA0 = np.array([0.3, -0.2, 1.0, 0.2, -0.3, 1.0])
NU0 = np.array([0.6, 0.3, -0.2, 0.3, -0.2, 0.4])
PUSH = np.array([30.0, 25.0, 25.0, 2.0, 2.0, 3.0])
PACE = np.array([1.1, 0.7, 0.9, 1.7, 1.3, 0.8])


def thrust(t: np.ndarray | float) -> np.ndarray:
    return PUSH * np.sin(np.asarray(t)[..., None] * PACE + np.arange(6))


def kernel_end(b: Body, nu0: np.ndarray, current: np.ndarray) -> np.ndarray:
    t = DT * np.arange(round(SECONDS / DT))
    tau = np.stack([thrust(t), thrust(t + DT / 2), thrust(t + DT)], axis=1)
    return simulate_run(b.p, state(ETA0, nu0), tau, DT, current)[-1]


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_momenta_and_euler_angles_by_dop853(seed: int) -> None:
    b = body(seed)
    assert pose_difference(kernel_end(b, NU0, np.zeros(3)), b.motion(ETA0, NU0, thrust, SECONDS)) < 5e-9


def explicit_rate(b: Body, current: np.ndarray, t: float, s: np.ndarray) -> np.ndarray:
    """Fossen's matrix form with Euler angles, absolute velocity, and M_RB and M_A kept apart."""
    R, nu = rotation(s[3:6]), s[6:]
    nu_c = np.concatenate([R.T @ current, np.zeros(3)])
    nu_c_dot = np.concatenate([-np.cross(nu[3:], nu_c[:3]), np.zeros(3)])
    nu_r = nu - nu_c

    def coriolis(M: np.ndarray, v: np.ndarray) -> np.ndarray:
        A, C = M @ v, np.zeros((6, 6))
        C[:3, 3:] = C[3:, :3] = -cross_matrix(A[:3])
        C[3:, 3:] = -cross_matrix(A[3:])
        return C

    force = thrust(t) + b.damping(nu_r) + b.gravity(R) + b.constant
    force -= coriolis(b.M_RB, nu) @ nu + coriolis(b.M_A, nu_r) @ nu_r - b.M_A @ nu_c_dot
    turning = np.linalg.solve(rates_to_omega(s[3:6]), nu[3:])
    return np.concatenate([R @ nu[:3], turning, np.linalg.solve(b.M, force)])


@pytest.mark.parametrize("current", [np.zeros(3), np.array([0.4, -0.3, 0.2])])
def test_matrix_form_with_current_by_dop853(current: np.ndarray) -> None:
    b = body(34)
    found = solve_ivp(
        lambda t, s: explicit_rate(b, current, t, s),
        (0.0, SECONDS),
        np.concatenate([ETA0, NU0]),
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    assert pose_difference(kernel_end(b, NU0, current), found.y[:, -1]) < 5e-9


def test_quaternions_and_euler_angles_by_the_same_method() -> None:
    """RK4 in Euler angles at the same step: only the description of attitude differs."""
    b, s = body(35), np.concatenate([ETA0, NU0])
    still, seconds = np.zeros(3), 0.5
    n = round(seconds / DT)
    for k in range(n):
        t = k * DT
        k1 = explicit_rate(b, still, t, s)
        k2 = explicit_rate(b, still, t + DT / 2, s + DT / 2 * k1)
        k3 = explicit_rate(b, still, t + DT / 2, s + DT / 2 * k2)
        k4 = explicit_rate(b, still, t + DT, s + DT * k3)
        s = s + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    t = DT * np.arange(n)
    tau = np.stack([thrust(t), thrust(t + DT / 2), thrust(t + DT)], axis=1)
    assert pose_difference(simulate_run(b.p, state(ETA0, NU0), tau, DT, still)[-1], s) < 1e-12


def test_tumbling_through_the_vertical_stays_regular() -> None:
    """Quaternions know no gimbal lock: a pure pitch spin through +-90 deg returns after one turn."""
    b = body(36, damped=False)
    M = np.diag(np.diag(b.M))
    b = Body(M, 0 * M, b.L, b.Q, b.W, b.W, b.r_G, b.r_G)
    turns_per_second = 0.5
    nu0 = np.array([0.0, 0.0, 0.0, 0.0, 2 * np.pi * turns_per_second, 0.0])
    start = state(np.zeros(6), nu0)
    end = simulate_run(b.p, start, np.zeros((2000, 1, 6)), DT, np.zeros(3))[-1]
    expected = start.copy()
    expected[3:7] *= -1.0  # one turn changes the quaternion's sign
    assert np.abs(end - expected).max() < 1e-9
