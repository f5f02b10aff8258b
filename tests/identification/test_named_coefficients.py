"""Coefficients that somebody names: told from nothing is enough, and what is hardly known is not thrown away."""

from __future__ import annotations

import pytest

from towtank.identification import LogLearning, learn_recordings
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import load_vehicle

from .runs import TRUTH, box, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))


def weak(push: float, seed: int) -> Recording:
    """Four seconds of surge pushed with little more force than the disturbance has."""
    wrench = waves(400, 0.01, (0, push, 1.2), square=True)
    return simulate(box(), wrench=wrench, sensors=Mocap(), seed=seed, disturbance=TANK)


def learn(log: Recording, **more: tuple[str, ...]) -> LogLearning:
    others = {name: value for name, value in TRUTH.items() if name not in ("X_udot", "X_uu")}
    return learn_recordings(unknown(box(), **others), [log], delay=0.0, **more)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_asked_for_is_identified_where_its_interval_excludes_nothing(seed: int) -> None:
    found = learn(weak(2.5, seed), free=("X_udot", "X_uu")).estimate["X_uu"]
    assert found.identified
    assert 0.25 < found.std / abs(found.value) < 0.5
    assert abs(found.value - TRUTH["X_uu"]) < 3.0 * found.std


def test_what_is_hardly_known_keeps_a_value_and_says_so() -> None:
    learning = learn(weak(0.3, 2), free=("X_udot", "X_uu"))
    found = learning.estimate["X_uu"]
    assert not found.identified
    assert found.std > 0.0
    assert learning.model.coefficient("X_uu") == found.value
    assert found.reason is not None
    assert found.reason.startswith("the data leave ")


@pytest.mark.parametrize("seed", range(3))
def test_a_delay_and_a_lag_that_are_hardly_known_do_no_harm(seed: int) -> None:
    truth = load_vehicle("vlbv300")
    commands = manoeuvre("surge-sine", truth, duration=4.0, dt=0.01).commands
    assert commands is not None
    log = simulate(truth, commands=0.3 * commands, dt=0.01, sensors=Mocap(), seed=seed, disturbance=TANK)
    learning = learn_recordings(truth, [log], free=("X_udot", "X_uu", "lag"))
    assert set(learning.estimate.names) == {"X_udot", "X_uu"}
    assert learning.delay_std > 0.02
    assert learning.lag_std > 0.0
