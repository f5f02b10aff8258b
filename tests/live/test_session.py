"""Links, recording and learning side by side."""

from __future__ import annotations

import errno
import json
import math
import os
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from towtank import Learner, load_vehicle
from towtank.errors import InputError
from towtank.live import Raw, Sample, SourceState, open_source
from towtank.live.pipeline.clock import steady_time
from towtank.live.pipeline.instants import rows_of
from towtank.live.pipeline.lane import GAP, Lane
from towtank.live.pipeline.sorter import Arrival
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.readers import read
from towtank.recording import Recording
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE
from towtank.recording.mcap.log import McapLog
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import Vehicle

from .learners import Counting

FREE = ("X_udot", "X_uu")
EPOCH = 1.7e9


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("seamor")


@pytest.fixture(scope="module")
def run(vehicle: Vehicle) -> Recording:
    plan = manoeuvre("surge-sine", vehicle, duration=12.0, dt=0.01, seed=1)
    return simulate(vehicle, commands=plan.commands, dt=0.01, sensors=Mocap(rate=100.0), seed=1)


class Link:
    """A link that hands over what it is given."""

    keeps_time = True

    def __init__(self, batches: Iterator[Sequence[Sample | Raw]], name: str = "test", patient: bool = True) -> None:
        self.name, self.patient = name, patient
        self._batches = batches
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


class Slow:
    """A learner that takes its time."""

    def __init__(self, learner: Learner, seconds: float) -> None:
        self._learner, self._seconds, self.restarts = learner, seconds, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._learner, name)

    def update(self, t: float, **arguments: Any) -> bool:
        time.sleep(self._seconds)
        return self._learner.update(t, **arguments)

    def restart(self) -> None:
        self.restarts += 1
        self._learner.restart()


def samples(run: Recording, topic: str = "all") -> list[Sample]:
    return [Sample("test", topic, EPOCH + t, EPOCH + t, names, values) for t, names, values in rows_of(run)]


def session(link: Any, vehicle: Vehicle, learner: Any, **settings: Any) -> Status:
    links = link if isinstance(link, list) else [link]
    made = Session([(each.name, each) for each in links], vehicle, learner, epoch=EPOCH, **settings)
    made.open()
    return made.run(threading.Event())


def test_a_stream_teaches_what_the_same_samples_teach_one_by_one(
    vehicle: Vehicle, run: Recording, tmp_path: Path
) -> None:
    alone = new_learner(vehicle, "joint", FREE, background=False)
    names = [f"cmd_{each.name}" for each in vehicle.thrusters]
    pose = ("x", "y", "z", "phi", "theta", "psi")
    for t, keys, values in rows_of(run):
        sample = dict(zip(keys, values, strict=True))
        commands = np.array([sample[name] for name in names]) if names[0] in sample else None
        alone.update(EPOCH + t - EPOCH, pose=[sample.get(name, math.nan) for name in pose], commands=commands)
    every = samples(run)
    batches = [every[k : k + 7] for k in range(0, len(every), 7)]
    log = McapLog.open(tmp_path / "a.mcap", epoch=datetime.fromtimestamp(EPOCH, UTC))
    learner = new_learner(vehicle, "joint", FREE, background=False)
    status = session(Link(iter(batches)), vehicle, learner, log=log)
    assert status.samples == status.learnt.instants == len(every)
    assert (status.dropped, status.late, status.bad) == (0, 0, 0)
    assert np.array_equal(learner.estimate.values, alone.estimate.values)
    assert np.array_equal(learner.estimate.std, alone.estimate.std)
    kept = read(tmp_path / "a.mcap")
    assert set(kept.names) == set(run.names)
    for name in run:
        assert np.array_equal(kept[name].measured.values, run[name].values)
        assert np.abs(kept[name].measured.t - run[name].t).max() < 1e-6


