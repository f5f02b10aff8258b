"""Loss of thrust with inflow in a simulated vehicle: what commands come to in moving water, and a wrench does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from towtank.core.attitude import euler_rates_matrix, rotation_from_euler
from towtank.recording.standard import WRENCH
from towtank.simulation import OrnsteinUhlenbeck, Perfect, simulate, simulate_batch
from towtank.vehicle import Vehicle, forward_dynamics, thruster_forces

from .vessels import LINEAR, table, thruster, vessel

EVEN = {"X_u2": 2.0, "Y_v2": -3.0, "Z_w2": 2.5, "K_p2": 0.1, "M_q2": -0.1, "N_r2": 0.05}
LOSS = {"inflow_loss": 0.25}
NU0 = np.array([0.8, 0.3, -0.3, 0.2, 0.2, -0.2])
ORDERS = np.array([40.0, 36.0, 38.0, 41.0, 30.0, -26.0])
END = 1.6  # s


def by_each(vehicle: Vehicle, forces: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """The wrench (6,) of thrusters, each with its own loss by the velocity of its place along its direction."""
    k, out = vehicle.coefficient("inflow_loss"), np.zeros(6)
    for one, T in zip(vehicle.thrusters, forces, strict=True):
        d, r = np.array(one.direction), np.array(one.position)
        left = T * (1.0 - k * np.sign(T) * (d @ (nu[:3] + np.cross(nu[3:], r))))
        out += left * np.concatenate([d, np.cross(r, d)])
    return out


def exact(vehicle: Vehicle, lag: float) -> np.ndarray:
    """Pose and velocity (12,) at END under ORDERS by DOP853 in Euler angles, the lag in closed form."""
    targets = thruster_forces(vehicle, ORDERS)

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        tau = by_each(vehicle, targets * (1.0 - np.exp(-t / lag)) if lag else targets, s[6:])
        position = rotation_from_euler(*s[3:6]) @ s[6:9]
        angles = euler_rates_matrix(s[3], s[4]) @ s[9:]
        return np.concatenate([position, angles, forward_dynamics(vehicle, s[:6], s[6:], tau)])

    start = np.concatenate([np.zeros(6), NU0])
    return np.asarray(solve_ivp(rate, (0.0, END), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


def error(vehicle: Vehicle, dt: float, expected: np.ndarray) -> float:
    run = simulate(vehicle, commands=np.tile(ORDERS, (round(END / dt), 1)), dt=dt, nu0=NU0)
    return float(np.abs(table(run)[-1] - expected).max())


@pytest.mark.parametrize("lag", [0.0, 0.4])
def test_fourth_order_by_the_loss_of_each_thruster(lag: float) -> None:
    """With a lag the loss varies within the steps, as the thrust does; asymmetric drag beside it."""
    vehicle = vessel(lags=(lag,) * 6, hydrodynamics={**LINEAR, **EVEN, **LOSS})
    expected = exact(vehicle, lag)
    coarse, fine = (error(vehicle, dt, expected) for dt in (0.02, 0.01))
    assert fine < 1e-6
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.4)


def single(loss: float, drag: float = 10.0) -> Vehicle:
    """A body with one thruster that pushes it ahead through its centre."""
    return Vehicle(
        name="single",
        rigid_body={"mass": 12.0, "inertia": (0.2, 0.3, 0.35)},  # type: ignore[arg-type]
        hydrodynamics={"X_u": -drag, "inflow_loss": loss},  # type: ignore[arg-type]
        thrusters=(thruster("aft", (-0.3, 0.0, 0.0), (1.0, 0.0, 0.0)),),
    )


@pytest.mark.parametrize("order", [60.0, -60.0])
def test_the_speed_reached_is_that_of_drag_and_loss_together(order: float) -> None:
    """T (1 - k |u|) = X u, so that u = T / (X + k |T|), ahead as astern."""
    vehicle = single(0.25)
    T = float(thruster_forces(vehicle, [order])[0])
    run = simulate(vehicle, commands=np.full((2000, 1), order), dt=0.02)
    assert run["u"].values[-1] == pytest.approx(T / (10.0 + 0.25 * abs(T)), rel=1e-9)


def test_it_acts_by_the_velocity_through_the_water() -> None:
    """In water that comes from ahead at 1 m/s a quarter of the thrust is gone; drifting with the water nothing is."""
    vehicle = single(0.25, drag=0.0)
    T = float(thruster_forces(vehicle, [60.0])[0])
    for u0, share in ((0.0, 0.75), (-1.0, 1.0)):
        run = simulate(vehicle, commands=[[60.0]], dt=0.001, nu0=(u0, 0, 0, 0, 0, 0), current=(-1.0, 0.0, 0.0))
        assert np.diff(run["u"].values)[0] / 0.001 == pytest.approx(share * T / 12.0, rel=1e-3)


def test_a_wrench_loses_nothing() -> None:
    bare, losing = vessel(), vessel().with_coefficients(LOSS)
    tau = 10.0 * np.sin(0.05 * np.arange(100)[:, None] + np.arange(6))
    runs = [simulate(each, wrench=tau, nu0=NU0) for each in (bare, losing)]
    np.testing.assert_array_equal(table(runs[0]), table(runs[1]))
    batches = [simulate_batch(each, wrench=tau[None], nu0=NU0) for each in (bare, losing)]
    np.testing.assert_array_equal(batches[0].nu, batches[1].nu)


@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_a_trace_of_it_is_nearly_nothing(lag: float) -> None:
    """The two ways through a simulation with commands, with and without, are one where it comes to nothing."""
    bare = vessel(lags=(lag,) * 6, delay=0.013)
    orders = 40.0 * np.sin(0.03 * np.arange(3000)[:, None] + np.arange(6))  # more than one chunk
    push = OrnsteinUhlenbeck()
    runs = [
        table(simulate(each, commands=orders, disturbance=push, nu0=NU0, current=(0.2, 0.1, 0.0)))
        for each in (bare, bare.with_coefficients({"inflow_loss": 1e-300}))
    ]
    assert np.abs(runs[0] - runs[1]).max() < 1e-9


def test_the_accelerometer_feels_it() -> None:
    vehicle = vessel(lags=(0.1,) * 6).with_coefficients(LOSS)
    run = simulate(vehicle, commands=np.tile(ORDERS, (400, 1)), dt=0.005, nu0=NU0, sensors=Perfect(accelerometer=True))
    v, omega = table(run, ("u", "v", "w")), table(run, ("p", "q", "r"))
    phi, theta = run["phi"].values, run["theta"].values
    down = np.column_stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    felt = np.gradient(v, 0.005, axis=0) + np.cross(omega, v) - 9.81 * down
    assert np.abs(table(run, ("ax", "ay", "az")) - felt)[1:-1].max() < 2e-3


def test_the_recorded_wrench_is_what_is_left() -> None:
    """Played back as a wrench, of which nothing is lost, it gives the same motion."""
    vehicle = vessel(lags=(0.1,) * 6, delay=0.03).with_coefficients(LOSS)
    run = simulate(vehicle, commands=np.tile(ORDERS, (300, 1)), nu0=NU0, record=("wrench",))
    again = simulate(vehicle, wrench=table(run, WRENCH), nu0=NU0)
    without = simulate(vessel(lags=(0.1,) * 6, delay=0.03), commands=np.tile(ORDERS, (300, 1)), nu0=NU0)
    assert np.abs(table(again) - table(run))[-1].max() < 1e-4
    assert np.abs(table(without) - table(run))[-1].max() > 0.1


def test_a_change_of_vehicle_changes_it() -> None:
    bare, losing = vessel(), vessel().with_coefficients(LOSS)
    orders = np.tile(ORDERS, (200, 1))
    run = simulate(bare, commands=orders, nu0=NU0, changes=[(1.0, losing)])
    first = table(simulate(bare, commands=orders[:100], nu0=NU0))
    second = table(simulate(losing, commands=orders[100:], eta0=first[-1, :6], nu0=first[-1, 6:]))
    np.testing.assert_allclose(table(run), np.vstack([first, second[1:]]), atol=1e-10)
