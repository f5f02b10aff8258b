"""One battery of checks for every streaming method: what a learner owes to whoever feeds and reads it."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import Estimate, Learner
from towtank.identification.data.samples import N_MEASURED
from towtank.identification.posterior.assembly import Current
from towtank.methods import STREAMING_METHODS
from towtank.recording import Recording
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

from .runs import POSE, VELOCITY, Run, box, fly, waves

FREE = ("X_udot", "X_uu", "N_rdot", "N_rr")
WRENCH = ("X", "Y", "Z", "K", "M", "N")
DT = 0.02  # s

pytestmark = pytest.mark.parametrize("method", STREAMING_METHODS)


@cache
def run_of(seconds: float) -> Run:
    """Surge and yaw to and fro, pose and velocity with a little noise."""
    n = round(seconds / DT)
    push = waves(n, DT, (0, 30.0, 2.0), (5, 3.0, 2.6), square=True)
    run, noise = fly(box(), push, DT), np.random.default_rng(5)
    pose = run.pose + 1e-3 * noise.normal(size=run.pose.shape)
    return Run(run.t, pose, run.velocity + 2e-3 * noise.normal(size=run.velocity.shape), run.wrench)


def new(method: str) -> Learner:
    return Learner(box(), method, free=FREE)


def feed(learner: Learner, run: Run, first: int = 0, last: int | None = None) -> Learner:
    for k in range(first, run.t.size if last is None else last):
        learner.update(float(run.t[k]), pose=run.pose[k], velocity=run.velocity[k], wrench=run.wrench[k])
    return learner


def assert_same(one: Learner, other: Learner, tolerance: float = 0.0) -> None:
    a, b = one.estimate, other.estimate
    assert a.names == b.names
    assert a.identified == b.identified
    assert any(a.identified)
    np.testing.assert_allclose(a.values, b.values, rtol=tolerance, atol=0.0)
    np.testing.assert_allclose(a.std, b.std, rtol=tolerance, atol=0.0)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=tolerance, atol=tolerance**2)


def contract(learner: Learner) -> dict[str, Any]:
    names = ("delay", "lag", "gains", "latency", "noise", "disturbance", "current", "likely", "events")
    return {name: getattr(learner, name) for name in names}


def test_the_contract_has_its_types_before_and_after_the_first_sample(method: str) -> None:
    learner = new(method)
    for _ in range(2):
        known = contract(learner)
        assert learner.method == method
        assert isinstance(learner.vehicle, Vehicle)
        assert isinstance(learner.keeps_checkpoints, bool)
        assert isinstance(learner.estimate, Estimate)
        assert isinstance(learner.model(), Vehicle)
        assert type(known["delay"]) is float
        assert type(known["lag"]) is float
        assert math.isnan(known["delay"]) or known["delay"] >= 0.0
        assert known["gains"] == {}  # a wrench tells nothing of thrusters
        assert known["noise"] is None or known["noise"].shape == (N_MEASURED,)
        assert known["disturbance"] is None or known["disturbance"].shape == (6,)
        assert known["latency"] == {}  # pose and velocity come in the same rows
        assert known["current"] is None or isinstance(known["current"], Current)
        assert known["likely"] == {}
        assert isinstance(known["events"], tuple)
        assert all(isinstance(each, Event) for each in known["events"])
        feed(learner, run_of(2.0))


def test_reading_changes_nothing(method: str) -> None:
    run, read, unread = run_of(4.0), new(method), new(method)
    for k in range(0, run.t.size, 20):
        feed(read, run, k, min(k + 20, run.t.size))
        once, model = read.estimate, read.model()
        contract(read)
        again = read.estimate
        assert once.names == again.names
        assert np.array_equal(once.values, again.values)
        assert np.array_equal(once.std, again.std, equal_nan=True)
        assert np.array_equal(model.parameters, read.model().parameters)
    assert_same(read, feed(unread, run))


def test_what_is_handed_in_and_out_stays_the_callers(method: str) -> None:
    run, one, other = run_of(4.0), new(method), new(method)
    pose, velocity, wrench = np.empty(6), np.empty(6), np.empty(6)
    for k in range(run.t.size):
        pose[:], velocity[:], wrench[:] = run.pose[k], run.velocity[k], run.wrench[k]
        other.update(float(run.t[k]), pose=pose, velocity=velocity, wrench=wrench)
        for given, kept in ((pose, run.pose[k]), (velocity, run.velocity[k]), (wrench, run.wrench[k])):
            assert np.array_equal(given, kept)
            given[:] = 1e9
        if k == run.t.size // 2:
            for array in (other.noise, other.disturbance, other.estimate.values, other.estimate.covariance):
                if array is not None:
                    array[:] = 1e9
    assert_same(feed(one, run), other)


def test_a_pickled_learner_goes_on(method: str) -> None:
    run, one = run_of(4.0), new(method)
    feed(one, run, 0, 90)
    other = pickle.loads(pickle.dumps(one))
    assert type(other) is type(one)
    assert_same(feed(one, run, 90), feed(other, run, 90))


def test_arrays_that_a_learner_hands_out_make_one_that_goes_on(method: str, tmp_path: Path) -> None:
    run, one = run_of(4.0), new(method)
    feed(one, run, 0, 90)
    if not one.keeps_checkpoints:
        with pytest.raises(InputError, match="keeps no checkpoint"):
            one.save(tmp_path / "state")
        return
    kept = {name: array.copy() for name, array in one.to_arrays().items()}
    other = type(one).from_arrays(kept, box())
    for name, array in one.to_arrays().items():
        assert np.array_equal(kept[name], array, equal_nan=array.dtype.kind == "f"), name
    assert_same(feed(one, run, 90), feed(other, run, 90), 1e-9)


def test_row_by_row_equals_at_once(method: str) -> None:
    run, whole = run_of(4.0), new(method)
    columns = dict(zip(POSE + VELOCITY + WRENCH, np.hstack([run.pose, run.velocity, run.wrench]).T, strict=True))
    assert whole.run(Recording.from_table(run.t, columns)) > 0
    assert_same(whole, feed(new(method), run), 1e-9)


def test_memory_is_bounded(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once as many rows are kept as may be, nothing grows any more: here after six seconds in place of minutes."""
    monkeypatch.setattr("towtank.identification.online.reestimation._MOST_ROWS", 300)
    monkeypatch.setattr("towtank.identification.changes.detector._LEAST_MOTION", 3.0)
    run, learner = run_of(60.0), new(method)
    feed(learner, run, 0, 1000)
    sizes = [numbers_in(feed(learner, run, k, k + 50)) for k in range(1000, 3000, 50)]
    early, late = sizes[:20], sizes[20:]
    assert min(late) <= 1.001 * min(early)
    assert max(late) <= 1.1 * max(early)  # filters that watch for changes come and go, one more or less at a time


