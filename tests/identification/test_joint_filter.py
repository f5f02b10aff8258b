"""The joint filter against a plain reference, and its behaviour with what sensors do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_product
from towtank.core.layout import N_PARAMETERS
from towtank.core.zero_order_hold import hold_force, mean_forces_into, new_zero_order_hold
from towtank.identification.data.samples import N_MEASURED, NoiseLevels, Samples, samples_of
from towtank.identification.kalman.filter import begin_motion, joint_events, rows_of, take_row
from towtank.identification.kalman.problem import inputs_of
from towtank.identification.kalman.state import FilterSettings, JointState, new_joint_state, transition_scratch
from towtank.identification.model.linearisation import step_and_linearise
from towtank.identification.model.measurements import ATTITUDE, NEVER, attitude_error
from towtank.identification.model.parameters import LATENCIES, N_FIXED, free_parameters
from towtank.identification.model.prior import prior_of
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle, configuration_matrix, load_vehicle

NAMES = ("X_udot", "Y_vdot", "X_uu", "N_rr", "BG_z")
NOISE = np.array([1e-3] * 6 + [5e-3] * 3 + [2e-3] * 3 + [0.05] * 3)
FORCE = np.array([0.5, 0.5, 0.5, 0.05, 0.05, 0.05])  # N, N m
SIGMA = FORCE / np.diag(load_vehicle("vlbv300").mass_matrix)  # m/s^2, rad/s^2


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("vlbv300")


def run_of(vehicle: Vehicle, sensors: Mocap | Ins, seconds: float = 8.0, seed: int = 4) -> Samples:
    move = manoeuvre("all-telegraph", vehicle, duration=seconds, dt=0.01, seed=2)
    force = OrnsteinUhlenbeck(std=tuple(FORCE), time_constant=2.0)
    run = simulate(vehicle, commands=move.commands, dt=0.01, sensors=sensors, disturbance=force, seed=seed)
    return samples_of(run, vehicle)


def filter_for(
    vehicle: Vehicle,
    names: tuple[str, ...] = NAMES,
    *,
    off: float = 0.2,
    settings: FilterSettings | None = None,
    B: Array,
) -> JointState:
    free = free_parameters(vehicle, names)
    theta = free.theta(vehicle, delay=0.0, lag=0.1)
    wide = np.array([0.5 if code[3] else 0.3 for code in free.codes])
    start = theta + np.where(free.codes[:, 3] > 0, off, 0.0)
    return new_joint_state(
        vehicle.parameters,
        free,
        start,
        wide,
        B,
        NoiseLevels(NOISE, SIGMA, np.zeros(6)),
        settings or FilterSettings(),
    )


def run_through(state: JointState, samples: Samples, last: int | None = None) -> JointState:
    held = new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
    end = len(samples) if last is None else last
    joint_events(state, held, rows_of(samples), 0, end, 0)
    return state


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (range(6), [0.3] * 3 + [1.0] * 3),  # the next attitudes tell every rate, however fast a stretch begins
        ((2,), [0.3] * 3 + [0.2] * 3),
        (range(12), [0.3] * 3 + [0.2] * 3),  # which are measured themselves
    ],
)
def test_a_stretch_may_begin_in_full_motion(vehicle: Vehicle, columns: Sequence[int], expected: list[float]) -> None:
    state = filter_for(vehicle, B=configuration_matrix(vehicle))
    held = new_zero_order_hold(state.B.shape[1], np.zeros(state.B.shape[1]), 0.0)
    hold_force(held, 0.0, np.zeros(state.B.shape[1]))
    row = np.full(N_MEASURED, np.nan)
    row[list(columns)] = 0.1
    begin_motion(state, held, 0.0, row)
    np.testing.assert_allclose(np.sqrt(np.diag(state.P)[6:12]), expected)


def sensed(t: Array, dvl: Array) -> Samples:
    """Rows of a gyro and an accelerometer, at the times `dvl` of a DVL, too, and of an attitude in the row before."""
    values = np.full((t.size, N_MEASURED), np.nan)
    values[:, 9:12], values[:, 12:15] = 0.02, (0.0, 0.0, -9.81)
    for k in np.searchsorted(t, dvl):
        values[k - 1, 3:6] = 0.1, 0.0, 2.0
        values[k, 6:9] = 0.4, -0.1, 0.05
    vehicle = load_vehicle("vlbv300")
    B = configuration_matrix(vehicle)
    m = B.shape[1]
    return Samples(t, values, np.zeros(1), np.zeros((1, m)), B, np.zeros(m), True)


@pytest.mark.parametrize(
    ("dvl", "speeds", "begins"),
    [
        ((0.4, 0.52), True, 0.4),  # at the first speed, for it is known that there are some
        ((0.4, 0.52), False, 0.0),  # at once, for nobody has seen any
        ((1.5,), True, 1.0),  # no longer than that
        ((), False, 0.0),
    ],
)
def test_a_motion_begins_at_a_speed_that_is_measured(
    vehicle: Vehicle, dvl: tuple[float, ...], speeds: bool, begins: float
) -> None:
    """With an accelerometer and a speed that nobody knows, drag and inertia would be read off at the wrong speed."""
    samples = sensed(0.01 * np.arange(200), np.array(dvl))
    state = filter_for(vehicle, B=samples.B)
    state.clock["speeds"] = speeds
    held = new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
    taken, k = 0, 0
    while not state.clock[0].started > 0.0:
        taken = joint_events(state, held, rows_of(samples), k, k + 1, taken)
        k += 1
    assert samples.t[k - 1] == pytest.approx(begins)
    if begins in dvl:
        np.testing.assert_allclose(state.x[7:10], (0.4, -0.1, 0.05), atol=1e-3)
        np.testing.assert_allclose(np.sqrt(np.diag(state.P)[6:9]), NOISE[6:9], rtol=0.01)
        psi = math.atan2(2.0 * (state.x[3] * state.x[6] + state.x[4] * state.x[5]), 1.0 - 2.0 * (state.x[6] ** 2))
        assert psi == pytest.approx(2.0, abs=0.05)  # shown a row before


def test_what_was_shown_long_before_the_inputs_were_known_does_not_begin_a_motion(vehicle: Vehicle) -> None:
    samples = sensed(0.01 * np.arange(400), np.array([0.5, 3.0]))
    samples.values[:60, 3:6] = 0.5, 0.0, -2.0
    late = replace(samples, input_t=np.array([2.6]))
    state = filter_for(vehicle, B=samples.B)
    state.clock["speeds"] = 1.0
    run_through(state, late, 301)
    assert state.clock[0].started > 0.0
    assert state.clock[0].time == pytest.approx(3.0)
    assert np.abs(state.shown[3:6] - (0.1, 0.0, 2.0)).max() < 1e-12


def test_a_heading_of_before_a_pause_does_not_begin_a_motion(vehicle: Vehicle) -> None:
    """While the motion waits for a speed, too: after a pause nothing is known of what was shown before."""
    samples = sensed(np.array([0.0, 30.0, 30.5, 31.0]), np.array([]))
    samples.values[0, 3:6] = 0.0, 0.0, 2.0
    state = filter_for(vehicle, B=samples.B)
    state.clock["speeds"] = 1.0
    run_through(state, samples)
    assert state.clock[0].started > 0.0
    assert state.clock[0].time == 31.0
    assert np.isnan(state.shown[3:6]).all()
    assert state.last_accepted[ATTITUDE] == NEVER


class Reference:
    """The same filter in plain NumPy: dense, Joseph's form, pose only, no gate, linearised about the start."""

    def __init__(self, vehicle: Vehicle, state: JointState, samples: Samples) -> None:
        self.samples, self.n = samples, state.theta.size
        self.p, self.codes, self.linearised_at = state.p.copy(), state.codes, state.linearised_at.copy()
        self.theta, self.P, self.x = state.theta.copy(), state.P.copy(), state.x.copy()
        self.disturbance = np.zeros(6)
        self.held = new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
        self.pushed = np.zeros((3, samples.B.shape[1]))

    def predict(self, t: float, h: float) -> None:
        mean_forces_into(self.held, t, self.pushed)
        F12, A, work, scratch = transition_scratch(self.n)
        fade = np.exp(-h / 2.0)
        mean = (1.0 - fade) * 2.0 / h
        step_and_linearise(
            self.p,
            self.x,
            self.samples.B @ self.pushed[0],
            mean * self.disturbance,
            np.zeros(3),
            h,
            0.5,
            self.codes,
            self.linearised_at,
            self.samples.B,
            self.pushed,
            F12,
            A,
            work,
            scratch,
        )
        F = np.eye(N_FIXED + self.n)
        F[:12] = F12
        F[12:18, 12:18] = fade * np.eye(6)
        self.shift(F[:12, N_FIXED:] @ (self.theta - self.linearised_at))
        Q = np.zeros_like(F)
        Q[12:18, 12:18] = np.diag(SIGMA**2 * (1.0 - fade**2))
        Q[6:12, 6:12] = 1e-8 * h * np.eye(6)
        self.P = F @ self.P @ F.T + Q
        self.disturbance = fade * self.disturbance

    def shift(self, e: Array) -> None:
        self.x[:3] += e[:3]
        self.x[7:] += e[6:12]
        angle = np.linalg.norm(e[3:6])
        half = np.concatenate([[np.cos(0.5 * angle)], e[3:6] * (np.sin(0.5 * angle) / angle if angle > 0 else 0.5)])
        self.x[3:7] = quaternion_product(self.x[3:7], half)
        self.x[3:7] /= np.linalg.norm(self.x[3:7])

    def update(self, z: Array) -> None:
        e = attitude_error(self.x[3:7], z[3], z[4], z[5])
        nu = np.concatenate([z[:3] - self.x[:3], e])
        H = np.zeros((6, self.P.shape[0]))
        H[:, :6] = np.eye(6)
        R = np.diag(NOISE[:6] ** 2)
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        keep = np.eye(len(self.P)) - K @ H
        self.P = keep @ self.P @ keep.T + K @ R @ K.T
        dx = K @ nu
        self.shift(dx[:12])
        self.disturbance += dx[12:18]
        self.theta += dx[N_FIXED:]


