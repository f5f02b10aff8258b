"""Inertia: the mass matrix from point masses, the Coriolis forces from momentum, from energy, and by their signs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from towtank.core.inertia import (
    bilinear_coriolis_into,
    coriolis_force,
    coriolis_matrix,
    rigid_body_mass,
    skew,
)

from .independent import (
    body,
    cross_matrix,
    derivative,
    moments,
    point_masses,
    rates_to_omega,
    rigid_mass,
    rotation,
)
from .proof import eulers, proof, seeds, symmetric, vectors


def size(M: np.ndarray, nu: np.ndarray) -> float:
    """Scale of the terms that must cancel; 1 where everything is small."""
    return 1.0 + float(np.abs(M).max() * (1.0 + np.abs(nu).max()) ** 3)


@proof
@given(vectors(3), vectors(3))
def test_skew_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    assert np.array_equal(skew(a), cross_matrix(a))
    assert np.abs(skew(a) @ b - np.cross(a, b)).max() < 1e-13


@proof
@given(seeds, vectors(6))
def test_mass_matrix_holds_the_kinetic_energy_and_the_momenta_of_point_masses(seed: int, nu: np.ndarray) -> None:
    masses, places = point_masses(np.random.default_rng(seed))
    M = rigid_body_mass(*moments(masses, places))
    speeds = nu[:3] + np.cross(nu[3:], places)
    energy = 0.5 * masses @ (speeds**2).sum(axis=1)
    momentum = masses @ speeds
    spin = masses @ np.cross(places, speeds)
    assert 0.5 * nu @ M @ nu == pytest.approx(energy, rel=1e-12, abs=1e-12)
    assert np.abs(M @ nu - np.concatenate([momentum, spin])).max() < 1e-12 * size(M, nu)
    assert np.abs(M - rigid_mass(masses, places)).max() < 1e-13
    assert np.array_equal(M, M.T)


@proof
@given(symmetric(), vectors(6))
def test_coriolis_matrix_is_skew_and_does_no_work(M: np.ndarray, nu: np.ndarray) -> None:
    C = coriolis_matrix(M, nu)
    assert np.array_equal(C, -C.T)
    assert abs(nu @ C @ nu) <= 1e-12 * size(M, nu)
    assert abs(nu @ coriolis_force(M, nu)) <= 1e-12 * size(M, nu)
    assert np.abs(C @ nu - coriolis_force(M, nu)).max() <= 1e-12 * size(M, nu)


@proof
@given(symmetric(), vectors(6, 3.0), vectors(6, 3.0), eulers, vectors(3))
def test_coriolis_force_is_what_momentum_conservation_demands(
    M: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray, euler: np.ndarray, x: np.ndarray
) -> None:
    """Linear and angular momentum in the inertial frame, differentiated in time along an arbitrary motion.

    The moment is taken about the place where the body origin is now, which stays put while the body moves on.
    """
    R0, S = rotation(euler), cross_matrix(nu[3:])
    S_dot = cross_matrix(nu_dot[3:])

    def momenta(t: complex) -> np.ndarray:
        R = R0 @ (np.eye(3) + S * t + 0.5 * (S @ S + S_dot) * t**2)
        moved = R0 @ nu[:3] * t
        h = M @ (nu + nu_dot * t)
        return np.concatenate([R @ h[:3], np.cross(moved, R @ h[:3]) + R @ h[3:]])

    rate = derivative(momenta)
    wrench = np.concatenate([R0.T @ rate[:3], R0.T @ rate[3:]])
    assert np.abs(M @ nu_dot + coriolis_force(M, nu) - wrench).max() <= 1e-12 * size(M, nu)


@proof
@given(seeds, vectors(3, 1.2), vectors(6, 2.0), vectors(6, 2.0))
def test_coriolis_force_by_lagrange(seed: int, euler: np.ndarray, rates: np.ndarray, speedup: np.ndarray) -> None:
    """d/dt dT/d(eta_dot) - dT/d(eta) = Q with T = nu^T M nu / 2, Q . eta_dot = tau . nu: energy alone, no frames."""
    M = body(seed).M
    eta = np.concatenate([np.zeros(3), euler])

    def velocity_map(eta: np.ndarray) -> np.ndarray:
        """nu = V(eta) eta_dot."""
        V = np.zeros((6, 6), dtype=eta.dtype)
        V[:3, :3] = rotation(eta[3:]).T
        V[3:, 3:] = rates_to_omega(eta[3:])
        return V

    def momentum(t: complex) -> np.ndarray:
        V = velocity_map(eta + rates * t + 0.5 * speedup * t**2)
        return V.T @ M @ V @ (rates + speedup * t)

    def energy(step: complex, i: int) -> complex:
        nu = velocity_map(eta + step * np.eye(6)[i]) @ rates
        return 0.5 * nu @ M @ nu

    def velocity(t: complex) -> np.ndarray:
        return velocity_map(eta + rates * t + 0.5 * speedup * t**2) @ (rates + speedup * t)

    Q = derivative(momentum) - [derivative(lambda s, i=i: energy(s, i)) for i in range(6)]
    tau = np.linalg.solve(velocity_map(eta).T, Q)
    nu, nu_dot = velocity(0.0), derivative(velocity)
    assert np.abs(M @ nu_dot + coriolis_force(M, nu) - tau).max() <= 1e-11 * size(M, nu)


@proof
@given(symmetric(), vectors(6), vectors(6), vectors(6), st.floats(-3.0, 3.0))
def test_bilinear_form_is_linear_in_both_velocities(
    M: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, k: float
) -> None:
    def form(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        out = np.full(6, np.nan)
        bilinear_coriolis_into(M, x, y, out)
        return out

    scale = size(M, np.concatenate([a, b, c])) * (1.0 + abs(k))
    assert np.abs(form(a + k * c, b) - form(a, b) - k * form(c, b)).max() <= 1e-12 * scale
    assert np.abs(form(a, b + k * c) - form(a, b) - k * form(a, c)).max() <= 1e-12 * scale
    assert np.abs(form(a, a) - coriolis_force(M, a)).max() <= 1e-12 * scale
    assert abs(a @ form(a, b)) <= 1e-12 * scale


def test_rigid_body_forces_are_those_on_spinning_point_masses() -> None:
    """A body spinning steadily about its origin: every point needs the centripetal force m omega x (omega x r)."""
    masses, places = point_masses(np.random.default_rng(5))
    omega = np.array([0.7, -1.1, 0.4])
    pulls = masses[:, None] * np.cross(omega, np.cross(omega, places))
    wrench = np.concatenate([pulls.sum(axis=0), np.cross(places, pulls).sum(axis=0)])
    nu = np.concatenate([np.zeros(3), omega])
    assert np.abs(coriolis_force(rigid_body_mass(*moments(masses, places)), nu) - wrench).max() < 1e-13


def test_munk_moment_turns_a_slender_body_broadside() -> None:
    """Surge 1 m/s, sway 0.1 m/s: N = (Y_vdot - X_udot) u v on the right-hand side, bow away from the flow."""
    X_udot, Y_vdot = -2.0, -20.0
    M_A = np.diag([-X_udot, -Y_vdot, 20.0, 0.1, 1.0, 1.0])
    N = -coriolis_force(M_A, np.array([1.0, 0.1, 0.0, 0.0, 0.0, 0.0]))[5]
    assert pytest.approx((Y_vdot - X_udot) * 1.0 * 0.1, abs=1e-15) == N
    # The flow comes from starboard of the bow; the moment turns the bow to port and so enlarges the angle.
    assert N < 0.0
    # The same by energy: at constant momentum in the water, energy h^2 / 2M falls as the body turns broadside.
    h = M_A[:2, :2] @ [1.0, 0.1]

    def energy(angle: complex) -> complex:
        R = expm(-cross_matrix(np.array([0.0, 0.0, 1.0])) * angle)[:2, :2]
        return 0.5 * (R @ h) @ np.linalg.inv(M_A[:2, :2]) @ (R @ h)

    assert -derivative(energy) == pytest.approx(N, abs=1e-14)
