"""A lag that is too short to be told from a delay: their sum is known, and the lag as far as its square shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import towtank as tt
from towtank.core.arrays import Array
from towtank.core.zero_order_hold import hold_force, mean_forces_into, new_zero_order_hold
from towtank.identification import learn_recordings
from towtank.identification.kalman.state import FilterSettings, healthy_snapshot, recovered
from towtank.identification.model.parameters import (
    _SHOWS,
    DELAY,
    LAG,
    FreeParameters,
    free_parameters,
    linearised_about,
    seen_about,
    told,
)
from towtank.identification.online.joint import JointLearner
from towtank.identification.posterior.wording import surer_together
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

STEP, SHOWS = 1e-3, 0.01  # s
VLBV300 = load_vehicle("vlbv300")


def unknowns(*names: str) -> FreeParameters:
    return free_parameters(VLBV300, ["X_uu", *names])


def thrust(delay: float, lag: float) -> tuple[Array, Array]:
    """Return where a unit mass is pushed by commands that switch at random (n,), and its derivatives (n, 2)."""
    rng, n = np.random.default_rng(3), 40
    held = new_zero_order_hold(1, np.array([lag]), delay)
    for t, value in zip(np.cumsum(rng.uniform(0.05, 0.4, n)), rng.choice([-1.0, 1.0], (n, 1)), strict=True):
        hold_force(held, t, value)
    rows, out = [], np.zeros((3, 1))
    for end in np.arange(STEP, 8.0, STEP):
        mean_forces_into(held, end, out)
        rows.append([out[0, 0], out[1, 0], out[2, 0] / lag])
    force = np.array(rows)
    speed = np.cumsum(force, axis=0) * STEP
    moved = np.cumsum(speed - 0.5 * STEP * force, axis=0) * STEP
    return moved[:, 0], moved[:, 1:]


@pytest.mark.parametrize("lag", [0.001, 0.003, 0.006])
def test_motion_goes_with_the_sum_and_with_the_square_of_a_short_lag(lag: float) -> None:
    """By delay and lag themselves the same step of the linearised motion is more than ten times as far off."""
    free, true = unknowns(DELAY, LAG), np.array([-9.0, 0.08, lag])
    about = linearised_about(free, true)
    assert about[1:] == pytest.approx([0.08 + lag - SHOWS, SHOWS])
    there, _ = seen_about(free, about, true, np.eye(3) * 1e-12)
    begin, by = thrust(*about[1:])
    truth, _ = thrust(*true[1:])
    off = [np.linalg.norm(begin + by @ (each - about)[1:] - truth) for each in (there, true)]
    assert off[0] < 0.1 * off[1]


@pytest.mark.parametrize("about", [(0.08, 0.1), (0.07, 0.01), (0.001, 0.004)])
@pytest.mark.parametrize("known", [(0.05, 0.15), (0.08, 0.012), (0.002, 0.009), (0.1, 0.001)])
def test_what_is_told_is_what_was_seen(about: tuple[float, float], known: tuple[float, float]) -> None:
    free, mean = unknowns(DELAY, LAG), np.array([-9.0, *known])
    root = np.array([[1.0, 0.0, 0.0], [0.01, 0.02, 0.0], [-0.01, -0.015, 0.008]])
    point = np.array([-8.0, *about])
    there, covariance = seen_about(free, point, mean, root @ root.T)
    assert there[1:].sum() == pytest.approx(mean[1:].sum())
    theta, middle, back = told(free, point, there, there, covariance)
    np.testing.assert_allclose([theta, middle], [mean, mean], atol=1e-9)
    np.testing.assert_allclose(back, root @ root.T, atol=1e-12)


def test_what_is_allowed_stays_allowed() -> None:
    free, rng = unknowns(DELAY, LAG), np.random.default_rng(7)
    low, high = free.bounds
    for delay, lag, away, other in rng.uniform(0.0, 0.3, (300, 4)):
        about = linearised_about(free, np.array([-9.0, delay, max(lag, 0.001)]))
        assert about[1:].sum() == pytest.approx(delay + max(lag, 0.001))
        assert about[2] >= SHOWS or about[1:].sum() < 2.0 * SHOWS
        inside = np.array([-9.0, away * (away > 0.1), max(other - 0.1, 0.001)])
        theta, *_ = told(free, about, inside, inside, 1e-4 * np.eye(3))
        assert np.all((low <= theta) & (theta <= high))


@pytest.mark.parametrize("names", [(), (DELAY,), (LAG,), (DELAY, LAG)])
def test_where_either_is_known_or_both_are_short_they_are_as_they_stand(names: Sequence[str]) -> None:
    free = unknowns(*names)
    theta, covariance = np.array([-9.0, 0.002, 0.007])[: len(free)], np.eye(len(free))
    np.testing.assert_array_equal(linearised_about(free, theta), theta)
    for found in (seen_about(free, theta, theta, covariance), told(free, theta, theta, theta, covariance)[1:]):
        np.testing.assert_array_equal(found[0], theta)
        np.testing.assert_array_equal(found[1], covariance)


def test_a_lag_shows_from_half_a_step_of_integration_on() -> None:
    assert FilterSettings().step == 2.0 * _SHOWS
    assert SHOWS == _SHOWS


def test_a_sum_is_said_where_it_is_far_surer_than_its_parts() -> None:
    assert surer_together(0.01, (0.0802, 0.0003)) == ("80.20", "0.30")
    assert surer_together(0.01, (0.0802, 0.006)) is None
    assert surer_together(None, (0.0802, 0.0003)) is None
    assert surer_together(0.01, None) is None


def quick(delay: float, seed: int, seconds: float = 24.0) -> tuple[Vehicle, tt.Recording]:
    """Return the rigid body and a run with thrusters that have a delay and no lag."""
    truth = VLBV300.model_copy(
        update={
            "command_delay": delay,
            "thrusters": tuple(each.model_copy(update={"time_constant": 0.0}) for each in VLBV300.thrusters),
        }
    )
    commands = manoeuvre("all-square", truth, duration=seconds, dt=0.05, seed=seed).commands
    run = simulate(truth, commands=commands, dt=0.05, sensors=Mocap(), seed=seed)
    return truth.model_copy(update={"hydrodynamics": {}, "command_delay": 0.0}), run


@pytest.fixture(scope="module")
def streamed() -> JointLearner:
    known, run = quick(0.08, 1)
    learner = JointLearner(known, changes=False)
    learner.run(run)
    return learner


def test_a_stream_tells_them_as_a_log_does(streamed: JointLearner) -> None:
    """Its filter is linearised about a lag that shows, and has other coordinates."""
    running = streamed._stream.running
    assert running is not None
    d, T = (running.free.names.index(name) for name in (DELAY, LAG))
    assert running.state.linearised_at[T] >= SHOWS
    theta, covariance = running.told
    assert (streamed.delay, streamed.lag) == (max(theta[d], 0.0), theta[T])
    together = covariance[np.ix_([d, T], [d, T])].sum() ** 0.5
    assert abs(streamed.delay + streamed.lag - 0.08) < 3.0 * together < 0.006
    assert covariance[d, d] ** 0.5 < 0.02


def test_what_contradicts_it_is_no_coordinate(streamed: JointLearner) -> None:
    running = streamed._stream.running
    assert running is not None
    apart = 0.01 * np.arange(len(running.free))
    wider = running._replace(apart=apart).told[1] - running._replace(apart=0.0 * apart).told[1]
    np.testing.assert_allclose(wider, np.outer(apart, apart), atol=1e-12)


def test_inputs_of_a_filter_that_recovers_are_as_late_as_before(streamed: JointLearner) -> None:
    running = streamed._stream.running
    assert running is not None
    known = healthy_snapshot(running.state)
    assert known is not None
    moved = replace(known, theta=known.theta + 0.003)
    anew = recovered(running.state, moved, running.free, running.settings)
    late = np.isin(running.free.names, (DELAY, LAG))
    np.testing.assert_array_equal(anew.linearised_at[late], running.state.linearised_at[late])
    np.testing.assert_array_equal(anew.linearised_at[~late], moved.theta[~late])
    np.testing.assert_array_equal(anew.theta, moved.theta)


@pytest.mark.parametrize("seed", [1, 2])
def test_thrusters_without_a_lag_have_the_delay_that_they_have(seed: int) -> None:
    """It was 70 +- 44 ms, and passes went on for long, where the sum was known to a millisecond."""
    known, run = quick(0.08, seed)
    learning = learn_recordings(known, [run], free_runs=False)
    assert abs(learning.delay - 0.08) < 2.0 * learning.delay_std
    assert learning.delay_std < 0.02
    assert learning.lag < 0.02
    together = learning.together
    assert together is not None
    assert abs(together[0] - 0.08) < 3.0 * together[1]
    assert together[1] < 0.25 * learning.delay_std