def test_the_filter_is_the_textbooks(vehicle: Vehicle) -> None:
    samples = run_of(vehicle, Mocap(jump_fraction=0.0), 1.5)
    never = FilterSettings(gate=1e9, huber=1e9)
    state = filter_for(vehicle, B=samples.B, settings=never)
    reference = Reference(vehicle, state, samples)
    held = new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
    taken = 0
    for i in range(17):  # until the linearisation point moves
        taken = joint_events(state, held, rows_of(samples), i, i + 1, taken)
        while reference.held.counters[0].received < held.counters[0].received:
            k = int(reference.held.counters[0].received)
            hold_force(reference.held, samples.input_t[k], samples.input_force[k])
        if i == 0:
            mean_forces_into(reference.held, samples.t[0], reference.pushed)
            reference.x, reference.P = state.x.copy(), state.P.copy()
            reference.disturbance = state.force.copy()
            reference.theta = state.theta.copy()
            continue
        reference.predict(samples.t[i], samples.t[i] - samples.t[i - 1])
        reference.update(samples.values[i])
        np.testing.assert_array_equal(state.linearised_at, reference.linearised_at)
        np.testing.assert_allclose(state.x, reference.x, atol=1e-9)
        np.testing.assert_allclose(state.theta, reference.theta, atol=1e-8)
        scale = np.sqrt(np.outer(np.diag(reference.P), np.diag(reference.P))) + 1e-12
        assert (np.abs(state.P - reference.P) / scale).max() < 1e-6