def test_late_samples_are_recorded_but_not_learned_from(vehicle: Vehicle, run: Recording, tmp_path: Path) -> None:
    every = samples(run)[:400]
    late = every[100]

    def one_late() -> Iterator[list[Sample]]:
        yield from ([each] for each in (*every[:100], *every[101:300]))
        deadline = time.monotonic() + 60.0
        while made.learning.now.instants < 200 and time.monotonic() < deadline:  # it is late once others are learned
            time.sleep(0.01)
        yield from ([each] for each in (late, *every[300:]))

    learner = new_learner(vehicle, "joint", FREE, background=False)
    log = McapLog.open(tmp_path / "a.mcap")
    made = Session([("test", Link(one_late()))], vehicle, learner, epoch=EPOCH, log=log, window=0.1)
    made.open()
    status = made.run(threading.Event())
    assert status.late == 1
    assert status.learnt.instants == 399
    assert len(read(tmp_path / "a.mcap")["x"]) == 400


def test_a_learner_that_cannot_keep_up_costs_learning_only(vehicle: Vehicle, run: Recording, tmp_path: Path) -> None:
    every = samples(run)[:600]
    log = McapLog.open(tmp_path / "a.mcap")
    learner = Slow(new_learner(vehicle, "joint", FREE, background=False), 0.002)
    began = time.monotonic()

    def paced() -> Iterator[list[Sample]]:
        for k in range(0, len(every), 10):
            time.sleep(0.002)
            yield every[k : k + 10]

    status = session(Link(paced(), patient=False), vehicle, learner, log=log, room=50)
    assert time.monotonic() - began < 3.0
    assert status.dropped > 100
    assert status.learnt.instants + status.dropped == 600
    assert learner.restarts >= status.gaps > 0  # no interval spans what was passed over
    assert any("could not keep up" in text for text in status.warnings)
    assert len(read(tmp_path / "a.mcap")["x"]) == 600


def test_a_learner_that_fails_does_not_end_the_recording(vehicle: Vehicle, run: Recording, tmp_path: Path) -> None:
    class Failing(Slow):
        def update(self, t: float, **arguments: Any) -> bool:
            if t > 1.0:
                raise FloatingPointError("singular")
            return True

    every = samples(run)
    log = McapLog.open(tmp_path / "a.mcap")
    batches = iter([every[k : k + 10] for k in range(0, len(every), 10)])
    status = session(
        Link(batches), vehicle, Failing(new_learner(vehicle, "joint", FREE, background=False), 0.0), log=log, room=100
    )
    assert status.learnt.trouble == "learning has stopped: FloatingPointError: singular"
    assert len(read(tmp_path / "a.mcap")["x"]) == len(every)


@pytest.mark.parametrize("begun", [True, False])
def test_a_full_disk_costs_samples_of_the_recording_and_is_said(
    vehicle: Vehicle, run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: bool
) -> None:
    full = threading.Event()
    write = os.write

    def written(descriptor: int, data: Any) -> int:
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    every = samples(run)
    log = McapLog.open(tmp_path / "a.mcap", interval=0.05)
    told: list[str] = []

    def stream() -> Iterator[list[Sample]]:
        monkeypatch.setattr("towtank.recording.mcap.log.os.write", written)
        if begun:
            yield every[:400]
            time.sleep(0.3)
        full.set()  # of a recording that is not begun not even the columns are in the file
        yield every[400 * begun : 800]
        until = time.monotonic() + 20.0  # a busy machine takes its time
        while not (told and any(event.kind == "recording" for event in made.status().events)):
            assert time.monotonic() < until
            time.sleep(0.1)
            told[:] = [text for text in made.status().warnings if "No space left on device" in text]
        full.clear()
        yield every[800:]  # the file may end before anybody looks at it again

    learner = new_learner(vehicle, "joint", FREE, background=False)
    made = Session([("test", Link(stream()))], vehicle, learner, epoch=EPOCH, log=log)
    made.open()
    status = made.run(threading.Event())
    assert all("learning goes on" in text for text in told)
    assert status.learnt.instants == len(every)
    assert status.warnings == ()  # what waited was written when there was room again
    told_of = [event for event in status.events if event.kind == "recording"]
    assert [event.details["state"] for event in told_of] == ["trouble", "back"]
    assert "nothing lost" in told_of[1].text
    assert len(read(tmp_path / "a.mcap")["x"]) == len(every)


