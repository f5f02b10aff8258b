"""Sensors away from the body's origin, whose places nobody knows: what they show of turning goes with the place, and
must not pass for more information than it is."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import rotation_from_quaternion, row_of_rotation
from towtank.core.dynamics import forward_dynamics
from towtank.identification import learn_recordings
from towtank.identification.data.samples import N_MEASURED, NoiseLevels, prepared, samples_of
from towtank.identification.kalman.state import N_FIXED, FilterSettings, JointState, new_joint_state
from towtank.identification.kalman.update import expect, inject, update_specific_force
from towtank.identification.model.measurements import POSITION, SPECIFIC_FORCE, VELOCITY
from towtank.identification.model.parameters import DVL_PLACE, LATENCIES, MARKER_PLACE, PLACES
from towtank.identification.model.prior import prior_of
from towtank.identification.offline.free_runs import _at_origin
from towtank.recording import align, bind_thrusters
from towtank.recording.channel import Channel
from towtank.recording.standard import EULER, POSE, RATES
from towtank.simulation import Ins, Mocap, Perfect
from towtank.simulation.motion import Motion
from towtank.simulation.sensors.sensor import Sensors
from towtank.validation.prediction import predict
from towtank.vehicle import Coefficient, configuration_matrix, load_vehicle
from towtank.vehicle.posterior import Posterior

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from place_study import CASES, learned
from tumbling import named, tumble

VEHICLE = load_vehicle("vlbv300").with_coefficients({"Y_rdot": 0.7, "X_qdot": -0.4})  # so that axes are coupled
LATE = tuple(LATENCIES[s] for s in (POSITION, VELOCITY))
PRIOR = prior_of(VEHICLE, more=(*LATE, *PLACES)).only(("X_udot", "N_rdot", "M_qdot", "X_uu", "N_r", *LATE, *PLACES))
AT = np.where(np.isin(PRIOR.names, PLACES), 0.0, PRIOR.mean)
AT[-9:] = 0.2, -0.1, 0.15, -0.1, 0.3, 0.1, 0.25, 0.1, -0.2
AWAY = np.array([0.3, -0.4, 0.2, 0.1, 0.3, 0.0, 0.0, 0.1, 0.2, -0.1, 0.2, 0.1, 0.1, -0.3, 0.2, 0.1])
SHOWN = [POSITION, VELOCITY, SPECIFIC_FORCE]


def _moving(theta: Array, linearised_at: Array) -> JointState:
    levels = NoiseLevels(np.full(N_MEASURED, 0.01), np.full(6, 0.01))
    B, settings = configuration_matrix(VEHICLE), FilterSettings(biases=True)
    p = np.array(VEHICLE.parameters)
    state = new_joint_state(p, PRIOR.free, theta, PRIOR.std, B, levels, settings, linearised_at=linearised_at)
    state.x[:] = 0.5, -0.2, 1.0, 0.9, 0.2, -0.3, 0.25, 0.4, 0.5, 0.3, -0.6, 0.5, 0.8
    state.x[3:7] /= np.linalg.norm(state.x[3:7])
    state.rate[:] = 0.3, -0.2, 0.1, 0.5, -0.4, 0.7
    state.tau[:] = 10.0, 5.0, -3.0, 0.2, 3.0, 4.0
    return state


def _expected(sensor: int, state: JointState) -> tuple[Array, Array]:
    """What a sensor is expected to show (3,), and its rows of H."""
    columns = slice(3 * sensor, 3 * sensor + 3)
    far = np.full(N_MEASURED, np.nan)
    far[columns] = 1e4  # rejected, so that the innovation stays to be read
    if sensor == SPECIFIC_FORCE:
        update_specific_force(state, far)
    else:
        expect(state, far, sensor, True)
    return far[columns] - state.innovation, state.H[:3].copy()


@pytest.mark.parametrize("sensor", SHOWN)
def test_what_a_sensor_away_from_the_origin_shows_is_the_motion_of_its_place(sensor: int) -> None:
    """p + R r, v + omega x r, and omega_dot x r + omega x (omega x r) more, of rigid bodies."""
    here = AT.copy()
    here[-9:] = 0.0
    r = dict(zip((SPECIFIC_FORCE, VELOCITY, POSITION), AT[-9:].reshape(3, 3), strict=True))[sensor]
    state = _moving(AT, AT)
    omega, R = state.x[10:13].copy(), rotation_from_quaternion(state.x[3:7])
    away, origin = (_expected(sensor, _moving(each, each))[0] for each in (AT, here))
    omega_dot = forward_dynamics(state.p[None, :], state.x[None, 3:7], state.x[None, 7:], state.tau[None, :])[0, 3:]
    more = {
        POSITION: R @ r,
        VELOCITY: np.cross(omega, r),
        SPECIFIC_FORCE: np.cross(omega_dot, r) + np.cross(omega, np.cross(omega, r)),
    }
    np.testing.assert_allclose(away - origin, more[sensor], atol=1e-10)


def test_an_accelerometer_feels_a_disturbance_where_it_is() -> None:
    a = np.array([0.3, -0.2, 0.1, 0.5, -0.4, 0.7])
    calm, pushed = _moving(AT, AT), _moving(AT, AT)
    pushed.force[:] = a
    more = _expected(SPECIFIC_FORCE, pushed)[0] - _expected(SPECIFIC_FORCE, calm)[0]
    np.testing.assert_allclose(more, a[:3] + np.cross(a[3:], AT[-9:-6]), atol=1e-10)


@pytest.mark.parametrize("sensor", SHOWN)
def test_coefficients_and_place_away_from_where_they_are_linearised_count_to_first_order(sensor: int) -> None:
    """What is left is of second order, half as far away a quarter; and the rows stay those of the linearisation."""
    left = []
    for size in (0.1, 0.05):
        theta = AT + size * AWAY
        first_order, rows = _expected(sensor, _moving(theta, AT))
        np.testing.assert_array_equal(rows, _expected(sensor, _moving(AT, AT))[1])
        left.append(np.abs(first_order - _expected(sensor, _moving(theta, theta))[0]).max())
    assert left[1] <= 0.3 * left[0] + 1e-10


@pytest.mark.parametrize("sensor", SHOWN)
def test_the_rows_are_its_derivative(sensor: int) -> None:
    step, rows = 1e-6, _expected(sensor, _moving(AT, AT))[1]
    for c, name in enumerate(PRIOR.names):
        e = step * np.eye(AT.size)[c]
        above, below = (_expected(sensor, _moving(each, each))[0] for each in (AT + e, AT - e))
        derivative = (above - below) / (2.0 * step)
        if name not in LATE:  # what is shown late is told from beside what is shown
            np.testing.assert_allclose(rows[:, N_FIXED + c], derivative, rtol=1e-5, atol=1e-4, err_msg=name)
    for i in range(18) if sensor != SPECIFIC_FORCE else range(12, 18):  # of its own motion: test_measurements.py
        shown = []
        for sign in (1.0, -1.0):
            state = _moving(AT, AT)
            state.dx[i] = sign * step
            inject(state)
            shown.append(_expected(sensor, state)[0])
        derivative = (shown[0] - shown[1]) / (2.0 * step)
        np.testing.assert_allclose(rows[:, i], derivative, rtol=1e-5, atol=1e-4, err_msg=f"error {i}")


@pytest.mark.parametrize("sensor", [POSITION, VELOCITY])
def test_how_fast_it_changes_is_what_it_shows_late(sensor: int) -> None:
    step, column = 1e-5, N_FIXED + PRIOR.names.index(LATENCIES[sensor])
    at = AT.copy()
    at[[PRIOR.names.index(name) for name in LATE]] = 0.0
    state, later = _moving(at, at), _moving(at, at)
    shown, rows = _expected(sensor, state)
    R = np.array([row_of_rotation(state.x[3:7], k) for k in range(3)])
    later.dx[:3], later.dx[3:6], later.dx[6:12] = step * R @ state.x[7:10], step * state.x[10:13], step * state.rate
    inject(later)
    pace = (_expected(sensor, later)[0] - shown) / step
    np.testing.assert_allclose(-rows[:, column], pace, atol=1e-3)


@pytest.mark.parametrize("case, seed", [("imu off", 3), ("dvl off", 1), ("camera off", 2)])
def test_a_sensor_that_nobody_says_the_place_of(case: str, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With rows that followed the coefficients, or no place at all, deviations were eight times too small."""
    sensors, measured = CASES[case]
    slower = replace(sensors, **{"rate" if isinstance(sensors, Mocap) else "imu_rate": 50.0})
    monkeypatch.setitem(CASES, case, (slower, measured))
    off = np.array([size for _, size in learned(case, seed).values()])
    assert off.size > 20
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert np.abs(off).max() < 4.0


