"""Commands that stop while motion goes on: noticed where they came steadily, and not learned from as if in force."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from towtank import load_vehicle
from towtank.identification import Estimate
from towtank.live import Raw, Sample
from towtank.live.learning import Recent, Silence, recording_of
from towtank.live.links.source import SourceState
from towtank.live.pipeline.instants import rows_of
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.recording import Recording
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import Vehicle

EPOCH = 1.7e9
COMMANDS, POSE = {"commands": 1}, {"pose": 1}


def seen(silence: Silence, times: Sequence[float], arguments: dict[str, int]) -> list[float]:
    """Return when an event came."""
    return [t for t in times if silence.see(t, arguments) is not None]


def test_steady_commands_are_missed_after_a_second_or_five_periods() -> None:
    fast, slow = Silence(), Silence()
    assert seen(fast, np.arange(0.0, 2.0, 0.05).tolist(), COMMANDS) == []
    late = np.arange(2.0, 5.0, 0.01)
    assert seen(fast, late.tolist(), POSE) == pytest.approx([1.95 + 1.01], abs=0.011)
    assert fast.since == pytest.approx(1.95)
    assert seen(slow, np.arange(0.0, 10.0, 0.5).tolist(), COMMANDS) == []
    assert seen(slow, np.arange(10.0, 20.0, 0.01).tolist(), POSE) == pytest.approx([9.5 + 2.51], abs=0.011)
    assert seen(slow, [20.0], COMMANDS) == []
    assert slow.since is None
    assert len(seen(slow, np.arange(20.0, 30.0, 0.01).tolist(), POSE)) == 1  # missed again


def test_commands_sent_when_they_change_hold_for_ever() -> None:
    silence = Silence()
    times = np.cumsum(np.tile([0.1, 0.1, 0.1, 3.0, 7.0], 8)).tolist()
    assert seen(silence, times, COMMANDS) == []
    assert seen(silence, (times[-1] + np.arange(0.0, 60.0, 0.1)).tolist(), POSE) == []
    few = Silence()
    assert seen(few, [0.0, 0.1, 0.2], COMMANDS) == []
    assert seen(few, np.arange(0.2, 60.0, 0.1).tolist(), POSE) == []


def test_where_nothing_comes_for_a_tenth_of_a_second_and_five_periods_commands_were_lost() -> None:
    fast, slow, seldom = Silence(), Silence(), Silence()
    seen(fast, np.arange(0.0, 2.0, 0.01).tolist(), COMMANDS)
    assert not fast.lost(0.09)
    assert fast.lost(0.11)
    seen(slow, np.arange(0.0, 9.0, 0.1).tolist(), COMMANDS)
    assert not slow.lost(0.49)
    assert slow.lost(0.51)
    seen(seldom, np.cumsum(np.tile([0.1, 0.1, 0.1, 3.0, 7.0], 8)).tolist(), COMMANDS)
    assert not seldom.lost(60.0)
    assert not Silence().lost(60.0)


class Link:
    name, patient, keeps_time = "test", True, True

    def __init__(self, samples: Sequence[Sample]) -> None:
        self._batches: Iterator[Sequence[Sample]] = (samples[k : k + 20] for k in range(0, len(samples), 20))
        self._ended = False

    def open(self) -> None:
        pass

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        batch = next(self._batches, None)
        self._ended = batch is None
        return batch or []

    def state(self) -> SourceState:
        return SourceState(ended=self._ended)

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("seamor")


@pytest.fixture(scope="module")
def run(vehicle: Vehicle) -> Recording:
    plan = manoeuvre("surge-sine", vehicle, duration=24.0, dt=0.01, seed=1)
    return simulate(vehicle, commands=plan.commands, dt=0.01, sensors=Mocap(rate=100.0), seed=1)


def learned(vehicle: Vehicle, run: Recording, away: tuple[float, float], *, heed: bool = True) -> Status:
    """Learn from a run whose commands are not told for a while."""
    samples = []
    for t, names, values in rows_of(run):
        pairs = [
            (name, value)
            for name, value in zip(names, values, strict=True)
            if not (name.startswith("cmd_") and away[0] <= t < away[1])
        ]
        samples.append(Sample("test", "all", EPOCH + t, EPOCH + t, *map(tuple, zip(*pairs, strict=True))))  # type: ignore[arg-type]
    learner = new_learner(vehicle, "joint", ("X_udot", "X_uu"), background=False)
    session = Session([("test", Link(samples))], vehicle, learner, epoch=EPOCH)
    if not heed:
        session.learning._silence.see = lambda t, arguments: None  # type: ignore[method-assign]
    session.open()
    return session.run(threading.Event())


def test_a_session_says_so_and_learns_on_when_they_are_back(vehicle: Vehicle, run: Recording) -> None:
    status = learned(vehicle, run, (10.0, 15.0))
    gone = [each for each in status.events if each.kind == "occlusion"]
    assert [each.details["measured"] for each in gone] == ["commands"]
    assert gone[0].t == pytest.approx(9.99, abs=0.011)
    assert status.learnt.silent is None
    assert not any("no commands" in text for text in status.warnings)

    def wrong(status: Status) -> float:
        found = status.learnt.estimate
        return max(abs(found[name].value / vehicle.coefficient(name) - 1.0) for name in ("X_udot", "X_uu"))

    found = status.learnt.estimate
    for name in ("X_udot", "X_uu"):  # commands are missed after a second of forces that were not
        assert abs(found[name].value - vehicle.coefficient(name)) < 2.0 * found[name].std
    assert wrong(status) < 0.10
    assert wrong(status) < wrong(learned(vehicle, run, (10.0, 15.0), heed=False))


def told_of(vehicle: Vehicle, run: Recording, away: tuple[float, float], *, heed: bool = True) -> Estimate:
    """Learn from a run of which nothing at all is told for a while."""
    rows = [each for each in rows_of(run) if not away[0] <= each[0] < away[1]]
    samples = [Sample("test", "all", EPOCH + t, EPOCH + t, names, values) for t, names, values in rows]
    learner = new_learner(vehicle, "joint", ("X_udot", "X_uu"), background=False)
    session = Session([("test", Link(samples))], vehicle, learner, epoch=EPOCH)
    if not heed:
        session.learning._silence.lost = lambda seconds: False  # type: ignore[method-assign]
    session.open()
    session.run(threading.Event())
    return learner.estimate


@pytest.fixture(scope="module")
def whole(vehicle: Vehicle, run: Recording) -> Estimate:
    """What is learned where nothing is lost."""
    return told_of(vehicle, run, (0.0, 0.0))


@pytest.mark.parametrize("heed", [True, False])
def test_what_a_link_lost_with_the_commands_is_not_made_up(
    vehicle: Vehicle, run: Recording, whole: Estimate, *, heed: bool
) -> None:
    away = (12.0, 12.4)  # half a swing of the thrusters
    found = told_of(vehicle, run, away, heed=heed)
    change = np.abs(found.values - whole.values) / whole.std
    assert bool(change.max() < 0.5) == heed


def test_silence_to_the_end_is_a_warning(vehicle: Vehicle, run: Recording) -> None:
    status = learned(vehicle, run, (12.0, 99.0))
    assert any("no commands since 12.0 s" in text for text in status.warnings)
    noticed = learned(vehicle, run.window(0.0, 12.99), (12.0, 99.0)).learnt.estimate
    silent = learned(vehicle, run.window(0.0, 18.0), (12.0, 99.0)).learnt.estimate
    found = status.learnt.estimate
    assert 0 <= found.samples - noticed.samples <= 20  # none after the second that it takes to notice, and a batch
    for name in ("X_udot", "X_uu"):
        assert abs(silent[name].value - noticed[name].value) < noticed[name].std  # the same samples, seen anew
        assert found[name].value == pytest.approx(vehicle.coefficient(name), rel=0.05)


def test_the_recent_part_is_the_longer_stretch(run: Recording) -> None:
    recent = Recent()
    for t, names, values in rows_of(run):
        recent.add(t, dict(zip(names, values, strict=True)))
        if t in (4.0, 20.0):
            recent.break_off()
    kept = recent.recording()
    assert kept is not None
    assert (kept.start, kept.end) == (pytest.approx(4.01), pytest.approx(20.0))
    np.testing.assert_array_equal(kept["x"].measured.values, run.window(4.005, 20.005)["x"].measured.values)
    assert Recent().recording() is None


def test_the_recent_part_is_a_minute_and_a_copy_of_it_stays() -> None:
    recent = Recent()
    for k in range(2000):
        recent.add(0.1 * k, {"u": float(k), "strange": 1.0, "v": math.nan})
    copy = recent.copy()
    recent.add(200.0, {"u": 2000.0})
    kept, after = copy.recording(), recent.recording()
    assert kept is not None
    assert after is not None
    assert list(kept.channels) == ["u"]
    assert (kept.end, after.end) == (pytest.approx(199.9), 200.0)
    assert kept.end - kept.start == pytest.approx(60.0, abs=0.11)
    assert kept["u"].values.tolist() == [float(round(10.0 * t)) for t in kept["u"].t]


def test_of_two_values_of_a_moment_the_first_counts_and_none_that_goes_back() -> None:
    rows = [(1.0, ("u", "cmd_1"), (1.0, 5.0)), (1.0, ("u",), (2.0,)), (0.5, ("u",), (3.0,)), (2.0, ("u",), (4.0,))]
    found = recording_of(rows, "rows")
    assert found is not None
    assert (found["u"].t.tolist(), found["u"].values.tolist()) == ([1.0, 2.0], [1.0, 4.0])
    assert (found["u"].unit, found["u"].frame) == ("m/s", "FRD")
    assert recording_of([(1.0, ("strange", "u"), (1.0, math.inf))], "rows") is None