def test_covariance_stays_symmetric_and_positive(vehicle: Vehicle) -> None:
    samples = run_of(vehicle, Mocap())
    state = run_through(filter_for(vehicle, B=samples.B), samples)
    np.testing.assert_array_equal(state.P, state.P.T)
    active = np.diag(state.P) > 0.0
    assert np.linalg.eigvalsh(state.P[np.ix_(active, active)]).min() > 0.0
    assert state.clock[0].rows == len(samples) - 1


def test_after_hours_with_everything_unknown_the_covariance_is_one(vehicle: Vehicle) -> None:
    """Two hours, every coefficient of the prior free, late sensors, biases, current and waves."""
    dt, hours = 0.1, 2.0
    push = np.random.default_rng(5).uniform(-40.0, 40.0, (round(hours * 1800.0), len(vehicle.thrusters)))
    commands = np.repeat(push, 20, axis=0)  # 2 s each
    water = OrnsteinUhlenbeck(std=tuple(FORCE), time_constant=2.0)
    log = simulate(vehicle, commands=commands, dt=dt, sensors=Ins(), disturbance=water, seed=1)
    samples = samples_of(log, vehicle)
    prior = prior_of(vehicle, more=(LATENCIES[0], LATENCIES[2]))
    levels = NoiseLevels(NOISE, SIGMA, np.zeros(6), np.full(3, 0.05))
    settings = FilterSettings(biases=True, wanders=True, current=True, step=dt)
    p = np.array(vehicle.with_coefficients(prior.vehicle_values).parameters)
    state = new_joint_state(p, prior.free, prior.mean, prior.covariance, samples.B, levels, settings)
    joint_events(state, inputs_of(samples, prior.free, prior.mean, 0.0), rows_of(samples), 0, len(samples), 0)
    assert state.clock[0].duration > 0.99 * 3600.0 * hours
    assert len(prior.free) > 50
    assert state.P.shape[0] == N_FIXED + len(prior.free) + 9 + 6
    assert np.isfinite(state.theta).all()
    assert np.isfinite(state.x).all()
    np.testing.assert_array_equal(state.P, state.P.T)
    std = np.sqrt(np.diag(state.P))
    assert std.min() > 0.0
    assert np.linalg.eigvalsh(state.P / np.outer(std, std)).min() > 0.0
    assert (std[N_FIXED : N_FIXED + len(prior.free)] <= prior.std * (1.0 + 1e-9)).all()


