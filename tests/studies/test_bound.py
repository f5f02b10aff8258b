"""The bounds that the studies compare with, against formulas and ways of their own."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from towtank.identification.model.prior import prior_of
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate
from towtank.vehicle import HYDRODYNAMIC

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from bound import force_covariance, force_response, surge_bound, whitened
from experiments import EXPERIMENTS, chosen, experiment
from kalman_bound import kalman_bound
from sensitivity import STEP, changed, motion, pose_sensitivity

SECONDS = 600  # samples of a shortened run


def short(name, **more):
    """The experiment cut to its first 6 s."""
    full = experiment(name)
    return replace(full, commands=full.commands[:SECONDS], **more)


def test_white_noise_without_drag_is_the_closed_form():
    """x = F t^2 / 2 M: d x / d ln M = -x, so that the variance of ln M is sigma^2 over the sum of x^2."""
    truth = experiment("s1-1mm-square").truth
    free = truth.model_copy(update={"hydrodynamics": {"X_udot": truth.hydrodynamics["X_udot"]}})
    commands = np.repeat(experiment("s1-1mm-square").commands[100:101], 300, axis=0)
    X = pose_sensitivity(free, commands, 0.01, ("X_udot",), 0)
    force = (
        np.polynomial.polynomial.polyval(30.0, (0.0684, -0.03366, 0.006736))
        * 2.0
        * (np.cos(np.pi / 4) + np.cos(np.radians(35.0)))
    )
    t = 0.01 * np.arange(301)
    x = 0.5 * force / (20.9 + 19.519) * t**2
    np.testing.assert_allclose(X[:, 0], -x, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(X[:, 1], 1.0, rtol=1e-9)  # position at the start
    np.testing.assert_allclose(X[:, 2], t, rtol=1e-7, atol=1e-9)  # velocity at the start
    white = whitened(X[:, :1], 1e-3, np.ones(301, dtype=bool))
    assert 1.0 / np.sqrt((white**2).sum()) == pytest.approx(1e-3 / np.sqrt((x**2).sum()), rel=1e-6)


def test_response_to_a_force_is_the_simulators():
    """A small force held over one step moves the simulated vehicle as G says, with drag along the way."""
    case = short("s2-square")
    n, at = 300, 120
    u = np.gradient(motion(case.truth, case.commands[:n], 0.01)[:, 0], 0.01)
    G = force_response(float(case.truth.mass_matrix[0, 0]), -case.truth.coefficient("X_uu"), u, 0.01)
    ends = []
    for side in (1.0, -1.0):
        push = Push(side * 1e-3, at)
        ends.append(simulate(case.truth, commands=case.commands[:n], disturbance=push)["x"].values)
    np.testing.assert_allclose(G[:, at], (ends[0] - ends[1]) / 2e-3, rtol=2e-3, atol=1e-9)


class Push(OrnsteinUhlenbeck):
    """A force over one step alone."""

    def __init__(self, size, at):
        super().__init__()
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "at", at)

    def sample(self, n, dt, seed):
        push = np.zeros((n, 6))
        push[self.at, 0] = self.size
        return push


def test_covariance_of_the_force_is_that_of_its_samples():
    force = OrnsteinUhlenbeck(std=0.5, time_constant=0.1, axes=("X",))
    drawn = np.array([force.sample(20, 0.01, seed)[:, 0] for seed in range(4000)])
    np.testing.assert_allclose(drawn.T @ drawn / 4000, force_covariance(force, 20, 0.01), atol=0.02)


@pytest.mark.parametrize("name", ["s1-5mm-stairs", "s1-1mm-square", "s2-stairs", "s2-square"])
def test_factorisation_and_kalman_filter_agree(name):
    """The dense covariance of all samples and the recursive filter are two ways to the same information."""
    case = short(name)
    dense, recursive = (
        surge_bound(case, 3),
        kalman_bound(replace(case, disturbance=None) if name[1] == "1" else case, every=1.0),
    )
    seen_all = surge_bound(case)
    assert dense.t[-1] == pytest.approx(6.0)
    np.testing.assert_allclose(seen_all.std[300::100], recursive.std[3:], rtol=1e-3)
    assert (dense.std[-1] >= seen_all.std[-1]).all()  # hidden samples tell nothing


def test_coupled_bound_without_random_wrench_is_that_of_whole_simulations():
    """Sensitivities of single steps, chained by the filter, against those of whole runs, for all coefficients."""
    case = short("coupled-pose", disturbance=None, sensors=Mocap(jump_fraction=0.0))
    chained = kalman_bound(case, every=1.0)
    columns = []
    for name in case.free:
        ends = [motion(changed(case.truth, name, side * STEP), case.commands, 0.01) for side in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * STEP))
    for which, axes in (("eta0", range(6)), ("nu0", range(6))):
        for axis in axes:
            at = STEP * np.eye(6)[axis]
            ends = [motion(case.truth, case.commands, 0.01, **{which: side * at}) for side in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / (2.0 * STEP))
    X = np.stack(columns, axis=-1).reshape(-1, len(columns)) / 1e-3
    prior = np.concatenate([np.full(13, 30.0), np.ones(6), np.full(6, 0.01)])
    covariance = np.linalg.inv(X.T @ X + np.diag(prior**-2))
    np.testing.assert_allclose(chained.std[-1], np.sqrt(np.diag(covariance))[:13], rtol=1e-3)


def test_ideal_errors_have_the_covariance_of_the_bound():
    bound = surge_bound(short("s2-square"))
    generator = np.random.default_rng(0)
    drawn = np.array([bound.ideal_errors(generator)[-1] for _ in range(2000)])
    np.testing.assert_allclose(drawn.std(axis=0), bound.std[-1], rtol=0.06)


def test_names():
    assert chosen(EXPERIMENTS, "s2") == ("s2-stairs", "s2-square", "delay-s2-stairs", "delay-s2-square")
    assert chosen(EXPERIMENTS, "s2-*,gyro") == ("s2-stairs", "s2-square", "coupled-gyro")
    with pytest.raises(ValueError, match="nothing matches"):
        chosen(EXPERIMENTS, "s3")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_learner_is_told_nothing_of_what_it_is_to_learn_and_what_all_else_is(name):
    case = experiment(name)
    told, free = case.start.hydrodynamics, set(case.free)
    assert not free & told.keys()
    assert told.keys() == set(HYDRODYNAMIC) - free
    assert all(each.std == 0.0 and each.value == case.truth.coefficient(key) for key, each in told.items())
    assert case.start.coefficient("BG_z") == (0.0 if "BG_z" in free else case.truth.coefficient("BG_z"))
    assert case.start.command_delay == 0.0
    assert not any(thruster.time_constant for thruster in case.start.thrusters)
    supposed = prior_of(case.start).only(case.free)
    assert (supposed.covariance.diagonal() > 0.0).all()
