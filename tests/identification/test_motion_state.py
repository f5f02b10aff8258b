"""Velocity and gravity direction from poses, gyros and accelerometers, beside motions known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.attitude import euler_rates_matrix, rotation_from_euler
from towtank.identification.least_squares.velocity import (
    ABSENT,
    ATTITUDE_ACCELEROMETER,
    ATTITUDE_GYRO,
    ATTITUDE_MEASURED,
    DERIVED,
    MEASURED,
    Motion,
    motion_step,
    new_motion,
)

ALL_DERIVED = np.full(6, DERIVED)
ALL_MEASURED = np.full(6, MEASURED)
NOTHING3, NOTHING6, STILL = np.full(3, np.nan), np.full(6, np.nan), np.zeros(6)
OPEN = 1e9  # rad/s: a corner so high that the low-passes pass everything


def pose(t: float) -> np.ndarray:
    """A tumbling path: roll through a full turn, pitch to 1 rad, yaw on and on."""
    return np.array([np.sin(t), 2 * np.cos(0.7 * t), 0.3 * t, 1.7 * t, np.sin(0.9 * t), 2.0 + 1.1 * t])


def velocity(t: float) -> np.ndarray:
    e = 1e-5
    rate = (pose(t - 2 * e) - 8 * pose(t - e) + 8 * pose(t + e) - pose(t + 2 * e)) / (12 * e)
    phi, theta, psi = pose(t)[3:]
    linear = rotation_from_euler(phi, theta, psi).T @ rate[:3]
    return np.concatenate([linear, np.linalg.solve(euler_rates_matrix(phi, theta), rate[3:])])


def gravity(t: float) -> np.ndarray:
    phi, theta, _ = pose(t)[3:]
    return np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])


def wrapped(p: np.ndarray) -> np.ndarray:
    """The same pose with its angles within half a turn, as sensors tell them."""
    out = p.copy()
    out[3:] = (p[3:] + np.pi) % (2 * np.pi) - np.pi
    return out


def step(m: Motion, t: float, p: np.ndarray = NOTHING6, v: np.ndarray = NOTHING6, a: np.ndarray = NOTHING3) -> float:
    return motion_step(m, t, p, v, a, STILL)


def worst(h: float) -> float:
    m = new_motion(ALL_DERIVED, ATTITUDE_MEASURED, OPEN, 0.5)
    error = 0.0
    for k in range(round(4.0 / h)):
        t = k * h
        if step(m, t, wrapped(pose(t))) > 0.0:
            error = max(error, float(np.abs(m.nu[1] - velocity(t - 0.5 * h)).max()))
    return error


def test_derived_velocity_is_of_second_order_through_full_turns() -> None:
    coarse, fine = worst(0.02), worst(0.01)
    assert fine < 1e-4
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


def test_the_low_passes_are_two_first_order_ones_on_motion_gravity_and_wrench_alike() -> None:
    corner, h = 8.0, 0.01
    m = new_motion(ALL_DERIVED, ATTITUDE_MEASURED, corner, 0.5)
    low = np.zeros((2, 3))
    for k in range(400):
        t = k * h
        push = np.array([np.sin(t), 0.0, 0.0, 0.0, 0.0, np.cos(3 * t)])
        used = motion_step(m, t, np.array([0.1 * t * t, 0, 0, 0, 0, 0]), NOTHING6, NOTHING3, push * h)
        if k == 0:
            continue
        mean = np.array([0.1 * (2 * t - h), push[0], push[5]])
        gain = 1.0 - np.exp(-corner * h)
        if k == 1:
            low[:] = mean
        else:
            low[0] += gain * (mean - low[0])
            low[1] += gain * (low[0] - low[1])
        assert np.allclose([m.nu[1, 0], m.wrench[1, 0], m.wrench[1, 5]], low[1], atol=1e-12)
        assert np.allclose(m.k[1], [0, 0, 1])
        assert (used > 0.0) == (k >= 2 + 10 / (corner * h))


def test_measured_velocity_is_taken_as_it_is_and_used_at_once() -> None:
    m = new_motion(ALL_MEASURED, ATTITUDE_MEASURED, 25.0, 0.5)
    assert step(m, 0.0, wrapped(pose(0.0)), velocity(0.0)) == 0.0
    assert step(m, 0.1, wrapped(pose(0.1)), velocity(0.1)) == pytest.approx(0.1)
    assert np.array_equal(m.nu, [velocity(0.0), velocity(0.1)])
    assert np.allclose(m.k, [gravity(0.0), gravity(0.1)], atol=1e-14)


@pytest.mark.parametrize("attitude", [ATTITUDE_ACCELEROMETER, ATTITUDE_GYRO])
def test_gravity_follows_the_gyros(attitude: float) -> None:
    source = np.array([ABSENT] * 3 + [MEASURED] * 3)
    m = new_motion(source, attitude, 25.0, 0.5)
    for k in range(3001):
        t = 0.001 * k
        assert step(m, t, v=velocity(t), a=-9.81 * gravity(t)) >= 0.0
        # The gyros alone are pulled to level at 0.05 1/s, so they agree for a while only.
        limit = 3e-3 if attitude == ATTITUDE_ACCELEROMETER else 0.06 * t + 1e-4
        assert np.abs(m.k[1] - gravity(t)).max() < limit
        assert np.linalg.norm(m.k[1]) == pytest.approx(1.0, abs=1e-12)


def test_the_accelerometer_takes_out_a_wrong_start_slowly() -> None:
    m = new_motion(np.array([ABSENT] * 3 + [MEASURED] * 3), ATTITUDE_ACCELEROMETER, 25.0, 0.5)
    still = np.zeros(6)
    step(m, 0.0, v=still, a=np.array([0.0, -9.81 * np.sin(0.5), -9.81 * np.cos(0.5)]))
    assert np.arctan2(m.k[1, 1], m.k[1, 2]) == pytest.approx(0.5)
    for k in range(1, 501):
        step(m, 0.01 * k, v=still, a=np.array([0.0, 0.0, -9.81]))
    assert np.arctan2(m.k[1, 1], m.k[1, 2]) == pytest.approx(0.5 * np.exp(-0.2 * 5.0), rel=0.02)


def test_a_gap_begins_a_new_stretch() -> None:
    m = new_motion(ALL_MEASURED, ATTITUDE_MEASURED, 25.0, 0.5)
    flat, still = np.zeros(6), np.zeros(6)
    assert [step(m, t, flat, still) > 0 for t in (0.0, 0.1, 0.6, 1.2, 1.3)] == [False, True, True, False, True]
    assert m.counts.starts[0] == 2


def test_a_row_that_lacks_something_is_passed_over_and_the_next_interval_is_longer() -> None:
    m = new_motion(ALL_MEASURED, ATTITUDE_MEASURED, 25.0, 0.5)
    flat, still = np.zeros(6), np.zeros(6)
    step(m, 0.0, flat, still)
    for hole in (np.array([0, np.nan, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0, np.inf])):
        assert step(m, 0.1, flat, hole) == -1.0
    assert step(m, 0.1, np.array([0, 0, 0, np.nan, 0, 0]), still) == -1.0
    assert step(m, 0.0, flat, still) == -1.0  # the same time again
    assert step(m, -1.0, flat, still) == -1.0  # an earlier one
    assert step(m, 0.2, flat, still) == pytest.approx(0.2)


def test_a_sensor_that_dies_silences_its_own_axis_alone() -> None:
    m = new_motion(ALL_MEASURED, ATTITUDE_MEASURED, 25.0, 0.5)
    flat, dead = np.zeros(6), np.array([0, np.nan, 0, 0, 0, 0])
    used = [step(m, 0.1 * k, flat, np.zeros(6) if k < 20 or k >= 40 else dead) for k in range(60)]
    assert min(used[1:20]) > 0.0
    assert used[20:24] == [-1.0] * 4  # waited for
    assert min(u for k, u in enumerate(used) if k > 25 and k != 25) > 0.0
    assert m.valid[1, 1] == 1.0
    m.valid[:] = 0.0
    step(m, 7.0, flat, dead)
    assert m.valid[1].tolist() == [1.0, 0.0, 1.0, 1.0, 1.0, 1.0]


def test_marker_jumps_are_cut_and_counted_and_quick_motion_is_not() -> None:
    rng = np.random.default_rng(8)
    m = new_motion(ALL_DERIVED, ATTITUDE_MEASURED, 25.0, 0.5)
    worst_error = 0.0
    for k in range(2000):
        t = 0.01 * k
        p = np.array([np.sin(t), 0, 0, 0, 0, 0.5 * np.sin(1.5 * t)])
        p[:3] += 1e-3 * rng.standard_normal(3)
        if 1000 <= k < 1030:
            p[:3] += [0.05, -0.04, 0.03]  # hidden for 0.3 s: it jumps away and back
        step(m, t, p)
        if k > 100:
            worst_error = max(worst_error, abs(m.nu[1, 0] - np.cos(t - 0.08) * np.cos(p[5])))
    assert m.counts.jumps[0] == 6
    assert worst_error < 0.15  # uncut it would be 5 m/s for a sample and 0.6 m/s after the low-passes


def test_the_other_position_is_needed_too_where_velocity_is_derived() -> None:
    source = np.array([DERIVED, DERIVED, MEASURED, MEASURED, MEASURED, MEASURED])
    m = new_motion(source, ATTITUDE_MEASURED, 25.0, 0.5)
    for k in range(100):
        p = np.array([0.01 * k, 0, np.nan if k == 40 else 0.0, 0, 0, 1.0])
        step(m, 0.01 * k, p, np.zeros(6))
    assert np.isfinite(m.nu).all()
    assert np.isfinite(m.scatter).all()


def test_the_heading_is_needed_where_velocity_is_derived() -> None:
    source = np.array([DERIVED] * 3 + [MEASURED] * 3)
    m = new_motion(source, ATTITUDE_MEASURED, OPEN, 0.5)
    for k in range(100):
        p = np.array([0.0, 0.01 * k, 0, 0, 0, np.nan if k == 40 else np.pi / 2])
        if step(m, 0.01 * k, p, np.zeros(6)) > 0.0:
            assert m.nu[1, :2] == pytest.approx([1.0, 0.0], abs=1e-9)
