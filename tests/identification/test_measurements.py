"""The table of sensors: what each shows, and that H is the derivative of it by every error of the state."""

from __future__ import annotations

import inspect
import math

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import euler_from_quaternion, rotation_from_euler, rotation_from_quaternion
from towtank.core.rk4 import simulate_run
from towtank.identification import Learner
from towtank.identification.data.samples import N_MEASURED, NoiseLevels
from towtank.identification.kalman.state import N_BIASES, N_WAVES, FilterSettings, JointState, new_joint_state
from towtank.identification.kalman.update import expect, inject
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
    pace_of,
    residual_of,
    rotation_between,
    specific_force,
    specific_force_row_into,
    unit_error,
)
from towtank.identification.model.parameters import LATENCIES, N_FIXED, free_parameters
from towtank.recording.standard import MEASURED, SAMPLE, STANDARD, TRIPLES
from towtank.vehicle import load_vehicle

STEP = 1e-6
NO_BIAS = np.zeros(N_BIASES)
GENERATOR = np.random.default_rng(7)
OTHERS = [sensor for sensor in range(N_SENSORS) if sensor != SPECIFIC_FORCE]


def a_state() -> Array:
    q = np.array([0.8, 0.3, -0.2, 0.45])
    return np.concatenate([[1.0, -2.0, 3.0], q / np.linalg.norm(q), [0.6, -0.3, 0.2, 0.3, -0.5, 0.4]])


def moved(x: Array, current: Array, errors: Array) -> tuple[Array, Array]:
    """State and current with errors (N,) put in."""
    out = x.copy()
    out[:3] += errors[:3]
    out[7:13] += errors[6:12]
    turn_by(out, errors[3], errors[4], errors[5])
    return out, current + errors[18:21]


def shown(x: Array, current: Array, sensor: int, k: int, whole: bool) -> float:
    """What number k of a sensor shows, measured from a row of zeros; angles about those of the state."""
    z = np.zeros(N_MEASURED)
    if sensor == ATTITUDE:
        z[3:6] = euler_from_quaternion(*a_state()[3:7])
    return -residual_of(z, x, current, NO_BIAS, sensor, k, whole)


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("k", range(3))
@pytest.mark.parametrize("sensor", OTHERS, ids=[SENSORS[i].name for i in OTHERS])
def test_h_is_the_derivative_of_what_a_sensor_shows(sensor: int, k: int, whole: bool) -> None:
    x, current = a_state(), np.array([0.2, -0.1, 0.05])
    size = N_FIXED + 2
    h = np.zeros(size)
    measurement_row_into(x, current, True, sensor, k, whole, h)
    differences = np.zeros(size)
    for j in range(size):
        errors = np.zeros(size)
        errors[j] = STEP
        above = shown(*moved(x, current, errors), sensor, k, whole)
        below = shown(*moved(x, current, -errors), sensor, k, whole)
        differences[j] = (above - below) / (2.0 * STEP)
    np.testing.assert_allclose(h, differences, atol=1e-8)


def a_filter() -> JointState:
    """A filter in motion, with a current, waves, biases, and a latency of every sensor that may have one."""
    vehicle = load_vehicle("vlbv300")
    free = free_parameters(vehicle, ("X_uu", *(LATENCIES[sensor] for sensor in OTHERS)))
    levels = NoiseLevels(np.full(N_MEASURED, 0.01), np.ones(6), np.zeros(6), np.full(3, 0.1))
    settings = FilterSettings(biases=True, wanders=True, current=True)
    n, B = len(free), np.zeros((6, 1))
    state = new_joint_state(np.array(vehicle.parameters), free, np.full(n, 0.05), np.ones(n), B, levels, settings)
    state.x[:] = a_state()
    state.current[:], state.wave[:] = [0.2, -0.1, 0.05], [0.04, 0.03, -0.02, 0.1, 0.1, 0.1]
    state.bias[:6], state.rate[:] = 0.1 * GENERATOR.standard_normal(6), GENERATOR.standard_normal(6)
    inject(state)
    return state


@pytest.mark.parametrize("off", [0.0, 1.2])
def test_a_heading_that_is_off_turns_the_attitude_about_the_vertical_whatever_way_it_leans(off: float) -> None:
    """By however much, and the heading alone by as much."""
    state, z = a_filter(), np.zeros(N_MEASURED)
    bias = np.append(np.zeros(8), off)
    phi, theta, psi = euler_from_quaternion(*state.x[3:7])
    z[3:6] = phi, theta, psi + off + 0.01
    turned = [residual_of(z, state.x, state.water, bias, ATTITUDE, k, True) for k in range(3)]
    down = rotation_from_quaternion(state.x[3:7]).T @ [0.0, 0.0, 0.01]
    np.testing.assert_allclose(turned, down, atol=1e-12)
    assert residual_of(z, state.x, state.water, bias, ATTITUDE, 2, False) == pytest.approx(0.01)
    expect(state, z, ATTITUDE, False)
    column = N_FIXED + state.theta.size + 8
    assert state.H[:, column].tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize("k", range(3))
