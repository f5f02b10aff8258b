"""Blocks of the joint filter beside motion and coefficients: waves, an attitude that wanders, losses by inflow.

Each goes over steps without a measurement, beside what is exact. Also run as plain Python.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_from_euler, rotation_from_euler
from towtank.core.layout import I_MASS, I_MASS_INVERSE, I_MOMENT, I_WEIGHT
from towtank.core.zero_order_hold import ZeroOrderHold, hold_force, new_zero_order_hold
from towtank.identification.data.samples import N_MEASURED, NoiseLevels, samples_of
from towtank.identification.kalman.filter import take_row
from towtank.identification.kalman.state import N_BIASES, N_WAVES, FilterSettings, JointState, new_joint_state
from towtank.identification.kalman.update import carried_along
from towtank.identification.model.parameters import N_FIXED, free_parameters
from towtank.simulation import simulate
from towtank.simulation.integration import lifted
from towtank.vehicle import Vehicle, configuration_matrix, load_vehicle
from towtank.vehicle.matrices import GRAVITY
from towtank.vehicle.records import Buoyancy

PERIOD, MEMORY = 6.0, 24.0  # s
H = 0.02  # s
LEVEL = np.array([0.10, 0.05, 0.02])  # m/s
NOTHING = np.full(N_MEASURED, np.nan)  # measured
STILL = NoiseLevels(np.full(N_MEASURED, 0.01), np.zeros(6), np.zeros(6), np.zeros(3))


def at_rest(vehicle: Vehicle, levels: NoiseLevels, settings: FilterSettings) -> tuple[JointState, ZeroOrderHold]:
    """A filter whose motion has begun at rest at the origin, nothing of it uncertain but its own blocks."""
    free = free_parameters(vehicle, ("inflow_loss",))
    B = configuration_matrix(vehicle)
    theta = free.theta(vehicle, delay=0.0, lag=0.0)
    state = new_joint_state(np.array(vehicle.parameters), free, theta, np.zeros(1), B, levels, settings)
    state.clock["started"] = 1.0
    held = new_zero_order_hold(B.shape[1], np.zeros(B.shape[1]), 0.0)
    hold_force(held, 0.0, np.zeros(B.shape[1]))
    held.clock[0] = 0.0
    return state, held


def advance(state: JointState, held: ZeroOrderHold, seconds: float, step: float = H) -> None:
    start = float(state.clock[0].time)
    for k in range(1, round(seconds / step) + 1):
        assert take_row(state, held, start + k * step, NOTHING)


# -- waves

WAVES = NoiseLevels(STILL.noise, STILL.disturbance, STILL.velocity_walk, LEVEL)
TURN = np.array([[-1.0 / MEMORY, -2.0 * np.pi / PERIOD], [2.0 * np.pi / PERIOD, -1.0 / MEMORY]])  # of one axis


def in_waves() -> tuple[JointState, ZeroOrderHold]:
    return at_rest(load_vehicle("vlbv300"), WAVES, FilterSettings(wave_period=PERIOD))


def with_one_centre(state: JointState) -> None:
    """Let it be neutrally buoyant: nothing lifts it but the water that moves."""
    state.p[I_WEIGHT : I_MOMENT + 3] = 0.0


def block(state: JointState, axis: int) -> Array:
    """Covariance (2, 2) of one axis of the waves and its quadrature."""
    rows = np.array([axis - N_WAVES, axis + 3 - N_WAVES])
    return np.asarray(state.P[np.ix_(rows, rows)])


@pytest.mark.parametrize("axis", range(3))
def test_second_moments_of_waves_are_those_of_the_complex_process(axis: int) -> None:
    """dC/dt = A C + C A^T + 2/T level^2, from any start; its solution is e^(At) (C0 - Ceq) e^(At)^T + Ceq."""
    state, held = in_waves()
    rows = np.array([axis - N_WAVES, axis + 3 - N_WAVES])
    start, mean = 0.01 * np.array([[3.0, 1.0], [1.0, 0.5]]), np.array([0.3, -0.2])
    state.P[np.ix_(rows, rows)] = start
    state.wave[[axis, 3 + axis]] = mean
    advance(state, held, 1.7)
    turned, equal = expm(1.7 * TURN), LEVEL[axis] ** 2 * np.eye(2)
    np.testing.assert_allclose(block(state, axis), turned @ (start - equal) @ turned.T + equal, atol=1e-12)
    np.testing.assert_allclose(state.wave[[axis, 3 + axis]], turned @ mean, atol=1e-12)
    assert state.water[axis] == state.wave[axis]


def test_waves_begin_as_they_stay_on_average() -> None:
    state, held = in_waves()
    before = state.P[-N_WAVES:, -N_WAVES:].copy()
    advance(state, held, 3.0)
    np.testing.assert_allclose(state.P[-N_WAVES:, -N_WAVES:], before, atol=1e-14)
    np.testing.assert_allclose(np.diag(before), np.tile(LEVEL**2, 2))


def test_waves_move_the_vehicle() -> None:
    """Water that goes to and fro takes it along: its path is the integral of the water's velocity."""
    state, held = in_waves()
    with_one_centre(state)
    state.wave[:] = [0.2, -0.1, 0.05, 0.0, 0.1, -0.05]
    start, seconds, step = state.wave.copy(), 2.5, 0.01
    advance(state, held, seconds, step)
    path = np.linalg.solve(TURN, expm(seconds * TURN) - np.eye(2))
    for axis in range(3):
        expected = (path @ start[[axis, 3 + axis]])[0]
        assert state.x[axis] == pytest.approx(expected, abs=0.005)
        assert abs(expected) > 0.02
    np.testing.assert_allclose(state.x[7:13], 0.0, atol=1e-12)  # not through the water


