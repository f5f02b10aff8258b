"""Forward-speed terms in a simulated vehicle: what they do to a torpedo, in still water and in a current."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.simulation import simulate
from towtank.vehicle import FORWARD_SPEED, Vehicle, faults, forward_dynamics, inverse_dynamics, load_vehicle

from .vessels import reference, table, vessel

TORPEDO = Path(__file__).parents[2] / "benchmarks" / "studies" / "torpedo.toml"
STUDIED = ("Y_uv", "Y_ur", "N_uv", "N_ur")
LIFT = {
    "Y_uv": -30.0, "Y_ur": 6.0, "N_uv": 4.0, "N_ur": -2.0, "K_up": -0.4,
    "Z_uw": -28.0, "Z_uq": -5.0, "M_uw": -3.0, "M_uq": -2.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def torpedo() -> Vehicle:
    return load_vehicle(str(TORPEDO))


def zigzag(vehicle: Vehicle, duration: float, seed: int) -> np.ndarray:
    """Commands at 50 Hz: ahead at several speeds, the tunnels in steps of either sign."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.uniform(-1.0, 1.0, (round(duration / 4.0), 3)), 200, axis=0)
    return np.array([15.0, 60.0, 60.0]) * steps + np.array([75.0, 0.0, 0.0])


def fit(measured: np.ndarray, predicted: np.ndarray) -> float:
    return 100.0 * (1.0 - float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured - measured.mean())))


def test_the_torpedo_is_physical_and_stays_upright(torpedo: Vehicle) -> None:
    assert faults(torpedo) == ()
    assert torpedo.warnings == ()
    run = simulate(torpedo, commands=zigzag(torpedo, 60.0, 1), dt=0.02, nu0=(1.0, 0, 0.01, 0, 0.01, 0))
    assert np.abs(run["theta"].values).max() < 0.05
    assert np.abs(run["phi"].values).max() < 0.3
    assert np.ptp(run["r"].values) > 0.2
    assert run["u"].values.min() > 0.5


def test_without_them_the_yaw_of_a_torpedo_cannot_be_predicted(torpedo: Vehicle) -> None:
    commands = zigzag(torpedo, 60.0, 2)
    truth, plain = (
        simulate(each, commands=commands, dt=0.02, nu0=(1.0, 0, 0, 0, 0, 0))["r"].values
        for each in (torpedo, torpedo.with_coefficients(dict.fromkeys(STUDIED, 0.0)))
    )
    assert fit(truth, plain) < 40.0


def test_the_simulator_integrates_them() -> None:
    vehicle = vessel().with_coefficients(LIFT)

    def wrench(t: np.ndarray) -> np.ndarray:
        return np.array([20.0, 6.0, -5.0, 0.3, 0.4, 0.8]) * np.sin(np.asarray(t)[..., None] + 0.3 * np.arange(6) + 1.0)

    nu0 = np.array([0.8, 0.3, -0.3, 0.2, 0.2, -0.2])
    run = simulate(vehicle, wrench=wrench, dt=0.005, duration=1.0, nu0=nu0)
    expected = reference(vehicle, lambda t: wrench(np.array(t)), [0.0, 1.0], np.concatenate([np.zeros(6), nu0]))
    assert np.abs(table(run)[-1] - expected[-1]).max() < 1e-6


def test_they_act_by_the_velocity_through_the_water(torpedo: Vehicle) -> None:
    """At rest over ground in a current from ahead a torpedo feels them; drifting with the water it does not."""
    current = np.array([-1.0, -0.2, 0.0])
    for nu0, moves in (((0.0, 0, 0, 0, 0, 0), True), ((-1.0, -0.2, 0, 0, 0, 0), False)):
        runs = [
            simulate(each, dt=0.01, duration=1.0, nu0=nu0, current=current)
            for each in (torpedo, torpedo.with_coefficients(dict.fromkeys(STUDIED, 0.0)))
        ]
        apart = np.abs(runs[0]["r"].values - runs[1]["r"].values).max()
        assert apart > 0.05 if moves else apart < 1e-12


def test_names_go_through_forward_and_inverse_dynamics() -> None:
    assert set(LIFT) == set(FORWARD_SPEED)
    bare, rng = vessel(), np.random.default_rng(0)
    eta, nu, nu_dot = rng.normal(size=(3, 20, 6)) * 0.5
    for name, value in LIFT.items():
        vehicle = bare.with_coefficients({name: value})
        force = inverse_dynamics(bare, eta, nu, nu_dot) - inverse_dynamics(vehicle, eta, nu, nu_dot)
        expected = np.zeros((20, 6))
        expected[:, "XYZKMN".index(name[0])] = value * nu[:, 0] * nu[:, "uvwpqr".index(name[3])]
        np.testing.assert_allclose(force, expected, atol=1e-11)
        again = forward_dynamics(vehicle, eta, nu, inverse_dynamics(vehicle, eta, nu, nu_dot))
        np.testing.assert_allclose(again, nu_dot, atol=1e-10)