def numbers_in(learner: Learner) -> int:
    """Return how many numbers all arrays hold that a learner reaches, each counted once."""
    arrays: dict[int, int] = {}
    for array in arrays_in(learner, set()):
        base = array if array.base is None else array.base
        arrays[id(base)] = int(getattr(base, "size", array.size))
    return sum(arrays.values())


def arrays_in(thing: Any, seen: set[int]) -> Iterator[np.ndarray]:
    if id(thing) in seen or isinstance(thing, Vehicle):
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        yield thing
    elif isinstance(thing, Mapping):
        for each in thing.values():
            yield from arrays_in(each, seen)
    elif isinstance(thing, list | tuple | set) or type(thing).__name__ == "deque":
        for each in thing:
            yield from arrays_in(each, seen)
    elif is_dataclass(thing) and not isinstance(thing, type):
        for field in fields(thing):
            yield from arrays_in(getattr(thing, field.name), seen)
    elif hasattr(thing, "__dict__") and type(thing).__module__.startswith("towtank"):
        for each in vars(thing).values():
            yield from arrays_in(each, seen)


@dataclass
class _Holder:
    inner: list[np.ndarray]


def test_the_count_of_numbers_sees_what_is_inside(method: str) -> None:
    grown = _Holder([np.zeros(10), np.zeros((5, 2))])
    assert sum(array.size for array in arrays_in(grown, set())) == 20
    assert numbers_in(new(method)) > 0