@dataclass(frozen=True)
class Parts:
    """Some channels of one set of sensors, and all of another."""

    some: Sensors
    names: tuple[str, ...]
    other: Sensors

    def observe(self, motion: Motion, seed: int) -> list[Channel]:
        kept = [each for each in self.some.observe(motion, seed) if each.name in self.names]
        return kept + self.other.observe(motion, seed)


def test_free_runs_see_the_motion_of_the_origin() -> None:
    """What is learned of the places brings a DVL and a camera to the origin."""
    dvl, marker = (0.3, -0.2, 0.1), (-0.1, 0.2, -0.15)
    quiet = dict.fromkeys(("attitude_noise_mrad", "heading_noise_mrad", "gyro_noise", "gyro_bias", "dvl_noise"), 0.0)
    camera = Mocap(rate=20.0, noise_mm=0.0, noise_mrad=0.0, jump_fraction=0.0, place=marker)
    gyros = ("u", "v", "w", "p", "q", "r")
    settings: dict[str, Any] = {"seed": 1, "seconds": 5.0, "measured": (*POSE, *gyros)}
    off = tumble(named(), sensors=Parts(Ins(dvl_place=dvl, **quiet), gyros, camera), **settings)
    here = tumble(named(), sensors=Perfect(), **settings)
    seen, true = (samples_of(prepared(each, named()), named()) for each in (off, here))
    brought = _at_origin(seen, np.array(dvl), np.array(marker))
    for columns in (slice(0, 3), slice(6, 9)):
        shown = np.isfinite(brought.values[:, columns]).all(axis=1)
        there = np.column_stack([np.interp(brought.t[shown], true.t, each) for each in true.values[:, columns].T])
        assert np.abs(seen.values[shown, columns] - there).max() > 0.02
        np.testing.assert_allclose(brought.values[shown, columns], there, atol=2e-3)


