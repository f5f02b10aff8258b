"""When thrust may be sent and when it must not: a state machine without clock, sockets or threads.

    off -> ready -> driving -> stopping -> off        by a fault
                            -> stopping -> ready      at the end of a segment

Off, nothing is sent. An operator switches on, which makes ready; ready, nothing is sent either. Thrust begins where a
segment is under way and the dead-man key is held, pressed after the switch: a key that hangs begins nothing. Whatever
is missing while driving stops: neutral commands at once, a few of them against loss, then nothing. After a fault the
switch is off, whatever comes back: only an operator switches on again. `step` is called every `PERIOD`; a call that
comes too late is a fault itself. Times are of one steady clock [s].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from towtank.core.arrays import Array

__all__ = ["PERIOD", "STALE", "Interlock", "Limits", "Order", "Seen", "Send", "Stage"]

PERIOD = 0.02  # s between two steps: a command with each
STALE = 0.2  # s: a key, a pose or a link that is older is lost; thrust then ends within 0.3 s on a busy computer
_AHEAD = 0.1  # s that a stamp may lie before the step: beyond it cannot be
_BEAT = 2.5  # s between two heartbeats, which come once a second: one may be lost
_HELD_UP = STALE  # s between two steps, after which commands may have come too late to be meant
_NEUTRALS = 10  # neutral commands after a stop, one a step
_RELEASES = 3  # then, where channels are overridden, messages that let go of them


class Stage(StrEnum):
    """Where the drive stands."""

    OFF = "off"
    READY = "ready"
    DRIVING = "driving"
    STOPPING = "stopping"


class Send(StrEnum):
    """What is sent in a step."""

    NOTHING = "nothing"
    STICKS = "sticks"
    NEUTRAL = "neutral"
    RELEASE = "release"


@dataclass(frozen=True)
class Limits:
    """What is never exceeded: thrust as a share of each stick's full way, and seconds of one run of the drive."""

    amplitude: float = 1.0
    duration: float = 30.0


@dataclass(frozen=True, eq=False)
class Seen:
    """What is known at a step.

    Attributes:
        t: time of the step [s]. pose, link, beat, outputs, key: when each was seen last [s], -inf for never: a pose
            that can be believed, any message of the autopilot, its heartbeat, what it gives to the thrusters, a sign
            of the dead-man key.
        pressed: since when the key is held [s].
        armed: the vehicle is. manual: its mode gives sticks straight to the thrusters.
        fault: what else is wrong, "" for nothing.
        sticks: (6,) that are wanted now, -1 .. 1; None where no segment is under way.
    """

    t: float
    pose: float = -math.inf
    link: float = -math.inf
    beat: float = -math.inf
    outputs: float = -math.inf
    key: float = -math.inf
    pressed: float = math.inf
    armed: bool = False
    manual: bool = False
    fault: str = ""
    sticks: Array | None = None


@dataclass(frozen=True, eq=False)
class Order:
    """What a step asks to be sent; sticks (6,) where these are."""

    send: Send
    sticks: Array | None = None


_NOTHING, _NEUTRAL, _RELEASE = Order(Send.NOTHING), Order(Send.NEUTRAL), Order(Send.RELEASE)


def _lost(t: float, seen: float, patience: float) -> bool:
    return not -_AHEAD <= t - seen <= patience  # a NaN is lost as well


