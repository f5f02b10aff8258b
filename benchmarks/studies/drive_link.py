"""A drive over real sockets: a live session with `--drive`'s own parts, and a simulated vehicle behind loopback UDP.

The operator is a thread: it holds the key ten times a second, as the page does, and switches on again after each stop.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from simulated_sub import SimulatedSub

from towtank.app.live.coaching import Coaching
from towtank.app.live.driving import Driving, helm_of, link_of
from towtank.live.driving.interlock import Stage
from towtank.live.driving.sticks import Way
from towtank.live.links.urls import open_source
from towtank.live.pipeline.clock import steady_time
from towtank.live.session import Session
from towtank.live.warm_up import new_learner, warm_up
from towtank.planning import Plan, Planned, Segment, Space
from towtank.planning.plan import Accuracy
from towtank.recording.mcap.log import McapLog
from towtank.vehicle import load_vehicle

__all__ = ["LOSSES", "Driven", "Link", "driven", "lost", "plan_of"]

_TURN = 0.01  # s
SPACE = "5x5x2.5"
ATTEMPTS = 10  # to begin a segment: a computer that is busy with something else stops it by itself


def plan_of(segments: int = 1, duration: float = 8.0) -> Plan:
    """Return a plan of surge and yaw, for a BlueROV2 Heavy."""
    switches = (tuple(np.arange(1.0, duration, 1.0).tolist()), tuple(np.arange(0.5, duration, 1.0).tolist()))
    segment = Segment("telegraph", duration, (0, 5), (30.0, 3.0), switches, ((1.0,), (1.0,)))
    planned = Planned(segment, (1.0, 1.0, 0.5), 0.0)
    wanted = (Accuracy("X_uu", 0.5, 0.04, 0.03, 0.05, ""), Accuracy("N_rr", 0.5, 0.04, 0.03, 0.05, ""))
    return Plan("bluerov2_heavy", "pose", Space.from_text(SPACE), 0.05, (planned,) * segments, wanted)


class Foreseen(Coaching):
    """Leads through the segments as they were planned: to design another takes seconds and shows nothing here."""

    def _think(self) -> None:
        self._coach.offer(None)


@dataclass
class Link:
    """The vehicle behind a socket; `down`, `up`: whether messages pass each way, `posed`: whether positions come."""

    sub: SimulatedSub
    port: int
    down: bool = True
    up: bool = True
    posed: bool = True
    thrust_ended: float = -1.0  # monotonic time at which it last stopped thrusting
    commands: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._stop = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Link:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        due, to, thrusting = time.monotonic(), ("127.0.0.1", self.port), False
        while not self._stop.wait(max(due - time.monotonic(), 0.0)):
            due += _TURN
            answers = []
            with contextlib.suppress(BlockingIOError, ConnectionError):
                while True:
                    data = self._socket.recv(4096)
                    before = len(self.sub.got)
                    answers += self.sub.take(data) if self.up else []
                    self.commands += [(time.monotonic(), each.get_type()) for _, each in self.sub.got[before:]]
            self.sub.advance(_TURN)
            if thrusting and not self.sub.thrusting:
                self.thrust_ended = time.monotonic()
            thrusting = self.sub.thrusting
            said = [data for name, data in self.sub.says() if self.posed or name != "LOCAL_POSITION_NED"]
            for data in [*answers, *said] if self.down else []:
                with contextlib.suppress(OSError):
                    self._socket.sendto(data, to)


@dataclass
class Driven:
    """A session that drives: its parts, and what the operator does."""

    link: Link
    session: Session
    driving: Driving
    holds: bool = False
    refused: str = ""

    @property
    def stage(self) -> Stage:
        return self.driving.driver.interlock.stage

    @property
    def told(self) -> list[str]:
        """Events of the drive."""
        return [event.text for event in self.session.events.all if event.kind == "drive"]

    def until(self, what: Callable[[], bool], seconds: float) -> bool:
        """Wait for something; return whether it came."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if what():
                return True
            time.sleep(0.02)
        return False

    def begin(self, seconds: float = 15.0) -> bool:
        """Switch on, begin a segment and hold the key; return whether the vehicle is being driven."""
        self.holds = False
        if not self.until(lambda: self.stage is Stage.OFF, 2.0):  # an attempt before this one came no farther than on
            self.driving.ask("drive-off")
        time.sleep(0.3)
        self.link.sub.place(np.array([3.0, 1.0, 2.0, 0.0, 0.0, 1.0]))
        time.sleep(0.3)

        def on() -> bool:
            self.refused = self.driving.driver.switch(True)
            time.sleep(0.2 if self.refused else 0.0)
            return not self.refused

        if not self.until(on, seconds) or not self.until(lambda: self.driving.ask("begin"), seconds):
            return False
        self.holds = True
        return self.until(lambda: self.stage is Stage.DRIVING and self.link.sub.thrusting, seconds)