def test_a_link_that_fails_does_not_end_the_others(vehicle: Vehicle, run: Recording) -> None:
    def broken() -> Iterator[list[Sample]]:
        yield []
        raise OSError("unplugged")

    every = samples(run)[:200]
    links = [Link(broken(), "bad"), Link(iter([every]), "good")]
    status = session(links, vehicle, new_learner(vehicle, "joint", FREE, background=False))
    assert status.samples == 200
    assert any("bad: the link has failed (OSError: unplugged)" in text for text in status.warnings)


def test_two_links_of_different_clocks_stand_on_one(vehicle: Vehicle) -> None:
    """Two links send the same instants, one with a clock of its own; they meet within a millisecond."""

    class Live(Link):
        keeps_time = False

    def stream(name: str, offset: float) -> Iterator[list[Sample]]:
        for k in range(150):
            due = began + 0.01 * k
            time.sleep(max(due - time.time(), 0.0))
            yield [Sample("test", name, due - offset, time.time(), ("x" if offset else "y",), (due,))]

    began = time.time() + 0.1
    learner = new_learner(vehicle, "joint", FREE, background=False)
    seen: list[tuple[float, dict[str, Any]]] = []
    learner.update = lambda t, **arguments: bool(seen.append((t, arguments)))  # type: ignore[method-assign]
    links = [Live(stream("a", 0.0), "a", False), Live(stream("b", 5.96 * 86400.0), "b", False)]
    status = session(links, vehicle, learner, window=2.0, keep_all=True)  # without commands nothing else counts
    off = [t + EPOCH - np.nanmax(each["pose"][:2]) for t, each in seen]
    assert len(off) >= 150
    assert np.quantile(np.abs(np.array(off) - np.median(off)), 0.9) < 0.02  # a busy machine wakes late at times
    assert float(np.median(np.abs(np.diff(off)))) < 2e-3
    assert status.sources[1].offset == pytest.approx(5.96 * 86400.0, abs=0.05)


