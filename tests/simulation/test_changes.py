"""A vehicle that changes while it is simulated."""

from __future__ import annotations

import numpy as np
import pytest

import towtank as tt
from towtank.errors import InputError
from towtank.simulation import OrnsteinUhlenbeck, manoeuvre


def test_a_changed_vehicle_goes_on_from_where_the_other_one_was() -> None:
    one = tt.load_vehicle("vlbv300")
    other = one.with_coefficients({"X_udot": one.coefficient("X_udot") - 2.0, "X_uu": 1.3 * one.coefficient("X_uu")})
    tau = manoeuvre("all-multisine", one, duration=6.0, dt=0.01, seed=1).wrench
    if tau is None:
        commands = manoeuvre("all-multisine", one, duration=6.0, dt=0.01, seed=1).commands
        assert commands is not None
        tau = tt.thruster_wrench(one, commands)
    whole = tt.simulate(one, wrench=tau, dt=0.01, changes=[(2.5, other)])
    before = tt.simulate(one, wrench=tau[:250], dt=0.01)
    pose = np.array([before[name].values[-1] for name in ("x", "y", "z", "phi", "theta", "psi")])
    speed = np.array([before[name].values[-1] for name in "uvwpqr"])
    after = tt.simulate(other, wrench=tau[250:], dt=0.01, eta0=pose, nu0=speed)
    for name in ("x", "psi", "u", "q"):
        np.testing.assert_allclose(whole[name].values[:250], before[name].values[:250], atol=1e-12)
        np.testing.assert_allclose(whole[name].values[250:], after[name].values, atol=1e-9)


def test_a_thruster_that_loses_thrust_pushes_less_from_then_on() -> None:
    one = tt.load_vehicle("vlbv300")
    weak = one.model_copy(update={"thrusters": (one.thrusters[0].model_copy(update={"gain": 0.6}), *one.thrusters[1:])})
    commands = np.full((400, len(one.thrusters)), 20.0)
    run = tt.simulate(one, commands=commands, dt=0.01, changes=[(2.0, weak)], record=("wrench",), disturbance=None)
    push = run["X"].values
    expected = [float(tt.thruster_wrench(each, commands[0])[0]) for each in (one, weak)]
    np.testing.assert_allclose(push[[100, 300]], expected, rtol=1e-12)
    assert expected[0] != expected[1]


def test_a_change_does_not_touch_the_disturbance() -> None:
    one = tt.load_vehicle("vlbv300")
    random = OrnsteinUhlenbeck(std=1.0)
    push = {"disturbance": random, "seed": 3, "record": ("disturbance",), "duration": 5.0}
    calm = tt.simulate(one, **push)
    changed = tt.simulate(one, changes=[(1.0, one)], **push)
    np.testing.assert_array_equal(calm["X_disturbance"].values, changed["X_disturbance"].values)
    np.testing.assert_allclose(calm["u"].values, changed["u"].values, atol=1e-14)


@pytest.mark.parametrize("when", [0.0, -1.0, float("nan"), float("inf")])
def test_a_change_before_the_start_is_refused(when: float) -> None:
    one = tt.load_vehicle("vlbv300")
    with pytest.raises(InputError, match="changes"):
        tt.simulate(one, duration=1.0, changes=[(when, one)])
