"""Drives: fifty times a second looks at what is known, asks the interlock, and sends what it says.

`step` does everything at a given time, so that a test can run it by a clock of its own; `start` makes a thread that
calls it by the steady clock of the session. Whoever refreshes the dead-man key or the switch is another thread.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.live.driving.heard import Autopilot, Measured
from towtank.live.driving.helm import Helm
from towtank.live.driving.interlock import PERIOD, STALE, Interlock, Limits, Seen, Send, Stage
from towtank.live.driving.sticks import Encoder, Way
from towtank.planning import RATE

__all__ = ["PARAMETERS", "RATES", "Driver", "Outside", "Standing", "Task"]

PARAMETERS = (
    "SYSID_MYGCS", "MAV_GCS_SYSID", "FRAME_CONFIG", "FS_PILOT_INPUT", "FS_PILOT_TIMEOUT",
    "JS_GAIN_DEFAULT", "JS_THR_GAIN", "ACRO_YAW_P",
)  # fmt: skip
RATES = {"HEARTBEAT": 10.0, "NAMED_VALUE_FLOAT": 2.0}  # Hz, asked for besides the usual ones
_GROUND_STATION = 255.0  # where the autopilot does not say whom it obeys
_SHORT = 0.3  # s, of FS_PILOT_TIMEOUT
_FULL_GAIN = 0.99
_YAW_GAIN = 3.375  # ACRO_YAW_P by which ArduSub's MANUAL mode takes the yaw stick as it is
_ADVICE = "set FS_PILOT_INPUT to 1 or 2 and FS_PILOT_TIMEOUT to 0.25"


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be driven: a wrench (n, 6) [N, N m] at 25 Hz, and how far it is, below 0 before it begins [s]."""

    wrench: Array
    clock: float

    @property
    def over(self) -> bool:
        """Whether nothing of it is left to be driven."""
        return self.clock >= len(self.wrench) / RATE


@dataclass(frozen=True)
class Outside:
    """What a driver needs of the world.

    Attributes:
        send: bytes to the autopilot. encoder: of the messages; None while no autopilot is known. parameters: of it.
        task: what is to be driven at a time [s], None for nothing.
        happened: called with a line for a person, and the fault of a stop, "" for none. sent: with what was sent.
    """

    send: Callable[[bytes], None]
    encoder: Callable[[Way, int, float], Encoder | None]
    parameters: Callable[[], dict[str, float]]
    task: Callable[[float], Task | None]
    happened: Callable[[str, str], None]
    sent: Callable[[float, bytes], None] = lambda t, data: None


@dataclass(frozen=True)
class Standing:
    """How a drive stands.

    Attributes:
        stage: why: it is off, or what it waits for, "" for nothing. held: the key is. bent: the guard bends.
        walls: how far they are, in words, "" while off.
    """

    stage: Stage
    why: str
    held: bool
    bent: bool
    walls: str


