"""A current that nobody knows, learned along: it must not pass for information about the vehicle."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import hold_force, mean_forces_into, new_zero_order_hold
from towtank.identification import learn_recordings
from towtank.identification.data.samples import N_MEASURED, NoiseLevels, prepared
from towtank.identification.kalman.filter import take_row
from towtank.identification.kalman.passes import _smoothed, one_pass
from towtank.identification.kalman.problem import JointProblem
from towtank.identification.kalman.state import (
    FilterSettings,
    JointState,
    coefficient_block,
    forget_surroundings,
    new_joint_state,
    surely_flows,
)
from towtank.identification.kalman.update import update_specific_force
from towtank.identification.model.measurements import VELOCITY, pace_of
from towtank.identification.model.parameters import IMU_PLACE
from towtank.identification.model.prior import prior_of
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.vehicle import configuration_matrix, load_vehicle

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from experiments import experiment

SURGE = experiment("s1-5mm-stairs")  # in still water, which nobody is told
NAMES = (*SURGE.free, "lag")


def _surge(seed: int) -> JointProblem:
    recording = prepared(SURGE.record(seed).window(0.0, 20.0), SURGE.start)
    return joint_problem(LearningRequest(SURGE.start, [recording], free=NAMES, delay=0.0))


def test_where_the_motion_is_linearised_hardly_changes_the_answer() -> None:
    """From 6 % below and above the true inertia; by 10 % while the motion followed the current of the moment."""
    problem = _surge(26)
    truth, levels = problem.free.theta(SURGE.truth, delay=0.0, lag=1e-3), problem.rough
    levels = replace(levels, disturbance=np.array([0.0084, 0.0018, 0.0018, 0.0045, 0.0045, 0.0045]))
    levels = replace(levels, currents=one_pass(problem, truth, levels)[3])
    off = np.array([0.06, 0.0, 0.0])
    below, above = (one_pass(problem, truth + side * off, levels)[0] for side in (-1.0, 1.0))
    deviation = float(np.sqrt(coefficient_block(below)[0, 0]))
    assert abs(above.theta[0] - below.theta[0]) < deviation < 0.02


@pytest.mark.parametrize("seed", [8, 15, 24, 26])
def test_an_inertia_beside_an_unknown_current_is_as_sure_as_it_says(seed: int) -> None:
    """Runs whose inertia was 5 % off at 4 to 7 deviations, while the motion followed the current of the moment."""
    recording = SURGE.record(seed).window(0.0, 20.0)
    estimate = learn_recordings(SURGE.start, [recording], free=NAMES, delay=0.0).estimate
    for name in SURGE.free:
        assert abs(estimate[name].value - SURGE.truth.coefficient(name)) < 3.0 * estimate[name].std


def test_what_a_pass_has_found_is_where_the_next_is_linearised_and_no_more_is_known_of_it() -> None:
    problem = _surge(8)
    state = one_pass(problem, problem.prior.mean, problem.rough)[0]
    forget_surroundings(state)
    supposed = state.P.copy()
    state.current_at[:] = 0.1, 0.0, -0.02
    np.testing.assert_array_equal(state.water, 0.0)
    np.testing.assert_array_equal(state.P, supposed)
    forget_surroundings(state, 5.0)  # of the same water
    np.testing.assert_array_equal(state.current_at, [0.1, 0.0, -0.02])
    forget_surroundings(state)
    np.testing.assert_array_equal(state.current_at, 0.0)


def test_stretches_in_the_same_water_are_linearised_about_what_the_last_has_found() -> None:
    """A first stretch that is short has found nothing."""
    [samples] = _surge(8).samples
    cut = int(np.searchsorted(samples.t, samples.t[0] + 0.8))
    stretches = (samples.stretch(0, cut), samples.stretch(cut, len(samples)))
    session = replace(_surge(8).over(stretches), session=True)
    known = np.array([[0, 0.0, 20.0, 0.2, 0.1, 0.0]])
    levels = replace(session.rough, currents=known)
    state, _, _, currents = one_pass(session, session.prior.mean, levels)
    np.testing.assert_array_equal(state.current_at, known[0, 3:])
    np.testing.assert_allclose(currents[0, 3:], currents[1, 3:], atol=2e-3)
    assert currents[0, 2] < currents[1, 1]
    dives = replace(session, session=False)
    apart = one_pass(dives, dives.prior.mean, replace(levels, currents=np.array([[0, 0.0, 0.5, 0.3, 0.0, 0.0]])))[0]
    np.testing.assert_array_equal(apart.current_at, 0.0)  # nothing is known of the second


def test_of_recordings_that_begin_at_the_same_time_each_has_its_own_current() -> None:
    [samples] = _surge(8).samples
    two = _surge(8).over((samples, samples))
    known = np.array([[0, 0.0, 20.0, 0.1, 0.0, 0.0], [1, 0.0, 20.0, 0.2, 0.0, 0.0]])
    levels = replace(two.rough, currents=known)
    np.testing.assert_array_equal(one_pass(two, two.prior.mean, levels)[0].current_at, known[1, 3:])
    three = two.over((samples, samples, samples))  # of which pieces these are nobody can tell
    np.testing.assert_array_equal(one_pass(three, three.prior.mean, levels)[0].current_at, 0.0)


def _moving(place: tuple[float, float, float], current: Array, at: Array) -> JointState:
    """A filter in full motion that takes the water to flow so, and is linearised about another current."""
    vehicle = load_vehicle("vlbv300")
    prior = prior_of(vehicle, more=IMU_PLACE).only(("X_udot", "Y_vdot", "N_rdot", "X_uu", "Y_vv", *IMU_PLACE))
    theta = np.where(np.isin(prior.names, IMU_PLACE), 0.0, prior.mean)
    theta[-3:] = place
    levels = NoiseLevels(np.full(N_MEASURED, 0.01), np.full(6, 0.01))
    B = configuration_matrix(vehicle)
    settings = FilterSettings(current=True, biases=True)
    state = new_joint_state(np.array(vehicle.parameters), prior.free, theta, prior.std, B, levels, settings)
    state.x[:] = 0.0, 0.0, 0.0, 0.9, 0.05, -0.03, 0.4, 0.5, 0.3, -0.1, 0.1, -0.05, 0.4
    state.x[3:7] /= np.linalg.norm(state.x[3:7])
    state.tau[:] = 10.0, 5.0, -3.0, 0.2, 0.3, 1.0
    state.current[:], state.water[:], state.current_at[:] = current, current, at
    return state


def _stepped(current: Array, at: Array) -> Array:
    """The motion, and the pace of a DVL, after a step."""
    state = _moving((0.0, 0.0, 0.0), current, at)
    held = new_zero_order_hold(state.B.shape[1], np.zeros(state.B.shape[1]), 0.0)
    hold_force(held, 0.0, np.full(state.B.shape[1], 5.0))
    mean_forces_into(held, 0.0, state.mean_force)
    state.clock["started"] = 1.0
    assert take_row(state, held, 0.02, np.full(N_MEASURED, np.nan))
    return np.concatenate([state.x, [pace_of(state.x, state.water, state.rate, VELOCITY, k) for k in range(3)]])


def _accelerometer(place: tuple[float, float, float], current: Array, at: Array) -> Array:
    """What an accelerometer at a place is expected to show."""
    state = _moving(place, current, at)
    far = np.full(N_MEASURED, np.nan)
    far[12:15] = 1e4  # rejected, so that the innovation stays to be read
    update_specific_force(state, far)
    return np.asarray(far[12:15] - state.innovation)


@pytest.mark.parametrize(
    "shown", [_stepped, partial(_accelerometer, (0.0, 0.0, 0.0)), partial(_accelerometer, (0.3, 0.2, 0.1))]
)
def test_a_current_away_from_where_the_motion_is_linearised_counts_to_first_order(shown: Callable[..., Array]) -> None:
    """What is left is of second order: half as far away it is a quarter."""
    left = []
    for size in (0.1, 0.05):
        current = size * np.array([1.0, -0.7, 0.2])
        left.append(np.abs(shown(current, np.zeros(3)) - shown(current, current)).max())
    assert 0.0 < left[1] < 0.3 * left[0]


def test_only_a_current_that_surely_flows_is_linearised_about() -> None:
    """Near a current that is chance, the Munk moment would tell of the inertias."""
    problem = _surge(15)  # where passes that followed every current ended 7 % off at 24 deviations
    state, _, _, found = one_pass(problem, problem.prior.mean, problem.rough)
    deviation = np.sqrt(np.diag(state.P)[18:21])
    assert (np.abs(state.current) < 3.0 * deviation).all()
    np.testing.assert_array_equal(found[:, 3:], 0.0)
    for share, kept in ((2.9, 0.0), (6.0, 0.75), (30.0, 0.99)):
        state.current[:] = -share * deviation
        np.testing.assert_allclose(surely_flows(state.current, deviation**2), kept * state.current, atol=1e-12)


def test_what_later_pieces_say_of_earlier_ones_is_the_posterior_of_a_random_walk() -> None:
    """Against all pieces at once, of which the walk is the prior."""
    walk, noise = 0.02, 0.03  # m/s in 1 s, m/s
    ends = np.array([10.0, 20.0, 35.0, 37.0, 60.0])
    seen = np.random.default_rng(1).normal(0.5, 0.1, (len(ends), 3))
    grown = np.concatenate([[4.0], walk**2 * np.diff(ends)])  # variance of the first current, and of what is walked
    prior = np.array([[grown[: min(i, j) + 1].sum() for j in range(len(ends))] for i in range(len(ends))])
    whole = np.linalg.inv(np.linalg.inv(prior) + np.eye(len(ends)) / noise**2)
    mean, variance = whole @ seen / noise**2, np.diag(whole)

    water, at, var = [], np.zeros(3), np.zeros(3)
    for k, (end, value) in enumerate(zip(ends, seen, strict=True)):  # forwards, as a filter goes
        var = var + grown[k]
        gain = var / (var + noise**2)
        at, var = at + gain * (value - at), (1.0 - gain) * var
        water.append(np.concatenate([[0, end - 1.0, end], at, var]))
    for row, expected, left in zip(_smoothed(water, walk), mean, variance, strict=True):
        np.testing.assert_allclose(row[3:], surely_flows(expected, np.full(3, left)), rtol=1e-9)
        assert (row[3:] != 0.0).all()


def test_what_was_found_of_other_recordings_says_nothing_of_these() -> None:
    problem = _surge(8)
    elsewhere = np.array([[0, 100.0, 120.0, 0.1, 0.1, 0.1], [1, 0.0, -1.0, 0.1, 0.1, 0.1]])
    others = replace(problem.rough, currents=elsewhere)
    without, beside = (one_pass(problem, problem.prior.mean, each)[0] for each in (problem.rough, others))
    np.testing.assert_array_equal(without.theta, beside.theta)
