"""Coefficients that somebody names: those are learned, what is hardly known is not thrown away, all else stays."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import LogLearning, learn_recordings
from towtank.identification.model.belief import belief
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import load_vehicle

from .runs import TRUTH, box, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
NAMES = ("X_udot", "X_uu")
OTHERS = {name: value for name, value in TRUTH.items() if name not in NAMES}


def weak(push: float, seed: int) -> Recording:
    """Four seconds of surge pushed with little more force than the disturbance has."""
    wrench = waves(400, 0.01, (0, push, 1.2), square=True)
    return simulate(box(), wrench=wrench, sensors=Mocap(), seed=seed, disturbance=TANK)


def learn(log: Recording, **more: tuple[str, ...]) -> LogLearning:
    return learn_recordings(unknown(box(), **OTHERS), [log], delay=0.0, **more)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_asked_for_is_identified_where_the_data_narrow_it(seed: int) -> None:
    found = learn(weak(2.5, seed), free=NAMES).estimate
    for name in NAMES:
        assert found[name].identified
        assert abs(found[name].value - TRUTH[name]) < 3.5 * found[name].std
    assert 0.05 < found["X_uu"].std / abs(found["X_uu"].value) < 0.6


def test_what_is_hardly_known_stays_as_fitted_and_says_so() -> None:
    learning = learn(weak(0.2, 2), free=NAMES)
    found = learning.estimate["X_uu"]
    assert not found.identified
    assert found.value < 0.0
    assert learning.model.coefficient("X_uu") == found.value  # the mass was fitted beside this, not beside none
    assert found.reason is not None
    assert found.reason.startswith(f"the data leave {100.0 * learning.narrowed['X_uu']:.0f} % of the prior's deviation")
    assert learning.model.deviation("X_uu") == found.std


@pytest.mark.parametrize("seed", range(3))
def test_a_delay_and_a_lag_that_are_hardly_known_do_no_harm(seed: int) -> None:
    truth = load_vehicle("vlbv300")
    commands = manoeuvre("surge-sine", truth, duration=4.0, dt=0.01).commands
    assert commands is not None
    log = simulate(truth, commands=0.3 * commands, dt=0.01, sensors=Mocap(), seed=seed, disturbance=TANK)
    learning = learn_recordings(truth, [log], free=(*NAMES, "lag"))
    assert set(learning.estimate.names) == set(NAMES)
    assert learning.delay_std > 0.01
    assert learning.lag_std > 0.0
    for name in NAMES:
        found = learning.estimate[name]
        assert abs(found.value - truth.coefficient(name)) < 3.5 * found.std


def test_of_what_nothing_is_told_the_prior_stays() -> None:
    """Of surge nothing is told: it is pushed to the side."""
    wrench = waves(400, 0.01, (1, 15.0, 1.2), square=True)
    vehicle = unknown(box(), **OTHERS)
    learning = learn(simulate(box(), wrench=wrench, sensors=Mocap(), disturbance=None), free=("X_uu", "Y_vv"))
    prior = belief(vehicle).only(("X_uu",))
    found = learning.estimate["X_uu"]
    assert not found.identified
    assert learning.narrowed["X_uu"] > 0.9
    assert abs(found.value - prior.mean[0]) < 0.5 * prior.std[0]
    assert found.std == pytest.approx(learning.narrowed["X_uu"] * prior.std[0])
    assert learning.estimate["Y_vv"].identified


def test_everything_else_is_left_as_it_was_supposed() -> None:
    learning = learn(weak(10.0, 0), free=NAMES)
    before = belief(unknown(box(), **OTHERS), commands=False).vehicle_values
    for name, value in before.items():
        if name not in NAMES:
            assert learning.model.coefficient(name) == value, name
            assert name not in learning.estimate.names
    assert set(learning.narrowed) == set(NAMES)  # the delay was given
    assert learning.remarks[0] == "free: X_udot, X_uu; everything else is fixed at the prior's mean"
    posterior = learning.model.posterior
    assert posterior is not None
    assert set(posterior.names) == set(NAMES)


def test_a_name_that_the_prior_does_not_know_is_refused_with_the_nearest() -> None:
    for name, nearest in (("X_udto", "X_udot"), ("gain_left", "")):
        with pytest.raises(InputError, match=f'free: "{name}" is not a coefficient of the prior.*{nearest}'):
            learn(weak(2.5, 0), free=(name,))


def test_deviations_are_those_of_what_is_named_alone() -> None:
    """With everything else known, what is named is known better than with everything unknown."""
    log = weak(10.0, 1)
    named, whole = learn(log, free=NAMES).estimate, learn(log).estimate
    for name in NAMES:
        assert np.isfinite(whole[name].std)
        assert named[name].std < whole[name].std