def test_the_path_is_as_uncertain_as_the_waves() -> None:
    """Var of int_0^t u ds of a stationary u: int int level^2 exp(-|s - r|/T) cos(omega (s - r))."""
    state, held = in_waves()
    with_one_centre(state)
    seconds = 2.5
    advance(state, held, seconds, 0.01)
    omega = 2.0 * np.pi / PERIOD

    def lag(d: float) -> float:
        return 2.0 * (seconds - d) * float(np.exp(-d / MEMORY) * np.cos(omega * d))

    def lead(d: float) -> float:  # the wave at the end, and the path until then
        return float(np.exp(-d / MEMORY) * np.cos(omega * d))

    spread, common = quad(lag, 0.0, seconds)[0], quad(lead, 0.0, seconds)[0]
    for axis in range(3):
        first = axis - N_WAVES
        assert state.P[axis, axis] == pytest.approx(LEVEL[axis] ** 2 * spread, rel=0.01)
        assert state.P[axis, first] == pytest.approx(LEVEL[axis] ** 2 * common, rel=0.02, abs=1e-5)
    np.testing.assert_array_equal(state.P, state.P.T)


def heavy_in_waves() -> tuple[JointState, ZeroOrderHold]:
    """A vehicle that is heavy at one end and floats at another, in full motion in waves that go on as they are."""
    state, held = in_waves()
    state.p[I_WEIGHT : I_MOMENT + 3] = (7.0, 0.9, -0.4, 2.3)
    state.settings["wave_decay"] = 0.0
    state.wave[:] = (0.08, -0.05, 0.03, -0.02, 0.06, 0.04)
    state.x[3:7] = quaternion_from_euler(0.3, -0.4, 1.1)
    state.x[7:13] = (0.3, -0.1, 0.2, 0.1, -0.2, 0.3)
    return state, held


def test_water_that_waves_accelerate_lifts_a_body_as_in_the_simulator() -> None:
    """Gravity along -dv_w/dt, between the centres of buoyancy and gravity: M times what comes of it is that wrench."""
    (state, held), (calm, held_in_calm) = heavy_in_waves(), heavy_in_waves()
    calm.wave[3:] = 0.0
    lift = -2.0 * np.pi / PERIOD * state.wave[3:] / GRAVITY
    mass = state.p[I_MASS:I_MASS_INVERSE].reshape(6, 6)
    attitude, h = state.x[3:7].copy(), 1e-4
    advance(state, held, h, h)
    advance(calm, held_in_calm, h, h)
    more = mass @ (state.x[7:13] - calm.x[7:13]) / h
    np.testing.assert_allclose(more, lifted(state.p, attitude, lift), rtol=1e-3, atol=1e-4)
    assert np.abs(more).max() > 0.01


