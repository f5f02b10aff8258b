"""Only water counts, live too: what is learned from, what is said of the rest, and that its recording is cut alike."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank import Learner, load_vehicle
from towtank.errors import InputError
from towtank.live import Raw, Sample, SourceState, open_source
from towtank.live.events import EventLog
from towtank.live.learning import Learning
from towtank.live.links.json import JsonMessages
from towtank.live.pipeline.instants import rows_of
from towtank.live.pipeline.lane import Lane
from towtank.live.pipeline.sorter import Sorter
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.readers import read
from towtank.recording import Channel, Recording
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE, free_motion
from towtank.recording.mcap.log import McapLog
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import Vehicle

from .learners import Counting

EPOCH = 1.7e9
FREE = ("X_udot", "X_uu")
ATTRIBUTES = dict([DEPTH_BELOW_SURFACE]) | {"modes": "9 SURFACE, 19 MANUAL"}


class Link:
    name, patient, keeps_time = "test", True, True

    def __init__(self, batches: Iterator[Sequence[Sample | Raw]], attributes: Mapping[str, str] | None = None) -> None:
        self._batches, self._attributes = batches, attributes or {}
        self._ended = False

    def open(self) -> None:
        pass

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        batch = next(self._batches, None)
        self._ended = batch is None
        return batch or []

    def state(self) -> SourceState:
        return SourceState(ended=self._ended, attributes=self._attributes)

    def close(self) -> None:
        pass


class Taught:
    """A learner that writes down what it is taught."""

    def __init__(self, learner: Learner) -> None:
        self._learner = learner
        self.told: list[tuple[float, dict[str, Any]]] = []
        self.restarts: list[float] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._learner, name)

    def update(self, t: float, **arguments: Any) -> bool:
        self.told.append((t, arguments))
        return self._learner.update(t, **arguments)

    def restart(self) -> None:
        self.restarts.append(self.told[-1][0])
        self._learner.restart()

    @property
    def times(self) -> np.ndarray:
        return np.array([t for t, _ in self.told])


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("seamor")


@pytest.fixture(scope="module")
def dive(vehicle: Vehicle) -> Recording:
    """A dive of 30 s: disarmed to 6 s, at the surface from 14 to 18, a splash at 21, in mode SURFACE from 26 s on."""
    plan = manoeuvre("surge-sine", vehicle, duration=30.0, dt=0.02, seed=1)
    run = simulate(vehicle, commands=plan.commands, dt=0.02, sensors=Mocap(rate=50.0), seed=1)
    t = run["z"].t
    up = ((t >= 14.0) & (t < 18.0)) | ((t >= 21.0) & (t < 21.5))
    states = {"armed": ([0.0, 6.0], [0.0, 1.0]), "mode": ([0.0, 26.0], [19.0, 9.0])}
    channels = [Channel("z", t, np.where(up, 0.02, 2.0 + run["z"].values), "m", "NED")]
    channels += [Channel(name, *pair, "1") for name, pair in states.items()]
    return Recording(run.replace(channels).channels, "dive", attributes=ATTRIBUTES)


def samples(run: Recording) -> list[Sample]:
    return [Sample("test", "all", EPOCH + t, EPOCH + t, names, values) for t, names, values in rows_of(run)]


def learned(
    vehicle: Vehicle, run: Recording, log: McapLog | None = None, *, keep_all: bool = False
) -> tuple[Taught, Status]:
    every = samples(run)
    batches = iter([every[k : k + 9] for k in range(0, len(every), 9)])
    learner = Taught(new_learner(vehicle, "joint", FREE, background=False))
    link: Any = Link(batches, run.attributes)
    session = Session([("test", link)], vehicle, learner, epoch=EPOCH, log=log, keep_all=keep_all)  # type: ignore[arg-type]
    session.open()
    return learner, session.run(threading.Event())


@pytest.fixture(scope="module")
def told(vehicle: Vehicle, dive: Recording, tmp_path_factory: pytest.TempPathFactory) -> tuple[Taught, Status, Path]:
    path = tmp_path_factory.mktemp("left_out") / "dive.mcap"
    log = McapLog.open(path, epoch=datetime.fromtimestamp(EPOCH, UTC))
    return *learned(vehicle, dive, log), path


def test_what_does_not_count_teaches_nothing(told: tuple[Taught, Status, Path], dive: Recording) -> None:
    learner, status, _ = told
    t = dive["z"].t
    counts = ((t >= 6.0) & (t < 14.0)) | ((t > 18.0) & (t < 26.0))
    assert learner.times == pytest.approx(t[counts], abs=0.021)
    assert status.learnt.instants == len(learner.told)
    assert len(learner.restarts) == 1  # across the surfacing; the splash is no cut
    assert learner.restarts[0] == pytest.approx(13.98, abs=0.021)


def test_the_first_instant_of_a_stretch_knows_the_commands_in_force(told: tuple[Taught, Status, Path]) -> None:
    learner, _, _ = told
    first = next(k for k, t in enumerate(learner.times) if t > 17.0)
    assert "commands" in learner.told[0][1]
    assert "commands" in learner.told[first][1]


def test_it_is_said_when_and_why(told: tuple[Taught, Status, Path]) -> None:
    _, status, _ = told
    events = [each for each in status.events if each.kind == "left out"]
    assert [each.text.partition(" after 4.0")[0].partition(" after 6.0")[0] for each in events] == [
        "not learning: disarmed",
        "learning again",
        "not learning: at the surface or out of the water (depth below 0.1 m)",
        "learning again",
        "not learning: autopilot in mode SURFACE, which comes up by itself, as after a leak",
    ]
    assert [each.t for each in events] == pytest.approx([0.0, 6.0, 14.0, 18.0, 26.0], abs=0.03)
    assert events[1].text == "learning again after 6.0 s: disarmed"
    assert [each.kind for each in status.learnt.cuts] == ["disarmed", "surface"]
    now = status.learnt.left_out
    assert now is not None
    assert (now.kind, now.end - now.start) == ("mode", pytest.approx(4.0, abs=0.03))
    assert status.learnt.not_learning.endswith(("as after a leak since 3 s", "as after a leak since 4 s"))


def test_the_recording_is_whole_and_is_cut_as_the_session_was(
    told: tuple[Taught, Status, Path], dive: Recording, vehicle: Vehicle
) -> None:
    learner, _, path = told
    kept = read(path)
    assert len(kept["z"]) == len(dive["z"])
    for name in ("armed", "mode"):
        assert kept[name].measured.values.tolist() == dive[name].values.tolist()
        assert kept[name].measured.t == pytest.approx(dive[name].t, abs=1e-6)
    assert ATTRIBUTES.items() <= kept.attributes.items()
    found = free_motion(kept, vehicle)
    assert [each.kind for each in found.left_out] == ["disarmed", "surface", "mode"]
    inside = [t for t in learner.times if any(a - 0.021 <= t <= b + 0.021 for a, b in found.kept)]
    assert inside == learner.times.tolist()


def test_keep_all_learns_from_all_of_it(vehicle: Vehicle, dive: Recording) -> None:
    learner, status = learned(vehicle, dive, keep_all=True)
    assert status.learnt.instants == len(dive["z"])
    assert learner.restarts == []
    assert status.learnt.left_out is None
    assert not [each for each in status.events if each.kind == "left out"]


def test_a_splash_is_learned_from_after_all(vehicle: Vehicle, dive: Recording) -> None:
    part = Recording(dive.window(20.0, 25.0).channels, attributes=ATTRIBUTES)
    learner, status = learned(vehicle, part)
    assert len(learner.told) == len(part["z"])
    assert (np.diff(learner.times) > 0.0).all()
    assert status.learnt.left_out is None


def test_what_is_in_doubt_to_the_end_counts(vehicle: Vehicle, dive: Recording) -> None:
    part = Recording(dive.window(12.0, 14.7).channels, attributes=ATTRIBUTES)
    assert len(learned(vehicle, part)[0].told) == len(part["z"])


def test_a_replayed_log_brings_its_states_along(vehicle: Vehicle, dive: Recording, tmp_path: Path) -> None:
    dive.write(tmp_path / "dive.mcap")
    text = f"replay:{tmp_path / 'dive.mcap'}@0"
    source = open_source(text, vehicle)
    session = Session([(text, source)], vehicle, new_learner(vehicle, "joint", FREE, background=False), epoch=EPOCH)
    session.open()
    assert source.state().attributes == ATTRIBUTES
    status = session.run(threading.Event())
    assert [each.kind for each in status.learnt.cuts] == ["disarmed", "surface"]
    assert status.learnt.left_out is not None
    assert status.state == "ended"


def test_json_tells_states_as_numbers_or_truths() -> None:
    messages = JsonMessages(["a"], None)
    assert messages.decode(b'{"t": 1.0, "armed": true, "mode": 19}') == (1.0, ("armed", "mode"), (1.0, 19.0))
    assert messages.bad == 0


def test_a_link_that_tells_states_alone_hands_nothing_over(vehicle: Vehicle) -> None:
    """Heartbeats go on where the vehicle has stopped to send: that is no data."""

    class Beating(Link):
        patient = False

    def beats() -> Iterator[list[Sample]]:
        for _ in range(25):
            time.sleep(0.1)
            now = time.time()
            yield [Sample("test", "HEARTBEAT", now, now, ("armed",), (1.0,))]

    silent: list[float | None] = []
    link: Any = Beating(beats())
    session = Session([("test", link)], vehicle, new_learner(vehicle, "joint", FREE), epoch=time.time())
    session.open()
    session.run(threading.Event(), show=lambda status: silent.append(status.silent), period=0.1)
    assert any(each is not None and each > 2.0 for each in silent)


def test_a_session_has_ended_when_everything_is_learned_from(vehicle: Vehicle, dive: Recording) -> None:
    """Its links are stopped before, and its learner still has seconds of samples to do."""
    seen: list[tuple[str, int]] = []

    class Slow(Taught):
        def update(self, t: float, **arguments: Any) -> bool:
            seen.append((session.status().state, len(self.told)))
            time.sleep(0.002)
            return super().update(t, **arguments)

    every = samples(dive.window(6.0, 13.0))
    link: Any = Link(iter([every]), ATTRIBUTES)
    learner: Any = Slow(new_learner(vehicle, "joint", FREE, background=False))
    session = Session([("test", link)], vehicle, learner, epoch=EPOCH)
    session.open()
    status = session.run(threading.Event())
    states = [state for state, _ in seen]
    assert "ended" not in states
    assert states[-1] == "ending"
    assert status.state == "ended"
    assert len(learner.told) == len(seen) == len(every)


@pytest.mark.parametrize("method", ["joint", "paper"])
def test_a_learner_takes_of_a_recording_what_counts(vehicle: Vehicle, dive: Recording, method: str) -> None:
    run = dive.window(0.0, 13.0)
    part, whole, asked = (Learner(vehicle, method, free=FREE) for _ in range(3))
    assert part.run(run) == asked.run(run.window(6.0, 13.0), keep_all=True)
    assert whole.run(run, keep_all=True) > part.run(run.window(6.0, 13.0)) > 0
    never = run.without("armed").replace([Channel("armed", [0.0], [0.0], "1")])
    with pytest.raises(InputError, match=r"nothing of it counts \(0 to 13 s: disarmed\)"):
        Learner(vehicle, method).run(never)


def rows_at(times: Sequence[float]) -> list[tuple[float, tuple[str, ...], tuple[float, ...]]]:
    return [(t, ("u", "r"), (0.1 * t, 0.2)) for t in times]


def test_what_was_recorded_before_is_learned_from_in_stretches(vehicle: Vehicle) -> None:
    learner, events = Counting(), EventLog()
    learning = Learning(vehicle, learner, Lane(100), Sorter(0.1, 1), events=events, keep_all=True)
    times = [0.1 * k for k in range(20)] + [5.0 + 0.1 * k for k in range(20)] + [6.9 + 1.9, 6.9 + 1.9 + 2.1]
    learning.catch_up(rows_at(times))
    assert learner.seen == times
    assert learner.restarts == [20, 41]  # after pauses of more than two seconds
    assert [each.text for each in events.all if each.kind == "resume"] == ["resumed, 42 instants learned from again"]
    assert (learning.now.t, learning.now.instants) == (times[-1], 42)
    kept = learning.recent.recording()
    assert kept is not None
    assert (kept.start, kept.end) == (5.0, pytest.approx(8.8))  # the longer stretch of the last minute


def test_where_nothing_was_recorded_nothing_is_resumed(vehicle: Vehicle) -> None:
    events = EventLog()
    learning = Learning(vehicle, Counting(), Lane(100), Sorter(0.1, 1), events=events)
    learning.catch_up([])
    assert events.all == ()
    assert learning.now.t == -math.inf
    assert not learning.alive
    assert learning.now.not_learning == ""


def test_learning_that_is_paused_takes_nothing_and_begins_a_new_stretch(vehicle: Vehicle) -> None:
    learner, events = Counting(), EventLog()
    learning = Learning(vehicle, learner, Lane(100), Sorter(0.1, 1), events=events, keep_all=True)
    taps: list[float] = []
    learning.tap = lambda t, arguments: taps.append(t)
    learning.catch_up(rows_at([0.0, 0.1]))
    learning.pause(True)
    learning.pause(True)
    learning.catch_up(rows_at([0.2, 0.3]), since=0.1)
    assert learning.now.paused
    learning.pause(False)
    learning.catch_up(rows_at([0.4, 0.5]), since=0.3)
    assert learner.seen == [0.0, 0.1, 0.4, 0.5]
    assert taps == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    assert [each.text for each in events.all if each.kind == "mark"] == ["learning paused", "learning resumed"]
    assert learning._latency.count == 0