class Driver:
    """Puts interlock, helm and link together.

    Args:
        helm: that steers. autopilot, measured: what is heard. way: how sticks are sent. outside: all else.
        limits: never exceeded. now: the steady clock of the session [s].
    """

    def __init__(
        self,
        helm: Helm,
        autopilot: Autopilot,
        measured: Measured,
        way: Way,
        outside: Outside,
        *,
        limits: Limits | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._helm, self._autopilot, self._measured = helm, autopilot, measured
        self._way, self._outside, self._now = way, outside, now
        self.interlock = Interlock(limits or Limits(), overrides=way is Way.RC)
        self._encoder: Encoder | None = None
        self._key, self._pressed = -math.inf, math.inf
        self._was, self._refused = Stage.OFF, ""
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="drive", daemon=True)

    # -- what the operator does

    def switch(self, on: bool) -> str:
        """Switch on or off; return why it cannot be switched on, "" where it was done."""
        with self._lock:
            t = self._now()
            if not on:
                was = self.interlock.stage
                self.interlock.switch(False, self._seen(t))
                if was is Stage.READY:
                    self._tell_change()
                return ""
            if self.interlock.stage is not Stage.OFF:
                return self.interlock.switch(True, self._seen(t))
            self._measured.hold_on(self._measured.t)
            why = self._refusal() or self.interlock.switch(True, self._seen(t))
            if why:
                self._measured.let_go()
                if why != self._refused:
                    self._outside.happened(f"not switched on: {why}", "")
                self._refused = why
                return why
            self._helm.anchor(self._measured.t, self._measured.pose)
            self._helm.see(self._measured.t, self._measured.pose)
            self._was, self._refused = Stage.READY, ""
            text = f"switched on; pose by {self._measured.text}; walls: {self._helm.walls}"
            self._outside.happened(text, "")
            for each in self._doubts():
                self._outside.happened(each, "")
            return ""

    def hold(self) -> None:
        """Take a sign that the dead-man key is held; a pause of `STALE` is a release."""
        t = self._now()
        if t - self._key > STALE:
            self._pressed = t
        self._key = t

    def let_go(self) -> None:
        """Take note that the key was released."""
        self._key = -math.inf

    def _refusal(self) -> str:
        """Return why nothing may be driven with this autopilot, "" where it may; finds out how to speak to it."""
        known = self._outside.parameters()
        if not self._autopilot.submarine:
            return "no ArduSub is heard"
        frame, own = known.get("FRAME_CONFIG"), self._helm.sticks_of
        if frame is not None and frame != own.number:
            return f"the autopilot's FRAME_CONFIG is {frame:g}, the vehicle's file is of frame {own.number}"
        if known.get("FS_PILOT_INPUT") == 0.0:
            return f"FS_PILOT_INPUT is off: thrusters would go on when the link breaks; {_ADVICE}"
        if abs(known.get("ACRO_YAW_P", _YAW_GAIN) - _YAW_GAIN) > 0.01 * _YAW_GAIN:
            return f"ACRO_YAW_P is {known['ACRO_YAW_P']:g}, which scales the yaw stick: set it to {_YAW_GAIN}"
        thrust = known.get("JS_THR_GAIN", 1.0)
        if self._way is Way.MANUAL:
            told = self._autopilot.gain
            gain = known.get("JS_GAIN_DEFAULT", math.nan) if math.isnan(told) else told
            if not gain >= _FULL_GAIN or not thrust >= _FULL_GAIN:
                which = f"JS_THR_GAIN is {thrust:g}"
                if not gain >= _FULL_GAIN:
                    which = f"the pilot's gain is {'not told' if math.isnan(gain) else f'{100 * gain:.0f} %'}"
                return f"{which}: set it to 1, or use --drive-by rc, which knows no gain"
        system = known.get("SYSID_MYGCS", known.get("MAV_GCS_SYSID", _GROUND_STATION))
        self._encoder = self._outside.encoder(self._way, int(system), thrust)
        return "" if self._encoder is not None else "no autopilot is known yet"

    def _doubts(self) -> list[str]:
        known = self._outside.parameters()
        timeout = known.get("FS_PILOT_TIMEOUT", math.nan)
        if "FS_PILOT_INPUT" not in known or math.isnan(timeout):
            return [f"FS_PILOT_INPUT is not known: what stops the thrusters when the link breaks? {_ADVICE}"]
        if timeout > _SHORT:
            return [f"FS_PILOT_TIMEOUT is {timeout:g} s: thrusters go on for so long when the link breaks; {_ADVICE}"]
        return []

    # -- step by step

    def step(self) -> None:
        """Do what is due now."""
        with self._lock:
            t = self._now()
            helm = self._helm
            if self.interlock.stage is not Stage.STOPPING:  # which needs to know of nothing
                self._listen()
            seen = self._seen(t)
            task = None if self.interlock.stage in (Stage.OFF, Stage.STOPPING) else self._outside.task(t)
            if task is not None and self.interlock.stage is Stage.DRIVING:
                seen = replace(seen, sticks=helm.sticks(t, task.wrench, task.clock))
            elif task is not None and not task.over and helm.prepare(task.wrench):  # while nothing is sent yet
                seen = replace(seen, sticks=np.zeros(6))
            order = self.interlock.step(seen)
            if order.send is not Send.NOTHING and self._encoder is not None:
                data = self._encoder.neutral() if order.sticks is None else self._encoder.sticks(order.sticks)
                data = self._encoder.release() if order.send is Send.RELEASE else data
                self._outside.send(data)
                self._outside.sent(t, data)
            self._tell_change()

    def _listen(self) -> None:
        """Take what came since the last step."""
        measured, helm = self._measured, self._helm
        while measured.outputs:
            helm.hear(*measured.outputs.popleft())
        while measured.poses:
            helm.see(*measured.poses.popleft())

    def _failed(self, error: Exception) -> None:
        """Stop for an error of the program's own: neutral commands need none of what may be broken."""
        with self._lock:
            self.interlock.fail(f"the drive has failed ({type(error).__name__}: {error})")
            with contextlib.suppress(Exception):
                self._tell_change()

    def _seen(self, t: float) -> Seen:
        pilot, measured = self._autopilot, self._measured
        return Seen(
            t,
            pose=measured.t,
            link=pilot.link,
            beat=pilot.beat,
            outputs=measured.outputs_t,
            key=self._key,
            pressed=self._pressed,
            armed=pilot.armed,
            manual=pilot.manual,
            fault=self._helm.fault() if self.interlock.stage in (Stage.READY, Stage.DRIVING) else "",
        )

    def _tell_change(self) -> None:
        stage, was = self.interlock.stage, self._was
        if stage is was:
            return
        self._was = stage
        why = self.interlock.why
        if stage is Stage.DRIVING:
            self._helm.rest()
            self._outside.happened("drives", "")
        elif stage is Stage.STOPPING:
            self._helm.rest()
            text = f"stopped: {why}" if why else "thrust off at the end of the segment"
            self._outside.happened(text, why)
        elif stage is Stage.OFF and was is Stage.READY:
            self._outside.happened(why, "")
        if stage is Stage.OFF:
            self._measured.let_go()

    @property
    def standing(self) -> Standing:
        """How it stands."""
        with self._lock:
            t, stage = self._now(), self.interlock.stage
            held = t - self._key <= STALE
            on = stage is not Stage.OFF
            return Standing(stage, self.interlock.why, held, self._helm.bent and on, self._helm.walls if on else "")

    # -- as a thread

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + PERIOD, time.monotonic() - PERIOD)
            try:
                self.step()
            except Exception as error:  # whatever it is, thrust must end
                self._failed(error)

    def close(self) -> None:
        """End: thrust off first, where there is any."""
        if self._thread.is_alive():
            self.switch(False)
            deadline = time.monotonic() + 1.0
            while self.interlock.stage is Stage.STOPPING and time.monotonic() < deadline:
                time.sleep(PERIOD)
            self._stop.set()
            self._thread.join()
