"""A drive in simulated time: the simulated vehicle, the driver by a clock of its own, and what can go wrong between.

Everything of the drive is the real thing: what is sent are the bytes that the vehicle parses, what is heard are the
bytes that it sends. Only sockets, threads and the learner are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from simulated_sub import STABILIZE, SimulatedSub

from towtank.core.arrays import Array
from towtank.live.driving.driver import Driver, Outside, Task
from towtank.live.driving.heard import Autopilot, Measured
from towtank.live.driving.helm import Helm
from towtank.live.driving.interlock import PERIOD, Stage
from towtank.live.driving.sticks import Encoder, Way
from towtank.live.links.mavlink.frames import Framer
from towtank.live.links.source import Sample
from towtank.live.pipeline.sorter import Arrival
from towtank.readers.mavlink.format import layouts
from towtank.readers.mavlink.senders import Sender

__all__ = ["FAULTS", "Fault", "Rig"]

_RATES = {"HEARTBEAT": 10.0, "ATTITUDE": 50.0, "LOCAL_POSITION_NED": 50.0, "SERVO_OUTPUT_RAW": 50.0}
_KEY = 0.1  # s between two signs of the key


@dataclass
class World:
    """What stands between vehicle and drive; a fault changes it."""

    down: bool = True
    up: bool = True
    key: bool = True
    pose: Callable[[Array], Array] = lambda pose: pose
    posed: bool = True
    frozen: bool = False
    late: float = 0.0
    beats: bool = True
    outputs: bool = True
    stalled: bool = False
    back: float = 0.0
    strange: bool = False


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong: what it is, what it does, and whether the vehicle's own word on it must come first."""

    name: str
    does: Callable[[Rig], None]
    delays: float = 0.0  # s until it can be known here


def _set(**changes: object) -> Callable[[Rig], None]:
    def does(rig: Rig) -> None:
        for name, value in changes.items():
            setattr(rig.world, name, value)

    return does


def _jump(rig: Rig) -> None:
    rig.world.pose = lambda pose: pose + np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])


def _nan(rig: Rig) -> None:
    rig.world.pose = lambda pose: pose * math.nan


def _disarm(rig: Rig) -> None:
    rig.sub.armed = False


def _mode(rig: Rig) -> None:
    rig.sub.mode = STABILIZE


FAULTS = (
    Fault("pose: none comes", _set(posed=False)),
    Fault("pose: stands still", _set(frozen=True)),
    Fault("pose: no number", _nan),
    Fault("pose: jumps", _jump),
    Fault("pose: comes late", _set(late=0.6)),
    Fault("link: nothing comes", _set(down=False)),
    Fault("link: cut both ways", _set(down=False, up=False)),
    Fault("operator: lets go of the key", lambda rig: rig.let_go()),
    Fault("operator: key's signs stop", _set(key=False)),
    Fault("operator: switches off", lambda rig: rig.switch(False)),
    Fault("arm switch: disarmed", _disarm, 0.1),
    Fault("mode: STABILIZE", _mode, 0.1),
    Fault("outputs: not told", _set(outputs=False), 0.25),
    Fault("computer: stands still for 0.4 s", _set(stalled=True)),
    Fault("clock: goes back", _set(back=5.0)),
    Fault("thrusters: follow another", _set(strange=True), 0.5),
)


