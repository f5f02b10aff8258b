"""Coefficients that are considered but not updated: left as they are while little is learned of them."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.identification import Learner
from towtank.identification.data.samples import N_MEASURED, NoiseLevels
from towtank.identification.kalman.state import FilterSettings, JointState, new_joint_state
from towtank.identification.kalman.update import look_ahead, product_of_rows, update
from towtank.identification.model.parameters import N_FIXED, free_parameters
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate

from .runs import TRUTH, box, unknown, waves

NAMES = ("X_udot", "X_uu", "N_rdot", "N_rr")
DT = 0.05
LEARNED, HELD, AGAIN = 140.0, 400.0, 60.0  # s
FORCE = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.02, 0.02, 0.02), time_constant=2.0)


def state_with(P: Array, is_considered: tuple[int, ...]) -> JointState:
    vehicle = box()
    free = free_parameters(vehicle, NAMES)
    theta = free.theta(vehicle, delay=0.0, lag=0.0)
    state = new_joint_state(
        np.array(vehicle.parameters), free, theta, np.ones(len(free)), np.eye(6),
        NoiseLevels(np.full(N_MEASURED, 0.1), np.ones(6), np.zeros(6)), FilterSettings(),
    )  # fmt: skip
    state.P[:] = P
    for k in is_considered:
        state.active[N_FIXED + k] = 0.0
    return state


def take_one(state: JointState, row: Array, residual: float) -> None:
    """Update by one number of the first sensor, whose H is `row` (N,)."""
    state.H[0] = row
    look_ahead(state, 0, residual)
    update(state, np.array([1.0, np.nan, np.nan]), 0)


def test_the_covariance_of_one_that_is_considered_is_josephs_with_its_gain_left_out() -> None:
    random = np.random.default_rng(3)
    size = N_FIXED + len(NAMES)
    root = random.standard_normal((size, size))
    P = root @ root.T / size
    is_considered = (1, 3)
    state = state_with(P, is_considered)
    row = random.standard_normal(size)
    take_one(state, row, 0.2)
    R = 0.1**2
    S = row @ P @ row + R
    gain = P @ row / S
    gain[[N_FIXED + k for k in is_considered]] = 0.0
    keep = np.eye(size) - np.outer(gain, row)
    np.testing.assert_allclose(state.P, keep @ P @ keep.T + R * np.outer(gain, gain), atol=1e-12)
    np.testing.assert_allclose(state.dx, 0.2 * gain, atol=1e-12)
    np.testing.assert_array_equal(state.P, state.P.T)
    assert np.linalg.eigvalsh(state.P).min() > 0.0


def test_three_numbers_at_once_are_three_one_after_the_other() -> None:
    random = np.random.default_rng(4)
    size = N_FIXED + len(NAMES)
    root = random.standard_normal((size, size))
    P, rows, residuals = root @ root.T / size, random.standard_normal((3, size)), np.array([0.02, -0.01, 0.03])
    for is_considered in ((), (0, 2)):
        one, other = state_with(P, is_considered), state_with(P, is_considered)
        one.H[:] = rows
        for k in range(3):
            look_ahead(one, k, residuals[k])
            take_one(other, rows[k], residuals[k])
        update(one, np.ones(3), 0)
        np.testing.assert_allclose(one.P, other.P, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(one.dx, other.dx, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(one.P, one.P.T)
        assert one.clock[0].log_likelihood == pytest.approx(other.clock[0].log_likelihood, rel=1e-9)


def test_a_motion_that_has_diverged_and_what_is_not_measured_change_nothing() -> None:
    random = np.random.default_rng(6)
    size = N_FIXED + len(NAMES)
    root = random.standard_normal((size, size))
    for lost in (False, True):
        state = state_with(root @ root.T / size, ())
        state.G[:], state.innovation[:], state.variance[:] = np.inf, np.nan, -1.0  # of a row before
        if lost:
            state.P[:N_FIXED, :N_FIXED] = np.nan
        before, rows = state.P.copy(), random.standard_normal((3, size)) * (np.arange(size) < N_FIXED)
        z = np.array([1.0, 2.0, 3.0]) if lost else np.full(3, np.nan)
        state.H[:] = rows if lost else 0.0
        for k in range(3 if lost else 0):
            look_ahead(state, k, 0.1)
        update(state, z, 0)
        assert (state.dx == 0.0).all()
        np.testing.assert_array_equal(state.P, before)


def test_what_was_gained_is_the_fall_of_the_logarithm_of_the_variance() -> None:
    random = np.random.default_rng(5)
    size = N_FIXED + len(NAMES)
    root = random.standard_normal((size, size))
    state = state_with(root @ root.T / size, ())
    before = np.diag(state.P)[N_FIXED:].copy()
    take_one(state, 1e-3 * random.standard_normal(size), 0.0)
    fell = np.log(before / np.diag(state.P)[N_FIXED:])
    np.testing.assert_allclose(state.information_rate, fell, rtol=1e-3)


def test_a_vehicle_that_is_held_in_place_learns_nothing_wrong_and_goes_on_when_it_moves() -> None:
    vehicle = box()
    n, held, again = (round(seconds / DT) for seconds in (LEARNED, HELD, AGAIN))
    wrench = waves(n + held + again, DT, (0, 15.0, 0.5), (5, 1.0, 0.4), square=True)
    wrench[n : n + held] *= 0.01
    run = simulate(vehicle, wrench=wrench, dt=DT, sensors=Mocap(jump_fraction=0.0), disturbance=FORCE, seed=2)
    others = {name: value for name, value in TRUTH.items() if name not in NAMES}
    alone = {"X_u": -1e-9, "N_r": -1e-9}  # drag is quadratic alone
    learner = Learner(unknown(vehicle, **others, **alone), free=NAMES, changes=False)

    def known() -> tuple[Array, Array]:
        return np.array(learner.estimate.values), np.array(learner.estimate.std)

    channels = {name: run[name] for name in ("x", "y", "z", "phi", "theta", "psi")}
    readings = {}
    for k in range(n + held + again):
        pose = [channels[name].values[k] for name in channels]
        learner.update(k * DT, pose=pose, wrench=wrench[k])
        if k in (n, n + round(60.0 / DT), n + held - 1):
            readings[k] = known()
    truth = np.array([TRUTH[name] for name in learner.estimate.names])
    (_, (calm, spread), (after, still)), (last, least) = readings.values(), known()
    assert np.all(np.abs(after - calm) < 2.0 * spread)
    assert np.all(still < 1.5 * spread)
    assert np.all(np.abs(after - truth) < 4.0 * still)
    assert np.all(least < 1.1 * still)
    assert np.median(least / still) < 0.95
    assert np.all(np.abs(last - truth) < 4.0 * least)


def test_sums_in_any_order_are_the_sums() -> None:
    random = np.random.default_rng(1)
    A, B = random.standard_normal((2, 5, 77))
    for size in (0, 1, 3, 64, 77):
        assert product_of_rows(A, 2, B, 4, size) == pytest.approx(A[2, :size] @ B[4, :size], rel=1e-12, abs=1e-15)
    A[2, 1] = np.nan
    assert np.isnan(product_of_rows(A, 2, B, 4, 77))
