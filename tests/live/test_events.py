"""What happens in a session: noticed, kept, and written into its recording."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from towtank import load_vehicle
from towtank.live import Sample, SourceState
from towtank.live.events import EventLog, Sight
from towtank.live.pipeline.lane import Errands
from towtank.live.session import Session
from towtank.live.warm_up import new_learner
from towtank.readers import read
from towtank.recording.event import EVENT_TOPIC, Event
from towtank.recording.mcap.log import McapLog

EPOCH = 1.7e9


def pose(x: float) -> dict[str, Any]:
    return {"pose": np.full(6, x)}


def seen(sight: Sight, times: Iterator[float] | list[float]) -> list[Event]:
    return [event for t in times if (event := sight.see(t, pose(0.0))) is not None]


def test_a_sensor_that_lost_sight_is_told_once_it_is_back() -> None:
    sight = Sight()
    assert seen(sight, [k / 100 for k in range(100)]) == []
    assert sight.see(1.2, pose(float("nan"))) is None
    found = seen(sight, [2.5, 2.51, 2.52])
    assert [(event.t, event.kind, event.text) for event in found] == [(0.99, "occlusion", "no position for 1.5 s")]


def test_a_sensor_that_is_slow_by_nature_is_not_told() -> None:
    assert seen(Sight(), [float(k) for k in range(30)]) == []
    assert len(seen(Sight(), [*map(float, range(10)), 20.0])) == 1


def test_events_of_a_learner_are_taken_once() -> None:
    told: list[Event] = []
    log = EventLog(told.append)
    first, second = Event(1.0, "change", "heavier"), Event(2.0, "change", "lighter")
    log.take((first,))
    log.take((first, second))
    assert log.all == (first, second) == tuple(told)


def test_errands_are_done_by_the_owner_and_by_whoever_asks_once_it_has_ended() -> None:
    errands = Errands()
    ended = threading.Event()

    def own() -> None:
        while not ended.is_set():
            errands.run()
            time.sleep(0.002)
        errands.close()

    owner = threading.Thread(target=own)
    owner.start()
    assert errands.ask(threading.current_thread) is owner
    with pytest.raises(ZeroDivisionError):
        errands.ask(lambda: 1 // 0)
    ended.set()
    owner.join()
    assert errands.ask(threading.current_thread) is threading.current_thread()
    with pytest.raises(TimeoutError):
        Errands().ask(lambda: 1, timeout=0.01)


class Hands:
    """A link by hand."""

    keeps_time, patient, name = True, False, "hands"

    def __init__(self) -> None:
        self.waiting: list[Sample] = []
        self.ended = False

    def open(self) -> None:
        pass

    def read(self, timeout: float) -> list[Sample]:
        time.sleep(0.01)
        out, self.waiting = self.waiting, []
        return out

    def state(self) -> SourceState:
        return SourceState(ended=self.ended)

    def close(self) -> None:
        pass

    def put(self, t: float) -> None:
        names = ("x", "y", "z", "phi", "theta", "psi")
        self.waiting.append(Sample("test", "pose", EPOCH + t, EPOCH + t, names, (t, 0.0, 0.0, 0.0, 0.0, 0.0)))


def test_paused_marked_and_recorded(tmp_path: Path) -> None:
    vehicle = load_vehicle("seamor")
    log = McapLog.open(tmp_path / "a.mcap", epoch=datetime.fromtimestamp(EPOCH, UTC))
    link = Hands()
    learner = new_learner(vehicle, "joint", ("X_uu",), background=False)
    settings = {"window": 0.0, "interval": 0.01, "keep_all": True}  # without commands nothing counts
    session = Session([("hands", link)], vehicle, learner, epoch=EPOCH, log=log, **settings)  # type: ignore[arg-type]
    tapped: list[float] = []
    session.learning.tap = lambda t, arguments: tapped.append(t)
    session.open()
    run = threading.Thread(target=session.run, args=(threading.Event(),))
    run.start()

    def until(count: int) -> int:
        for _ in range(500):
            if len(tapped) == count:
                break
            time.sleep(0.01)
        assert len(tapped) == count
        time.sleep(0.05)
        return session.learning.now.instants

    for k in range(5):
        link.put(0.1 * k)
    assert until(5) == 5
    session.learning.pause(True)
    session.learning.pause(True)
    for k in range(5, 10):
        link.put(0.1 * k)
    assert until(10) == 5  # seen and recorded, not learned from
    assert session.status().learnt.paused
    session.learning.pause(False)
    session.mark("ballast on")
    link.put(1.0)
    assert until(11) == 6
    assert session.learning.errands.ask(session.learning.learner.model).name == "seamor"
    link.ended = True
    session._stop.set()
    run.join()
    told = [event.text for event in session.status().events]
    assert told == ["learning paused", "learning resumed", "ballast on"]
    kept = read(tmp_path / "a.mcap")
    assert len(kept["x"]) == 11
    assert EVENT_TOPIC in {each.name for each in kept.contents}
    with (tmp_path / "a.mcap").open("rb") as stream:
        messages = [(m.log_time, json.loads(m.data)) for _, _, m in make_reader(stream).iter_messages([EVENT_TOPIC])]
    assert [m["text"] for _, m in messages] == told
    assert messages[2][1]["kind"] == "mark"
    assert messages[2][0] / 1e9 - EPOCH == pytest.approx(messages[2][1]["t"], abs=1e-3)


def test_events_go_on_in_a_recording_that_is_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    log = McapLog.open(path, epoch=datetime.fromtimestamp(EPOCH, UTC))
    log.write_event(Event(1.0, "mark", "one", {"share": float("nan")}))
    log.close()
    log = McapLog.resume(path)
    log.write_event(Event(2.0, "mark", "two"))
    log.close()
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        messages = [json.loads(m.data) for _, _, m in reader.iter_messages()]
    assert summary is not None
    assert len(summary.channels) == 1
    assert [(m["text"], m["details"]) for m in messages] == [("one", {"share": None}), ("two", {})]
