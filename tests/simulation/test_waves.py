"""Waves: the water's motion, and a body in it against Newton's law in the frame of the ground."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from towtank.core.attitude import rotation_from_euler
from towtank.core.forces import damping_force
from towtank.core.inertia import coriolis_force
from towtank.core.layout import I_LINEAR, I_QUADRATIC, I_WEIGHT
from towtank.errors import InputError
from towtank.simulation import OrnsteinUhlenbeck, Perfect, RisingCurrent, Together, WaterTrack, Waves, simulate
from towtank.vehicle import Vehicle

from .vessels import COUPLED, table, vessel

SWELL = Waves(rms=0.2, period=3.0, heading=0.7, vertical=0.8)
ANGLES = ("phi", "theta", "psi")
LIGHT = {"centre": (0.02, 0.01, -0.05), "force": 100.0}  # of 118 N


def test_the_waters_motion_is_one_motion() -> None:
    t = np.arange(4000) * 0.005
    water = SWELL.motion(t, seed=3)
    np.testing.assert_allclose(water.displacement[0], 0.0, atol=1e-15)
    for moved, rate in ((water.displacement, water.velocity), (water.velocity, water.acceleration)):
        np.testing.assert_allclose(np.gradient(moved, t, axis=0)[1:-1], rate[1:-1], atol=1e-4)
    again, other = SWELL.motion(t[:10], seed=3), SWELL.motion(t[:10], seed=4)
    np.testing.assert_array_equal(again.velocity, water.velocity[:10])
    assert np.abs(other.velocity - again.velocity).max() > 0.01


def test_waves_come_up_from_still_water_to_the_motion_that_they_have() -> None:
    t = np.arange(8000) * 0.005
    full, water = SWELL.motion(t, seed=3), replace(SWELL, begin=12.0).motion(t, seed=3)
    for part in water:
        np.testing.assert_array_equal(part[t < 12.0], 0.0)
    np.testing.assert_allclose(water.velocity[t > 27.0], full.velocity[t > 27.0], rtol=1e-12)
    np.testing.assert_allclose(water.acceleration[t > 27.0], full.acceleration[t > 27.0], atol=1e-15)
    for moved, rate in ((water.displacement, water.velocity), (water.velocity, water.acceleration)):
        np.testing.assert_allclose(np.gradient(moved, t, axis=0)[1:-1], rate[1:-1], atol=1e-4)


def test_a_current_begins_to_flow_and_stays() -> None:
    t = np.arange(8000) * 0.005
    water = RisingCurrent((0.2, -0.1, 0.05), begin=12.0, seconds=10.0).motion(t, seed=3)
    for part in water:
        np.testing.assert_array_equal(part[t < 12.0], 0.0)
    np.testing.assert_allclose(water.velocity[t > 22.0], np.broadcast_to([0.2, -0.1, 0.05], (np.sum(t > 22.0), 3)))
    for moved, rate in ((water.displacement, water.velocity), (water.velocity, water.acceleration)):
        np.testing.assert_allclose(np.gradient(moved, t, axis=0)[1:-1], rate[1:-1], atol=1e-4)


@pytest.mark.parametrize(
    "settings, expected",
    [
        ({"velocity": (0.1, math.nan, 0.0)}, "rising current: velocity"),
        ({"velocity": (0.1, 0.0, 0.0), "begin": -1.0}, "rising current: begin: found -1"),
        ({"velocity": (0.1, 0.0, 0.0), "seconds": 0.0}, "rising current: seconds: found 0"),
    ],
)
def test_a_rising_current_that_cannot_be(settings: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        RisingCurrent(**settings)


def test_its_size_period_and_heading_are_those_asked_for() -> None:
    t = np.arange(60_000) * 0.05
    velocity = SWELL.motion(t, seed=1).velocity
    along = velocity[:, 0] * np.cos(0.7) + velocity[:, 1] * np.sin(0.7)
    across = velocity[:, 1] * np.cos(0.7) - velocity[:, 0] * np.sin(0.7)
    assert np.hypot(along.std(), across.std()) == pytest.approx(0.2, rel=0.02)
    assert across.std() < 0.5 * along.std()
    assert velocity[:, 2].std() == pytest.approx(0.8 * 0.2, rel=0.02)
    crossings = np.sum(np.diff(np.sign(along)) > 0)
    assert t[-1] / crossings == pytest.approx(3.0, rel=0.15)
    assert abs(np.corrcoef(along, velocity[:, 2])[0, 1]) < 0.05  # a quarter of a period behind: an orbit


def _commanded(**more: Any) -> Any:
    t = np.arange(2600) * 0.005  # more than the simulator takes at once
    orders = 60.0 * np.sin(np.multiply.outer(t, [1.1, 1.7, 0.7, 2.3, 1.3, 0.9]))
    start = {"eta0": (0.0, 0.0, 2.0, 0.2, -0.1, 1.0), "nu0": (0.3, 0.1, 0.0, 0.0, 0.1, 0.3)}
    both = Together((Perfect(accelerometer=True), WaterTrack(rate=200.0, noise=0.0)))
    return {"commands": orders, "dt": 0.005, "waves": SWELL, "sensors": both, "seed": 5, **start, **more}


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_a_body_in_waves_obeys_newtons_law_over_ground(loss: float) -> None:
    """Rigid body by its velocity over ground; added mass and drag by that through the water; pressure at its centre."""
    current = np.array([0.1, -0.05, 0.0])
    body = vessel(buoyancy=LIGHT, lags=(0.1,) * 6, delay=0.03, hydrodynamics={**COUPLED, "inflow_loss": loss})
    run = simulate(body, current=current, record=("wrench",), **_commanded())
    nu, nu_r = table(run, "uvwpqr"), np.hstack([table(run, ("u_w", "v_w", "w_w")), table(run, "pqr")])
    attitudes = [rotation_from_euler(*each) for each in table(run, ANGLES)]
    water = SWELL.motion(run["u"].t, seed=5)
    for k in range(5, 2590, 31):
        rates = ((each[k + 1] - each[k - 1]) / 0.01 for each in (nu, nu_r))
        tau = 0.5 * (table(run, "XYZKMN")[k - 1] + table(run, "XYZKMN")[k])
        missing = _unexplained(body, attitudes[k], nu[k], nu_r[k], *rates, tau, water.acceleration[k])
        np.testing.assert_allclose(missing, 0.0, atol=0.03)  # N, N m; the wrench is a mean of 10 ms
    np.testing.assert_allclose(
        nu[:, :3] - nu_r[:, :3],
        [R.T @ (current + v) for R, v in zip(attitudes, water.velocity, strict=True)],
        atol=1e-12,
    )


def _unexplained(
    body: Vehicle, R: np.ndarray, nu: np.ndarray, nu_r: np.ndarray, nu_dot: np.ndarray, nu_r_dot: np.ndarray,
    tau: np.ndarray, water: np.ndarray,
) -> np.ndarray:  # fmt: skip
    rigid = body.rigid_body_matrix
    added = body.mass_matrix - rigid
    inertia = rigid @ nu_dot + coriolis_force(rigid, nu)
    p = np.array(body.parameters)
    L, Q = p[I_LINEAR:I_QUADRATIC].reshape(6, 6), p[I_QUADRATIC:I_WEIGHT].reshape(6, 6)
    hydro = added @ nu_r_dot + coriolis_force(added, nu_r) - damping_force(L, Q, nu_r)
    g, W = np.array([0.0, 0.0, 9.81]), body.weight
    B = W - body.weight_minus_buoyancy
    weight, pressure = R.T @ g * W / 9.81, R.T @ (water - g) * B / 9.81
    r_G, r_B = np.array(body.rigid_body.centre_of_gravity), np.array(body.buoyancy.centre)
    pushed = np.concatenate([weight + pressure, np.cross(r_G, weight) + np.cross(r_B, pressure)])
    return np.asarray(inertia + hydro - tau - pushed)


def test_a_neutral_body_at_rest_in_the_water_goes_with_it() -> None:
    water = SWELL.motion(np.arange(501) * 0.01, seed=2)
    start = {"nu0": (*water.velocity[0], 0.0, 0.0, 0.0), "duration": 5.0, "seed": 2, "waves": SWELL}
    run = simulate(vessel(buoyancy={"centre": (0.0, 0.0, 0.0)}), **start)
    np.testing.assert_allclose(table(run, "xyz"), water.displacement, atol=1e-12)
    np.testing.assert_allclose(table(run, "uvw"), water.velocity, atol=1e-12)
    assert np.abs(table(run, "pqr")).max() < 1e-15
    tilted = simulate(vessel(), **start)  # its centres apart, it rolls and pitches as a pendulum does
    assert np.abs(table(tilted, "pq")).max() > 1e-3


def test_an_accelerometer_feels_what_the_position_says() -> None:
    run = simulate(vessel(buoyancy=LIGHT), **_commanded())
    position, attitudes = table(run, "xyz"), [rotation_from_euler(*each) for each in table(run, ANGLES)]
    acceleration = np.diff(position, n=2, axis=0) / 0.005**2
    felt = table(run, ("ax", "ay", "az"))
    for k in range(10, 2590, 97):
        expected = attitudes[k + 1].T @ (acceleration[k] - [0.0, 0.0, 9.81])
        np.testing.assert_allclose(felt[k + 1], expected, atol=0.02)


def test_a_wrench_a_change_and_a_disturbance_go_with_waves() -> None:
    held = np.tile([5.0, 0.0, 0.0, 0.0, 0.0, 0.2], (400, 1))
    push = OrnsteinUhlenbeck(0.3)
    bare = simulate(vessel(), wrench=held, disturbance=push, waves=Waves(rms=0.0), seed=1)
    still = simulate(vessel(), wrench=held, disturbance=push, seed=1)
    np.testing.assert_allclose(table(bare), table(still), atol=1e-12)
    losing = vessel(hydrodynamics={**COUPLED, "inflow_loss": 0.2})  # by thrusters: of a wrench it takes nothing
    np.testing.assert_array_equal(
        *(table(simulate(each, wrench=held, waves=SWELL, seed=1)) for each in (vessel(), losing))
    )
    other = vessel(hydrodynamics={"X_u": -40.0})
    settings: dict[str, Any] = {"wrench": held, "waves": SWELL, "seed": 1}
    changed, same = (simulate(vessel(), changes=c, **settings) for c in ([(2.0, other)], []))
    np.testing.assert_array_equal(table(changed)[:201], table(same)[:201])
    assert np.abs(changed["u"].values[-1] - same["u"].values[-1]) > 0.05


def test_long_steps_are_as_good_as_their_substeps() -> None:
    def end(dt: float, substeps: int) -> np.ndarray:
        held = np.tile([5.0, 0.0, 0.0, 0.0, 0.0, 0.2], (round(10.0 / dt), 1))
        run = simulate(vessel(buoyancy=LIGHT), wrench=held, dt=dt, substeps=substeps, waves=SWELL, seed=1)
        return np.asarray(table(run)[-1])

    fine = end(0.1, 80)
    one, ten = (np.abs(end(0.1, substeps) - fine).max() for substeps in (1, 10))
    assert ten < 0.2 * one
    np.testing.assert_allclose(end(0.01, 1), end(0.1, 10), atol=1e-3)  # the water's acceleration is linear over dt


@pytest.mark.parametrize(
    "wrong, complaint",
    [
        ({"rms": -0.1}, "waves: rms: found -0.1, expected a finite number, 0 or more"),
        ({"period": 0.0}, "period: found 0 s, expected more"),
        ({"heading": float("nan")}, "waves: heading: found nan, expected a finite number$"),
        ({"vertical": -1.0}, "waves: vertical"),
    ],
)
def test_waves_that_cannot_be(wrong: dict[str, float], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        Waves(**wrong)
