"""Delay and lag between command and wrench: exact for any part of a step."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.simulation import simulate
from towtank.simulation.actuation import MOST_PIECES, cut_step
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

from .vessels import LINEAR, reference, table, vessel

LAGS = (0.0, 0.05, 0.1, 0.2, 0.03, 0.15)
TIMES = np.array([0.0, 0.5, 0.9, 1.3])


def orders_at(dt: float) -> np.ndarray:
    """Commands for 1.5 s that change every 0.1 s."""
    steps = np.random.default_rng(4).uniform(-40.0, 40.0, size=(15, 6))
    return np.repeat(steps, round(0.1 / dt), axis=0)


def exact_motion(vehicle: Vehicle, delay: float) -> np.ndarray:
    """Motion at TIMES with the lag solved in closed form and the integration restarted at every switch."""
    forces = thruster_forces(vehicle, orders_at(0.1))
    lags = np.array([thruster.time_constant for thruster in vehicle.thrusters])
    switches = np.concatenate([[0.0], delay + 0.1 * np.arange(15)])
    targets = np.vstack([np.zeros(6), forces])
    starts = [np.zeros(6)]
    for k in range(15):
        away = (starts[k] - targets[k]) * decay(switches[k + 1] - switches[k], lags)
        starts.append(targets[k] + away)

    def wrench(t: float) -> np.ndarray:
        k = int(np.searchsorted(switches, t, side="right")) - 1
        f = targets[k] + (starts[k] - targets[k]) * decay(t - switches[k], lags)
        return np.asarray(configuration_matrix(vehicle) @ f)

    grid = np.unique(np.round(np.concatenate([switches[switches < TIMES[-1]], TIMES]), 12))
    found = reference(vehicle, wrench, grid, np.zeros(12))
    return found[np.searchsorted(grid, TIMES - 1e-9)]


def decay(t: float, lags: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.where(lags > 0.0, np.exp(-t / np.where(lags > 0.0, lags, 1.0)), 0.0)


def errors(vehicle: Vehicle, delay: float, dt: float, exact: np.ndarray) -> float:
    run = table(simulate(vehicle, commands=orders_at(dt), dt=dt, delay=delay))
    return float(np.abs(run[np.round(TIMES / dt).astype(int)] - exact).max())


@pytest.mark.parametrize("lags", [(0.0,) * 6, LAGS], ids=["no lag", "lags"])
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.0137, 0.15 + 1e-4])
def test_against_dop853(lags: tuple[float, ...], delay: float) -> None:
    vehicle = vessel(lags=lags, hydrodynamics=LINEAR)
    assert errors(vehicle, delay, 0.01, exact_motion(vehicle, delay)) < 1e-7


def test_fourth_order_with_a_switch_inside_the_steps() -> None:
    vehicle = vessel(lags=tuple(15.0 * np.array(LAGS)), hydrodynamics=LINEAR)
    delay = 0.1 / 3.0  # two thirds of a step, then one third of a step half as long: the largest piece halves too
    exact = exact_motion(vehicle, delay)
    coarse, fine = (errors(vehicle, delay, dt, exact) for dt in (0.05, 0.025))
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.4)


def test_a_delay_of_whole_steps_moves_the_commands() -> None:
    late = table(simulate(vessel(), commands=orders_at(0.01), delay=0.07))
    moved = np.vstack([np.zeros((7, 6)), orders_at(0.01)[:-7]])
    np.testing.assert_allclose(late, table(simulate(vessel(), commands=moved)), atol=1e-14)


def test_the_vehicles_own_delay_is_the_default() -> None:
    orders = orders_at(0.01)
    np.testing.assert_array_equal(
        table(simulate(vessel(delay=0.043), commands=orders)), table(simulate(vessel(), commands=orders, delay=0.043))
    )
    still = simulate(vessel(delay=0.043), wrench=np.tile([5.0, 0, 0, 0, 0, 0], (4, 1)))
    assert still["u"].values[1] > 0.0  # a wrench is not delayed unless asked for
    assert simulate(vessel(), wrench=np.tile([5.0, 0, 0, 0, 0, 0], (4, 1)), delay=0.015)["u"].values[1] == 0.0


def test_recorded_wrench_is_the_mean_over_the_step() -> None:
    orders = np.full((100, 6), 50.0)
    for lag, delay in ((0.0, 0.004), (0.05, 0.0), (0.05, 0.013)):
        run = simulate(vessel(lags=(lag,) * 6), commands=orders, delay=delay, record=("wrench",))
        force = thruster_forces(vessel(), orders[0])[4] * 2.0
        t = np.maximum(np.arange(101) * 0.01 - delay, 0.0)
        impulse = force * (t - lag * (1.0 - decay(1.0, np.array([1.0]))[0] ** (t / lag)) if lag else t)
        np.testing.assert_allclose(run["Z"].values, np.diff(impulse) / 0.01, atol=1e-4 * force)


def test_dead_band_and_voltage() -> None:
    idle = simulate(vessel(), commands=np.full((10, 6), 3.9), record=("wrench",))
    assert not table(idle, "XYZKMN").any()
    run = simulate(vessel(), commands=np.full((10, 6), 20.0), voltage=np.linspace(12.0, 16.0, 10))
    np.testing.assert_array_equal(run["voltage"].values, np.linspace(12.0, 16.0, 10))


def test_cuts_of_a_step() -> None:
    whole = cut_step(0.01, delay=0.03)
    assert (whole.lengths.tolist(), whole.late.tolist()) == ([0.01], [3])
    split = cut_step(0.01, delay=0.034)
    np.testing.assert_allclose(split.lengths, [0.004, 0.006])
    assert split.late.tolist() == [4, 3]
    fine = cut_step(0.01, lags=np.array([0.0, 0.01]))
    np.testing.assert_allclose(fine.lengths, [0.0025] * 4)
    assert cut_step(0.01, lags=np.array([1e-9])).lengths.size == MOST_PIECES
    for cut in (whole, split, fine):
        assert cut.lengths.sum() == pytest.approx(0.01)
