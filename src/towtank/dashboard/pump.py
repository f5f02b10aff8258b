"""From the session to its viewers, at a steady pace: reads the feed, makes frames, and puts them into mailboxes.

Numbers go through the socket in binary frames, everything else as JSON (docs/design/page.md). Both sides are bounded:
numbers over hours lose every second row where there is no room, and a viewer that is slow misses older frames.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
import time
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.dashboard.feed import Feed, Now
from towtank.dashboard.prediction import Prediction
from towtank.dashboard.state import events_message, greeting, state_document
from towtank.dashboard.verdict import axes_known
from towtank.identification import Estimate
from towtank.recording.event import Event

__all__ = ["HEADER", "VERSION", "VIEWERS", "Kind", "Mailbox", "Pump", "Thinned", "decode", "encode"]

VERSION = 1
HEADER = struct.Struct("<BBHIII")  # version, kind, columns, rows, sequence, nothing
_ROOM = 40  # frames of a stream: two seconds of signals
VIEWERS = 16  # at once
_TICK = 0.05  # s between two batches of signals
_STATE = 0.25  # s between two states, points of the convergence and free runs
_SHOWN = 20.0  # s of signals that a new viewer gets
_EVENTS = 200  # that are shown


class Thinned:
    """Rows over time, at most `most` of them.

    Attributes:
        step: least time [s] between two rows; it doubles whenever the room is full.
    """

    def __init__(self, width: int, *, step: float, most: int = 2048) -> None:
        self.step = step
        self._t, self._rows, self._count = np.empty(most), np.empty((most, width), dtype=np.float32), 0

    def __len__(self) -> int:
        return self._count

    def add(self, t: float, row: Array) -> bool:
        """Take a row of time t [s] unless the last one is nearer than `step`; return whether it was taken."""
        if self._count and not t - self._t[self._count - 1] >= self.step:
            return False
        if self._count == self._t.size:
            half = self._t[::2].size
            self._t[:half], self._rows[:half] = self._t[::2].copy(), self._rows[::2].copy()
            self._count, self.step = half, 2.0 * self.step
        self._t[self._count], self._rows[self._count] = t, row
        self._count += 1
        return True

    def of_columns(self, source: NDArray[np.intp]) -> Thinned:
        """Return the same times with columns put together anew; NaN where `source` (width,) is negative."""
        out = Thinned(source.size, step=self.step, most=self._t.size)
        out._t[:], out._count = self._t, self._count
        old = np.column_stack([self._rows, np.full(len(self._rows), np.nan, dtype=np.float32)])
        out._rows[:] = old[:, source]
        return out

    @property
    def t(self) -> Array:
        """Times (n,) [s]."""
        return self._t[: self._count]

    @property
    def rows(self) -> Array:
        """Values (n, width), single precision."""
        return self._rows[: self._count].astype(np.float64)


class Kind(IntEnum):
    """What a frame holds."""

    SIGNALS = 1  # rows to append: the columns of "signals" in the greeting
    COEFFICIENTS = 2  # rows to append: values, then deviations, of "coefficients" in the greeting
    PREDICTION = 3  # rows to replace: u .. r measured, u .. r predicted
    TRACK = 4  # rows to append: x, y, z [m]


def encode(kind: Kind, t: Array, values: Array, sequence: int = 0) -> bytes:
    """Return a frame of times (n,) [s] and values (n, m): header, n Float64, then m columns of n Float32."""
    rows, columns = values.shape
    head = HEADER.pack(VERSION, kind, columns, rows, sequence & 0xFFFFFFFF, 0)
    return head + t.astype("<f8").tobytes() + np.ascontiguousarray(values.T, dtype="<f4").tobytes()


def decode(frame: bytes) -> tuple[Kind, int, Array, Array]:
    """Return kind, sequence, times (n,) and values (n, m) of a frame."""
    version, kind, columns, rows, sequence, _ = HEADER.unpack_from(frame)
    if version != VERSION or len(frame) != HEADER.size + 8 * rows + 4 * rows * columns:
        raise ValueError(f"not a frame: version {version}, {rows} rows, {columns} columns, {len(frame)} bytes")
    t = np.frombuffer(frame, "<f8", rows, HEADER.size)
    values = np.frombuffer(frame, "<f4", rows * columns, HEADER.size + 8 * rows).reshape(columns, rows).T
    return Kind(kind), sequence, t, values.astype(np.float64)


class Mailbox:
    """Frames for one viewer; used within one event loop.

    A frame put in a *place* replaces the one that waits there; others queue, and the oldest is given up when there is
    no room.

    Attributes:
        skipped: frames given up.
    """

    def __init__(self, room: int = _ROOM) -> None:
        self.skipped = 0
        self._places: dict[str, str | bytes] = {}
        self._queue: deque[bytes] = deque()
        self._room = room
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._places) + len(self._queue)

    def put(self, frame: bytes) -> None:
        """Queue a frame."""
        if len(self._queue) >= self._room:
            self._queue.popleft()
            self.skipped += 1
        self._queue.append(frame)
        self._filled.set()

    def replace(self, place: str, frame: str | bytes) -> None:
        """Put a frame where only the newest counts."""
        if place in self._places:
            self.skipped += 1
        self._places[place] = frame
        self._filled.set()

    async def next(self) -> str | bytes:
        """Return what is to be sent next, once there is something."""
        while not self._places and not self._queue:
            self._filled.clear()
            await self._filled.wait()
        if self._places:
            return self._places.pop(next(iter(self._places)))
        return self._queue.popleft()


class Pump:
    """What all viewers see; lives in the page's event loop.

    Args:
        feed: the session. session: its name, so that a page notices a new one. report: whether there is one.
        page: returns what the page says of itself.

    Attributes:
        state: the latest, as JSON. ended: whether the session has.
    """

    def __init__(self, feed: Feed, session: str, *, report: bool, page: Callable[[], dict[str, Any]]) -> None:
        self._feed, self._page = feed, page
        self._session, self._report = session, report
        self._prediction = Prediction(feed.about.vehicle)
        self._motion = self._prediction.motion
        self._about = feed.about
        self._names: tuple[str, ...] = ()
        self._units: dict[str, str] = {}
        self._history = Thinned(0, step=_STATE)
        self._track = Thinned(3, step=0.5)
        self._events: tuple[Event, ...] = ()
        self._pose = np.full(6, np.nan)
        self._predicted = b""
        self._events_text = "{}"
        self._sequence = 0
        self._boxes: set[Mailbox] = set()
        self._next_state = 0.0
        self.state, self.ended, self.trouble = "{}", False, ""

    @property
    def viewers(self) -> int:
        """How many look."""
        return len(self._boxes)

    @property
    def skipped(self) -> int:
        """Frames that were given up for the viewers of now."""
        return sum(box.skipped for box in self._boxes)

    @property
    def recording(self) -> Any:
        """The session's own recording."""
        return self._feed.now().recording

    def join(self, box: Mailbox) -> None:
        """Add a viewer: names first, then all that was."""
        box.replace("hello", json.dumps(self._greeting()))
        if len(self._history):
            box.put(encode(Kind.COEFFICIENTS, self._history.t, self._history.rows))
        if len(self._track):
            box.put(encode(Kind.TRACK, self._track.t, self._track.rows))
        t, rows = self._motion.last(_SHOWN)
        if t.size:
            box.put(encode(Kind.SIGNALS, t, rows))
        if self._predicted:
            box.replace("prediction", self._predicted)
        box.replace("events", self._events_text)
        box.replace("state", self.state)
        self._boxes.add(box)

    def leave(self, box: Mailbox) -> None:
        """Take a viewer out."""
        self._boxes.discard(box)

    async def run(self) -> None:
        """Go on until cancelled; what fails is shown and tried again."""
        due = time.monotonic()
        while True:
            try:
                await self.turn()
                self.trouble = ""
            except Exception as error:  # the page must not end because of one number
                self.trouble = f"page: {type(error).__name__}: {' '.join(str(error).split())}"
            due = max(due + _TICK, time.monotonic())
            await asyncio.sleep(max(due - time.monotonic(), 0.005))

    async def turn(self) -> None:
        """Hand on what came since the last turn, and from time to time where the session stands."""
        self._sequence += 1
        t, rows = self._motion.add(self._feed.taken())
        if t.size:
            self._see(t, rows)
            self._send(encode(Kind.SIGNALS, t, rows, self._sequence))
        if time.monotonic() >= self._next_state:
            self._next_state = time.monotonic() + _STATE
            now = self._feed.now()
            await self._predict(now)
            self._stand(now)

    async def end(self) -> None:
        """Say that the session has ended; give viewers a moment to hear of it."""
        self.ended = True
        with contextlib.suppress(Exception):
            self._stand(self._feed.now())
        for _ in range(20):
            if not any(len(box) for box in self._boxes):
                return
            await asyncio.sleep(0.02)

    def _greeting(self) -> dict[str, Any]:
        return greeting(self._feed.about, self._names, self._units, self._session, report=self._report)

    def _see(self, t: Array, rows: Array) -> None:
        """Take the pose along, and the track."""
        for row in rows:
            np.copyto(self._pose, row[:6], where=np.isfinite(row[:6]))
        known = np.flatnonzero(np.isfinite(rows[:, :2]).all(axis=1))
        if known.size and self._track.add(float(t[known[-1]]), rows[known[-1], :3]):
            self._send(encode(Kind.TRACK, t[known[-1] :][:1], rows[known[-1] :][:1, :3], self._sequence))

    async def _predict(self, now: Now) -> None:
        if now.silent is not None:  # the last seconds are over: what was predicted of them says nothing of now
            return
        renew = self._prediction.renew
        run = await asyncio.to_thread(renew, self._feed.about.vehicle, now.estimate, now.delay)
        if run is None:
            return
        self._predicted = encode(Kind.PREDICTION, run.t, np.hstack([run.measured, run.predicted]), self._sequence)
        for box in self._boxes:
            box.replace("prediction", self._predicted)

    def _stand(self, now: Now) -> None:
        self._learnt(now)
        speeds, vehicle = tuple(self._prediction.speeds), self._feed.about.vehicle
        axes = axes_known(now.estimate, speeds, now.excitation, vehicle)
        page = {**self._page(), "viewers": self.viewers, "skipped": self.skipped}
        document = state_document(
            now, axes, self._prediction.run, tuple(self._pose), sequence=self._sequence, page=page, ended=self.ended
        )
        events = now.events[-_EVENTS:]
        if events != self._events or self._events_text == "{}":
            self._events = events
            self._events_text = json.dumps(events_message(events))
            self._place("events", self._events_text)
        self.state = json.dumps({**document, "events": events_message(events)["events"]}, allow_nan=False)
        self._place("state", json.dumps(document, allow_nan=False))

    def _learnt(self, now: Now) -> None:
        """Add a point to the convergence; the names are known from the first estimate on, and may grow."""
        estimate: Estimate = now.estimate
        if estimate.names != self._names:
            known = {name: k for k, name in enumerate(self._names)}
            source = np.array([known.get(name, -1) for name in estimate.names], dtype=np.intp)
            second = np.where(source >= 0, source + len(known), -1)  # deviations stand behind values
            self._history = self._history.of_columns(np.concatenate([source, second]))
            self._names = estimate.names
            self._units = {each.name: each.unit for each in estimate.coefficients}
            self._place("hello", json.dumps(self._greeting()))
            if len(self._history):
                self._send(encode(Kind.COEFFICIENTS, self._history.t, self._history.rows, self._sequence))
        elif self._feed.about is not self._about:
            self._place("hello", json.dumps(self._greeting()))
        self._about = self._feed.about
        identified = np.array(estimate.identified, dtype=bool)
        row = np.concatenate(
            [np.where(identified, estimate.values, np.nan), np.where(identified, estimate.std, np.nan)]
        )
        if np.isfinite(now.t) and self._history.add(now.t, row):
            self._send(encode(Kind.COEFFICIENTS, np.array([now.t]), row[None], self._sequence))

    def _send(self, frame: bytes) -> None:
        for box in self._boxes:
            box.put(frame)

    def _place(self, place: str, text: str) -> None:
        for box in self._boxes:
            box.replace(place, text)
