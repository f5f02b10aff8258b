"""Links that fall silent: noticed within two and a half seconds, said, and told again when they are back."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import pytest
from mcap.reader import make_reader

from towtank import load_vehicle
from towtank.live import Raw, Sample
from towtank.live.links.source import SourceState
from towtank.live.pipeline.hearing import Hearing
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.recording.event import EVENT_TOPIC
from towtank.recording.mcap.log import McapLog


def listened(hearing: Hearing, moments: Sequence[float]) -> None:
    for moment in moments:
        hearing.heard(moment, moment)


def test_a_link_is_lost_after_two_seconds_or_three_of_its_periods() -> None:
    hearing, start = Hearing("fast"), time.monotonic()
    listened(hearing, [start + 0.01 * k for k in range(500)])
    last = start + 4.99
    assert hearing.silent(last + 1.99) is None
    assert hearing.notice(last + 1.99) is None
    assert hearing.silent(last + 2.01) == pytest.approx(2.01)
    event = hearing.notice(last + 2.01)
    assert event is not None
    assert (event.kind, event.t, event.details["state"]) == ("link", pytest.approx(last), "lost")
    assert hearing.notice(last + 9.0) is None  # told once
    slow, begin = Hearing("slow"), time.monotonic()
    listened(slow, [begin + 1.5 * k for k in range(60)])
    last = begin + 1.5 * 59
    assert slow.silent(last + 4.3) is None
    assert slow.silent(last + 4.6) is not None


def test_it_is_back_after_the_time_without_data_and_can_be_lost_again() -> None:
    hearing, start = Hearing("udp"), time.monotonic()
    listened(hearing, [start, start + 0.1, start + 0.2])
    assert hearing.notice(start + 3.0) is not None
    listened(hearing, [start + 12.6, start + 12.7])
    back = hearing.notice(start + 12.8)
    assert back is not None
    assert back.text == "udp: link back after 12.4 s without data"
    assert back.details["seconds"] == pytest.approx(12.4)
    assert back.t == pytest.approx(start + 12.6)
    assert hearing.silent(start + 12.8) is None
    assert hearing.silent(start + 14.8) is not None  # the gap is not taken for usual
    assert hearing.notice(start + 14.8) is not None


def test_what_never_sent_is_silent_and_not_lost() -> None:
    hearing = Hearing("udp")
    assert not hearing.ever
    assert hearing.silent(time.monotonic() + 3.0) == pytest.approx(3.0, abs=0.1)
    assert hearing.notice(time.monotonic() + 3.0) is None


class Link:
    """Sends its heading twenty times a second while it may; heartbeats, of which nothing is learned, in any case."""

    name, patient, keeps_time = "test", False, True

    def __init__(self) -> None:
        self.sends = threading.Event()
        self.sends.set()
        self.stopped = 0.0

    def open(self) -> None:
        pass

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        time.sleep(0.05)
        now = time.time()
        found: list[Sample | Raw] = [Raw(self.name, "heartbeat", now, b"alive")]
        if self.sends.is_set():
            found.append(Sample(self.name, "all", now, now, ("psi", "cmd_1", "cmd_2"), (0.1, 1500.0, 1500.0)))
            self.stopped = time.monotonic()
        return found

    def state(self) -> SourceState:
        return SourceState()

    def close(self) -> None:
        pass


def until(told: list[tuple[float, Status]], states: str, seconds: float = 6.0) -> tuple[float, Status]:
    """Return moment and status of the first that is in a state."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for moment, status in list(told):
            if status.state.startswith(states):
                return moment, status
        time.sleep(0.01)
    raise AssertionError([status.state for _, status in told])


def test_a_session_tells_of_a_dead_link_in_time_and_of_its_return(tmp_path: Path) -> None:
    vehicle = load_vehicle("blueboat")
    link, stop = Link(), threading.Event()
    epoch = time.time()
    log = McapLog.open(tmp_path / "a.mcap", epoch=datetime.fromtimestamp(epoch, UTC))
    session = Session([("boat", link)], vehicle, new_learner(vehicle, "joint", ("N_rdot",)), epoch=epoch, log=log)
    told: list[tuple[float, Status]] = []
    session.open()
    thread = threading.Thread(
        target=session.run, args=(stop,), kwargs={"show": lambda status: told.append((time.monotonic(), status))}
    )
    thread.start()
    try:
        until(told, "learning")
        time.sleep(0.5)
        link.sends.clear()
        told.clear()
        moment, status = until(told, "no data since 2 s")
        assert moment - link.stopped < 2.5
        assert status.silent is not None
        assert status.warnings == ()  # the state says it
        assert [each.details["state"] for each in status.events if each.kind == "link"] == ["lost"]
        link.sends.set()
        told.clear()
        until(told, "learning")
        time.sleep(0.5)
    finally:
        stop.set()
        thread.join()
    lost, back = [each for each in session.status().events if each.kind == "link"]
    assert lost.text == "boat: link lost, no data from here on"
    assert back.text.startswith("boat: link back after 2.")
    assert back.t - lost.t == pytest.approx(back.details["seconds"])
    assert session.status().state == "ended"
    assert recorded(tmp_path / "a.mcap") == ["lost", "back"]


def recorded(path: Path) -> list[str]:
    """Return what the recording tells of the link."""
    with path.open("rb") as stream:
        events = [json.loads(message.data) for _, _, message in make_reader(stream).iter_messages([EVENT_TOPIC])]
    return [event["details"]["state"] for event in events if event["kind"] == "link"]


def test_one_silent_link_of_two_is_a_warning(tmp_path: Path) -> None:
    vehicle = load_vehicle("blueboat")
    one, two, stop = Link(), Link(), threading.Event()
    learner = new_learner(vehicle, "joint", ("N_rdot",))
    session = Session([("one", one), ("two", two)], vehicle, learner, epoch=time.time())
    told: list[tuple[float, Status]] = []
    session.open()
    show = {"show": lambda status: told.append((time.monotonic(), status))}
    thread = threading.Thread(target=session.run, args=(stop,), kwargs=show)
    thread.start()
    try:
        until(told, "learning")
        time.sleep(0.3)
        two.sends.clear()
        time.sleep(2.8)
        _, status = told[-1]
        assert status.state == "learning"
        assert [each.silent is None for each in status.sources] == [True, False]
        assert status.warnings == ("two: no data since 2 s",)
    finally:
        stop.set()
        thread.join()


def test_a_slow_link_is_not_lost_at_every_sample() -> None:
    hearing, events = Hearing("link"), []
    hearing.begin()
    for k in range(40):
        hearing.heard(3.0 * k, 1000.0 + 3.0 * k)
        event = hearing.notice(1000.0 + 3.0 * k + 2.9)
        events += [] if event is None else [event]
    assert len(events) <= 4  # until its period is known
    assert hearing.silent(1000.0 + 3.0 * 39 + 8.0) is None
    assert hearing.silent(1000.0 + 3.0 * 39 + 10.0) is not None