@pytest.mark.parametrize("sensor", OTHERS, ids=[SENSORS[i].name for i in OTHERS])
def test_the_filter_s_row_is_the_derivative_by_biases_latency_and_waves_too(sensor: int, k: int) -> None:
    state, z = a_filter(), np.zeros(N_MEASURED)
    z[3:6] = euler_from_quaternion(*state.x[3:7])
    size = state.P.shape[0]
    assert size == N_FIXED + state.theta.size + N_BIASES + N_WAVES
    expect(state, z, sensor, True)
    h = state.H[k].copy()
    differences = np.zeros(size)
    for j in range(size):
        ends = []
        for sign in (1.0, -1.0):
            other = a_filter()
            other.bias[:], other.rate[:] = state.bias, state.rate
            other.dx[j] = sign * STEP
            inject(other)
            expect(other, z, sensor, True)
            ends.append(-other.innovation[k])
        differences[j] = (ends[0] - ends[1]) / (2.0 * STEP)
    np.testing.assert_allclose(h, differences, atol=1e-8)
    assert h[N_FIXED + state.latency[sensor]] != 0.0
    assert np.count_nonzero(h[N_FIXED : N_FIXED + state.theta.size]) == 1


def test_a_sensor_that_is_late_shows_what_was() -> None:
    """Of a latency known beside the one that rows were moved by, the rest is expected by the pace of the sensor."""
    state, z = a_filter(), np.zeros(N_MEASURED)
    expect(state, z, VELOCITY, True)
    on_time = state.innovation[0]
    state.theta[state.latency[VELOCITY]] += 0.02
    expect(state, z, VELOCITY, True)
    assert state.innovation[0] - on_time == pytest.approx(0.02 * pace_of(state.x, state.water, state.rate, VELOCITY, 0))


@pytest.mark.parametrize("sensor", OTHERS, ids=[SENSORS[i].name for i in OTHERS])
def test_the_pace_is_the_derivative_by_time_of_what_a_sensor_shows_in_a_current(sensor: int) -> None:
    p, current, step = np.array(load_vehicle("vlbv300").parameters), np.array([0.2, -0.15, 0.05]), 1e-4
    push = np.array([30.0, -20.0, 15.0, 3.0, -2.0, 4.0])

    def along(x: Array, h: float) -> Array:
        ground = x.copy()
        ground[7:10] += rotation_from_quaternion(x[3:7]).T @ current
        out = simulate_run(p, ground, push.reshape(1, 1, 6), h, current)[-1]
        out[7:10] -= rotation_from_quaternion(out[3:7]).T @ current
        return out

    before = a_state()
    x = along(before, step)
    after = along(x, step)
    rate = (after - before) / (2.0 * step)
    z = np.zeros(N_MEASURED)
    z[3:6] = euler_from_quaternion(*x[3:7])
    for k in range(3):
        ends = [residual_of(z, each, current, NO_BIAS, sensor, k, True) for each in (before, after)]
        pace = pace_of(x, current, rate[7:], sensor, k)
        assert pace == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-5)
        assert abs(pace) > 1e-2


@pytest.mark.parametrize("k", range(3))
def test_the_row_of_the_specific_force_is_its_derivative(k: int) -> None:
    x, rate, n = a_state(), GENERATOR.standard_normal(13), 3
    A = GENERATOR.standard_normal((12, N_FIXED + n))  # of the rates of velocity by everything
    h = np.zeros(N_FIXED + n)
    specific_force_row_into(x, A, k, h)
    nothing = np.zeros(3)
    for j in range(12):
        errors = np.zeros(N_FIXED)
        errors[j] = STEP
        above, below = (moved(x, nothing, sign * errors)[0] for sign in (1.0, -1.0))
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
            h = np.zeros(N_FIXED)
            measurement_row_into(x, water, False, sensor, k, True, h)
            expected = np.zeros_like(h)
            expected[unit_error(sensor, k, True)] = 1.0
            np.testing.assert_array_equal(h, expected)
    assert unit_error(ATTITUDE, 0, False) == unit_error(SPECIFIC_FORCE, 0, True) == -1


def test_over_ground_and_through_the_water_differ_by_the_current_in_the_body() -> None:
    x, current, bias = a_state(), np.array([0.3, -0.2, 0.1]), NO_BIAS
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
    assert len(SENSORS) == len(TRIPLES)
    assert len(MEASURED) == N_MEASURED == len(TYPICAL_NOISE) == len(LEAST_NOISE)
    assert all(set(columns) <= set(STANDARD) and len(columns) == 3 for columns in TRIPLES)
    assert all(0.0 < least < typical for least, typical in zip(LEAST_NOISE, TYPICAL_NOISE, strict=True))
    assert all(math.isinf(sensor.longest_outage) or not sensor.offset_stays for sensor in SENSORS)
    assert all(math.isinf(sensor.reacquire) for sensor in SENSORS if sensor.first_error < 0)


def test_the_arguments_of_a_sample_one_after_the_other_are_a_row() -> None:
    assert tuple(name for names in SAMPLE.values() for name in names) == MEASURED
    assert set(SAMPLE) < set(inspect.signature(Learner.update).parameters)
