"""Sensors whose clock is not that of the others: their rows are moved, and the filter finds what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.identification.data.samples import N_MEASURED, NoiseLevels, Samples, samples_of
from towtank.identification.kalman.passes import one_pass
from towtank.identification.kalman.problem import JointProblem, settings_for
from towtank.identification.kalman.state import FilterSettings, coefficient_std
from towtank.identification.model.measurements import ATTITUDE, POSITION, RATES, VELOCITY, WATER_VELOCITY
from towtank.identification.model.parameters import DVL_PLACE, IMU_PLACE, LATENCIES, MARKER_PLACE, PLACES
from towtank.identification.model.prior import further_unknowns, prior_of
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, Together, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

LATE = 0.12  # s
DVL = ("u", "v", "w")


def rows(t: Array, *sensors: tuple[int, Array]) -> Samples:
    """Rows with the numbers 3 s + k + row / 1000 of these sensors, in the rows where they speak."""
    values = np.full((t.size, N_MEASURED), np.nan)
    for sensor, where in sensors:
        for k in range(3):
            values[where, 3 * sensor + k] = 3 * sensor + k + where / 1000.0
    return Samples(t, values, np.zeros(1), np.zeros((1, 1)), np.zeros((6, 1)), np.zeros(1), True)


def latency(**sensors: float) -> Array:
    out = np.zeros(6)
    for name, value in sensors.items():
        out[LATENCIES.index(f"latency_{name}")] = value
    return out


# -- rows are moved


def test_a_late_sensor_s_numbers_move_to_when_they_were_true_and_all_others_stay() -> None:
    t = 0.01 * np.arange(200)
    samples = rows(t, (RATES, np.arange(200)), (VELOCITY, np.arange(0, 200, 10)))
    moved = samples.shifted(latency(velocity=0.034))
    assert (np.diff(moved.t) > 0.0).all()
    assert np.isfinite(moved.values).any(axis=1).all()
    for sensor, late in ((RATES, 0.0), (VELOCITY, 0.034)):
        columns = slice(3 * sensor, 3 * sensor + 3)
        before, after = (np.isfinite(each.values[:, columns]).all(axis=1) for each in (samples, moved))
        np.testing.assert_allclose(moved.t[after], samples.t[before] - late, atol=1e-12)
        np.testing.assert_array_equal(moved.values[after, columns], samples.values[before, columns])
    assert np.isfinite(moved.values).sum() == np.isfinite(samples.values).sum()
    assert len(moved) == 200 + 20


def test_a_quick_sensor_is_thinned_and_a_slow_one_keeps_its_rows() -> None:
    t = 0.01 * np.arange(200)
    fewer = rows(t, (RATES, np.arange(200)), (VELOCITY, np.arange(3, 200, 10))).thinned(0.04)
    quick, slow = (np.isfinite(fewer.values[:, 3 * each]) for each in (RATES, VELOCITY))
    np.testing.assert_allclose(fewer.t[quick], t[::4])
    np.testing.assert_allclose(fewer.t[slow], t[3::10])
    np.testing.assert_array_equal(fewer.values[quick, 3 * RATES], 3 * RATES + np.arange(0, 200, 4) / 1000.0)


def test_instants_that_meet_become_one_row() -> None:
    t = 0.01 * np.arange(100)
    everywhere = np.arange(100)
    samples = rows(t, (RATES, everywhere), (VELOCITY, everywhere[::5]), (POSITION, everywhere[::20]))
    moved = samples.shifted(latency(velocity=0.03, position=0.05))
    assert len(moved) == 100 + 1 + 1  # the first of each speaks of a time before the first row
    assert (np.diff(moved.t) > 5e-3).all()
    assert np.isfinite(moved.values).sum() == np.isfinite(samples.values).sum()
    k = int(np.searchsorted(moved.t, 0.10 - 1e-9))
    np.testing.assert_allclose(moved.values[k, 9], 9.0 + 0.010)
    where = int(np.searchsorted(moved.t, 0.12 - 1e-9))
    np.testing.assert_allclose(moved.values[where, 6], 6.0 + 0.015)  # stamped 0.15
    np.testing.assert_allclose(moved.values[where, 9], 9.0 + 0.012)


def test_a_sensor_ahead_of_its_stamp_and_one_alone() -> None:
    t = 0.1 * np.arange(10)
    early = rows(t, (VELOCITY, np.arange(10))).shifted(latency(velocity=-0.02))
    np.testing.assert_allclose(early.t, t + 0.02)
    np.testing.assert_array_equal(early.values, rows(t, (VELOCITY, np.arange(10))).values)


def test_nothing_moves_where_nothing_is_late() -> None:
    samples = rows(0.1 * np.arange(10), (RATES, np.arange(10)))
    assert samples.shifted(np.zeros(6)) is samples
    assert samples.shifted(latency(velocity=0.1)) is samples  # it is not measured
    before = samples.values.copy()
    samples.shifted(latency(rates=0.01))
    np.testing.assert_array_equal(samples.values, before)


# -- which sensors may be late


def dive(sensors: Mocap | Ins | Together, seconds: float = 40.0, seed: int = 3) -> Recording:
    vehicle = load_vehicle("vlbv300")
    commands = manoeuvre("all-telegraph", vehicle, duration=seconds, dt=0.01, seed=seed).commands
    water = OrnsteinUhlenbeck(std=(0.25,) * 3 + (0.02,) * 3, time_constant=2.0)
    return simulate(vehicle, commands=commands, dt=0.01, sensors=sensors, disturbance=water, seed=seed)


def late_of(samples: Sequence[Samples]) -> tuple[str, ...]:
    """Which sensors may be late."""
    return tuple(name for name in further_unknowns(samples) if name not in PLACES)


def test_the_time_of_the_gyro_is_taken_as_it_is_else_that_of_the_attitude_else_that_of_the_position() -> None:
    vehicle, t, n = load_vehicle("vlbv300"), 0.01 * np.arange(300), np.arange(300)
    inertial, camera = (samples_of(dive(each, 2.0), vehicle) for each in (Ins(), Mocap()))
    assert late_of([inertial]) == ("latency_velocity",)  # depth comes in rows of the attitude
    assert late_of([camera]) == ()  # one device, one time
    gyro, attitude = (RATES, n[::3]), (ATTITUDE, n[1::3])
    position, velocity, through_water = (POSITION, n[2::3]), (VELOCITY, n[::30]), (WATER_VELOCITY, n[::15])
    others = ("latency_position", "latency_velocity")
    apart = rows(t, gyro, attitude, position, velocity)
    assert late_of([apart]) == ("latency_position", "latency_attitude", "latency_velocity")
    assert late_of([rows(t, attitude, position, velocity)]) == others
    assert late_of([rows(t, position, velocity)]) == others[1:]
    assert late_of([rows(t, position, through_water)]) == ("latency_velocity_through_the_water",)
    both = rows(t, gyro, (ATTITUDE, n[::6]), (POSITION, n[::60]))
    assert late_of([both]) == ()
    assert late_of([both, apart]) == ("latency_position", "latency_attitude", "latency_velocity")


def test_where_sensors_are_is_unknown_where_something_shows_the_turning() -> None:
    vehicle, t, n = load_vehicle("vlbv300"), 0.01 * np.arange(300), np.arange(300)
    inertial, camera = (samples_of(dive(each, 2.0), vehicle) for each in (Ins(), Mocap()))
    assert further_unknowns([inertial])[1:] == (*IMU_PLACE, *DVL_PLACE, *MARKER_PLACE)
    assert further_unknowns([camera]) == MARKER_PLACE
    assert further_unknowns([rows(t, (VELOCITY, n[::30]), (RATES, n))])[1:] == DVL_PLACE
    assert not {*PLACES} & {*further_unknowns([rows(t, (POSITION, n[2::3]), (VELOCITY, n[::30]))])}


# -- the filter finds what is left


def made_late(log: Recording, seconds: float) -> Recording:
    """The log with each sample of the DVL stamped so much later."""
    return log.replace([replace(log[name], t=log[name].t + seconds) for name in DVL])


def asked(vehicle: Vehicle, log: Recording) -> tuple[JointProblem, NoiseLevels]:
    """What the filter is asked where only the latency of the DVL, and one inertia, is unknown."""
    samples = [samples_of(log, vehicle)]
    prior = prior_of(vehicle, more=("latency_velocity",)).only(("X_udot", "latency_velocity"))
    sensor = Ins()
    noise = np.repeat([0.1, 0.01, sensor.dvl_noise, sensor.gyro_noise, 0.1, 1.0], 3)
    levels = NoiseLevels(noise, np.full(6, 0.01), np.zeros(6))
    settings = settings_for(samples, FilterSettings())
    return JointProblem(samples, vehicle, prior, settings, noise), levels


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("late", [0.0, 0.06, LATE])
def test_what_is_left_of_a_latency_is_found_in_one_pass(late: float, seed: int) -> None:
    vehicle = load_vehicle("vlbv300")
    problem, levels = asked(vehicle, made_late(dive(Ins(), seed=seed), late))
    k = problem.free.names.index("latency_velocity")
    about = problem.prior.mean.copy()
    about[k] = late - 0.02
    state, *_ = one_pass(problem, about, levels)
    found, std = state.theta[k], coefficient_std(state)[k]
    assert std < 0.004
    assert abs(found - late) < 3.5 * std + 0.001  # 0.02 s away, to first order
    again, *_ = one_pass(problem, state.theta.copy(), levels)
    assert abs(again.theta[k] - late) < 3.5 * coefficient_std(again)[k]
    assert abs(again.theta[k] - found) < 2.0 * std


def test_a_pass_ends_with_the_commands_after_its_last_row_too() -> None:
    """Where all that came with a command is late, the last row speaks of before it; a stream goes on with it."""
    problem, levels = asked(load_vehicle("vlbv300"), dive(Ins(), 2.0))
    samples = problem.samples[0]
    t, force = samples.t[-1] + 0.01, np.full((1, samples.B.shape[1]), 3.0)
    more = np.append(samples.input_t, t), np.vstack([samples.input_force, force])
    later = replace(samples, input_t=more[0], input_force=more[1])
    _, held, *_ = one_pass(problem.over([later]), problem.prior.mean, levels)
    assert held.counters[0].received == later.input_t.size
    np.testing.assert_array_equal(held.values[later.input_t.size - 1], force[0])


def test_a_speed_just_before_all_else_begins_a_log_as_one_beside_it_does() -> None:
    """Thrusters that were asked for something before: the start waits until they have forgotten it. Where the Doppler
    log speaks a millisecond before that, it does not wait for the next time, so that passes on both sides of a latency
    of nothing take the same and can be compared."""
    vehicle = load_vehicle("vlbv300")
    lagged = tuple(each.model_copy(update={"time_constant": 0.1}) for each in vehicle.thrusters)
    problem, _ = asked(vehicle.model_copy(update={"thrusters": lagged}), dive(Ins(), 2.0))
    assert problem.samples[0].input_force[0].any()
    first = problem.over([problem.samples[0].stretch(0, 53)])
    levels = problem.rough  # that much is rejected of so little is chance
    k, about, taken = problem.free.names.index("latency_velocity"), problem.prior.mean.copy(), []
    speeds = []
    for late in (-1e-3, 0.0, 1e-3):
        about[k] = late
        state, *_ = one_pass(problem, about, levels)
        taken.append([int(state.statistics[3 * sensor].accepted) for sensor in (ATTITUDE, VELOCITY, RATES)])
        state, *_ = one_pass(first, about, levels)
        speeds.append(np.sqrt(np.diag(state.P)[6:9]))
    assert np.ptp(taken, axis=0).max() <= 1
    np.testing.assert_allclose(speeds[1:], speeds[:-1], rtol=0.15)  # as well known from the first moment on
    assert taken[1][-1] > 140  # of 200 in 2 s, of which the first half a second waits
