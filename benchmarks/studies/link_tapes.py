"""A simulated vehicle on tape: what it says over JSON, MAVLink and DDS, and a session that hears it."""

from __future__ import annotations

import json
import math
import random
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect
from rosbags.typesys import Stores, get_typestore

from towtank import load_vehicle
from towtank.live import session as live_session
from towtank.live.links.json import JsonSource
from towtank.live.links.mavlink import source as mavlink_source
from towtank.live.links.mavlink.source import MavlinkSource
from towtank.live.links.ros2 import source as ros2_source
from towtank.live.links.ros2.source import Ros2Source
from towtank.live.links.ros2.transports import Message
from towtank.live.links.source import Raw, Sample, SourceState
from towtank.live.pipeline.instants import rows_of
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.recording import Recording
from towtank.simulation import Mocap, manoeuvre, simulate

FREE = ("X_udot", "X_uu")
RATE, SECONDS = 50.0, 30.0  # Hz, s
EPOCH = 1.7e9
OWN, OTHER = ("10.0.0.2", 14550), ("10.0.0.9", 14550)
ODOMETRY, WRENCH = "nav_msgs/msg/Odometry", "geometry_msgs/msg/WrenchStamped"
_STORE = get_typestore(Stores.ROS2_HUMBLE)


class Heard(NamedTuple):
    """What came over a link: when [s, Unix], its bytes, and from where, or on which topic."""

    received: float
    data: bytes
    sender: Any


Tape = list[list[Heard]]  # batches, as they are read
Batches = Iterable[list[Heard]]


class Player:
    """Plays a tape in the place of a socket; the time is that of the tape."""

    stream = speaks_first = False
    bandwidth, broken, dropped = 0.0, "", 0
    name = "tape"
    said: tuple[str, ...] = ()

    def __init__(self, tape: Batches) -> None:
        self._batches = iter(tape)
        self.now, self.ended, self.slowest = EPOCH, False, 0.0
        self._handed = math.inf

    def open(self) -> None:
        """There is nothing to open."""

    def receive(self, timeout: float) -> list[Any]:
        """Return the next batch."""
        self.slowest = max(self.slowest, time.thread_time() - self._handed)
        batch = next(self._batches, None)
        self.ended = batch is None
        if batch:
            self.now = batch[-1].received
        self._handed = time.thread_time()
        return [(each.data, each.received, each.sender) for each in batch or ()]

    def send(self, data: bytes, to: Any) -> None:
        """Say nothing."""

    def close(self) -> None:
        """There is nothing to close."""


class Topics(Player):
    """The same for topics of ROS 2."""

    def receive(self, timeout: float) -> list[Any]:
        """Return the next batch as messages."""
        return [Message(*topic, received, data) for data, received, topic in super().receive(timeout)]

    def topics(self) -> dict[str, str]:
        """Return what is published."""
        return {"/odom": ODOMETRY, "/thrust": WRENCH}

    def subscribe(self, topic: str, kind: str) -> str:
        """Listen."""
        return ""


