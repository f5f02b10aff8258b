"""Levels that the joint filter finds where speeds are measured: noise, velocity walk, disturbance."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from towtank.identification import learn_recordings
from towtank.identification.data.samples import N_MEASURED, NoiseLevels, samples_of
from towtank.identification.kalman import passes
from towtank.identification.kalman.noise_adaptation import adapt_noise
from towtank.identification.kalman.passes import one_pass
from towtank.identification.kalman.problem import JointProblem
from towtank.identification.kalman.state import FilterSettings, JointState, new_joint_state
from towtank.identification.kalman.update import count_speed
from towtank.identification.model.parameters import free_parameters
from towtank.identification.model.prior import prior_of
from towtank.simulation import Ins, OrnsteinUhlenbeck, simulate

from .runs import TRUTH, box, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
NOISE, WALK, STEP = 0.01, 0.02, 0.1  # m/s, m/s sqrt(1/s), s
LEVELS = NoiseLevels(np.full(N_MEASURED, NOISE), np.ones(6), np.full(6, WALK))


def counting(since: float) -> JointState:
    """A filter whose counts are all that matters."""
    free = free_parameters(box(), ("X_uu",))
    state = new_joint_state(
        np.array(box().parameters), free, np.zeros(1), np.ones(1), np.zeros((6, 0)), LEVELS, FilterSettings(),
    )  # fmt: skip
    state.clock["since_accepted"] = since
    return state


def followed(gain: float, n: int, seed: int) -> JointState:
    """What a filter of this gain counts of a random walk under noise; it believes its gain to be the right one."""
    generator = np.random.default_rng(seed)
    speed = np.cumsum(generator.normal(0.0, WALK * np.sqrt(STEP), n))
    seen = speed + generator.normal(0.0, NOISE, n)
    state, estimate = counting(STEP), seen[0]
    for z in seen[1:]:
        nu = float(z - estimate)
        count_speed(state, 6, nu, NOISE**2 / (1.0 - gain), gain)
        estimate += gain * nu
    return state


@pytest.mark.parametrize("gain", [0.05, 0.2, 0.45, 0.9])
def test_neighbouring_innovations_tell_a_sensor_s_noise_whatever_the_gain(gain: float) -> None:
    counted = followed(gain, 20_000, 1).statistics[6]
    assert counted.neighbour_sum / counted.neighbours == pytest.approx(NOISE**2, rel=0.05)


def test_a_velocity_walk_is_found_by_steps_of_scoring() -> None:
    walk = 5.0 * WALK
    for _ in range(6):
        # the gain of the steady state: M^2 / (M + R) = q dt
        q = walk**2 * STEP
        M = 0.5 * (q + np.sqrt(q * q + 4.0 * q * NOISE**2))
        state = followed(float(M / (M + NOISE**2)), 20_000, 2)
        own = state.statistics[6]
        walk = float(np.sqrt(max(walk**2 + own.steady_score / own.steady_information, 0.0)))
    assert walk == pytest.approx(WALK, rel=0.05)


def test_a_pause_between_two_samples_tells_nothing_of_the_noise() -> None:
    state = counting(5.0)
    for nu in (0.1, -0.1, 0.1):
        count_speed(state, 6, nu, 1.0, 0.5)
    assert state.statistics[6].neighbours == 0.0


def test_what_a_model_that_is_off_leaves_tells_nothing_of_the_noise() -> None:
    state = counting(STEP)
    for nu in (0.1, 5.0, 5.0, 0.1, 0.1):  # of variance 1
        count_speed(state, 6, nu, 1.0, 0.5)
    own = state.statistics[6]
    assert own.neighbours == 1.0
    assert own.neighbour_sum == pytest.approx(0.5 * 0.1**2 - 0.1**2)


def test_speeds_of_two_recordings_are_no_neighbours() -> None:
    wrench = waves(300, 0.01, (0, 10.0, 1.2))
    logs = [samples_of(simulate(box(), wrench=wrench, sensors=Ins(), seed=seed), box()) for seed in range(2)]
    prior = prior_of(box(), commands=False).only(("X_uu",))
    problem = JointProblem(logs, box(), prior, FilterSettings(), LEVELS.noise)
    state, *_ = one_pass(problem, prior.mean, LEVELS)
    accepted, pairs = state.statistics[6].accepted, state.statistics[6].neighbours
    assert accepted > 20.0
    assert pairs == accepted - 2.0


@pytest.mark.parametrize("seed", range(3))
def test_a_dvl_s_noise_and_the_disturbance_are_told_apart(seed: int) -> None:
    rows = ((0, 25.0, 1.2), (1, 30.0, 0.9), (2, 25.0, 1.5), (5, 2.0, 1.1))
    log = simulate(box(), wrench=waves(6000, 0.01, *rows, square=True), sensors=Ins(), seed=seed, disturbance=TANK)
    log = log.without("phi", "theta", "psi", "ax", "ay", "az")
    names = tuple(name for name in TRUTH if name[0] in "XYZN")
    levels = learn_recordings(unknown(box(), **TRUTH), [log], free=names, delay=0.0).levels
    assert levels is not None
    np.testing.assert_allclose(levels.noise[6:9], Ins().dvl_noise, rtol=0.25)
    assert 0.2 < np.exp(np.mean(np.log(levels.disturbance[:3]))) < 1.0
    assert np.all(levels.velocity_walk[:3] < 0.02)


@pytest.mark.parametrize(("shown", "share"), [(0.2, 0.8), (1.0, 0.5)])
def test_a_pose_s_noise_falls_by_its_share_of_what_the_disturbance_falls_by(shown: float, share: float) -> None:
    """Innovations of four fifths of what is foreseen: without the disturbance the noise would make up for all of it."""
    state = counting(STEP)
    pose = state.statistics[:6]
    pose["accepted"], pose["nis_sum"] = 1000.0, 1000.0 * 0.8
    pose["noise_samples"], pose["noise_sum"] = 1000.0, 1000.0 * 0.5 * NOISE**2
    state.disturbance_statistics["time"], state.disturbance_statistics["effective_samples"] = 100.0, 1e9
    state.disturbance_statistics["square"] = 100.0 * shown
    found = adapt_noise(state, LEVELS, FilterSettings(), LEVELS.noise)
    assert (found.disturbance < 0.95).all() == (shown < 1.0)
    np.testing.assert_allclose(found.noise[:6] ** 2, share * NOISE**2)


@pytest.mark.parametrize(
    ("worth", "speaks", "made"),
    [
        ({"about": (5.0, False)}, "about", ["about"]),
        ({"about": (math.nan, True), "sooner": (4.0, False)}, "sooner", ["about", "sooner"]),
        ({"about": (5.0, True), "sooner": (7.0, False)}, "sooner", ["about", "sooner"]),
        ({"about": (7.0, True), "sooner": (5.0, False)}, "about", ["about", "sooner"]),
        ({"about": (3.0, False, 0.02)}, "about", ["about"]),  # no inputs sooner than at once: by little
        ({"about": (3.0, False, 0.2), "sooner": (1.0,)}, "about", ["about", "sooner"]),
        ({"about": (3.0, False, 0.2, 2.5), "sooner": (1.0,)}, "sooner", ["about", "sooner"]),  # likelier by that
    ],
)
def test_a_second_start_speaks_where_it_is_likelier(
    monkeypatch: pytest.MonkeyPatch, worth: dict[str, tuple[Any, ...]], speaks: str, made: list[str]
) -> None:
    began = []
    log = simulate(box(), wrench=waves(300, 0.01, (0, 10.0, 1.2)), sensors=Ins())
    prior = prior_of(box(), commands=False).only(("delay",))
    problem, supposed = JointProblem([samples_of(log, box())], box(), prior, FilterSettings(), LEVELS.noise), prior.mean

    def stub(problem: Any, about: Any, levels: Any, **rest: Any) -> tuple[Any, bool]:
        began.append(name := "about" if about[0] == supposed[0] else "sooner")
        told: tuple[Any, ...] = worth[name]
        likelihood, lost, sooner, forbidden = told + (0.0, False, 0.0, 0.0)[len(told) :]
        mean, theta = np.array([-sooner * prior.std[0]]), np.zeros(1)
        return SimpleNamespace(name=name, likelihood=likelihood, mean=mean, theta=theta, forbidden=forbidden), lost

    monkeypatch.setattr(passes, "_passes", stub)
    levels = NoiseLevels(LEVELS.noise, np.ones(6))
    found: Any = passes.settled(problem, supposed, levels)
    assert (found.name, began) == (speaks, made)


def test_a_second_start_that_is_the_first_one_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where inputs are supposed to act at once already, they cannot act sooner."""
    began = []
    log = simulate(box(), wrench=waves(300, 0.01, (0, 10.0, 1.2)), sensors=Ins())
    prior = prior_of(box(), commands=False).only(("delay",))
    problem = JointProblem([samples_of(log, box())], box(), prior, FilterSettings(), LEVELS.noise)

    def stub(problem: Any, about: Any, levels: Any, **rest: Any) -> tuple[Any, bool]:
        began.append(about)
        return SimpleNamespace(likelihood=1.0, mean=np.zeros(1), theta=np.zeros(1), forbidden=0.0), True

    monkeypatch.setattr(passes, "_passes", stub)
    passes.settled(problem, np.zeros(1), NoiseLevels(LEVELS.noise, np.ones(6)))
    assert len(began) == 1
