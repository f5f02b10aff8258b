"""What a person reads of a link is counted right: rates, what was bad, whom it hears, how long it has been silent."""

from __future__ import annotations

import io
import json
import os
import socket
import sys
import time
from itertools import pairwise

import pytest

from towtank import load_vehicle
from towtank.errors import InputError
from towtank.live import Sample, SourceState
from towtank.live.events import EventLog, Sight
from towtank.live.links.json import JsonMessages, JsonSource
from towtank.live.links.mavlink import connection
from towtank.live.links.mavlink.connection import Tcp
from towtank.live.links.ros2.transports import topic_of_token
from towtank.live.links.source import Rates, Raw
from towtank.live.pipeline.clock import SourceClock
from towtank.live.status import SourceStatus, Status
from towtank.recording.event import Event
from towtank.recording.standard import MOTION


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands at its only element."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_a_rate_is_counted_over_two_seconds_and_first_after_half_of_one(clock):
    rates = Rates()
    rates.add("pose", 10)
    clock[0] += 0.5
    assert rates.now() == {}
    clock[0] += 0.5
    assert rates.now() == {"pose": pytest.approx(10.0)}  # 10 in 1 s
    clock[0] += 1.0
    rates.add("pose", 10)
    assert rates.now() == {"pose": pytest.approx(10.0)}  # 20 in 2 s
    clock[0] += 1.9
    rates.add("pose", 100)
    assert rates.now() == {"pose": pytest.approx(10.0)}  # not yet anew
    clock[0] += 0.1
    assert rates.now() == {"pose": pytest.approx(50.0)}  # 100 in the 2 s since
    clock[0] += 2.0
    assert rates.now() == {"pose": 0.0}


def test_topics_beyond_the_two_hundredth_are_counted_together(clock):
    rates = Rates()
    for k in range(205):
        rates.add(f"topic_{k}")
    rates.add("topic_3")
    assert len(rates.counts) == 201
    assert (rates.counts["topic_199"], rates.counts["topic_3"], rates.counts["others"]) == (1, 2, 5)


def test_a_connection_that_broke_is_tried_once_a_second(clock, monkeypatch):
    tried: list[float] = []

    def refused(self: Tcp, patience: float) -> None:
        tried.append(clock[0])
        raise OSError("refused")

    def sleep(seconds: float) -> None:
        clock[0] += seconds

    monkeypatch.setattr(Tcp, "_connect", refused)
    monkeypatch.setattr(connection.time, "sleep", sleep)
    link = Tcp("tcp:127.0.0.1:9", "127.0.0.1", 9)
    began = clock[0]
    while clock[0] < began + 5.05:
        assert link.receive(0.1) == []
        clock[0] += 1e-3
    assert len(tried) in (5, 6)
    assert min(b - a for a, b in pairwise(tried)) >= 1.0


def test_names_of_a_message_are_shortened_to_sixty_letters_on_the_way_to_the_terminal():
    messages = JsonMessages(("a",))
    messages.decode(json.dumps({"k" * 60: 1, "k" * 61: 1, "j" * 59: 1, "cmd": {"l" * 80: "x"}}).encode())
    assert messages.unknown == {"k" * 60: 2, "j" * 59: 1}
    assert messages.wrong == f'"cmd_{"l" * 56}" is not a number that can be'
    assert messages.bad == 1


def test_wrong_commands_are_said_with_how_many_were_expected():
    messages = JsonMessages(("a", "b"))
    messages.decode(b'{"cmd": [1, 2, 3]}')
    assert messages.wrong == '"cmd" holds 3 numbers, expected 2 numbers or an object'
    messages.decode(b'{"cmd": "full"}')
    assert messages.wrong == '"cmd" holds str, expected 2 numbers or an object'
    assert messages.bad == 2


