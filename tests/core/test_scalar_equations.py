"""The full model reduces to the six scalar equations that the field writes out by hand.

First (31) of the source paper with its errata corrected: diagonal M_A, body origin in the centre of gravity, neutral
buoyancy, quadratic damping on the diagonal. Then the same with the terms of z_G that (31) leaves out (SNAME 1950).
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from towtank.core.dynamics import forward_dynamics, inverse_dynamics
from towtank.core.inertia import rigid_body_mass
from towtank.core.layout import pack_parameters

from .independent import quaternion
from .proof import eulers, proof, vectors

# Table I of the paper; the centre of buoyancy is not printed.
m, I_X, I_Y, I_Z, B = 18.826, 0.559, 0.953, 0.90, 18.826 * 9.81
X_udot, Y_vdot, Z_wdot, K_pdot, M_qdot, N_rdot = -27.08, -25.952, -68.576, -61.683, -79.411, -0.154
X_uu, Y_vv, Z_ww, K_pp, M_qq, N_rr = -61.117, -139.81, -51.724, -12.0, -56.61, -1.772


def parameters(z_G: float, z_B: float) -> np.ndarray:
    """Kernel vector; I_X and I_Y are about the body origin."""
    at_origin = np.diag([I_X, I_Y, I_Z]) - m * z_G**2 * np.diag([1.0, 1.0, 0.0])
    M_RB = rigid_body_mass(m, np.array([0.0, 0.0, z_G]), at_origin)
    M_A = -np.diag([X_udot, Y_vdot, Z_wdot, K_pdot, M_qdot, N_rdot])
    Q = np.diag([X_uu, Y_vv, Z_ww, K_pp, M_qq, N_rr])
    return pack_parameters(M_RB + M_A, np.zeros((6, 6)), Q, 0.0, np.array([0.0, 0.0, B * (z_G - z_B)]))


def corrected_31(euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray, BG: float) -> np.ndarray:
    (phi, theta, _), (u, v, w, p, q, r), (ud, vd, wd, pd, qd, rd) = euler, nu, nu_dot
    F_BK = BG * np.cos(theta) * np.sin(phi)
    F_BM = BG * np.sin(theta)
    return np.array(
        [
            (m - X_udot) * ud - (m - Y_vdot) * v * r + (m - Z_wdot) * w * q - X_uu * abs(u) * u,
            (m - Y_vdot) * vd - (m - Z_wdot) * w * p + (m - X_udot) * u * r - Y_vv * abs(v) * v,
            (m - Z_wdot) * wd - (m - X_udot) * u * q + (m - Y_vdot) * v * p - Z_ww * abs(w) * w,
            (I_X - K_pdot) * pd
            + (Y_vdot - Z_wdot) * w * v
            + (I_Z - I_Y - N_rdot + M_qdot) * r * q
            - K_pp * abs(p) * p
            + F_BK,
            (I_Y - M_qdot) * qd
            + (Z_wdot - X_udot) * u * w
            + (I_X - I_Z + N_rdot - K_pdot) * r * p
            - M_qq * abs(q) * q
            + F_BM,
            (I_Z - N_rdot) * rd + (X_udot - Y_vdot) * u * v + (I_Y - I_X + K_pdot - M_qdot) * p * q - N_rr * abs(r) * r,
        ]
    )


def z_G_terms(nu: np.ndarray, nu_dot: np.ndarray, z_G: float) -> np.ndarray:
    """What a centre of gravity below the origin adds."""
    (u, v, w, p, q, r), (ud, vd, _, pd, qd, _) = nu, nu_dot
    return (m * z_G) * np.array(
        [p * r + qd, q * r - pd, -(p**2 + q**2), -(vd - w * p + u * r), ud - v * r + w * q, 0.0]
    )


@proof
@given(eulers, vectors(6, 2.0), vectors(6, 2.0), st.floats(-0.1, 0.1))
def test_corrected_31_is_the_full_model(euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray, z_B: float) -> None:
    tau = inverse_dynamics(parameters(0.0, z_B)[None], quaternion(euler)[None], nu[None], nu_dot[None])[0]
    scalar = corrected_31(euler, nu, nu_dot, -B * z_B)
    scale = 1.0 + np.abs(scalar).max()
    assert np.abs(tau - scalar).max() < 1e-12 * scale
    back = forward_dynamics(parameters(0.0, z_B)[None], quaternion(euler)[None], nu[None], scalar[None])[0]
    assert np.abs(back - nu_dot).max() < 1e-12 * scale


@proof
@given(eulers, vectors(6, 2.0), vectors(6, 2.0), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_with_a_low_centre_of_gravity(
    euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray, z_G: float, z_B: float
) -> None:
    tau = inverse_dynamics(parameters(z_G, z_B)[None], quaternion(euler)[None], nu[None], nu_dot[None])[0]
    scalar = corrected_31(euler, nu, nu_dot, B * (z_G - z_B)) + z_G_terms(nu, nu_dot, z_G)
    assert np.abs(tau - scalar).max() < 1e-12 * (1.0 + np.abs(scalar).max())


def acceleration(euler: list[float], nu: list[float]) -> np.ndarray:
    p = parameters(0.0, -0.05)
    return forward_dynamics(p[None], quaternion(euler)[None], np.array([nu]), np.zeros((1, 6)))[0]


def test_roll_and_pitch_return_like_a_pendulum() -> None:
    BG = 0.05 * B
    assert acceleration([0.1, 0.0, 0.0], [0.0] * 6)[3] == pytest.approx(-BG * np.sin(0.1) / (I_X - K_pdot), rel=1e-13)
    assert acceleration([0.0, 0.1, 0.0], [0.0] * 6)[4] == pytest.approx(-BG * np.sin(0.1) / (I_Y - M_qdot), rel=1e-13)


def test_munk_moment_of_the_whole_vehicle() -> None:
    rd = acceleration([0.0, 0.0, 0.0], [1.0, 0.1, 0.0, 0.0, 0.0, 0.0])[5]
    assert rd == pytest.approx((Y_vdot - X_udot) * 1.0 * 0.1 / (I_Z - N_rdot), rel=1e-13)
