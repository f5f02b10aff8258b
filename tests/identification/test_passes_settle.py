"""Passes come to rest: levels that go to and fro go half way, and those that explain far less are gone back from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towtank.identification.data.samples import NoiseLevels
from towtank.identification.kalman import passes
from towtank.identification.kalman.noise_adaptation import converged
from towtank.identification.kalman.passes import first_passes, joint_fit
from towtank.identification.kalman.problem import JointProblem
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.simulation.tank import tank_session

LEVELS = NoiseLevels(np.ones(18), np.full(6, 0.1), np.array([0.01, 0.0, 0.0, np.nan, 0.0, 0.0]), np.full(3, 0.02))


@pytest.fixture(scope="module")
def problem() -> JointProblem:
    session = tank_session(8.0)
    return joint_problem(LearningRequest(session.known, [session.recording]))


def with_surge(disturbance: float) -> NoiseLevels:
    return replace(LEVELS, disturbance=np.array([disturbance, *LEVELS.disturbance[1:]]))


def test_a_level_that_turns_back_goes_half_way() -> None:
    before, last = with_surge(0.1), with_surge(0.4)
    back, on = with_surge(0.1).turning(last, before), with_surge(0.5).turning(last, before)
    np.testing.assert_allclose(back.disturbance, [0.2, *LEVELS.disturbance[1:]])
    np.testing.assert_allclose(on.disturbance, [0.5, *LEVELS.disturbance[1:]])
    for name in ("noise", "velocity_walk", "waves"):
        np.testing.assert_array_equal(getattr(back, name), getattr(LEVELS, name))


def test_levels_that_go_to_and_fro_have_converged_and_those_that_go_on_have_not() -> None:
    before, last = with_surge(0.1), with_surge(0.2)
    assert converged(with_surge(0.12), last, before)
    assert not converged(with_surge(0.22), last, before)
    assert converged(with_surge(0.205), last, before)


def test_levels_that_explain_far_less_are_gone_back_from(
    problem: JointProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often innovations are taken for a disturbance a hundred times less than there is, which rejects much."""
    well = joint_fit(problem)
    monkeypatch.setattr(
        passes,
        "adapt_noise",
        lambda state, levels, *_, **__: replace(levels, disturbance=0.01 * well.levels.disturbance),
    )
    found = first_passes(problem, 16, since=(problem.prior.mean, well.levels))
    assert found.likelihood > well.likelihood - 10.0
    apart = np.abs(found.theta - well.theta) / well.std
    assert apart.max() < 0.3