class Interlock:
    """Decides, step by step.

    Args:
        limits: that are never exceeded. overrides: whether channels must be let go of after a stop.

    Attributes:
        stage: why: it is off, or what it lacks while ready, in words; "" for nothing.
        stops: how many faults there were.
    """

    def __init__(self, limits: Limits, *, overrides: bool = False) -> None:
        self._limits, self._overrides = limits, overrides
        self.stage, self.why, self.stops = Stage.OFF, "", 0
        self._last = math.nan
        self._ready = self._began = math.inf
        self._after, self._left = Stage.OFF, 0

    def switch(self, on: bool, seen: Seen) -> str:
        """Switch on or off; return why it cannot be switched on, "" where it was done."""
        if not on:
            if self.stage is Stage.DRIVING:
                self._stop("switched off", Stage.OFF)
            elif self.stage is Stage.STOPPING:
                self._after = Stage.OFF
            elif self.stage is Stage.READY:
                self.stage, self.why = Stage.OFF, "switched off"
            return ""
        if self.stage is not Stage.OFF:
            return "it is on already" if self.stage is not Stage.STOPPING else "it is stopping"
        missing = self._missing(seen, idle=True)
        if missing:
            return missing
        self.stage, self.why, self._ready = Stage.READY, "", seen.t
        return ""

    def step(self, seen: Seen) -> Order:
        """Go on to the time of what is seen, and return what is to be sent."""
        passed, self._last = seen.t - self._last, seen.t
        if self.stage is Stage.READY:
            self._start(seen)
        elif self.stage is Stage.DRIVING and not 0.0 <= passed <= _HELD_UP:
            how = f"held up for {passed:.2f} s" if passed > 0.0 else "its clock went back"
            self._stop(f"this computer: {how}", Stage.OFF)
        if self.stage is Stage.DRIVING:
            return self._drive(seen)
        if self.stage is Stage.STOPPING:
            return self._end()
        return _NOTHING

    def _start(self, seen: Seen) -> None:
        pressed = seen.pressed >= self._ready and not _lost(seen.t, seen.key, STALE)
        self.why = self._missing(seen)
        if seen.sticks is not None and pressed and not self.why:
            self.stage, self._began = Stage.DRIVING, seen.t

    def fail(self, why: str) -> None:
        """Stop for a fault that no step has seen."""
        if self.stage is Stage.DRIVING:
            self._stop(why, Stage.OFF)
        elif self.stage is Stage.READY:
            self.stage, self.why = Stage.OFF, why
        elif self.stage is Stage.STOPPING:
            self._after = Stage.OFF

    def _drive(self, seen: Seen) -> Order:
        missing = self._missing(seen)
        if not missing and _lost(seen.t, seen.key, STALE):
            missing = "the key was let go"
        if not missing and seen.t - self._began > self._limits.duration:
            missing = f"driven for {self._limits.duration:g} s at a stretch, as long as is allowed"
        sticks = seen.sticks
        if not missing and sticks is not None:
            most = self._limits.amplitude
            within = [min(max(float(each), -most), most) for each in sticks]
            if all(math.isfinite(each) for each in within):
                return Order(Send.STICKS, _array(within))
            missing = "a command that is no number"
        if missing:
            self._stop(missing, Stage.OFF)
        else:
            self._stop("", Stage.READY)
        return self._end()

    def _missing(self, seen: Seen, *, idle: bool = False) -> str:
        """Return what thrust lacks, "" for nothing; idle: the vehicle need not be armed yet."""
        if _lost(seen.t, seen.link, STALE):
            return "nothing comes from the autopilot"
        if _lost(seen.t, seen.beat, _BEAT):
            return "no heartbeat comes from the autopilot"
        if not idle and not seen.armed:
            return "the vehicle is disarmed"
        if not idle and not seen.manual:
            return "the vehicle is not in MANUAL mode"
        if _lost(seen.t, seen.pose, STALE):
            return "no pose comes"
        if _lost(seen.t, seen.outputs, STALE):
            return "the autopilot does not tell its outputs"
        return seen.fault

    def _stop(self, why: str, after: Stage) -> None:
        self.stage, self._after = Stage.STOPPING, after
        self._left = _NEUTRALS + (_RELEASES if self._overrides else 0)
        if after is Stage.OFF:
            self.why, self.stops = why, self.stops + 1

    def _end(self) -> Order:
        self._left -= 1
        release = self._overrides and self._left < _RELEASES
        if self._left <= 0:
            self.stage, self._ready = self._after, self._last  # for the next segment the key is pressed anew
        return _RELEASE if release else _NEUTRAL


def _array(values: list[float]) -> Array:
    import numpy as np

    return np.array(values)
