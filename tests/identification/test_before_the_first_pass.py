"""What stands before the first pass: noise by the samples alone, the largest disturbance, where a recording begins,
bounds of physics, the prior as it is seen from elsewhere."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from towtank.core.zero_order_hold import ZeroOrderHold, force_integral_into, hold_force, new_zero_order_hold
from towtank.identification import learn_recordings
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.kalman.filter import _inputs_known
from towtank.identification.kalman.noise_adaptation import accelerations_of, most_disturbed
from towtank.identification.model.measurements import LEAST_NOISE, TYPICAL_NOISE
from towtank.identification.model.parameters import free_parameters
from towtank.identification.model.prior import prior_of
from towtank.identification.model.terms import DISTURBANCE
from towtank.recording.noise import noise_of_rows
from towtank.simulation import Ins, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.simulation.tank import DISTURBANCE as TANK
from towtank.simulation.tank import tank_session
from towtank.vehicle import load_vehicle

from .runs import box, unknown, waves

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from pushed_box import flight, true_box
from tumbling import INERTIAS, named, true_vehicle, tumble

U, R, PSI, VELOCITY = 6, 11, 5, 6
RATE = 100.0  # Hz


def rows(n: int = 3000) -> np.ndarray:
    return np.full((n, N_MEASURED), np.nan)


def samples(values: np.ndarray, force: float = 0.0, rate: float = RATE) -> Samples:
    """Rows of a body that a wrench along x pushes from second to second to and fro."""
    input_t = np.arange(0.0, len(values) / rate)
    wrench = np.zeros((len(input_t), 6))
    wrench[:, 0] = force * (-1.0) ** np.arange(len(input_t))
    t = np.arange(len(values)) / rate
    return Samples(t, values, input_t, wrench, np.eye(6), np.zeros(6), commands=False)


def test_the_acceleration_of_an_axis_is_that_of_its_speed_or_of_its_pose() -> None:
    t, w = np.arange(3000) / RATE, 0.8
    by_speed, by_pose = rows(), rows()
    by_speed[:, U], by_speed[:, R] = 0.5 * np.sin(w * t), 0.7 * np.sin(w * t)
    by_pose[:, :6] = 0.0
    by_pose[:, PSI] = 2.0 + 0.7 / w * (1.0 - np.cos(w * t))  # through the branch cut
    along = 0.5 * np.sin(w * t) / RATE
    by_pose[:, 0], by_pose[:, 1] = (np.cumsum(along * f(by_pose[:, PSI])) for f in (np.cos, np.sin))
    by_pose[:, PSI] = np.angle(np.exp(1j * by_pose[:, PSI]))
    usual = np.quantile(np.abs(np.cos(w * t)), 0.9) * w
    speeds, poses = accelerations_of(samples(by_speed)), accelerations_of(samples(by_pose))
    np.testing.assert_allclose(speeds[[0, 5]], usual * np.array([0.5, 0.7]), rtol=0.03)
    np.testing.assert_allclose(poses[[0, 5]], speeds[[0, 5]], rtol=0.1)
    assert speeds[1] == 0.0  # nothing measures it
    by_speed[:, 12] = 0.1
    assert accelerations_of(samples(by_speed))[0] == speeds[0]
    by_speed[:, U] = np.nan
    assert np.isinf(accelerations_of(samples(by_speed))[0])  # felt, but beside gravity


def test_a_disturbance_is_at_most_what_motion_and_inputs_show() -> None:
    body = box()
    values = rows()
    values[:, 6:12] = 0.0
    most = most_disturbed([samples(values, force=60.0)], np.array(body.parameters))
    assert most[0] == pytest.approx(60.0 / body.mass_matrix[0, 0] + DISTURBANCE[0])  # something holds it in place
    np.testing.assert_allclose(most[1:], DISTURBANCE[1:])


def test_thrusters_that_answer_at_once_where_a_lag_is_supposed() -> None:
    """Switched at random, with gyros alone: what is supposed of delay and lag turns the vehicle the wrong way for half
    of the time, and passes from there ended at seven times the inertia."""
    truth = true_vehicle()
    learning = learn_recordings(named(), [tumble(truth, seed=2, seconds=30.0)], free_runs=False)
    rigid = truth.rigid_body.inertia
    for own, name in zip(rigid, INERTIAS, strict=True):
        assert own - learning.model.coefficient(name) == pytest.approx(own - truth.coefficient(name), rel=0.1), name
    assert learning.delay + learning.lag < 0.02


def test_an_axis_at_rest_is_not_taken_for_one_that_is_pushed_hard_and_damped_hard() -> None:
    """From a disturbance of 20 times the usual the yaw of this run went to 90 times, its inertia to half the truth."""
    tank = tank_session(2.0)
    commands = manoeuvre("surge-square", tank.truth, duration=30.0, dt=0.01, seed=1).commands
    start = (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    run = simulate(tank.truth, commands=commands, dt=0.01, eta0=start, sensors="ins", disturbance=TANK, seed=1)
    learning = learn_recordings(tank.known, [run], free_runs=False)
    assert learning.levels is not None
    assert learning.levels.disturbance[5] < 5.0 * TANK.std[5]
    yaw = learning.estimate["N_rdot"]
    assert abs(yaw.value - tank.truth.coefficient("N_rdot")) < 3.0 * learning.model.deviation("N_rdot")
    assert not learning.findings


def smoothed(noise: np.ndarray) -> np.ndarray:
    """What a filter on board makes of samples."""
    for _ in range(4):
        noise = np.convolve(noise, np.ones(15) / 15.0, mode="same")
    return noise


def test_noise_that_was_smoothed_on_board_is_that_of_a_usual_sensor() -> None:
    generator = np.random.default_rng(4)
    t = np.arange(2000) / 20.0
    values = rows(2000)
    motion = 0.3 * np.sin(0.5 * t)
    for j in range(3):
        values[:, VELOCITY + j] = motion + smoothed(0.02 * generator.standard_normal(2000))
        values[:, 3 + j] = motion + 0.004 * generator.standard_normal(2000)
        values[:, 9 + j] = np.round(motion + 2e-5 * generator.standard_normal(2000), 5)
    noise = noise_of_rows(t, values, TYPICAL_NOISE, LEAST_NOISE)
    np.testing.assert_allclose(noise[6:9], TYPICAL_NOISE[6:9])
    np.testing.assert_allclose(noise[3:6], 0.004, rtol=0.15)
    np.testing.assert_allclose(noise[9:12], TYPICAL_NOISE[9:12])  # a last digit is no noise


@pytest.mark.parametrize("case", ["smooth 1.2", "heading wanders"])
def test_rates_that_were_smoothed_count_as_noisy_as_their_attitude_says(case: str) -> None:
    """Believed, they make of a yaw inertia of 2.3 one of 11 or 12 at a deviation of 0.8; a gyro beside a heading that
    wanders is believed."""
    truth = true_box()
    learning = learn_recordings(unknown(truth), [flight(case, 1).window(0.0, 40.0)], free_runs=False)
    for name in ("N_rdot", "N_rr"):
        found = learning.estimate[name]
        assert found.identified
        assert abs(found.value - truth.coefficient(name)) < 3.0 * found.std, name
    assert learning.estimate["N_rdot"].value == pytest.approx(truth.coefficient("N_rdot"), rel=0.05)
    assert learning.levels is not None
    said = any(
        text.startswith("samples of p q r show no noise of their own, and differ from the attitude as by noise of 0.")
        for text in learning.remarks
    )
    assert said == (case == "smooth 1.2")
    assert (learning.levels.noise[R] > 0.05) == said


def test_a_position_that_jumps_is_no_noise() -> None:
    """By 14 cm for 2 s in 13: beside its speed a sixth is rejected, and what is left has a noise of 5 mm, not of 35."""
    run = flight("raw", 1, speeds=True).window(0.0, 40.0)
    jumps = (np.arange(len(run["x"])) % 267 >= 200) & (np.arange(len(run["x"])) % 267 < 240)
    run = run.replace(
        [run[name].with_values(run[name].values + sign * jumps) for name, sign in (("x", 0.1), ("y", -0.1))]
    )
    learning = learn_recordings(unknown(true_box()), [run], free_runs=False)
    assert learning.levels is not None
    np.testing.assert_allclose(learning.levels.noise[:2], 5e-3, rtol=0.2)
    surge = learning.estimate["X_udot"]
    assert abs(surge.value - true_box().coefficient("X_udot")) < 3.0 * surge.std


@pytest.mark.parametrize("seed", range(3))
def test_a_light_body_that_is_pushed_hard_is_not_lost(seed: int) -> None:
    """A light body that is pushed by 40 times the usual disturbance, beyond what the first pass takes it for."""
    body = box(rigid_body={"mass": 20.0, "inertia": (0.1, 0.12, 0.15)}, hydrodynamics={})
    truth = body.with_coefficients({"N_rdot": -0.1, "N_rr": -0.2})
    push = OrnsteinUhlenbeck(std=(0.1, 0.1, 0.1, 0.0, 0.0, 40.0 * 0.25 * DISTURBANCE[5]))
    wrench = waves(2000, 0.02, (5, 1.0, 1.3), square=True)
    run = simulate(truth, wrench=wrench, dt=0.02, sensors=Ins(imu_rate=50.0), disturbance=push, seed=seed)
    log = run.without("ax", "ay", "az")
    yaw = learn_recordings(body, [log], free_runs=False).estimate["N_rdot"]
    assert yaw.identified
    assert abs(yaw.value + 0.1) < 3.0 * yaw.std


def held(first: float, lag: float, delay: float = 0.0) -> ZeroOrderHold:
    out = new_zero_order_hold(1, np.array([lag]), delay)
    hold_force(out, 1.0, np.array([first]))
    return out


def test_what_thrusters_do_is_known_once_they_have_answered() -> None:
    assert not _inputs_known(new_zero_order_hold(1, np.array([0.1]), 0.0), 1.0)  # no command yet
    for asked in (0.0, 5.0):  # a log that is cut out of a longer one may begin just after a push
        assert not _inputs_known(held(asked, lag=0.1), 1.0)
        assert _inputs_known(held(asked, lag=0.1), 1.6)
    assert _inputs_known(held(5.0, lag=0.0), 1.0)  # a wrench acts at once


def test_a_clock_that_starts_late_knows_every_command_before() -> None:
    """The force after several commands is the sum of their exponentials, wherever the clock is started."""
    stamps, asked, T = np.array([0.0, 0.31, 0.35, 1.2]), np.array([2.0, -1.0, 4.0, 0.5]), 0.4
    hold = new_zero_order_hold(1, np.array([T]), 0.0)
    for t, value in zip(stamps, asked, strict=True):
        hold_force(hold, t, np.array([value]))
    out = np.empty(1)
    force_integral_into(hold, 1.5, out)
    answered = -np.expm1(-(1.5 - stamps[1:]) / T)  # the first command was in force long before
    exact = float(asked[0] + np.sum(np.diff(asked) * answered))
    assert hold.force[0] == pytest.approx(exact, rel=1e-12)
    assert out[0] == 0.0
    force_integral_into(hold, 2.0, out)
    whole = 0.5 * asked[-1] + (exact - asked[-1]) * -T * np.expm1(-0.5 / T)
    assert out[0] == pytest.approx(whole, rel=1e-12)


def test_bounds_are_those_of_physics() -> None:
    vehicle = load_vehicle("vlbv300")
    names = ("X_udot", "X_wdot", "X_uu", "X_q", "inflow_loss", "delay", "lag")
    low, high = (dict(zip(names, each, strict=True)) for each in free_parameters(vehicle, names).bounds)
    assert low["X_udot"] == pytest.approx(np.log(vehicle.rigid_body.mass))  # of the total inertia: water adds to it
    assert (low["inflow_loss"], low["delay"], high["X_uu"]) == (0.0, 0.0, 0.0)
    assert 0.0 < low["lag"] < 0.01 < 1.0 < high["lag"]
    for name in ("X_wdot", "X_q"):
        assert np.isinf(low[name])
        assert np.isinf(high[name])


def test_the_share_of_the_common_scale_is_supposed_the_same_wherever_it_is_seen_from() -> None:
    """c / g, to first order about each point: its mean and its variance, and its covariance with the scale."""
    prior = prior_of(load_vehicle("vlbv300").model_copy(update={"hydrodynamics": {}}), commands=True)
    gains = np.array([name.startswith("gain_") for name in prior.names])
    share, drag = gains / gains.sum(), prior.names.index("X_uu")
    theta = prior.mean + 0.2 * gains
    theta[drag] *= 1.7

    def ratio(at: np.ndarray) -> tuple[float, float, float]:
        mean, covariance = prior.seen_from(at)
        g = float(np.exp(share @ (at - prior.mean)))
        slope = -at[drag] / g * share
        slope[drag] = 1.0 / g
        value = at[drag] / g + slope @ (mean - at)
        return float(value), float(slope @ covariance @ slope), float(slope @ covariance @ share)

    assert ratio(theta) == pytest.approx(ratio(prior.mean), rel=1e-9)
    assert ratio(prior.mean)[0] == prior.mean[drag]


def test_a_force_far_surer_than_the_scale_is_itself_from_everywhere() -> None:
    prior = prior_of(load_vehicle("vlbv300").model_copy(update={"hydrodynamics": {}}), commands=True)
    drag, small = prior.names.index("X_uu"), np.ones(len(prior.names))
    small[drag] = 1e-4
    sure = replace(prior, covariance=prior.covariance * np.outer(small, small))
    away = prior.mean + 0.2 * np.array([name.startswith("gain_") for name in prior.names])
    mean, covariance = sure.seen_from(away)
    assert mean[drag] == prior.mean[drag]
    np.testing.assert_array_equal(covariance[drag], sure.covariance[drag])
