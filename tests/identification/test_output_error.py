"""Output error against scipy on the same residuals, and the truth found again from many kinds of recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.identification.runs import TRUTH, box

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import new_zero_order_hold
from towtank.identification.data.samples import N_MEASURED, Samples, samples_of
from towtank.identification.model.parameters import FreeParameters, free_parameters
from towtank.identification.simulation_error.fit import OutputErrorFit, fit_output_error
from towtank.identification.simulation_error.residuals import HUBER
from towtank.identification.simulation_error.segments import CandidateModel, FreeRun, free_run_of
from towtank.identification.simulation_error.trajectory import (
    Unknowns,
    free_run_into,
    new_equations,
    new_workspace,
)
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate, stream
from towtank.simulation.sensors.mocap import intervals
from towtank.vehicle import Vehicle, load_vehicle

DT = 0.01
SURGE = ("X_udot", "X_uu")
YAW = ("N_rdot", "N_rr")
ALL = (*TRUTH, "BG_z")
POSE, RATES = range(6), range(9, 12)
NOISE = np.array([1e-3] * 6 + [5e-3] * 3 + [2e-3] * 3 + [2e-2] * 3 + [5e-3] * 3)


def push(n: int, *axes: int, period: float = 4.0) -> Array:
    """Square waves (n, 6) of incommensurate periods on some axes, after half a second of rest."""
    size = np.array([20.0, 25.0, 25.0, 0.4, 0.4, 2.0])
    t = DT * np.arange(n)
    out = np.zeros((n, 6))
    for axis in axes:
        out[:, axis] = size[axis] * np.sign(np.sin(2.0 * np.pi * t / (period * (1.0 + 0.17 * axis)) + 0.4 * axis))
    out[: round(0.5 / DT)] = 0.0
    return out


def recorded(vehicle: Vehicle, wrench: Array, *, seed: int = 0, noise: Array = NOISE, **more: object) -> Samples:
    """Every column measured with white noise, but those of velocity through the water."""
    samples = samples_of(simulate(vehicle, wrench=wrench, dt=DT, seed=seed, **more), vehicle)  # type: ignore[arg-type]
    values = samples.values.copy()
    values[:, :15] += noise[:15] * np.random.default_rng(seed).standard_normal((len(values), 15))
    return replace(samples, values=values)


def only(samples: Samples, columns: object) -> Samples:
    """The same with nothing but these columns measured."""
    values = np.full_like(samples.values, np.nan)
    values[:, list(columns)] = samples.values[:, list(columns)]  # type: ignore[call-overload]
    return replace(samples, values=values)


def start(free: FreeParameters, truth: Array, factor: float) -> Array:
    """Every coefficient too large or too small by a factor, in turn."""
    side = np.where(np.arange(len(free)) % 2 == 0, factor, 1.0 / factor)
    return np.where(free.codes[:, 3] != 0, truth + np.log(side), truth * side)


def fitted(
    samples: Samples | list[Samples], vehicle: Vehicle, names: tuple[str, ...], *, factor: float = 1.3, **more: object
) -> tuple[OutputErrorFit, Array]:
    """The fit and the truth."""
    free = free_parameters(vehicle, names)
    truth = free.theta(vehicle, delay=0.0, lag=0.0)
    recordings = samples if isinstance(samples, list) else [samples]
    noise = more.pop("noise", NOISE)
    model = CandidateModel(vehicle, free, start(free, truth, factor))
    fit = fit_output_error(recordings, model, noise, **more)  # type: ignore[arg-type]
    return fit, truth


def assert_found(fit: OutputErrorFit, truth: Array, *, within: float = 4.0, deviation: float = np.inf) -> None:
    std = np.sqrt(np.diag(fit.covariance))
    assert fit.converged
    assert np.isfinite(std).all()
    assert (np.abs(fit.theta - truth) < within * std).all(), (fit.theta - truth) / std
    assert (std < deviation * np.where(np.abs(truth) > 5.0, np.abs(truth), 1.0)).all(), std  # of damping a share


class Plain:
    """The weighted residuals of a whole run as a function of coefficients and initial errors, for scipy."""

    def __init__(self, samples: Samples, vehicle: Vehicle, free: FreeParameters, states: Array) -> None:
        self.run: FreeRun = free_run_of(samples, NOISE, None, 0.5, False)
        self.parameters, self.free, self.state = vehicle.parameters.copy(), free, states[0]

    def __call__(self, x: Array) -> Array:
        state = self.state.copy()
        state[[0, 7]] += x[:2]
        out = new_equations(1, int(self.run.block.max()) + 1, self.run.t.size, 12 + len(self.free))
        space = new_workspace(12 + len(self.free), len(self.free), self.run.B.shape[1])
        hold, every = new_zero_order_hold(self.run.lag.size, self.run.lag, 0.0), np.arange(12)
        unknowns = Unknowns(self.free.codes, x[2:], state[None, :], every, every)
        assert free_run_into(self.run, self.parameters, unknowns, hold, np.ones(N_MEASURED), False, out, space)
        return np.asarray(out.residuals[:, 0])


def test_theta_and_information_are_those_of_scipy() -> None:
    vehicle = box()
    samples = only(recorded(vehicle, push(1500, 0), seed=3), [0])
    free = free_parameters(vehicle, SURGE)
    truth = free.theta(vehicle, delay=0.0, lag=0.0)
    noise = 1.1 * NOISE  # a little more than there is: the scale of the residuals stays at 1
    fit = fit_output_error([samples], CandidateModel(vehicle, free, start(free, truth, 1.2)), noise)
    residuals = Plain(samples, vehicle, free, fit.states)
    residuals.run = residuals.run._replace(noise=noise)
    x0 = np.append(np.zeros(2), truth)
    other = least_squares(residuals, x0, jac="3-point", loss="huber", f_scale=HUBER, x_scale="jac", xtol=1e-12)
    std = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(fit.theta - other.x[2:]) < 0.1 * std)
    assert fit.cost == pytest.approx(other.cost, rel=1e-4)
    r = residuals(other.x)
    J = np.column_stack([(residuals(other.x + e) - residuals(other.x - e)) / 2e-6 for e in 1e-6 * np.eye(4)])
    H = J.T @ (np.minimum(1.0, HUBER / np.abs(r))[:, None] * J)
    information = H[2:, 2:] - H[2:, :2] @ np.linalg.solve(H[:2, :2], H[:2, 2:])
    np.testing.assert_allclose(fit.information, information, rtol=0.01)
    np.testing.assert_allclose(std, np.sqrt(np.diag(np.linalg.inv(information))), rtol=0.35)


@pytest.mark.parametrize("factor", [0.6, 0.8, 1.5])
def test_a_single_axis_from_its_position(factor: float) -> None:
    fit, truth = fitted(only(recorded(box(), push(1500, 0)), [0]), box(), SURGE, factor=factor)
    assert_found(fit, truth, deviation=0.01)
    assert fit.residual_std[0] == pytest.approx(NOISE[0], rel=0.1)
    assert np.isnan(fit.residual_std[1:]).all()
    assert fit.autocorrelation.time[0] < 2.0 * fit.autocorrelation.step[0] == pytest.approx(2.0 * DT)


def test_all_axes_at_once_from_the_pose() -> None:
    vehicle = box()
    fit, truth = fitted(only(recorded(vehicle, push(4000, *range(6))), POSE), vehicle, ALL, factor=1.2)
    assert_found(fit, truth, deviation=0.05)


@pytest.mark.parametrize(
    "names, columns, axes",
    [(YAW, RATES, (5,)), (YAW, [5], (5,)), (SURGE, [6], (0,)), (("K_pdot", "K_pp", "BG_z"), RATES, (3,))],
)
def test_few_columns_are_enough(names: tuple[str, ...], columns: object, axes: tuple[int, ...]) -> None:
    fit, truth = fitted(only(recorded(box(), push(2500, *axes)), columns), box(), names, factor=1.25)
    assert_found(fit, truth, deviation=0.1)


def test_heading_that_turns_round_and_round() -> None:
    vehicle = box()
    wrench = push(2500, 0)
    wrench[50:, 5] = 1.0
    samples = only(recorded(vehicle, 0.5 * wrench), POSE)
    assert np.ptp(samples.values[:, 5]) > 2.0 * np.pi
    samples.values[:, 5] = np.mod(samples.values[:, 5] + np.pi, 2.0 * np.pi) - np.pi
    fit, truth = fitted(samples, vehicle, (*SURGE, "N_rr"), factor=1.3)
    assert_found(fit, truth, deviation=0.05)


def test_rows_of_several_rates_irregular_and_with_gaps() -> None:
    vehicle = box()
    samples = recorded(vehicle, push(4000, *range(6)))
    generator = np.random.default_rng(1)
    values = samples.values.copy()
    rows = np.arange(len(samples))
    values[rows % 13 != 0, 0:3] = np.nan
    values[rows % 7 != 3, 3:6] = np.nan
    values[rows % 11 != 5, 6:9] = np.nan
    values[generator.random(values.shape) < 0.1] = np.nan
    kept = ~((samples.t > 12.0) & (samples.t < 14.5)) & (generator.random(len(samples)) > 0.2)
    samples = replace(samples, t=samples.t[kept], values=values[kept])
    fit, truth = fitted(samples, vehicle, ALL)
    assert len(fit.states) == 2
    assert_found(fit, truth, deviation=0.1)


def test_segments_and_recordings_begin_where_they_do() -> None:
    vehicle = box()
    parts = [only(recorded(vehicle, push(2000, 0), seed=s, nu0=(0.3 * s, 0, 0, 0, 0, 0)), POSE) for s in (0, 1)]
    fit, truth = fitted(parts, vehicle, SURGE, segment=5.0)
    assert_found(fit, truth, deviation=0.02)
    assert fit.states.shape == (8, 13)
    assert fit.states[4, 7] == pytest.approx(0.3, abs=0.01)


def test_delay_lag_and_gains_from_a_cold_start() -> None:
    start_vehicle = load_vehicle("vlbv300")
    slow = tuple(t.model_copy(update={"time_constant": 0.1}) for t in start_vehicle.thrusters)
    vehicle = start_vehicle.model_copy(update={"thrusters": slow, "command_delay": 0.15})
    commands = manoeuvre("all-multisine", vehicle, duration=30.0, dt=DT).commands
    samples = samples_of(simulate(vehicle, commands=commands, dt=DT, sensors=Mocap()), vehicle)
    names = ("X_udot", "Y_vdot", "N_rdot", "X_uu", "Y_vv", "N_rr", "delay", "lag")
    free = free_parameters(vehicle, names)
    truth = free.theta(vehicle, delay=0.15, lag=0.1)
    begin = free.theta(vehicle, delay=0.0, lag=0.03)
    begin[:3] += np.log([1.2, 0.8, 1.2])
    begin[3:6] *= [0.8, 1.2, 0.8]
    std = np.concatenate([np.full(3, 0.25), np.abs(begin[3:6]), [0.06, 0.08]])
    known = (begin, np.diag(std**-2.0))
    model, noise = CandidateModel(vehicle, free, begin), np.full(N_MEASURED, 1e-3)
    fit = fit_output_error([samples], model, noise, prior=known, iterations=40)
    assert_found(fit, truth, deviation=0.1)
    assert fit.theta[6] == pytest.approx(0.15, abs=0.005)


def test_gains_of_single_thrusters() -> None:
    vehicle = load_vehicle("vlbv300")
    weak = f"gain_{vehicle.thrusters[0].name}"
    commands = manoeuvre("all-multisine", vehicle, duration=30.0, dt=DT).commands
    samples = samples_of(simulate(vehicle, commands=commands, dt=DT, sensors=Mocap()), vehicle)
    samples = replace(samples, input_force=samples.input_force / np.where(np.arange(len(vehicle.thrusters)), 1.0, 0.8))
    free = free_parameters(vehicle, (weak, "N_rr"))
    truth = np.array([np.log(0.8), free.theta(vehicle, delay=0.0, lag=0.0)[1]])
    begin = CandidateModel(vehicle, free, truth - np.array([np.log(0.8), 0.2]))
    fit = fit_output_error([samples], begin, np.full(N_MEASURED, 1e-3))
    assert_found(fit, truth, deviation=0.05)


def test_an_inertial_set_at_its_own_rates() -> None:
    vehicle = box()
    quiet = Ins(gyro_bias=0.0, accelerometer_bias=0.0)
    samples = samples_of(simulate(vehicle, wrench=push(4000, *range(6)), dt=DT, sensors=quiet), vehicle)
    noise = np.array([5e-3] * 3 + [2e-3, 2e-3, 5e-3] + [5e-3] * 3 + [2e-3] * 3 + [2e-2] * 3 + [5e-3] * 3)
    fit, truth = fitted(samples, vehicle, ALL, noise=noise)
    assert_found(fit, truth, deviation=0.05)


def test_hidden_markers_have_no_say() -> None:
    vehicle, often = box(), Mocap(jump_fraction=0.05)
    for seed in (1, 3, 5):
        samples = samples_of(simulate(vehicle, wrench=push(1000, 0), dt=DT, sensors=often, seed=seed), vehicle)
        outage = intervals(samples.t, often.jump_fraction, often.jump_s, stream(seed, "mocap", "jumps")) >= 0
        fit, _ = fitted(samples, vehicle, SURGE, noise=np.full(N_MEASURED, 1e-3))
        seen = samples.values.copy()
        seen[outage, :3] = np.nan
        best, _ = fitted(replace(samples, values=seen), vehicle, SURGE, noise=np.full(N_MEASURED, 1e-3))
        assert_found(fit, best.theta, within=1.0, deviation=0.01)
        assert 0.4 * outage.mean() <= fit.rejected < outage.mean() + 0.01


def test_intervals_hold_the_truth_and_a_random_force_widens_them() -> None:
    vehicle, n, runs = box(), 1000, 40
    force = OrnsteinUhlenbeck(std=0.5, time_constant=0.5, axes=("X",))
    inside, widths = {}, {}
    for name, disturbance in (("white", None), ("coloured", force)):
        z, width = [], []
        for seed in range(runs):
            samples = only(recorded(vehicle, push(n, 0), seed=seed, disturbance=disturbance), [0])
            fit, truth = fitted(samples, vehicle, SURGE, factor=1.2)
            std = np.sqrt(np.diag(fit.covariance))
            z.append((fit.theta - truth) / std)
            width.append(std)
        inside[name], widths[name] = np.mean(np.abs(z) < 1.96), np.median(width, axis=0)
    assert 0.88 <= inside["white"] <= 1.0
    assert (widths["coloured"] > 3.0 * widths["white"]).all()
    assert inside["coloured"] > 0.6, inside


def test_a_prior_is_information() -> None:
    vehicle = box()
    samples = only(recorded(vehicle, push(1000, 0)), [0])
    free, (plain, truth) = free_parameters(vehicle, SURGE), fitted(samples, vehicle, SURGE)
    strong = (truth + np.array([0.3, 0.0]), np.diag([1e12, 0.0]))
    held = fit_output_error([samples], CandidateModel(vehicle, free, truth), NOISE, prior=strong)
    assert held.theta[0] == pytest.approx(truth[0] + 0.3, abs=1e-3)
    assert held.covariance[0, 0] < 1e-2 * plain.covariance[0, 0]
    np.testing.assert_allclose(held.information - [[1e12, 0.0], [0.0, 0.0]], held.information - strong[1])


def test_a_start_near_the_data_is_not_led_off_by_the_prior() -> None:
    vehicle = box()
    samples = only(recorded(vehicle, push(4000, *range(6))), POSE)
    free = free_parameters(vehicle, ALL)
    truth = free.theta(vehicle, delay=0.0, lag=0.0)
    std = np.where(free.codes[:, 3] != 0, 0.4, 0.5 * np.abs(truth) + 0.1)
    away = 2.0 * std * np.where(np.arange(len(free)) % 2 == 0, 1.0, -1.0)
    prior = (truth + away, np.diag(std**-2.0))
    fit = fit_output_error([samples], CandidateModel(vehicle, free, truth), NOISE, prior=prior)
    assert_found(fit, truth)
    assert fit.iterations <= 10
