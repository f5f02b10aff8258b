"""A heading that wanders beside a gyro that does not: found by likelihood, and taken for nothing else."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_recordings
from towtank.identification.kalman.passes import _other_surroundings
from towtank.identification.offline.joint import LearningRequest, joint_problem

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from pushed_box import flight, true_box


def learned(case: str, seed: int) -> LogLearning:
    return learn_recordings(true_box().model_copy(update={"hydrodynamics": {}}), [flight(case, seed)], free_runs=False)


@pytest.mark.parametrize("seed", [2, 5])
def test_it_is_taken_for_no_current_and_costs_the_gyro_nothing(seed: int) -> None:
    """Taken for a current that walks, or for noise of the attitude, it made inertias 8 deviations wrong; a gyro that
    was doubted for it told a tenth."""
    truth, found = true_box(), learned("so beside a quiet gyro", seed)
    off = {
        each.name: (each.value - truth.coefficient(each.name)) / each.std
        for each in found.estimate.coefficients
        if each.identified and each.std
    }
    assert len(off) > 38
    assert max(map(abs, off.values())) < 3.5
    assert found.levels is not None
    assert found.levels.heading_bias == 0.12
    assert found.levels.current_walk < 0.01
    assert found.levels.noise[3:6] == pytest.approx(2e-3, rel=0.15)
    assert any(text.startswith("the heading wanders") for text in found.remarks)
    assert (found.estimate["N_rdot"].std or np.inf) < 0.005


def test_one_that_does_not_is_not_asked_to() -> None:
    found = learned("raw", 2)
    assert found.levels is not None
    assert found.levels.heading_bias == 0.0
    assert not any(text.startswith("the heading wanders") for text in found.remarks)


def test_it_is_asked_for_beside_a_gyro_alone() -> None:
    """And where an attitude is supposed to wander already, for more of it alone."""
    bare, run = true_box().model_copy(update={"hydrodynamics": {}}), flight("raw", 1)

    def asked(without: str) -> list[float]:
        problem = joint_problem(LearningRequest(bare, [run.without(*without.split())]))
        return [level.heading_bias for row in _other_surroundings(problem, problem.rough) for _, level in row]

    assert [each for each in asked("") if each] == [0.03, 0.12]
    assert not any(asked("p q r") + asked("r") + asked("psi") + asked("phi theta"))
    assert [each for each in asked("x y") if each] == [0.12]
