"""From the session to its viewers, at a steady pace: reads the feed, makes frames, and puts them into mailboxes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.dashboard.course import Course
from towtank.dashboard.feed import Feed, Now
from towtank.dashboard.frames import Kind, encode
from towtank.dashboard.knowledge import axes_known
from towtank.dashboard.mailbox import Mailbox
from towtank.dashboard.motion import Motion
from towtank.dashboard.prediction import SECONDS, FreeRun, free_run
from towtank.dashboard.standing import events_document, greeting, state_document
from towtank.identification import Estimate
from towtank.recording.event import Event

__all__ = ["VIEWERS", "Pump"]

VIEWERS = 16  # at once
_TICK = 0.05  # s between two batches of signals
_STATE = 0.25  # s between two states, points of the convergence and free runs
_SHOWN = 20.0  # s of signals that a new viewer gets
_EVENTS = 200  # that are shown
_TOP = 98.0  # percentile of the speeds that counts as the largest: a jump of a marker is none


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
        self._motion = Motion(feed.about.vehicle)
        self._about = feed.about
        self._names: tuple[str, ...] = ()
        self._units: dict[str, str] = {}
        self._course = Course(0, step=_STATE)
        self._track = Course(3, step=0.5)
        self._events: tuple[Event, ...] = ()
        self._speeds = np.zeros(6)
        self._pose = np.full(6, np.nan)
        self._run: FreeRun | None = None
        self._prediction = b""
        self._told = "{}"
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
        if len(self._course):
            box.put(encode(Kind.COEFFICIENTS, self._course.t, self._course.rows))
        if len(self._track):
            box.put(encode(Kind.TRACK, self._track.t, self._track.rows))
        t, rows = self._motion.last(_SHOWN)
        if t.size:
            box.put(encode(Kind.SIGNALS, t, rows))
        if self._prediction:
            box.replace("prediction", self._prediction)
        box.replace("events", self._told)
        box.replace("state", self.state)
        self._boxes.add(box)

    def leave(self, box: Mailbox) -> None:
        """Take a viewer out."""
        self._boxes.discard(box)

    async def run(self) -> None:
        """Go on until cancelled; what fails is told and tried again."""
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
        t, rows = self._motion.last(SECONDS)
        vehicle, estimate = self._feed.about.vehicle, now.estimate
        run = await asyncio.to_thread(free_run, vehicle, estimate, now.delay, t.copy(), rows.copy())
        if run is None:
            return
        self._run = run
        with np.errstate(all="ignore"):
            seen = np.abs(np.where(np.isfinite(run.measured), run.measured, 0.0))
        self._speeds = np.maximum(self._speeds, np.percentile(seen, _TOP, axis=0))
        self._prediction = encode(Kind.PREDICTION, run.t, np.hstack([run.measured, run.predicted]), self._sequence)
        for box in self._boxes:
            box.replace("prediction", self._prediction)

    def _stand(self, now: Now) -> None:
        self._learnt(now)
        axes = axes_known(now.estimate, tuple(self._speeds), now.excitation)
        page = {**self._page(), "viewers": self.viewers, "skipped": self.skipped}
        document = state_document(
            now, axes, self._run, tuple(self._pose), sequence=self._sequence, page=page, ended=self.ended
        )
        events = now.events[-_EVENTS:]
        if events != self._events or self._told == "{}":
            self._events = events
            self._told = json.dumps(events_document(events))
            self._place("events", self._told)
        self.state = json.dumps({**document, "events": events_document(events)["events"]}, allow_nan=False)
        self._place("state", json.dumps(document, allow_nan=False))

    def _learnt(self, now: Now) -> None:
        """Add a point to the convergence; the names are known from the first estimate on, and may grow."""
        estimate: Estimate = now.estimate
        if estimate.names != self._names:
            self._names = estimate.names
            self._units = {each.name: each.unit for each in estimate.coefficients}
            self._course = Course(2 * len(self._names), step=_STATE)
            self._place("hello", json.dumps(self._greeting()))
        elif self._feed.about is not self._about:
            self._place("hello", json.dumps(self._greeting()))
        self._about = self._feed.about
        identified = np.array(estimate.identified, dtype=bool)
        row = np.concatenate(
            [np.where(identified, estimate.values, np.nan), np.where(identified, estimate.std, np.nan)]
        )
        if np.isfinite(now.t) and self._course.add(now.t, row):
            self._send(encode(Kind.COEFFICIENTS, np.array([now.t]), row[None], self._sequence))

    def _send(self, frame: bytes) -> None:
        for box in self._boxes:
            box.put(frame)

    def _place(self, place: str, text: str) -> None:
        for box in self._boxes:
            box.replace(place, text)
