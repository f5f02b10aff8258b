"""Restoring: the gradient of potential energy, Fossen's printed form, lever arms, and what rights a vehicle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from towtank.core.attitude import gravity_direction, quaternion_from_euler
from towtank.core.forces import restoring_wrench
from towtank.core.layout import I_CONSTANT, I_MOMENT, I_WEIGHT, N_PARAMETERS

from .independent import Body, derivative, rates_to_omega, rotation
from .proof import eulers, numbers, proof, vectors


def wrench(W: float, B: float, r_G: np.ndarray, r_B: np.ndarray, euler: np.ndarray) -> np.ndarray:
    k = gravity_direction(np.array(quaternion_from_euler(*euler)))
    p = np.zeros(N_PARAMETERS)
    p[I_WEIGHT], p[I_MOMENT:I_CONSTANT] = W - B, W * r_G - B * r_B
    return restoring_wrench(p, k)


def body(W: float, B: float, r_G: np.ndarray, r_B: np.ndarray) -> Body:
    none = np.zeros((6, 6))
    return Body(none, none, none, none, W, B, r_G, r_B)


weights = numbers(500.0).map(abs)
centres = vectors(3, 1.0)


@proof
@given(weights, weights, centres, centres, eulers)
def test_gradient_of_the_potential_energy(
    W: float, B: float, r_G: np.ndarray, r_B: np.ndarray, euler: np.ndarray
) -> None:
    """g . nu = dU/dt for every nu: g = V^-T dU/d(eta) with nu = V eta_dot."""
    potential = body(W, B, r_G, r_B).potential
    eta = np.concatenate([np.zeros(3), euler])
    slope = np.array([derivative(lambda s, i=i: potential(eta + s * np.eye(6)[i])) for i in range(6)])
    force = rotation(euler).T @ slope[:3]
    moment = np.linalg.solve(rates_to_omega(euler).T, slope[3:])
    g = wrench(W, B, r_G, r_B, euler)
    scale = 1.0 + W + B
    assert np.abs(g[:3] - force).max() < 1e-13 * scale
    assert np.abs(g[3:] - moment).max() < 1e-13 * scale / np.cos(euler[1])


@proof
@given(weights, weights, centres, centres, eulers)
def test_forces_and_lever_arms(W: float, B: float, r_G: np.ndarray, r_B: np.ndarray, euler: np.ndarray) -> None:
    g = wrench(W, B, r_G, r_B, euler)
    assert np.abs(g + body(W, B, r_G, r_B).gravity(rotation(euler))).max() < 1e-13 * (1.0 + W + B)


@proof
@given(weights, weights, centres, centres, eulers)
def test_equation_18_of_the_paper_as_printed(
    W: float, B: float, r_G: np.ndarray, r_B: np.ndarray, euler: np.ndarray
) -> None:
    (xG, yG, zG), (xB, yB, zB), (phi, theta, _) = r_G, r_B, euler
    c, s = np.cos, np.sin
    printed = [
        (W - B) * s(theta),
        -(W - B) * c(theta) * s(phi),
        -(W - B) * c(theta) * c(phi),
        -(yG * W - yB * B) * c(theta) * c(phi) + (zG * W - zB * B) * c(theta) * s(phi),
        (zG * W - zB * B) * s(theta) + (xG * W - xB * B) * c(theta) * c(phi),
        -(xG * W - xB * B) * c(theta) * s(phi) - (yG * W - yB * B) * s(theta),
    ]
    assert np.abs(wrench(W, B, r_G, r_B, euler) - printed).max() < 1e-13 * (1.0 + W + B)


def test_buoyancy_above_weight_rights_the_vehicle() -> None:
    """Starboard down (phi > 0) must give a moment to port (K < 0), bow up (theta > 0) a moment down (M < 0)."""
    W, dz = 200.0, 0.05
    r_G, r_B = np.array([0.0, 0.0, dz]), np.zeros(3)
    on_vehicle = -wrench(W, W, r_G, r_B, np.array([0.2, 0.0, 1.0]))
    assert on_vehicle[3] == pytest.approx(-W * dz * np.sin(0.2), rel=1e-14)
    on_vehicle = -wrench(W, W, r_G, r_B, np.array([0.0, 0.2, 1.0]))
    assert on_vehicle[4] == pytest.approx(-W * dz * np.sin(0.2), rel=1e-14)


def test_a_heavy_vehicle_sinks_and_a_tail_heavy_one_lifts_its_bow() -> None:
    level = np.zeros(3)
    assert -wrench(210.0, 200.0, level, level, level)[2] == pytest.approx(10.0)
    assert -wrench(200.0, 200.0, np.array([-0.1, 0.0, 0.0]), level, level)[4] == pytest.approx(20.0)
