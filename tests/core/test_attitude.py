"""Attitude: rotations are rotations, both descriptions agree, also looking straight up and straight down."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from towtank.core.attitude import (
    euler_from_quaternion,
    euler_rates_matrix,
    eulers_from_quaternions,
    gravity_direction,
    quaternion_from_euler,
    quaternion_product,
    quaternions_from_eulers,
    rotation_from_euler,
    rotation_from_quaternion,
    to_body,
)

from .independent import cross_matrix, quaternion, rates_to_omega, rotation, rotation_of, turn
from .proof import eulers, numbers, proof, vectors


def unit(q: np.ndarray) -> np.ndarray:
    n = np.linalg.norm(q)
    return q / n if n > 1e-3 else np.array([1.0, 0.0, 0.0, 0.0])


units = vectors(4, 1.0).map(unit)


@proof
@given(units)
def test_rotation_of_a_quaternion_is_in_so3(q: np.ndarray) -> None:
    R = rotation_from_quaternion(q)
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
    assert np.abs(R - rotation_of(q)).max() < 1e-14


@proof
@given(units, vectors(3))
def test_to_the_body_and_back_a_vector_is_itself(q: np.ndarray, v: np.ndarray) -> None:
    there = to_body(q, v)
    assert np.abs(rotation_from_quaternion(q) @ there - v).max() < 1e-13
    assert to_body(q, (float(v[0]), float(v[1]), float(v[2]))) == there


@proof
@given(units, units, vectors(3))
def test_product_of_quaternions_is_the_product_of_rotations(a: np.ndarray, b: np.ndarray, v: np.ndarray) -> None:
    ab = quaternion_product(a, b)
    together = rotation_from_quaternion(ab) @ v
    one_by_one = rotation_from_quaternion(a) @ (rotation_from_quaternion(b) @ v)
    assert np.abs(together - one_by_one).max() < 1e-13
    # The vector itself, turned by the sandwich a v a*.
    sandwich = quaternion_product(quaternion_product(a, np.append(0.0, v)), a * [1.0, -1.0, -1.0, -1.0])
    assert np.abs(sandwich[1:] - rotation_from_quaternion(a) @ v).max() < 1e-13


@proof
@given(vectors(3, 4.0))
def test_rotation_of_euler_angles_is_three_turns(euler: np.ndarray) -> None:
    R = rotation(euler)
    assert np.abs(rotation_from_euler(*euler) - R).max() < 1e-14
    q = np.array(quaternion_from_euler(*euler))
    assert np.abs(q - quaternion(euler)).max() < 1e-14
    assert np.abs(rotation_from_quaternion(q) - R).max() < 1e-14
    assert np.abs(Rotation.from_euler("ZYX", euler[::-1]).as_matrix() - R).max() < 1e-14


def test_signs_of_the_angles() -> None:
    """Bow up is positive pitch, starboard down is positive roll, bow to starboard is positive yaw (NED, FRD)."""
    bow, starboard = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    assert (rotation_from_euler(0.0, 0.1, 0.0) @ bow)[2] < 0
    assert (rotation_from_euler(0.1, 0.0, 0.0) @ starboard)[2] > 0
    assert (rotation_from_euler(0.0, 0.0, 0.1) @ bow)[1] > 0


@proof
@given(eulers)
def test_euler_angles_survive_the_way_through_quaternions(euler: np.ndarray) -> None:
    back = np.array(euler_from_quaternion(*quaternion_from_euler(*euler)))
    difference = (back - euler + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(difference).max() < 1e-13


@proof
@given(numbers(np.pi), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 12.0), numbers(np.pi))
def test_near_straight_up_and_down_the_rotation_survives(phi: float, sign: float, digits: float, psi: float) -> None:
    """At theta = +-pi/2 roll and yaw are not unique, but the attitude that they describe must stay the same."""
    theta = sign * (0.5 * np.pi - 10.0**-digits)
    back = euler_from_quaternion(*quaternion_from_euler(phi, theta, psi))
    assert np.abs(rotation(back) - rotation([phi, theta, psi])).max() < 1e-8
    assert abs(back[1] - theta) < 1e-8


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("gap", [0.0, 1e-16, 1e-12, 3e-10, 9e-10, 1.1e-9, 2e-9, 5e-9, 1e-8, 1e-7, 1e-6, 1e-4, 1e-2])
def test_straight_up_and_down_over_all_headings(sign: float, gap: float) -> None:
    angles = np.linspace(-3.0, 3.0, 13)
    euler = np.array([[phi, sign * (0.5 * np.pi - gap), psi] for phi in angles for psi in angles])
    back = eulers_from_quaternions(quaternions_from_eulers(euler))
    worst = max(np.abs(rotation(b) - rotation(e)).max() for b, e in zip(back, euler, strict=True))
    assert worst < 1e-8


@proof
@given(units)
def test_every_quaternion_has_euler_angles_in_their_ranges(q: np.ndarray) -> None:
    phi, theta, psi = euler_from_quaternion(*q)
    assert -np.pi <= phi <= np.pi
    assert -np.pi / 2 <= theta <= np.pi / 2
    assert -np.pi <= psi <= np.pi
    assert np.abs(rotation([phi, theta, psi]) - rotation_of(q)).max() < 1e-8


@proof
@given(eulers, vectors(3, 3.0))
def test_euler_rates_against_the_turning_rotation(euler: np.ndarray, omega: np.ndarray) -> None:
    """R(t) = R exp(S(omega) t): the angles read from it move at J2 omega (central differences)."""
    J2 = euler_rates_matrix(euler[0], euler[1])
    assert np.abs(J2 @ rates_to_omega(euler) - np.eye(3)).max() < 1e-12 / np.cos(euler[1])
    if abs(euler[1]) > 1.2:
        return
    S = cross_matrix(omega)

    def angles(t: float) -> np.ndarray:
        R = rotation(euler) @ expm(S * t)
        return np.array([np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0]), np.arctan2(R[1, 0], R[0, 0])])

    h = 1e-5
    moved = (angles(h) - angles(-h) + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(moved / (2 * h) - J2 @ omega).max() < 1e-6


@proof
@given(eulers)
def test_gravity_points_down(euler: np.ndarray) -> None:
    k = gravity_direction(np.array(quaternion_from_euler(*euler)))
    assert np.abs(rotation(euler) @ k - [0.0, 0.0, 1.0]).max() < 1e-14
    assert np.abs(k - turn(0, euler[0]).T @ turn(1, euler[1]).T @ [0.0, 0.0, 1.0]).max() < 1e-14


def test_array_forms_equal_the_scalar_forms_normalise_and_keep_nan() -> None:
    rng = np.random.default_rng(0)
    euler = rng.uniform([-3, -1.5, -3], [3, 1.5, 3], (20, 3))
    q = quaternions_from_eulers(euler)
    assert np.array_equal(q, [quaternion_from_euler(*e) for e in euler])
    assert np.abs(eulers_from_quaternions(q * rng.uniform(0.1, 9.0, (20, 1))) - euler).max() < 1e-13
    assert np.abs(eulers_from_quaternions(-q) - euler).max() < 1e-13
    euler[3, 1] = np.nan
    q = quaternions_from_eulers(euler)
    assert np.isnan(q[3]).all()
    assert np.isnan(eulers_from_quaternions(q)[3]).all()
    assert np.isfinite(np.delete(q, 3, axis=0)).all()