@pytest.mark.parametrize("value, taken", [(1e9, True), (-1e9, True), (1.1e9, False), (-1.1e9, False)])
def test_what_no_quantity_can_be_is_not_taken(value, taken):
    messages = JsonMessages(())
    found = messages.decode(json.dumps({"x": value, "y": 1.0}).encode())
    assert found is not None
    assert found[1] == (("x", "y") if taken else ("y",))
    assert messages.bad == (not taken)


class Input:
    """A standard input that is a pipe."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        here, self.there = os.pipe()
        self.stream = os.fdopen(here)
        monkeypatch.setattr(sys, "stdin", self.stream)
        self.source = JsonSource("-", load_vehicle("vlbv300"))
        self.source.open()

    def write(self, data: bytes) -> list[Sample | Raw]:
        os.write(self.there, data)
        return list(self.source.read(1.0))


def test_lines_of_standard_input_are_whole_however_they_come(monkeypatch):
    pipe = Input(monkeypatch)
    assert not pipe.source.keeps_time
    first = pipe.write(b'{"t": 1, "x": 1}\n\n{"t": 2, "x"')
    assert [each.values for each in first if isinstance(each, Sample)] == [(1.0,)]
    second = pipe.write(b': 2}\n{"t": 3, "x": 3}')
    assert [(each.t, each.values) for each in second if isinstance(each, Sample)] == [(2.0, (2.0,))]
    assert b"".join(each.data for each in (*first, *second) if isinstance(each, Raw)) == (
        b'{"t": 1, "x": 1}{"t": 2, "x": 2}'
    )
    assert not pipe.source.state().ended
    os.close(pipe.there)
    last = pipe.source.read(1.0)
    assert [each.values for each in last if isinstance(each, Sample)] == [(3.0,)]
    assert pipe.source.state().ended
    assert (pipe.source.state().bad, pipe.source.read(0.0)) == (0, [])
    pipe.stream.close()


def test_a_line_without_end_is_given_up_and_the_next_one_is_read(monkeypatch):
    pipe = Input(monkeypatch)
    assert pipe.write(b"x" * 40_000) == []
    assert pipe.source.state().bad == 0
    assert pipe.write(b"x" * 40_000) == []
    assert pipe.source.state().said[0] == "1 bad, last: a line of more than 65536 bytes"
    assert [each.values for each in pipe.write(b'{"x": 4}\n') if isinstance(each, Sample)] == [(4.0,)]
    os.close(pipe.there)
    pipe.stream.close()


def test_without_standard_input_there_is_one_line(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(InputError, match=r'source "-": there is no standard input \('):
        JsonSource("-", load_vehicle("vlbv300")).open()


def test_a_file_as_standard_input_begins_now_and_keeps_its_intervals(monkeypatch, tmp_path):
    path = tmp_path / "samples.jsonl"
    path.write_text("".join(json.dumps({"t": 100.0 + 0.5 * k, "x": k}) + "\n" for k in range(4)))
    with path.open() as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        source = JsonSource("-", load_vehicle("vlbv300"))
        assert source.keeps_time
        assert source.patient
        source.open()
        samples = [each for each in source.read(1.0) if isinstance(each, Sample)]
    assert [each.t - samples[0].t for each in samples] == pytest.approx([0.0, 0.5, 1.0, 1.5], abs=1e-5)
    assert samples[0].t == samples[0].received


def test_of_many_senders_eight_are_named_and_all_are_heard():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    source = JsonSource(f"json:127.0.0.1:{port}", load_vehicle("vlbv300"))
    source.open()
    heard, senders = [], []
    for k in range(10):
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sender.sendto(json.dumps({MOTION[k]: k}).encode() + b"\n" + b'{"battery": 1}', ("127.0.0.1", port))
        senders.append(sender)
        heard += [each for each in source.read(1.0) if isinstance(each, Sample)]
    state = source.state()
    assert [each.values for each in heard] == [(float(k),) for k in range(10)]
    assert state.senders == tuple(f"127.0.0.1:{each.getsockname()[1]}" for each in senders[:8])
    assert state.said == ("unknown keys passed over: battery (10 times)",)
    source.close()
    for each in senders:
        each.close()


def status_of(*silent: float | None, ended: tuple[int, ...] = ()) -> Status:
    sources = tuple(
        SourceStatus(f"link {k}", SourceState(bad=k, ended=k in ended), 10 * k, 1, 0.0, 0.0, each)
        for k, each in enumerate(silent)
    )
    return Status(9.0, None, sources, None, 0, 0, 0, 0, (), ())  # type: ignore[arg-type]


def test_a_session_is_silent_only_while_no_link_that_goes_on_is_heard():
    assert status_of(3.0, 5.0).silent == 3.0
    assert status_of(3.0, None).silent is None
    assert status_of(3.0, None, ended=(1,)).silent == 3.0
    assert status_of(None, ended=(0,)).silent is None
    assert status_of(12.0).state == "no data since 12 s"


def test_bad_messages_and_samples_of_all_links_are_added_up():
    assert (status_of(None, None, None).bad, status_of(None, None, None).samples) == (0 + 1 + 2 + 3, 30)


def test_an_event_that_changed_takes_its_place_and_is_told_again():
    told: list[Event] = []
    log = EventLog(told.append)
    first, second, third = (Event(float(k), "change", f"heavier by {k} kg") for k in range(3))
    log.take((first, second))
    log.add(third)
    better = Event(0.0, "change", "heavier by 0.4 kg")
    log.take((better, second))
    assert log.all == (better, second, third)
    assert told == [first, second, third, better]


def test_a_sensor_out_of_sight_for_half_a_second_or_five_intervals_is_told_with_how_long():
    def gap(interval: float, seconds: float) -> list[str]:
        sight, found = Sight(), []
        times = [k * interval for k in range(20)]
        for t in (*times, times[-1] + seconds):
            event = sight.see(t, {"velocity": (1.0,)})
            found += [event.text] if event is not None else []
        return found

    assert gap(0.02, 0.45) == []
    assert gap(0.02, 0.56) == ["no velocity for 0.6 s"]
    assert gap(0.2, 0.95) == []
    assert gap(0.2, 1.1) == ["no velocity for 1.1 s"]


def test_stamps_without_a_size_are_counted_and_late_ones_are_believed_up_to_ten_seconds():
    clock = SourceClock()
    assert not clock.believes(float("inf"), 100.0)
    assert clock.strange == 1
    assert clock.believes(50.0, 100.0)
    assert clock.offset == 50.0
    assert clock.believes(51.0, 110.5)  # 9.5 s late
    assert clock.believes(52.0, 112.5)  # 10.5 s late, behind the ones before: a link held it up
    assert clock.believes(50.5, 112.6)  # 12.1 s late, and a little out of order
    assert not clock.believes(49.5, 112.6)  # 13.1 s late, and before them
    assert clock.believes(53.0, 102.9)  # 0.1 s earlier than any before
    assert not clock.believes(54.0, 103.5)  # half a second earlier
    assert (clock.strange, clock.restarts) == (3, 0)


def test_a_clock_that_was_set_anew_is_followed_after_twenty_stamps():
    clock = SourceClock()
    assert clock.believes(0.0, 1000.0)
    believed = [clock.believes(5000.0 + 0.01 * k, 1000.0 + 0.01 * k) for k in range(1, 25)]
    assert believed.index(True) == 19
    assert all(believed[19:])
    assert (clock.strange, clock.restarts) == (20, 1)
    assert clock.offset == pytest.approx(-4000.0)


def test_a_token_needs_all_up_to_its_type():
    token = "@ros2_lv/0/a/1/2/MP/%/%/node/%tank%odom/nav_msgs::msg::dds_::Odometry_"
    assert topic_of_token(token) == ("/tank/odom", "nav_msgs/msg/Odometry")
    assert topic_of_token(f"{token}/RIHS01/q") == ("/tank/odom", "nav_msgs/msg/Odometry")
    assert topic_of_token(token.rpartition("/")[0]) is None
    assert topic_of_token(token.replace("/MP/", "/MS/")) is None