@dataclass
class Rig:
    """A drive of one vehicle.

    Args:
        sub: the vehicle. helm: that steers it. wrench: (n, 6) of the segment [N, N m]. way: how sticks are sent.
    """

    sub: SimulatedSub
    helm: Helm
    wrench: Array
    way: Way = Way.MANUAL
    lead: float = 0.5  # s of count-down
    world: World = field(default_factory=World)

    def __post_init__(self) -> None:
        self.starts = math.inf
        self.sent: list[tuple[float, bytes]] = []
        self.said: list[str] = []
        self._autopilot, self._measured = Autopilot(0.0), Measured(self.helm.guard.vehicle)
        self._names = tuple(f"cmd_{each.name}" for each in self.helm.guard.vehicle.thrusters)
        self._layouts = layouts()
        self._framer = Framer(self._layouts, stream=False)
        self._last_key, self._still = -math.inf, 0.0
        self._frozen: dict[str, tuple[float, ...]] = {}
        outside = Outside(
            send=self._send,
            encoder=lambda way, system, gain: Encoder(way, system, Sender(1, 1), gain),
            parameters=lambda: dict(self.sub.parameters),
            task=lambda t: (
                Task(self.wrench, self.sub.t - self.starts) if self.sub.t >= self.starts - self.lead else None
            ),
            happened=lambda text, fault: self.said.append(text),
            sent=lambda t, data: self.sent.append((self.sub.t, data)),
        )
        self.driver = Driver(
            self.helm, self._autopilot, self._measured, self.way, outside, now=lambda: self.sub.t - self.world.back
        )
        for name, rate in _RATES.items():
            self.sub._intervals[name] = 1.0 / rate

    def _task(self, t: float) -> Task | None:
        clock = self.sub.t - self.starts
        return Task(self.wrench, clock) if clock >= -self.lead else None

    def _send(self, data: bytes) -> None:
        if self.world.up:
            self.sub.take(data)

    @property
    def stage(self) -> Stage:
        return self.driver.interlock.stage

    def switch(self, on: bool) -> str:
        return self.driver.switch(on)

    def let_go(self) -> None:
        self.world.key = False
        self.driver.let_go()

    def begin(self) -> None:
        """Count down to the segment."""
        self.starts = self.sub.t + self.lead

    def turn(self) -> None:
        """Go on by one period."""
        self.sub.advance(PERIOD)
        if self.world.strange:  # somebody else's sticks come after ours
            self.sub.channels[4], self.sub.heard = 1900.0, self.sub.t
        for name, data in self.sub.says():
            self._hear(name, data)
        if self.world.key and self.sub.t - self._last_key >= _KEY - 1e-9:
            self._last_key = self.sub.t
            self.driver.hold()
        if self.world.stalled and self._still < 0.4:
            self._still += PERIOD
            return
        self.driver.step()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.turn()

    def _hear(self, name: str, data: bytes) -> None:
        world = self.world
        if not world.down or (name == "HEARTBEAT" and not world.beats):
            return
        for frame in self._framer.feed(data):
            layout = self._layouts[frame.number]
            self._autopilot.hear(name, lambda: layout.rows([frame.payload])[0], self.sub.t - world.back)  # noqa: B023
            row = layout.rows([frame.payload])[0]
            if name == "SERVO_OUTPUT_RAW" and world.outputs:
                values = tuple(float(row[f"servo{n}_raw"]) for n in range(1, len(self._names) + 1))
                self._sample(name, self._names, values, 0.0)
            elif name in ("ATTITUDE", "LOCAL_POSITION_NED") and world.posed:
                wanted = ("roll", "pitch", "yaw") if name == "ATTITUDE" else ("x", "y", "z")
                found = np.array([float(row[each]) for each in wanted])
                whole = world.pose(np.concatenate([np.zeros(3), found] if name == "ATTITUDE" else [found, np.zeros(3)]))
                values = tuple(whole[3:] if name == "ATTITUDE" else whole[:3])
                values = self._frozen.setdefault(name, values) if world.frozen else values
                names = ("phi", "theta", "psi") if name == "ATTITUDE" else ("x", "y", "z")
                self._sample(name, names, values, world.late)

    def _sample(self, topic: str, names: tuple[str, ...], values: tuple[float, ...], late: float) -> None:
        t = self.sub.t - self.world.back - late
        self._measured.take([Arrival(t, t, 0, Sample("mavlink", topic, t, t, names, values))])
