"""How estimates settle: the course begins at the prior, narrows, and ends where learning ended."""

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


def test_it_begins_at_the_prior(logs: Path) -> None:
    run = read(logs / "yaw.csv")
    learning = learn_recordings(load_vehicle("vlbv300"), [run], free=FREE, delay=0.0)
    course, prior = convergence(learning, [run]), learning.prior
    assert prior is not None
    k, row = course.names.index("N_rr"), prior.names.index("N_rr")
    assert 0.5 * prior.std[row] < course.std[0, k] <= prior.std[row]
    assert abs(course.values[0, k] - prior.mean[row]) < prior.std[row]


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