@pytest.mark.parametrize("axis", range(3))
def test_a_body_is_as_uncertain_as_what_lifts_it(axis: int) -> None:
    """What differences of the motion say of a wave's quadrature, over a step, stands in the covariance."""
    motions, h = [], 1e-3
    for more in (0.0, 1.0):
        state, held = heavy_in_waves()
        state.wave[3 + axis] += more
        advance(state, held, h, h)
        motions.append(state.x[7:13].copy())
    state, held = heavy_in_waves()
    state.P[:] = 0.0
    row = 3 + axis - N_WAVES
    state.P[row, row] = 1.0
    advance(state, held, h, h)
    by_difference = (motions[1] - motions[0]) / h
    np.testing.assert_allclose(state.P[6:12, row] / h, by_difference, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(state.P[6:12, 6:12] / h**2, np.outer(by_difference, by_difference), rtol=5e-3, atol=1e-3)
    assert np.abs(by_difference).max() > 0.05


# -- an attitude that wanders


def test_the_bias_of_an_attitude_fades_and_comes_back_to_its_level() -> None:
    settings = FilterSettings(biases=True, wanders=True)
    state, held = at_rest(load_vehicle("vlbv300"), STILL, settings)
    first = N_FIXED + 1 + 6
    rows = slice(first, first + 3)
    level, memory, seconds = settings.record["attitude_bias"][0], 30.0, 6.0
    np.testing.assert_allclose(np.diag(state.P)[rows], level**2)
    start = np.diag(level**2) + 1e-3 * np.array([[4.0, 1.0, 0.0], [1.0, 2.0, -0.5], [0.0, -0.5, 1.0]])
    state.P[rows, rows] = start
    state.P[rows, 0] = state.P[0, rows] = cross = np.array([1e-3, -2e-3, 3e-3])
    state.bias[:] = np.arange(1.0, 10.0) * 1e-3
    before = state.bias.copy()
    advance(state, held, seconds)
    fade = np.exp(-seconds / memory)
    np.testing.assert_allclose(state.bias[6:], fade * before[6:], rtol=1e-12)
    np.testing.assert_array_equal(state.bias[:6], before[:6])
    expected = fade**2 * start + (1.0 - fade**2) * np.diag(level**2)
    np.testing.assert_allclose(state.P[rows, rows], expected, atol=1e-15)
    np.testing.assert_allclose(state.P[rows, 0], fade * cross, rtol=1e-9)
    np.testing.assert_array_equal(state.P, state.P.T)


def test_a_camera_s_attitude_does_not_wander() -> None:
    state, held = at_rest(load_vehicle("vlbv300"), STILL, FilterSettings(biases=True))
    state.bias[6:] = 1e-3
    advance(state, held, 1.0)
    first = N_FIXED + 1 + 6
    assert not state.P[first : first + 3].any()
    np.testing.assert_array_equal(state.bias[6:], 1e-3)
    assert state.P.shape[0] == N_FIXED + 1 + N_BIASES


# -- thrust lost with inflow


def loses(loss: float) -> Vehicle:
    return load_vehicle("vlbv300").with_coefficients({"inflow_loss": loss})


def by_the_filter(vehicle: Vehicle, believed: float, commands: Array) -> Array:
    """Velocity (n, 6) that the filter predicts, linearised about the vehicle's loss, at another one."""
    samples = samples_of(simulate(vehicle, commands=commands, dt=H), vehicle)
    state, held = at_rest(vehicle, STILL, FilterSettings())
    state.theta[0] = believed
    found = [np.zeros(6)]
    for k in range(len(samples) - 1):
        hold_force(held, samples.input_t[k], samples.input_force[k])
        linear = state.p[72:108].copy()
        assert take_row(state, held, float(samples.t[k + 1]), NOTHING)
        found.append(state.x[7:].copy())
        np.testing.assert_array_equal(state.p[72:108], linear)  # what thrusters lose stands in `p` for a row only
    return np.array(found)


def test_the_filter_loses_thrust_with_inflow_as_the_simulator_does() -> None:
    commands = np.tile([40.0, 35.0, 30.0, 45.0, 20.0, 25.0], (60, 1))
    commands[30:] *= -0.5
    truth, other, none = (
        samples_of(simulate(loses(loss), commands=commands, dt=H), loses(loss)).values[:, 6:12]
        for loss in (0.3, 0.32, 0.0)
    )
    np.testing.assert_allclose(by_the_filter(loses(0.3), 0.3, commands), truth, atol=1e-9)
    assert np.abs(truth - none).max() > 0.02
    # to first order in what it is away from where the motion is linearised
    away = np.abs(by_the_filter(loses(0.3), 0.32, commands) - other).max()
    assert away < 0.05 * np.abs(other - truth).max()


# -- an accelerometer


def test_an_accelerometer_says_nothing_of_a_scale_that_forces_and_inertias_have_in_common() -> None:
    """Thrusters that are on their way to another force: what they give now moves the vehicle, and counts, alike."""
    inertias = dict.fromkeys(("X_udot", "Y_vdot", "Z_wdot"), -3.0)
    inertias |= dict.fromkeys(("K_pdot", "M_qdot", "N_rdot"), -0.1)
    vehicle = load_vehicle("vlbv300").model_copy(update={"hydrodynamics": {}, "buoyancy": Buoyancy()})
    vehicle = vehicle.with_coefficients(inertias)
    gains = tuple(f"gain_{each.name}" for each in vehicle.thrusters)
    free, B = free_parameters(vehicle, (*inertias, *gains)), configuration_matrix(vehicle)
    theta = free.theta(vehicle, delay=0.0, lag=0.15)
    n = theta.size
    state = new_joint_state(np.array(vehicle.parameters), free, theta, 1e-2 * np.eye(n), B, STILL, FilterSettings())
    state.clock["started"] = 1.0
    held = new_zero_order_hold(len(gains), np.full(len(gains), 0.15), 0.0)
    hold_force(held, 0.0, np.zeros(len(gains)))
    held.clock[0] = 0.0
    hold_force(held, 0.05, np.linspace(4.0, 9.0, len(gains)))
    felt = NOTHING.copy()
    felt[12:15] = (0.0, 0.0, -9.81)
    for k in range(1, 6):
        assert take_row(state, held, 0.02 * k, NOTHING if k < 5 else felt)
    rows = state.H[:, N_FIXED : N_FIXED + n]
    assert np.abs(rows).max() > 0.05
    np.testing.assert_allclose(rows.sum(axis=1), 0.0, atol=1e-12)


def test_an_accelerometer_is_carried_along_by_waves() -> None:
    """As the path of its water says; and its row of H, as differences do."""
    state, held = in_waves()
    state.wave[:] = (0.08, -0.05, 0.03, -0.02, 0.06, 0.04)
    state.x[3:7] = quaternion_from_euler(0.3, -0.4, 1.1)
    state.H[:] = 0.0
    felt = np.array([carried_along(state, k) for k in range(3)])
    row, before, h = state.H.copy(), state.wave.copy(), 1e-4
    R = rotation_from_euler(0.3, -0.4, 1.1)
    settings = state.settings[0]
    settings.wave_decay = 0.0  # else the water is pushed as well, at random
    advance(state, held, h, h)
    np.testing.assert_allclose(felt, R.T @ (state.wave[:3] - before[:3]) / h, atol=1e-4)
    for j in range(N_WAVES):
        other, _ = in_waves()
        other.wave[:] = before
        other.wave[j] += 1.0
        other.x[3:7] = quaternion_from_euler(0.3, -0.4, 1.1)
        more = np.array([carried_along(other, k) for k in range(3)]) - felt
        np.testing.assert_allclose(row[:, j - N_WAVES], more, atol=1e-12)
