"""The thread that learns: samples in order of time, those of one instant together, into the learner."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from towtank.identification import Estimate, Learner
from towtank.live.checkpoint import Checkpoint
from towtank.live.errands import Errands
from towtank.live.events import EventLog, Sight
from towtank.live.excitation import Excitation
from towtank.live.instants import Instants
from towtank.live.lane import Ended, Gap, Lane
from towtank.live.latency import Latency
from towtank.live.preference import Preference
from towtank.live.recent import Recent
from towtank.live.recorded import Row
from towtank.live.silence import Silence
from towtank.live.sorter import Arrival, Sorter
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["Learning", "Learnt"]

_TOGETHER = 1e-6  # s: stamps closer than this are one instant
_BREAK = 2.0  # s without a sample, after which a new stretch begins
_CHECKPOINT = 5.0  # s between two checkpoints
_IDLE = 0.1  # s


@dataclass(frozen=True)
class Learnt:
    """Where learning stands.

    Attributes:
        t: of the latest instant learned from [s of the session]. instants: how many.
        estimate: of the coefficients. delay, lag: [s], NaN where the learner has none.
        latency: from datagram to updated estimate [ms]: "median", "p99", "max". processing: without the time for which
            samples are held back.
        excitation: root mean square (6,) of the wrench asked for over ten seconds; empty where none was.
        likely: known configurations and how probable each is, since the last change.
        trouble: why learning has stopped, "" where it has not. paused: whether somebody has halted it.
        silent: time [s] of the last commands, where they came steadily and have stopped; None while they come.
    """

    t: float
    instants: int
    estimate: Estimate
    delay: float
    lag: float
    latency: dict[str, float]
    processing: dict[str, float]
    excitation: tuple[float, ...]
    likely: Mapping[str, float] = field(default_factory=dict)
    trouble: str = ""
    paused: bool = False
    silent: float | None = None


class Learning:
    """Learns what comes down the lane.

    Args:
        vehicle, learner: what is learned. lane, sorter: where samples come from.
        checkpoint: written every five seconds.
        interval: [s] between two readings of the estimate.
        timed: whether latencies mean anything: not where samples are read as fast as they are learned from.
        events: takes what happens.

    Attributes:
        learner: touched by the learning thread alone while that runs.
        now: where learning stands, renewed every `interval` [s].
        errands: what other threads ask of the learner. recent: what was learned from in the last minute.
        tap: called with time [s] and arguments of every instant, by the learning thread; must be quick.
        listeners: called likewise.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        learner: Learner,
        lane: Lane,
        sorter: Sorter,
        *,
        checkpoint: Checkpoint | None = None,
        interval: float = 0.25,
        timed: bool = True,
        events: EventLog | None = None,
    ) -> None:
        self.learner, self.preference = learner, Preference()
        self._lane, self._sorter = lane, sorter
        self._instants, self._excitation = Instants(vehicle), Excitation(vehicle)
        self._checkpoint, self._interval, self._timed = checkpoint, interval, timed
        self._latency, self._processing = Latency(), Latency()
        self._pending: dict[str, float] = {}
        self._pending_t = self._last = -math.inf
        self._moments: list[tuple[float, float]] = []  # came, might have gone
        self._taken = 0
        self._resumed = False
        self._trouble = ""
        self._paused = False
        self._events, self._sight = EventLog() if events is None else events, Sight()
        self._silence, self.recent = Silence(), Recent()
        self.errands = Errands()
        self.tap: Callable[[float, Mapping[str, Any]], None] | None = None
        self.listeners: tuple[Callable[[float, Mapping[str, Any]], None], ...] = ()
        self.now = self._standing()
        self._read = self._saved = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="learning", daemon=True)

    def catch_up(
        self, rows: Iterable[Row], *, since: float = -math.inf, inputs: Mapping[str, float] | None = None
    ) -> None:
        """Learn from what was recorded before; to be called before `start`.

        Args:
            rows: of the recording, later than `since`.
            since: time [s] up to which the learner has learned already. inputs: in force then.
        """
        self._last = since
        self._instants.arguments(inputs or {})
        for t, names, values in rows:
            if t - self._last > _BREAK:
                self._break_off()
            self._update(t, dict(zip(names, values, strict=True)))
            self.learner.settle()
        self._resumed = math.isfinite(self._last)
        if self._resumed:
            self._events.add(Event(self._last, "resume", f"gone on with, {self._taken} instants learned from again"))
        self.now = self._standing()

    def start(self) -> None:
        """Begin to learn."""
        self._thread.start()

    def pause(self, paused: bool) -> None:
        """Halt learning, or go on; samples are recorded and shown all the same."""
        if paused != self._paused:
            self._paused = paused
            word = "paused" if paused else "gone on with"
            self._events.add(Event(max(self._pending_t, 0.0), "mark", f"learning {word}"))

    def join(self) -> None:
        """Wait until everything in the lane is learned from; the lane must be closed."""
        self._thread.join()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def _run(self) -> None:
        more = True
        try:
            while more:
                more = self._turn()
            self._drain(math.inf)
            self.learner.settle()
            if self._checkpoint is not None and math.isfinite(self._last):
                self._checkpoint.save(self.learner, self._last, wait=True)
        except Exception as error:  # recording goes on, whatever a learner does
            self._trouble = f"learning has stopped: {type(error).__name__}: {' '.join(str(error).split())}"
        self.now = self._standing()
        self.errands.close()
        while more:  # no link waits for a learner that is gone
            more = self._lane.get(_IDLE)[1]

    def _turn(self) -> bool:
        """Take what has come and learn from what is due; return whether more may come."""
        wait = min(self._sorter.wait(time.monotonic()), _IDLE)
        items, more = self._lane.get(wait)
        self.errands.run()
        for item in items:
            if isinstance(item, Arrival):
                self._sorter.put(item)
            elif isinstance(item, Gap):
                self._drain(math.inf)
                text = "learning could not keep up: samples are passed over"
                self._events.add(Event(max(self._last, 0.0), "overload", text))
                self._break_off()
            elif isinstance(item, Ended):
                self._sorter.ended(item.rank)
        now = time.monotonic()
        self._drain(now)
        if now - self._read >= self._interval:
            self._read = now
            self.now = self._standing()
        if self._checkpoint is not None and now - self._saved >= _CHECKPOINT and math.isfinite(self._last):
            self._saved = now
            self._checkpoint.save(self.learner, self._last)
        return more

    def _drain(self, now: float) -> None:
        for arrival, ready in self._sorter.ready(now):
            if arrival.t - self._pending_t > _TOGETHER:
                self._flush()
                self._pending_t = arrival.t
            for name, value in self.preference.taken(arrival).items():
                if value == value:
                    self._pending[name] = value
            self._moments.append((arrival.came, ready))
        self._flush()

    def _flush(self) -> None:
        """Learn from the instant that is put together."""
        if self._pending:
            if not self._paused and (self._resumed or self._pending_t - self._last > _BREAK):
                self._break_off()
            self._update(self._pending_t, self._pending)
            self._pending = {}
        if self._timed:
            done = time.monotonic()
            for came, ready in self._moments:
                self._latency.add(done - came)
                self._processing.add(done - ready)
        self._moments.clear()

    def _update(self, t: float, sample: dict[str, float]) -> None:
        arguments = self._instants.arguments(sample)
        for listener in (self.tap, *self.listeners):
            if listener is not None:
                listener(t, arguments)
        back = self._sight.see(t, arguments)
        if back is not None:
            self._events.add(back)
        if self._paused:
            self._resumed = True  # a new stretch follows
        elif arguments:
            gone = self._silence.see(t, arguments)
            if gone is not None:
                self._events.add(gone)
                self._break_off(silent=True)
            self.learner.update(t, **arguments)
            self._excitation.see(t, arguments)
            self.recent.add(t, sample)
            self._last = t
            self._taken += 1

    def _break_off(self, *, silent: bool = False) -> None:
        """Begin a new stretch; which commands are in force is not known any more."""
        self._resumed = False
        self.recent.break_off()
        if not silent:
            self._silence.forget()
        if math.isfinite(self._last):
            self.learner.restart()
            self._instants.forget()

    def _standing(self) -> Learnt:
        learner = self.learner
        self._events.take(getattr(learner, "events", ()))
        return Learnt(
            t=self._last,
            instants=self._taken,
            estimate=learner.estimate,
            delay=float(getattr(learner, "delay", math.nan)),
            lag=float(getattr(learner, "lag", math.nan)),
            latency=self._latency.milliseconds(),
            processing=self._processing.milliseconds(),
            excitation=self._excitation.rms,
            likely=getattr(learner, "likely", {}),
            trouble=self._trouble,
            paused=self._paused,
            silent=self._silence.since,
        )