def test_one_by_one_is_as_all_at_once(vehicle: Vehicle) -> None:
    samples = run_of(vehicle, Ins(), 4.0)
    whole = run_through(filter_for(vehicle, B=samples.B, settings=FilterSettings(biases=True)), samples)
    state = filter_for(vehicle, B=samples.B, settings=FilterSettings(biases=True))
    held = new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
    k = 0
    for t, z in zip(samples.t, samples.values, strict=True):
        while k < len(samples.input_t) and samples.input_t[k] <= t:
            hold_force(held, samples.input_t[k], samples.input_force[k])
            k += 1
        take_row(state, held, t, z)
    for a, b in zip(whole[:7], state[:7], strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("sensors", [Mocap(), Ins()])
def test_errors_are_as_large_as_the_filter_says(vehicle: Vehicle, sensors: Mocap | Ins) -> None:
    squares = []
    for seed in range(6):
        samples = run_of(vehicle, sensors, 12.0, seed=seed)
        biases = isinstance(sensors, Ins)
        settings = FilterSettings(biases=biases)
        state = run_through(filter_for(vehicle, off=0.02, B=samples.B, settings=settings), samples)
        free = free_parameters(vehicle, NAMES)
        n = len(free)
        error = state.theta - free.theta(vehicle, delay=0.0, lag=0.1)
        block = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n]
        squares.append(error @ np.linalg.solve(block, error) / n)
    # 6 runs of 5 coefficients: chi squared with 30 degrees of freedom, over 30
    assert 0.3 < np.mean(squares) < 2.2


def test_a_lost_marker_is_rejected_and_a_moved_origin_taken_up(vehicle: Vehicle) -> None:
    samples = run_of(vehicle, Mocap(jump_fraction=0.0), 6.0)
    values = samples.values.copy()
    values[200:230, :3] += 0.04  # 0.3 s: a jump
    values[400:, :3] += 0.3  # for good
    moved = Samples(samples.t, values, samples.input_t, samples.input_force, samples.B, samples.lag, True)
    clean = run_through(filter_for(vehicle, B=samples.B), samples)
    state = run_through(filter_for(vehicle, B=samples.B), moved)
    assert 25 <= state.statistics[0].rejected - clean.statistics[0].rejected <= 30 + 75
    assert state.clock[0].resets == 1.0
    std = np.sqrt(np.diag(clean.P)[N_FIXED:])
    assert (np.abs(state.theta - clean.theta) < 1.0 * std + 1e-3).all()
    np.testing.assert_allclose(state.x[:3] - clean.x[:3], 0.3, atol=0.01)


