"""What the drive hears: the autopilot's own word on itself, poses, and what it gives to the thrusters.

Taken by the threads that read the links, as it comes, and read by the drive. A pose counts only while it changes: a
number that stands still to its last bit is no measurement. Position and attitude are each followed from one source,
the first named that sends them, and from the moment of `hold_on` from that one alone: two sources have two origins.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import euler_from_quaternion
from towtank.live.pipeline.sorter import Arrival
from towtank.recording.standard import COMMAND_PREFIX
from towtank.vehicle import Vehicle

__all__ = ["MANUAL", "Autopilot", "Measured", "Watched"]

MANUAL = 19  # custom_mode of ArduSub
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_ARDUPILOT, _SUBMARINE = 3, 12  # MAV_AUTOPILOT, MAV_TYPE
_FAR = 10.0  # s: a source that has been silent for so long is forgotten while nothing is held on to
_KEPT = 200  # poses and outputs that wait for the drive
_PLACE, _EULER, _QUATERNION = ("x", "y"), ("phi", "theta", "psi"), ("qw", "qx", "qy", "qz")


class Autopilot:
    """What an autopilot says of itself; `hear` is called for each of its messages.

    Args:
        epoch: Unix time [s] at which the session's time is 0.

    Attributes:
        link, beat: when anything, and a heartbeat, came last [s]. armed, mode, submarine: by the heartbeat.
        gain: of the pilot's sticks, NaN until it is told.
    """

    def __init__(self, epoch: float) -> None:
        self._epoch = epoch
        self.link = self.beat = -math.inf
        self.armed, self.mode, self.submarine = False, -1, False
        self.gain = math.nan

    def hear(self, name: str, row: Callable[[], Any], received: float) -> None:
        """Take a message: its name, its fields where they are wanted, when it came [s], Unix."""
        self.link = received - self._epoch
        if name == "HEARTBEAT":
            fields = row()
            self.armed, self.mode = bool(int(fields["base_mode"]) & _ARMED), int(fields["custom_mode"])
            self.submarine = (int(fields["autopilot"]), int(fields["type"])) == (_ARDUPILOT, _SUBMARINE)
            self.beat = self.link
        elif name == "NAMED_VALUE_FLOAT":
            fields = row()
            if bytes(fields["name"]).split(b"\0")[0] == b"PilotGain":
                self.gain = float(fields["value"])

    @property
    def manual(self) -> bool:
        """Whether sticks go straight to the thrusters."""
        return self.submarine and self.mode == MANUAL


class Watched(NamedTuple):
    """Where a quantity comes from: rank of the link, its source and topic."""

    rank: int
    source: str
    topic: str


class Measured:
    """Poses and outputs as they come; `take` is called by the links' threads, the rest by others.

    Attributes:
        t: time of the newest pose [s], -inf without one. pose: it (6,) [m, rad].
        outputs_t: of the newest outputs [s].
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._names = tuple(f"{COMMAND_PREFIX}{each.name}" for each in vehicle.thrusters)
        self._places: dict[Watched, tuple[float, tuple[float, ...]]] = {}
        self._attitudes: dict[Watched, tuple[float, tuple[float, ...]]] = {}
        self._depths: dict[Watched, tuple[float, tuple[float, ...]]] = {}
        self._lock = threading.RLock()
        self._held: tuple[Watched, Watched, Watched | None] | None = None
        self.t = self.outputs_t = -math.inf
        self.pose = np.full(6, np.nan)
        self.poses: deque[tuple[float, Array]] = deque(maxlen=_KEPT)
        self.outputs: deque[tuple[float, Array]] = deque(maxlen=_KEPT)

    def take(self, arrivals: Sequence[Arrival]) -> None:
        """Take samples of one link."""
        with self._lock:
            for arrival in arrivals:
                self._take(arrival)

    def _take(self, arrival: Arrival) -> None:
        sample = arrival.sample
        values = dict(zip(sample.names, sample.values, strict=True))
        source = Watched(arrival.rank, sample.source, sample.topic)
        if all(name in values for name in self._names):
            self._output(arrival.t, values)
        self._attitude(arrival.t, source, values)
        _note(self._depths, source, arrival.t, values, ("z",))
        place = (*_PLACE, "z") if "z" in values else _PLACE
        if _note(self._places, source, arrival.t, values, place, anew=True):
            self._combine()

    def _output(self, t: float, values: Mapping[str, float]) -> None:
        found = np.array([values[name] for name in self._names])
        if t > self.outputs_t and np.isfinite(found).all():
            self.outputs_t = t
            self.outputs.append((t, found))

    def _attitude(self, t: float, source: Watched, values: Mapping[str, float]) -> None:
        if all(name in values for name in _QUATERNION):
            angles = euler_from_quaternion(*(values[name] for name in _QUATERNION))
            values = dict(zip(_EULER, angles, strict=True))
        _note(self._attitudes, source, t, values, _EULER)

    def _combine(self) -> None:
        """Make a pose of the newest place and attitude; its time is that of the older."""
        now = max((t for t, _ in self._places.values()), default=-math.inf)
        held = self._held or self._chosen(now)
        if held is None:
            return
        place, attitude, depth = held
        parts = [self._places.get(place), self._attitudes.get(attitude), self._depths.get(depth or place)]
        known = [part for part in parts if part is not None]
        if len(known) < len(parts):
            return
        t = min(part[0] for part in known)
        if t > self.t:
            self.t = t
            self.pose = np.array([*known[0][1][:2], known[2][1][0], *known[1][1]])
            self.poses.append((t, self.pose))

    def _chosen(self, now: float) -> tuple[Watched, Watched, Watched | None] | None:
        """Return the sources of place, attitude and depth: the first named that send; the depth of the place's own."""
        place = _first(self._places, now)
        if place is None:
            return None
        own = {each: found for each, found in self._attitudes.items() if each[:2] == place[:2]}
        attitude = _first(own, now) or _first(self._attitudes, now)  # two headings may be of two norths
        if attitude is None:
            return None
        depth = place if place in self._depths else _first(self._depths, now)
        return None if depth is None else (place, attitude, depth)

    def hold_on(self, t: float) -> None:
        """Keep to the sources of now (time t [s]), whatever comes of them."""
        with self._lock:
            self._held = self._chosen(t)

    def let_go(self) -> None:
        """Take whatever sends again."""
        with self._lock:
            self._held, self.t = None, -math.inf

    @property
    def text(self) -> str:
        """Where the pose comes from, in words."""
        with self._lock:
            held = self._held or self._chosen(self.t)
        if held is None:
            return "nothing"
        topics = dict.fromkeys(f"{each.source} {each.topic}" for each in held if each is not None)
        return " and ".join(topics)


def _note(
    kept: dict[Watched, tuple[float, tuple[float, ...]]],
    source: Watched,
    t: float,
    values: Mapping[str, float],
    names: tuple[str, ...],
    *,
    anew: bool = False,
) -> bool:
    """Keep the values of a source where they are all there, finite and later; anew: and not the very same."""
    if not all(name in values for name in names):
        return False
    found = tuple(values[name] for name in names)
    before = kept.get(source)
    if not all(math.isfinite(each) for each in found):
        return False
    if before is not None and (t <= before[0] or (anew and found == before[1])):
        return False
    kept[source] = t, found
    return True


def _first(kept: Mapping[Watched, tuple[float, tuple[float, ...]]], now: float) -> Watched | None:
    return min((source for source, (t, _) in kept.items() if t >= now - _FAR), default=None)
