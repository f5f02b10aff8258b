"""The attack on the estimators, cut short: logs that are wrong end in what is right, withheld, said, or refused."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import attack_estimator

from towtank.identification import Learner

SECONDS = 8.0


@pytest.mark.parametrize("way", ["learn joint", "stream joint", "stream paper"])
@pytest.mark.parametrize("abuse", ["all constant", "ms for s", "all stamps alike"])
def test_logs_that_tell_nothing_teach_nothing_wrong(abuse: str, way: str) -> None:
    found = attack_estimator.tried(abuse, "mocap", way, SECONDS, seed=1)
    assert found.fault == ""
    assert found.ever == ()


@pytest.mark.parametrize("abuse", ["degrees: angles", "half of all cells empty"])
def test_what_is_learned_of_a_spoiled_log_is_right_or_withheld(abuse: str) -> None:
    found = attack_estimator.tried(abuse, "mocap", "learn joint", SECONDS, seed=1)
    assert found.fault == ""
    assert not found.silent, (found.ever, found.worst)


def test_every_abuse_changes_the_log_and_keeps_its_shape() -> None:
    right = attack_estimator.log_of("mocap", "nothing", 2.0, 1)
    for abuse in attack_estimator.ABUSES:
        log = attack_estimator.log_of("mocap", abuse, 2.0, 1)
        assert set(log.columns) == set(right.columns)
        assert all(x.shape == log.t.shape for x in log.columns.values())
        same = np.array_equal(log.t, right.t) and all(
            np.array_equal(x, right.columns[name], equal_nan=True) for name, x in log.columns.items()
        )
        apart = ("frozen", "stuck", "u v w")
        unseen = {"nothing"} | {name for name in attack_estimator.ABUSES if name.startswith(apart)}
        unseen |= {"degrees: rates"}  # channels that motion capture has not
        assert same <= (abuse in unseen), abuse


def test_a_value_that_is_off_is_seen_as_wrong() -> None:
    truth, start = attack_estimator.vehicles()
    log = attack_estimator.log_of("mocap", "nothing", SECONDS, 1)
    learner = Learner(start, "paper")
    pose = np.column_stack([log.columns[name] for name in attack_estimator.POSE])
    commands = np.column_stack([log.columns[name] for name in log.commands])
    for t, row, asked in zip(log.t, pose, commands, strict=True):
        learner.update(float(t), pose=row, commands=asked)
    known, _, fault = attack_estimator.judged(learner.estimate, truth)
    assert known > 0
    assert fault == ""
    found = [each.name for each in learner.estimate.coefficients if each.identified]
    name = next(each for each in found if each in truth.hydrodynamics)
    elsewhere = truth.with_coefficients({name: truth.coefficient(name) + 1e3})
    assert name in attack_estimator.judged(learner.estimate, elsewhere)[1]
