"""Studies on several processes: a task that ends its process costs the others nothing, and is a result of its own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.studies.ending import root_or_end

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import runner
from trial import Trial


def test_a_task_that_ends_its_process_is_one_result_among_the_others():
    found = runner.over("short", root_or_end, [(1.0,), (4.0,)], 2, died=lambda value, how: f"{value:.0f} {how}")
    assert found == [1.0, "4 killed by SIGABRT"]


def test_without_a_word_for_it_the_study_ends():
    with pytest.raises(RuntimeError, match="task 0 ended twice: killed by SIGABRT"):
        runner.over("short", root_or_end, [(4.0,)], 2)


def test_a_trial_whose_process_ends_is_a_failed_outcome(monkeypatch):
    monkeypatch.setattr(runner, "perform", abort)
    trial = Trial("s1-square", 7, "batch", (10.0, 20.0))
    (outcome,) = runner.run("short", [trial], 2)
    assert outcome.trial == trial
    assert outcome.failure == "its process ended twice: killed by SIGABRT"
    assert outcome.t.tolist() == [10.0, 20.0]
    assert np.isnan(outcome.values).all()


def abort(_: Trial) -> None:
    os.abort()