@contextlib.contextmanager
def driven(
    sub: SimulatedSub,
    plan: Plan,
    way: Way = Way.MANUAL,
    record: Path | None = None,
    free: tuple[str, ...] | None = None,
) -> Iterator[Driven]:
    """Yield a session that drives a simulated vehicle, and learns what is free of it; None: everything plausible."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    vehicle = load_vehicle("bluerov2_heavy")
    text = f"udpin:127.0.0.1:{port}"
    sources = [(text, open_source(text, vehicle))]
    helm = helm_of(vehicle, plan.space or Space.from_text(SPACE))
    link = link_of(sources)
    log = None if record is None else McapLog.open(record, source=text)
    warm_up(vehicle, new_learner(vehicle, "joint", free), lambda what, share: None)
    learner = new_learner(vehicle, "joint", free, background=True)
    session = Session(sources, vehicle, learner, epoch=steady_time(), log=log)
    driving = Driving(session, link, helm, Foreseen(session, vehicle, plan, waits=True), way)
    session.open()
    stop = threading.Event()
    running = threading.Thread(target=session.run, args=(stop,), daemon=True)
    with Link(sub, port) as wire, driving:
        found = Driven(wire, session, driving)

        def hold() -> None:
            while not stop.wait(0.1):
                if found.holds:
                    driving.ask("drive-key")

        running.start()
        holding = threading.Thread(target=hold, daemon=True)
        holding.start()
        try:
            yield found
        finally:
            stop.set()
            running.join()
            holding.join()


def _release(run: Driven) -> None:
    run.holds = False
    run.driving.ask("drive-let-go")


def _stop_holding(run: Driven) -> None:
    run.holds = False


def _set(name: str) -> Callable[[Driven], None]:
    return lambda run: setattr(run.link, name, False)


def _cut(run: Driven) -> None:
    run.link.down = run.link.up = False


def _switch_off(run: Driven) -> None:
    run.driving.ask("drive-off")


def _disarm(run: Driven) -> None:
    run.link.sub.armed = False


LOSSES: dict[str, Callable[[Driven], None]] = {
    "pose": _set("posed"),
    "link, from the vehicle": _set("down"),
    "link, both ways": _cut,
    "operator lets go": _release,
    "operator's signs stop": _stop_holding,
    "operator switches off": _switch_off,
    "arm switch": _disarm,
}


def restore(run: Driven) -> None:
    """Let everything be as it was, but for the drive."""
    run.link.down = run.link.up = run.link.posed = run.link.sub.armed = True


def lost(run: Driven, name: str) -> tuple[float, int]:
    """Begin a segment, lose something in it; return when thrust ended [s], -1 for never, and commands sent after it.

    What was lost comes back after a second, with the key held down and the segment under way: nothing may follow.
    """
    for _ in range(ATTEMPTS):  # a computer that is busy with something else stops by itself
        if run.begin() and not run.until(lambda: run.stage is not Stage.DRIVING, 0.3):
            break
    else:
        raise RuntimeError(f"{name}: not driven: {run.refused or run.told[-3:]}")
    began = time.monotonic()
    LOSSES[name](run)
    run.until(lambda: not run.link.sub.thrusting, 3.0)
    time.sleep(1.0)
    took = run.link.thrust_ended - began if run.link.thrust_ended >= began else -1.0
    quiet = time.monotonic()
    restore(run)
    run.holds = True
    time.sleep(1.0)
    run.holds = False
    after = [
        kind for at, kind in run.link.commands if at > quiet and kind in ("MANUAL_CONTROL", "RC_CHANNELS_OVERRIDE")
    ]
    return took, len(after)
