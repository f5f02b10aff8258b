"""How estimates settle: the course ends where learning ended, owes nothing to its start, and narrows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.identification import learn_recordings
from towtank.identification.offline.convergence import convergence
from towtank.readers import read
from towtank.vehicle import load_vehicle

FREE = ("N_rdot", "N_rr")


@pytest.mark.parametrize("method", ["joint", "paper"])
def test_it_ends_where_learning_ended(method: str, logs: Path) -> None:
    vehicle, run = load_vehicle("vlbv300"), read(logs / "yaw.csv")
    learning = learn_recordings(vehicle, [run], method=method, free=FREE, delay=0.0)
    course = convergence(learning, [run])
    assert course.names == FREE
    assert course.ends == ()
    assert course.t[-1] == pytest.approx(run.duration, abs=0.02)
    assert np.all(np.diff(course.t) > 0.0)
    for k, name in enumerate(FREE):
        result = learning.estimate[name]
        assert abs(course.values[-1, k] - result.value) < 3.0 * np.hypot(course.std[-1, k], result.std)
        known = course.std[np.isfinite(course.std[:, k]), k]
        assert known[-1] < 0.6 * known[0]
        assert known[-1] == pytest.approx(result.std, rel=0.6)


def test_it_owes_nothing_to_what_was_known_before(logs: Path) -> None:
    run, right = read(logs / "yaw.csv"), load_vehicle("vlbv300")
    wrong = right.with_coefficients({name: 4.0 * right.coefficient(name) for name in FREE})
    ends = []
    for vehicle in (right, wrong):
        learning = learn_recordings(vehicle, [run], free=FREE, delay=0.0)
        course = convergence(learning, [run])
        ends.append((course.values[-1], course.std[-1]))
    assert np.all(np.abs(ends[0][0] - ends[1][0]) < 0.5 * ends[0][1])


@pytest.mark.parametrize("method", ["joint", "paper"])
def test_logs_follow_each_other(method: str, logs: Path) -> None:
    runs = [read(logs / "yaw.csv"), read(logs / "surge.csv")]
    learning = learn_recordings(load_vehicle("vlbv300"), runs, method=method, free=(*FREE, "X_udot", "X_uu"), delay=0.0)
    course = convergence(learning, runs)
    assert course.ends == (pytest.approx(runs[0].duration, abs=0.02),)
    assert course.t[-1] == pytest.approx(sum(run.duration for run in runs), abs=0.05)
    surge = course.std[:, course.names.index("X_uu")]
    before, after = course.t < course.ends[0], course.t > course.ends[0] + 2.0
    assert np.nanmin(surge[after]) < 0.5 * np.nanmin(surge[before], initial=np.inf)


def test_nothing_learned_has_no_course(logs: Path) -> None:
    run = read(logs / "yaw.csv").without("u", "v", "w", "ax", "ay", "az", "z")
    learning = learn_recordings(load_vehicle("vlbv300"), [run], method="paper", free=("X_udot",), delay=0.0)
    assert convergence(learning, [run]).t.size == 0