def test_a_place_is_learned_whole_or_not_at_all_and_what_is_known_of_it_counts() -> None:
    whole = prior_of(VEHICLE, more=PLACES)
    assert set(PLACES) & set(whole.narrowed_to(("X_udot",), delay_given=True).names) == set()
    for free in (("X_udot", "dvl_y"), ("dvl_x", "dvl_y", "dvl_z")):
        assert set(PLACES) & set(whole.narrowed_to(free, delay_given=True).names) == set(DVL_PLACE)
    stated = VEHICLE.model_copy(update={"prior": {"marker_z": Coefficient(value=0.2, std=0.01)}})
    known = prior_of(stated, more=PLACES).narrowed_to(("X_udot",), delay_given=True)
    assert set(PLACES) & set(known.names) == set(MARKER_PLACE)
    assert known.mean[known.names.index("marker_z")] == 0.2


def test_learning_says_which_sensor_is_surely_elsewhere() -> None:
    camera = Mocap(rate=50.0, place=(0.3, 0.0, 0.0))
    run = tumble(named(), seed=1, seconds=20.0, sensors=camera, measured=POSE)
    learning = learn_recordings(named(), [run], free_runs=False)
    assert learning.places.keys() == set(MARKER_PLACE)
    value, std = learning.places["marker_x"]
    assert abs(value - 0.3) < 4.0 * std
    [said] = [each for each in learning.remarks if "origin" in each]
    assert said.startswith("the point whose position is measured is not at the body's origin: ")
    assert said.endswith(" cm along x")


@pytest.mark.parametrize("std, moved", [(0.01, True), (0.2, False)])
def test_a_prediction_is_compared_with_the_origin_where_a_model_knows_whose_motion_is_measured(
    std: float, moved: bool
) -> None:
    """As it stands where it is not sure of it."""
    place = (0.3, -0.2, 0.1)
    names = ("dvl_x", "dvl_y", "dvl_z")
    posterior = Posterior.from_covariance(names, place, std**2 * np.eye(3), np.full(3, 0.2))
    truth = named().model_copy(update={"posterior": posterior})
    quiet = dict.fromkeys(("attitude_noise_mrad", "heading_noise_mrad", "gyro_noise", "gyro_bias", "dvl_noise"), 0.0)
    gyros = (*RATES, *EULER, "u", "v", "w")
    run = tumble(named(), seed=1, seconds=10.0, sensors=Ins(dvl_place=place, **quiet), measured=gyros)
    here = tumble(named(), seed=1, seconds=10.0, sensors=Ins(**quiet), measured=gyros)
    shown, true = (
        predict(truth, align(bind_thrusters(each, [t.name for t in truth.thrusters]))) for each in (run, here)
    )
    if moved:
        true = predict(named(), align(bind_thrusters(here, [t.name for t in truth.thrusters])))
    for name in "uvw":
        measured, other = (each.channels[name][0] for each in (shown, true))
        known = np.isfinite(measured) & np.isfinite(other)
        away = np.abs(measured - other)[known].max()
        assert away < 2e-3 if moved else away > 0.02