class Played:
    """A link whose tape ends, and which can wait, as a file can."""

    patient = True

    def __init__(self, link: Any, player: Player) -> None:
        self._link, self._player = link, player
        self.name, self.keeps_time = link.name, link.keeps_time

    def open(self) -> None:
        """Open the link."""
        self._link.open()

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Read the link."""
        found: Sequence[Sample | Raw] = self._link.read(timeout)
        return found

    def state(self) -> SourceState:
        """Return how it fares, and whether the tape has ended."""
        return replace(self._link.state(), ended=self._player.ended)

    def close(self) -> None:
        """Close the link."""
        self._link.close()


# What a vehicle says


def drive(name: str, seconds: float, seed: int) -> Recording:
    """Return a simulated run in surge."""
    vehicle = load_vehicle(name)
    plan = manoeuvre("surge-sine", vehicle, duration=seconds, dt=1.0 / RATE, seed=seed)
    return simulate(vehicle, commands=plan.commands, dt=1.0 / RATE, sensors=Mocap(rate=RATE), seed=seed)


Packed = list[tuple[float, list[tuple[bytes, Any]]]]  # time of the vehicle [s], and what it sends then
Stamp = Callable[[float], float]


def json_of(run: Recording, stamp: Stamp, sender: Any = OWN) -> Packed:
    """Return a run as JSON."""
    return [
        (t, [(json.dumps({"t": stamp(t), **dict(zip(names, values, strict=True))}).encode(), sender)])
        for t, names, values in rows_of(run)
    ]


def mavlink_of(run: Recording, stamp: Stamp, sender: Any = OWN) -> Packed:
    """Return a run as an autopilot tells it; the stamp is the time since it started."""
    encoder = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    names = [name for name in run.names if name.startswith("cmd_")]
    grid = run["x"].t
    velocity = {name: np.gradient(run[name].values, grid) for name in ("x", "y", "z", "phi", "theta", "psi")}
    found: Packed = []
    for k, t in enumerate(grid.tolist()):
        boot = stamp(t)
        milli = round(1e3 * boot) % 2**32
        angles = [float(run[name].values[k]) for name in ("phi", "theta", "psi")]
        rates = [float(velocity[name][k]) for name in ("phi", "theta", "psi")]
        place = [float(run[name].values[k]) for name in ("x", "y", "z")]
        speed = [float(velocity[name][k]) for name in ("x", "y", "z")]
        pulses = [round(float(np.interp(t, run[name].t, run[name].values))) for name in names]
        said = [
            dialect.MAVLink_attitude_message(milli, *angles, *rates),
            dialect.MAVLink_local_position_ned_message(milli, *place, *speed),
            dialect.MAVLink_servo_output_raw_message(round(1e6 * boot) % 2**32, 0, *pulses, *[0] * (16 - len(pulses))),
        ]
        if k % round(RATE) == 0:
            said += [
                dialect.MAVLink_heartbeat_message(12, 3, 128, 19, 4, 3),  # armed, MANUAL
                dialect.MAVLink_ekf_status_report_message(63, 0.1, 0.1, 0.1, 0.1, 0.1),
            ]
        found.append((t, [(bytes(each.pack(encoder)), sender) for each in said]))
    return found


def ros2_of(run: Recording, stamp: Stamp, sender: Any = None) -> Packed:
    """Return a run as Odometry and WrenchStamped, in ENU and FLU, with the force that it was driven by."""
    grid = run["x"].t
    speed = np.gradient(run["x"].values, grid)
    found: Packed = []
    for k, t in enumerate(grid.tolist()):
        force = 30.0 * math.sin(0.6 * t)
        found.append(
            (
                t,
                [
                    (odometry(stamp(t), float(run["x"].values[k]), float(speed[k])), ("/odom", ODOMETRY)),
                    (wrench(stamp(t), force), ("/thrust", WRENCH)),
                ],
            )
        )
    return found


def _made(kind: str, **fields: Any) -> Any:
    return _STORE.types[kind](**fields)


def _header(stamp: float, frame: str) -> Any:
    seconds = math.floor(stamp)
    moment = _made("builtin_interfaces/msg/Time", sec=seconds, nanosec=round(1e9 * (stamp - seconds)) % 10**9)
    return _made("std_msgs/msg/Header", stamp=moment, frame_id=frame)


def _vector(x: float, y: float, z: float, kind: str = "Vector3") -> Any:
    return _made(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def odometry(stamp: float, north: float, u: float) -> bytes:
    """Return nav_msgs/Odometry of a vehicle that heads north."""
    half = math.sqrt(0.5)
    turn = _made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=half, w=half)
    pose = _made("geometry_msgs/msg/Pose", position=_vector(0.0, north, -1.0, "Point"), orientation=turn)
    rate = _made("geometry_msgs/msg/Twist", linear=_vector(u, 0.0, 0.0), angular=_vector(0.0, 0.0, 0.0))
    message = _made(
        ODOMETRY,
        header=_header(stamp, "odom"),
        child_frame_id="base_link",
        pose=_made("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=_made("geometry_msgs/msg/TwistWithCovariance", twist=rate, covariance=np.zeros(36)),
    )
    return bytes(_STORE.serialize_cdr(message, ODOMETRY))


def wrench(stamp: float, force: float) -> bytes:
    """Return geometry_msgs/WrenchStamped of a force forward."""
    both = _made("geometry_msgs/msg/Wrench", force=_vector(force, 0.0, 0.0), torque=_vector(0.0, 0.0, 0.0))
    return bytes(_STORE.serialize_cdr(_made(WRENCH, header=_header(stamp, "base_link"), wrench=both), WRENCH))


# Links, and what is learned


@dataclass(frozen=True)
class Link:
    """A kind of link: its vehicle, how a run is said over it, and what a tape is played to."""

    vehicle: str
    says: Callable[..., Packed]
    boot: float  # s on the vehicle's clock at t = 0


LINKS = {
    "JSON": Link("seamor", json_of, 100.0),
    "MAVLink": Link("bluerov2_heavy", mavlink_of, 100.0),
    "DDS": Link("seamor", ros2_of, EPOCH - 5e5),
}


@dataclass(frozen=True)
class Outcome:
    """What a tape taught.

    Attributes:
        values, std: of the coefficients. status: how the session ended. slowest: most work on one batch [s].
    """

    values: Any
    std: Any
    status: Status
    slowest: float

    @property
    def told(self) -> str:
        """All that a person is told."""
        said = [text for each in self.status.sources for text in each.state.said]
        return " | ".join([*said, *self.status.warnings, *(each.text for each in self.status.events)])


def played(kind: str, tape: Batches) -> Outcome:
    """Play a tape to a session; raises what a link or the learner raises."""
    vehicle = load_vehicle(LINKS[kind].vehicle)
    player: Player = Topics(tape) if kind == "DDS" else Player(tape)
    link: Any
    if kind == "JSON":
        link = JsonSource("json:127.0.0.1:9", vehicle)
        link.open = lambda: None
        link._link = player
    elif kind == "MAVLink":
        link = MavlinkSource("udpin:127.0.0.1:9?listen", vehicle)
        link._connection = player
    else:
        link = Ros2Source("dds:0")
        link._link = player
    learner = new_learner(vehicle, "joint", FREE, changes=False)
    session = Session([(kind, Played(link, player))], vehicle, learner, epoch=EPOCH)
    with ExitStack() as of_the_tape:  # its time is not that of the clock
        for module in (mavlink_source, ros2_source):
            of_the_tape.enter_context(patch.object(module, "steady_time", lambda: player.now))
        of_the_tape.enter_context(patch.object(live_session, "_SETTLING", math.inf))
        of_the_tape.enter_context(warnings.catch_warnings())
        warnings.simplefilter("error")
        session.open()
        status = session.run(threading.Event())
    broken = [text for text in status.warnings if "stopped" in text or "failed" in text]
    if broken:
        raise RuntimeError(f"{kind}: {'; '.join(broken)}")
    return Outcome(learner.estimate.values, learner.estimate.std, status, player.slowest)


def tape_of(packed: Packed, *, quickest: float = 0.002, seed: int = 1) -> Tape:
    """Return what comes of what is sent: each a little late, in its order."""
    chance = random.Random(seed)
    tape, last = [], 0.0
    for t, said in packed:
        last = max(EPOCH + t + quickest + chance.expovariate(500.0), last)
        tape.append([Heard(last, data, sender) for data, sender in said])
    return tape


def usual(kind: str, seed: int, seconds: float = SECONDS) -> Tape:
    """Return the tape of a link that nothing befalls."""
    link = LINKS[kind]
    return tape_of(link.says(drive(link.vehicle, seconds, seed), lambda t: link.boot + t), seed=seed)