def test_json_over_udp_is_learned_from_and_recorded_as_it_came(
    vehicle: Vehicle, run: Recording, tmp_path: Path
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    text = f"json:127.0.0.1:{port}"
    log = McapLog.open(tmp_path / "a.mcap", epoch=datetime.fromtimestamp(EPOCH, UTC))
    made = Session(
        [(text, open_source(text, vehicle))],
        vehicle,
        new_learner(vehicle, "joint", FREE, background=False),
        epoch=time.time(),
        log=log,
    )
    made.open()
    stop = threading.Event()
    rows = list(rows_of(run))[:200]

    def feed() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            began = time.monotonic()
            for k, (t, names, values) in enumerate(rows):
                time.sleep(max(began + t - time.monotonic(), 0.0))
                link.sendto(json.dumps({"t": t, **dict(zip(names, values, strict=True))}).encode(), ("127.0.0.1", port))
                if k % 10 == 0:
                    link.sendto(b"{broken", ("127.0.0.1", port))
        time.sleep(0.3)
        stop.set()

    feeder = threading.Thread(target=feed)
    feeder.start()
    status = made.run(stop)
    feeder.join()
    assert status.samples == status.learnt.instants == 200
    assert status.bad == 20
    assert status.waiting == 0
    assert status.learnt.latency["p99"] >= 99.0  # ms: the window
    kept = read(tmp_path / "a.mcap")
    assert {each.name: each.count for each in kept.contents if not each.name.startswith("/towtank/")} == {
        f"/json/port_{port}": 200,
        f"/raw/json/port_{port}": 220,
    }


def test_a_full_lane_drops_until_half_is_done() -> None:
    lane = Lane(10)
    arrivals = [Arrival(float(k), 0.0, 0, Sample("a", "b", 0.0, 0.0, ("x",), (0.0,))) for k in range(30)]
    lane.put(arrivals[:10])
    lane.put(arrivals[10:15])
    assert (lane.dropped, lane.gaps) == (5, 1)
    lane.get(0.0, most=4)
    lane.put(arrivals[15:16])
    assert lane.dropped == 6
    lane.get(0.0, most=2)
    lane.put(arrivals[16:18])
    assert lane.dropped == 6
    items, _ = lane.get(0.0)
    assert [each.t if isinstance(each, Arrival) else "gap" for each in items] == [6, 7, 8, 9, "gap", 16, 17]
    assert GAP in items


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("carrier pigeon", "expected one of udpin:"),
        ("json:127.0.0.1", "HOST:PORT"),
        ("json::99999", "HOST:PORT"),
        ("replay:", "expected replay:FILE"),
        ("replay:a.csv@fast", 'found speed "fast"'),
    ],
)
def test_what_is_no_source_is_said_in_one_line(vehicle: Vehicle, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        open_source(text, vehicle)


def test_a_port_that_is_taken_is_said(vehicle: Vehicle) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        text = f"json:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match="cannot listen there"):
            open_source(text, vehicle).open()


def test_a_log_is_replayed_at_the_pace_asked_for(vehicle: Vehicle, run: Recording, tmp_path: Path) -> None:
    run.write(tmp_path / "a.csv")
    source = open_source(f"replay:{tmp_path / 'a.csv'}@20", vehicle)
    source.open()
    began = time.monotonic()
    found: list[Sample] = []
    while not source.state().ended:
        found += [each for each in source.read(0.1) if isinstance(each, Sample)]
    assert time.monotonic() - began >= 12.0 / 20.0 - 0.05
    assert [each.t - found[0].t for each in found] == pytest.approx([t for t, _, _ in rows_of(run)], abs=1e-6)
    assert [each.values for each in found] == [values for _, _, values in rows_of(run)]


class Told(Link):
    """A link that says how it fares."""

    def __init__(self, batches: Sequence[Sequence[Sample | Raw]], patient: bool = True, **said: Any) -> None:
        super().__init__(iter(batches), patient=patient)
        self._said = said

    def state(self) -> SourceState:
        return SourceState(ended=self._ended, **self._said)


def of_pose(t: float, x: float, received: float | None = None) -> Sample:
    return Sample("test", "pose", EPOCH + t, EPOCH + t if received is None else received, ("x", "y"), (x, 0.0))


def session_of(*links: Any, vehicle: Vehicle, **settings: Any) -> tuple[Session, Counting]:
    learner = Counting()
    named = [(f"link {k}", each) for k, each in enumerate(links)]
    made = Session(named, vehicle, learner, epoch=EPOCH, keep_all=True, **settings)  # type: ignore[arg-type]
    made.open()
    return made, learner


def test_at_the_end_the_recording_says_how_each_link_fared(vehicle: Vehicle, tmp_path: Path) -> None:
    batch = [of_pose(0.01 * k, 0.1 * k) for k in range(300)]
    good, bad = Told([batch]), Told([[]], bad=2, dropped=3, foreign=4)
    path = tmp_path / "a.mcap"
    made, _ = session_of(good, bad, vehicle=vehicle, log=McapLog.open(path))
    made.run(threading.Event())
    assert read(path).notes == (
        "live link 0: 300 samples",
        "live link 1: 0 samples, 2 bad messages, 3 datagrams dropped by the system, "
        "4 messages and values of others passed over",
    )


def test_commands_that_no_thruster_takes_are_a_warning(vehicle: Vehicle) -> None:
    names = ("cmd_1", "cmd_nobody", "strange", "u")
    sample = [Sample("test", "a", EPOCH + 0.1 * k, EPOCH, names, (1.0, 2.0, 3.0, 4.0)) for k in range(9)]
    made, learner = session_of(Told([sample]), vehicle=vehicle)
    status = made.run(threading.Event())
    assert status.warnings == ("link 0: the vehicle has no thruster for cmd_nobody, strange; passed over",)
    assert (status.samples, len(learner.seen)) == (9, 9)
    assert status.ended
    assert not status.ending


def test_a_patient_session_ends_after_so_many_seconds_of_samples(vehicle: Vehicle) -> None:
    batches = [[of_pose(0.1 * (10 * k + n), 1.0 * n) for n in range(10)] for k in range(20)]
    made, learner = session_of(Told(batches), vehicle=vehicle)
    status = made.run(threading.Event(), seconds=3.05)
    assert status.samples == 31
    assert learner.seen[-1] == pytest.approx(3.0)
    assert made.t == pytest.approx(3.0)
    assert math.isnan(status.epoch)


class Live(Told):
    """A link whose messages bear the clock of their source."""

    keeps_time = False


def held_up(n: int, *, every: float, first: int, late: float) -> Live:
    """Messages, so many s apart, of a source whose clock shows 500 s less; the first ones are late, others by 10 ms."""

    def sent(k: int) -> Sample:
        delay = late if k < first else 0.01
        return Sample("t", "p", EPOCH - 500.0 + every * k, EPOCH + every * k + delay, ("x",), (1.0 * k,))

    return Live([[sent(k)] for k in range(n)], patient=True)


def test_samples_that_come_before_a_clock_has_settled_stand_on_it_all_the_same(vehicle: Vehicle) -> None:
    """A source whose clock shows 500 s less, and whose first messages come late."""
    made, learner = session_of(held_up(60, every=0.05, first=3, late=0.05), vehicle=vehicle)
    made.run(threading.Event())
    assert len(learner.seen) == 60
    assert np.diff(learner.seen) == pytest.approx(0.05, abs=1e-6)
    assert learner.seen[0] == pytest.approx(0.01, abs=1e-3)
    (only,) = made.status().sources
    assert only.offset == pytest.approx(500.01, abs=1e-3)


def test_a_link_that_is_held_up_when_it_begins_stands_right_as_soon_as_it_is_not(vehicle: Vehicle) -> None:
    """What follows lies earlier by as much as it was held up, and is learned from in order."""
    made, learner = session_of(held_up(150, every=0.02, first=35, late=0.06), vehicle=vehicle)
    status = made.run(threading.Event())
    assert status.samples == 150
    assert np.all(np.diff(learner.seen) > 0.0)
    assert len(learner.seen) >= 145  # a few share an instant with those before
    assert learner.seen[-1] == pytest.approx(0.02 * 149 + 0.01, abs=1e-3)
    assert not any(each.kind == "clock" for each in status.events)


def test_a_clock_that_was_set_anew_is_an_event_and_a_new_stretch(vehicle: Vehicle) -> None:
    link = Told([[of_pose(0.1 * k, 1.0 * k)] for k in range(5)], restarts=1)
    made, _ = session_of(link, vehicle=vehicle)
    status = made.run(threading.Event())
    assert [each.text for each in status.events if each.kind == "clock"] == ["link 0: its clock was set anew"]


def test_a_clock_that_was_set_anew_before_any_sample_is_an_event_of_the_beginning(vehicle: Vehicle) -> None:
    made, _ = session_of(Told([[of_pose(2.5, 1.0)]], restarts=1), vehicle=vehicle)
    made.run(threading.Event())
    assert [each.t for each in made.status().events if each.kind == "clock"] == [0.0]


def test_only_a_link_that_may_fall_silent_is_said_to_be(vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    live, replayed, over = Told([], patient=False), Told([], patient=True), Told([], patient=False)
    over._ended = True
    made, _ = session_of(live, replayed, over, vehicle=vehicle)
    now = time.monotonic()
    monkeypatch.setattr("towtank.live.pipeline.hearing.time.monotonic", lambda: now + 30.0)
    silent = [each.silent for each in made.status().sources]
    assert silent == [pytest.approx(30.0, abs=1.0), None, None]


def test_a_sample_came_when_it_was_received_however_late_it_is_read(vehicle: Vehicle) -> None:
    now = steady_time()
    sent = [Sample("test", "pose", now - 0.5 + 0.01 * k, now - 0.4, ("x", "y"), (1.0 * k, 0.0)) for k in range(5)]
    made, _ = session_of(Told([sent]), vehicle=vehicle)
    late: list[float] = []
    made.taps += (lambda arrivals: late.extend(time.monotonic() - each.came for each in arrivals),)
    made.run(threading.Event())
    assert len(late) == 5
    assert min(late) >= 0.39


@pytest.mark.parametrize(("name", "said", "below"), [("z", True, True), ("z", False, False), ("psi", True, False)])
def test_a_depth_is_below_the_surface_where_the_link_that_tells_it_says_so(
    vehicle: Vehicle, tmp_path: Path, name: str, said: bool, below: bool
) -> None:
    key, value = DEPTH_BELOW_SURFACE
    times = [EPOCH + 0.1 * k for k in range(9)]
    batches = [[Sample("test", "pose", t, t, (name,), (0.1 * k,))] for k, t in enumerate(times)]
    link = Told(batches, attributes={key: value} if said else {})
    made, _ = session_of(link, vehicle=vehicle, log=McapLog.open(tmp_path / "a.mcap"))
    made.run(threading.Event())
    assert read(tmp_path / "a.mcap").attributes.get(key) == (value if below else None)


def test_a_recording_no_longer_says_what_a_further_link_contradicts(vehicle: Vehicle, tmp_path: Path) -> None:
    """A depth by pressure is below the surface; not where another depth comes, too, of which nobody says so."""
    key, value = DEPTH_BELOW_SURFACE
    made, _ = session_of(
        Told([[Sample("test", "pose", EPOCH, EPOCH, ("z",), (0.5,))]], attributes={key: value, "modes": "ArduSub"}),
        Told([[]]),
        vehicle=vehicle,
        log=McapLog.open(tmp_path / "a.mcap"),
    )
    made.run(threading.Event())
    told: list[dict[str, str | None]] = []
    made._recorder = SimpleNamespace(put_attributes=told.append)  # type: ignore[assignment]
    made._describe()
    made._deep[1] = True
    made._describe()
    assert told == [{key: None, "modes": "ArduSub"}]


def test_what_somebody_says_of_the_session_is_an_event(vehicle: Vehicle) -> None:
    made, _ = session_of(Told([[of_pose(2.5, 1.0)]]), vehicle=vehicle)
    made.mark("before")
    made.run(threading.Event())
    made.mark("after")
    marks = [(each.t, each.text) for each in made.status().events if each.kind == "mark"]
    assert marks == [(0.0, "before"), (2.5, "after")]


def test_of_links_that_cannot_all_be_opened_none_is(vehicle: Vehicle) -> None:
    closed: list[str] = []

    class Opens(Told):
        def close(self) -> None:
            closed.append("closed")

    class Fails(Told):
        def open(self) -> None:
            raise InputError("no")

    with pytest.raises(InputError, match="no"):
        session_of(Opens([]), Fails([]), vehicle=vehicle)
    assert closed == ["closed"]


def test_what_is_sent_is_recorded_and_taps_see_samples_first(vehicle: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    made, _ = session_of(Told([[of_pose(0.1 * k, 1.0)] for k in range(5)]), vehicle=vehicle, log=McapLog.open(path))
    tapped: list[float] = []
    ended: list[bool] = []
    made.taps += (lambda arrivals: tapped.extend(each.t for each in arrivals),)
    made.before_end += (lambda: ended.append(made.status().ended),)
    made.keep(0.2, Raw("mavlink", "sent", EPOCH + 0.2, b"sent"))
    made.run(threading.Event())
    assert tapped == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert ended == [False]
    assert {each.name: each.count for each in read(path).contents}["/raw/mavlink/sent"] == 1
