"""Coefficients that somebody names: told from nothing is enough, and what is hardly known is not thrown away."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_recordings
from towtank.identification.least_squares.batch import learn_paper
from towtank.identification.offline.joint import speeds_of
from towtank.recording import Recording
from towtank.recording.standard import VELOCITIES
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


def test_what_is_hardly_known_stays_as_fitted_and_says_so() -> None:
    learning = learn(weak(1.5, 2), free=("X_udot", "X_uu"))
    found = learning.estimate["X_uu"]
    assert not found.identified
    assert found.value < 0.0
    assert learning.model.coefficient("X_uu") == found.value  # the mass was fitted beside this, not beside none
    assert found.reason is not None
    assert found.reason.startswith("X_uu would be known to ")
    assert found.reason.endswith("; as fitted along with the others")


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


def test_of_what_nothing_is_told_the_vehicle_s_value_stays() -> None:
    learning = learn(weak(1.5, 0), free=("X_udot", "X_uu"))
    found = learning.estimate["X_uu"]
    assert not found.identified
    assert found.value == learning.model.coefficient("X_uu") == 0.0
    assert found.reason is not None
    assert found.reason.endswith("; held at the vehicle's value")


def test_the_speeds_of_a_run_are_told_from_poses_alone() -> None:
    wrench = waves(3000, 0.01, *((i, 20.0 if i < 3 else 0.8, 0.7 + 0.1 * i) for i in range(6)))
    noisy = simulate(box(), wrench=wrench, sensors=Mocap(noise_mm=5.0), seed=1)
    whole = simulate(box(), wrench=wrench)
    true = np.array([whole[name].values for name in VELOCITIES])
    speeds = speeds_of(learn_paper(unknown(box()), [noisy], delay=0.0))
    np.testing.assert_allclose(speeds[:, 0], np.sqrt(np.mean(true**2, axis=1)), rtol=0.1)
    np.testing.assert_allclose(speeds[:, 1], np.abs(true).max(axis=1), rtol=0.2)


def test_speeds_that_nothing_tells_are_unknown_and_not_zero() -> None:
    log = simulate(box(), wrench=waves(1500, 0.01, (5, 3.0, 1.2), square=True), sensors=Mocap())
    turns = log.without("x", "y", "z")
    speeds = speeds_of(learn_paper(unknown(box()), [turns], delay=0.0))
    assert np.isnan(speeds[:3]).all()
    assert speeds[5, 1] > 0.1


def test_an_inertia_that_least_squares_cannot_tell_comes_with_a_warning() -> None:
    doubted = learn(weak(1.5, 0), free=("X_udot", "X_uu"))
    assert doubted.estimate["X_udot"].identified
    said = [text for text in doubted.warnings if text.startswith("X_udot: least squares cannot tell it (")]
    assert len(said) == 1
    assert "may be far too small" in said[0]
    assert not any("nothing could be identified" in text for text in doubted.warnings)
    assert not learn(weak(3.5, 0), free=("X_udot", "X_uu")).warnings
