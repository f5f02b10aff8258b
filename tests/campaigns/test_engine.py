"""The processes of one machine: all answers, whoever dies."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from pathlib import Path

import pytest

from towtank.campaigns.engines.child import Child, Died
from towtank.campaigns.engines.local import Local, perform_all

sys.path.append(str(Path(__file__).parent))  # processes that are started import it too

from small_jobs import doubled, environment, unlucky


def test_every_job_is_answered_and_one_that_dies_or_raises_takes_nothing_along() -> None:
    answers = {each.number: each for each in perform_all(doubled, [(k,) for k in range(20)], 2)}
    assert sorted(answers) == list(range(20))
    assert {k: each.value for k, each in answers.items() if each.value is not None} == {
        k: 2 * k for k in range(20) if k not in (13, 14)
    }
    assert answers[13].died == "killed by SIGKILL"
    assert isinstance(answers[14].error, KeyError)


def test_a_job_whose_process_died_once_is_tried_again(tmp_path: Path) -> None:
    [answer] = perform_all(unlucky, [(5, str(tmp_path / "mark"))], 1)
    assert (answer.value, answer.died, answer.error) == (5, None, None)


def test_a_process_has_one_thread_and_the_environment_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    child = Child(environment)
    try:
        assert child.perform(("OMP_NUM_THREADS",)) == child.perform(("NUMBA_NUM_THREADS",)) == "1"
    finally:
        child.close()
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert "NUMBA_NUM_THREADS" not in os.environ


def test_a_process_that_was_ended_from_outside_is_begun_anew() -> None:
    child = Child(doubled)
    try:
        assert child.perform((1,)) == 2
        child.close()
        assert child.perform((2,)) == 4
        with pytest.raises(Died, match="killed by SIGKILL"):
            child.perform((13,))
        assert child.perform((3,)) == 6
    finally:
        child.close()


def test_ending_early_ends_the_processes() -> None:
    before = {each.pid for each in multiprocessing.active_children()}
    answers = perform_all(time.sleep, [(0.0,), *((60.0,) for _ in range(5))], 2)
    next(answers)
    answers.close()
    until = time.monotonic() + 50.0  # the 60 s of a job are not waited for
    while {each.pid for each in multiprocessing.active_children()} - before:
        assert time.monotonic() < until
        time.sleep(0.05)


def test_who_is_ended_for_good_begins_no_other_process() -> None:
    """Nor where the job was taken in the moment before, by another thread."""
    child = Child(doubled)
    assert child.perform((1,)) == 2
    child.end()
    with pytest.raises(Died, match="on demand"):
        child.perform((2,))


def test_by_default_there_is_a_process_for_each_core() -> None:
    assert Local.usual().workers == len(os.sched_getaffinity(0))
