"""The table of sensors: what each shows, and that H is the derivative of it by every error of the state."""

from __future__ import annotations

import math

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import euler_from_quaternion, rotation_from_euler
from towtank.identification.data.samples import N_MEASURED
from towtank.identification.model.linearisation import turn_by
from towtank.identification.model.measurements import (
    ATTITUDE,
    LEAST_NOISE,
    N_SENSORS,
    SENSORS,
    SPECIFIC_FORCE,
    TYPICAL_NOISE,
    VELOCITY,
    WATER_VELOCITY,
    attitude_error,
    measurement_row_into,
    residual_of,
    rotation_between,
    specific_force,
    specific_force_row_into,
    unit_error,
)
from towtank.identification.model.parameters import N_FIXED
from towtank.recording.standard import MEASURED

STEP = 1e-6
BIASES = 6
GENERATOR = np.random.default_rng(7)
OTHERS = [sensor for sensor in range(N_SENSORS) if sensor != SPECIFIC_FORCE]


def a_state() -> Array:
    q = np.array([0.8, 0.3, -0.2, 0.45])
    return np.concatenate([[1.0, -2.0, 3.0], q / np.linalg.norm(q), [0.6, -0.3, 0.2, 0.3, -0.5, 0.4]])


def moved(x: Array, current: Array, bias: Array, errors: Array) -> tuple[Array, Array, Array]:
    """State, current and biases with errors (N,) put in."""
    out = x.copy()
    out[:3] += errors[:3]
    out[7:13] += errors[6:12]
    turn_by(out, errors[3], errors[4], errors[5])
    return out, current + errors[18:21], bias + errors[-BIASES:]


def shown(x: Array, current: Array, bias: Array, sensor: int, k: int, whole: bool) -> float:
    """What number k of a sensor shows, measured from a row of zeros; angles about those of the state."""
    z = np.zeros(N_MEASURED)
    if sensor == ATTITUDE:
        z[3:6] = euler_from_quaternion(*a_state()[3:7])
    return -residual_of(z, x, current, bias, sensor, k, whole)


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("k", range(3))
@pytest.mark.parametrize("sensor", OTHERS, ids=[SENSORS[i].name for i in OTHERS])
def test_h_is_the_derivative_of_what_a_sensor_shows(sensor: int, k: int, whole: bool) -> None:
    x, current, bias = a_state(), np.array([0.2, -0.1, 0.05]), np.array([0.01, -0.02, 0.03, 0.1, 0.0, -0.1])
    size = N_FIXED + 2 + BIASES
    h = np.zeros(size)
    measurement_row_into(x, current, True, True, sensor, k, whole, h)
    differences = np.zeros(size)
    for j in range(size):
        errors = np.zeros(size)
        errors[j] = STEP
        above = shown(*moved(x, current, bias, errors), sensor, k, whole)
        below = shown(*moved(x, current, bias, -errors), sensor, k, whole)
        differences[j] = (above - below) / (2.0 * STEP)
    np.testing.assert_allclose(h, differences, atol=1e-8)


@pytest.mark.parametrize("k", range(3))
def test_the_row_of_the_specific_force_is_its_derivative(k: int) -> None:
    x, rate, n = a_state(), GENERATOR.standard_normal(13), 3
    A = GENERATOR.standard_normal((12, N_FIXED + n))  # of the rates of velocity by everything
    h = np.zeros(N_FIXED + n + BIASES)
    specific_force_row_into(x, A, k, h)
    nothing = np.zeros(3)
    for j in range(12):
        errors = np.zeros(N_FIXED + BIASES)
        errors[j] = STEP
        above, below = (moved(x, nothing, np.zeros(6), sign * errors)[0] for sign in (1.0, -1.0))
        difference = (specific_force(above, rate, k) - specific_force(below, rate, k)) / (2.0 * STEP)
        assert h[j] == pytest.approx(A[6 + k, j] + difference, abs=1e-8)
    np.testing.assert_array_equal(h[12 : N_FIXED + n], A[6 + k, 12:])


def test_at_rest_an_accelerometer_shows_minus_gravity() -> None:
    x = np.zeros(13)
    x[3] = 1.0
    assert [specific_force(x, np.zeros(13), k) for k in range(3)] == pytest.approx([0.0, 0.0, -9.81])


def test_a_row_of_h_of_one_number_is_a_unit_vector_where_it_says_so() -> None:
    x, water = a_state(), np.zeros(3)
    for sensor in OTHERS:
        for k in range(3):
            h = np.zeros(N_FIXED + BIASES)
            measurement_row_into(x, water, False, False, sensor, k, True, h)
            expected = np.zeros_like(h)
            expected[unit_error(sensor, k, True)] = 1.0
            np.testing.assert_array_equal(h, expected)
    assert unit_error(ATTITUDE, 0, False) == unit_error(SPECIFIC_FORCE, 0, True) == -1


def test_over_ground_and_through_the_water_differ_by_the_current_in_the_body() -> None:
    x, current, bias = a_state(), np.array([0.3, -0.2, 0.1]), np.zeros(6)
    z = np.zeros(N_MEASURED)
    over_ground = [-residual_of(z, x, current, bias, VELOCITY, k, True) for k in range(3)]
    through = [-residual_of(z, x, current, bias, WATER_VELOCITY, k, True) for k in range(3)]
    turned = rotation_from_euler(*euler_from_quaternion(*x[3:7])).T @ current
    np.testing.assert_allclose(np.subtract(over_ground, through), turned, atol=1e-12)


def test_the_rotation_to_a_measured_attitude_is_the_shorter_one() -> None:
    x = a_state()
    angles = euler_from_quaternion(*x[3:7])
    turned = x.copy()
    turn_by(turned, 0.02, -0.01, 0.03)
    error = attitude_error(x[3:7], *euler_from_quaternion(*turned[3:7]))
    assert error == pytest.approx((0.02, -0.01, 0.03), abs=1e-9)
    assert rotation_between(x[3:7], *(-turned[3:7])) == pytest.approx((0.02, -0.01, 0.03), abs=1e-9)
    assert attitude_error(x[3:7], *angles) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_the_table_has_a_row_for_every_column_of_a_recording() -> None:
    assert tuple(name for sensor in SENSORS for name in sensor.columns) == MEASURED
    assert len(MEASURED) == N_MEASURED == len(TYPICAL_NOISE) == len(LEAST_NOISE)
    assert all(len(sensor.columns) == 3 for sensor in SENSORS)
    assert all(0.0 < sensor.least < sensor.typical for sensor in SENSORS)
    assert all(math.isinf(sensor.longest_outage) or not sensor.offset_stays for sensor in SENSORS)