def test_rows_out_of_order_and_without_numbers_change_nothing(vehicle: Vehicle) -> None:
    samples = run_of(vehicle, Mocap(), 3.0)
    state = filter_for(vehicle, B=samples.B)
    held = new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
    joint_events(state, held, rows_of(samples), 0, 100, 0)
    before = state.theta.copy(), state.P.copy()
    assert not take_row(state, held, float(samples.t[50]), samples.values[50])
    assert not take_row(state, held, float("nan"), samples.values[50])
    np.testing.assert_array_equal(state.theta, before[0])
    np.testing.assert_array_equal(state.P, before[1])
    nothing = np.full(N_MEASURED, np.nan)
    assert take_row(state, held, float(samples.t[100]), nothing)
    assert np.isfinite(state.P).all()
    assert np.isfinite(state.x).all()


def test_after_a_long_gap_the_motion_begins_anew_and_coefficients_stay(vehicle: Vehicle) -> None:
    samples = run_of(vehicle, Mocap(), 6.0)
    state = run_through(filter_for(vehicle, B=samples.B), samples, 300)
    theta = state.theta.copy()
    held = new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
    hold_force(held, samples.t[-1], samples.input_force[-1])
    z = samples.values[-1] + 5.0
    assert not take_row(state, held, float(samples.t[-1] + 60.0), z)
    np.testing.assert_allclose(state.theta, theta, atol=1e-12)
    np.testing.assert_allclose(state.x[:3], z[:3], atol=1e-2)


def test_the_kernel_vector_has_the_coefficients(vehicle: Vehicle) -> None:
    samples = run_of(vehicle, Mocap(), 5.0)
    state = run_through(filter_for(vehicle, B=samples.B), samples)
    assert state.p.size == N_PARAMETERS
    free = free_parameters(vehicle, NAMES)
    k = free.names.index("X_udot")
    assert state.p[0] == pytest.approx(np.exp(state.linearised_at[k]))


@pytest.mark.parametrize("heading_alone", [False, True])
def test_a_heading_that_comes_after_the_motion_began_is_taken_as_it_is(vehicle: Vehicle, heading_alone: bool) -> None:
    """Logs have rates and attitude in rows of their own, and which comes first is chance; nor is there a best north."""
    samples = run_of(vehicle, Ins())
    values = np.full_like(samples.values, np.nan)
    values[:, 9:12] = samples.values[:, 9:12]
    values[4::10] = np.nan
    first = 5 if heading_alone else 3
    values[4::10, first:6] = samples.values[4::10, first:6]
    states = []
    for north in (1.1, -2.2):
        values[4::10, 5] = samples.values[4::10, 5] + north
        states.append(run_through(filter_for(vehicle, B=samples.B), replace(samples, values=values)))
    there, turned = states
    assert turned.statistics["rejected"][5] == there.statistics["rejected"][5]
    assert turned.clock[0].log_likelihood == pytest.approx(there.clock[0].log_likelihood, rel=1e-6)
    ahead = quaternion_product(np.array([np.cos(1.65), 0.0, 0.0, -np.sin(1.65)]), there.x[3:7])
    assert abs(float(ahead @ turned.x[3:7])) == pytest.approx(1.0, abs=1e-9)


def test_an_accelerometer_that_is_rejected_costs_as_other_sensors_do(vehicle: Vehicle) -> None:
    """Else a model that contradicts it would be likelier than one that does not."""
    samples = run_of(vehicle, Ins(), 2.0)
    felt, none = samples.values.copy(), samples.values.copy()
    none[100:, 12:15] = np.nan
    felt[100:, 12] = 1e3
    worth = []
    for values in (felt, none):
        state = run_through(filter_for(vehicle, B=samples.B), replace(samples, values=values))
        worth.append(state.clock[0].log_likelihood)
    rejected = len(samples) - 100
    gate, cap = FilterSettings().gate, FilterSettings().huber
    assert (worth[1] - worth[0]) / rejected == pytest.approx(
        1.5 * (cap * (2.0 * gate - cap) + 2.0 * np.log(0.05)), rel=0.2
    )
