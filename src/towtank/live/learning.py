"""The thread that learns: samples in order of time, those of one instant together, into the learner.

Commands that have stopped while motion still comes are not in force for ever. Where a link has lost everything for a
while, commands among it, what the thrusters did meanwhile is not known, and a new stretch begins. The last minute of
what was learned from is kept as a recording: what the model of a session is judged on.

Only the vehicle moving freely in water counts (`recording.grids.online_free_motion`): what is in doubt is held back
until it is decided, at most five seconds, what does not count is not learned from.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from towtank.identification import Estimate, Learner
from towtank.live.events import EventLog, Sight
from towtank.live.pipeline.instants import Instants, Row
from towtank.live.pipeline.lane import Break, Ended, Errands, Gap, Lane
from towtank.live.pipeline.measures import Excitation, Latency
from towtank.live.pipeline.sorter import Arrival, Preference, Sorter
from towtank.live.recording.checkpoint import Checkpoint
from towtank.recording import Recording
from towtank.recording.channel import Channel
from towtank.recording.event import Event
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE, UNCOMMANDED, LeftOut
from towtank.recording.grids.online_free_motion import Decision, OnlineFreeMotion, Standing
from towtank.recording.standard import is_standard, standard_of
from towtank.vehicle import Vehicle

__all__ = ["Follower", "Learning", "Learnt", "Recent", "Row", "Silence", "recording_of"]

_LEAST, _PERIODS = 1.0, 5.0  # s, and usual periods of the commands, without any
_LEAST_LOST = 0.1  # s, and as many periods, without anything at all: some were lost
_FEWEST, _MOST = 10, 50  # periods that show what is usual
_STEADY = 2.0  # times the usual period: nine of ten are shorter, else commands are sent when they change, and hold
_SPAN = 60.0  # s
_MOST_RECENT = 30_000  # instants
_TOGETHER = 1e-6  # s: stamps closer than this are one instant
_BREAK = 2.0  # s without a sample, after which a new stretch begins
_CHECKPOINT = 5.0  # s between two checkpoints
_IDLE = 0.1  # s
_RENEWED = 0.25  # s at most between two looks at what the links say of their samples
_MOST_CUTS = 1000  # stretches left out that are kept
Attributes = Mapping[str, str]


class Silence:
    """Watches the commands, or wrenches, of a session.

    Where they came steadily, and none has come for a second and five of their periods, they are not known any more.
    Commands that are sent only when they change are never missed.

    Attributes:
        since: time of the last commands [s] while they are missed; None while they come.
    """

    def __init__(self) -> None:
        self.since: float | None = None
        self._last: float | None = None
        self._periods: deque[float] = deque(maxlen=_MOST)

    def see(self, t: float, arguments: Mapping[str, Any]) -> Event | None:
        """Take the learner's arguments of time t [s]; return the event where commands have just gone silent."""
        if "commands" in arguments or "wrench" in arguments:
            if self._last is not None and self.since is None and t > self._last:
                self._periods.append(t - self._last)
            self._last, self.since = t, None
            return None
        if self._last is None or self.since is not None:
            return None
        limit = self._limit()
        if limit is None or t - self._last <= limit:
            return None
        self.since = self._last
        text = f"no commands since {self._last:.1f} s while motion comes; learning waits for them"
        return Event(self._last, "occlusion", text, {"measured": "commands", "noticed": t})

    def lost(self, seconds: float) -> bool:
        """Whether commands must have come, and were lost, in a time [s] in which nothing has come at all."""
        limit = self._limit(_LEAST_LOST)
        return limit is not None and seconds > limit

    def forget(self) -> None:
        """Begin a new stretch: nothing is known of what was before, but the usual period."""
        self._last = self.since = None

    def _limit(self, least: float = _LEAST) -> float | None:
        """Return after how long [s] commands are missed; None where they do not come steadily."""
        if len(self._periods) < _FEWEST:
            return None
        ordered = sorted(self._periods)
        usual = ordered[len(ordered) // 2]
        if ordered[int(0.9 * (len(ordered) - 1))] > _STEADY * usual:
            return None
        return max(least, _PERIODS * usual)


class Recent:
    """Keeps the instants of the current stretch, and of the one before while that is the longer one."""

    def __init__(self) -> None:
        self._rows: deque[Row] = deque(maxlen=_MOST_RECENT)
        self._before: deque[Row] = deque()

    def add(self, t: float, sample: Mapping[str, float]) -> None:
        """Take what belongs to one instant."""
        self._rows.append((t, tuple(sample), tuple(sample.values())))
        while t - self._rows[0][0] > _SPAN:
            self._rows.popleft()

    def break_off(self) -> None:
        """Begin a new stretch."""
        if _span(self._rows) >= _span(self._before):
            self._before = self._rows
        self._rows = deque(maxlen=_MOST_RECENT)

    def copy(self) -> Recent:
        """Return what is kept by now, for another thread."""
        out = Recent()
        out._rows, out._before = self._rows.copy(), self._before.copy()
        return out

    def recording(self) -> Recording | None:
        """Return the longer stretch; None where nothing stands in it."""
        longer = max(self._rows, self._before, key=_span)
        return recording_of(longer, "the session's last minute")


def recording_of(rows: Iterable[Row], source: str) -> Recording | None:
    """Return instants as a recording; None where nothing was measured or commanded in them."""
    times: dict[str, list[float]] = {}
    values: dict[str, list[float]] = {}
    for t, names, numbers in rows:
        for name, value in zip(names, numbers, strict=True):
            if is_standard(name) and math.isfinite(value) and not (times.get(name) and t <= times[name][-1]):
                times.setdefault(name, []).append(t)
                values.setdefault(name, []).append(value)
    channels = {}
    for name, own in times.items():
        standard = standard_of(name)
        channels[name] = Channel(name, np.array(own), np.array(values[name]), standard.unit, standard.frame)
    return Recording(channels, source) if channels else None


class Follower(Protocol):
    """Keeps what was learned from."""

    def add(self, t: float, sample: Mapping[str, float]) -> None:
        """Take the channels of an instant; called by the thread that learns, must be quick."""

    def break_off(self) -> None:
        """Begin a new stretch."""


def _span(rows: deque[Row]) -> float:
    return rows[-1][0] - rows[0][0] if rows else 0.0


@dataclass(frozen=True)
class Learnt:
    """Where learning stands.

    Attributes:
        t: of the latest instant learned from [s of the session]. instants: how many.
        estimate: of the coefficients. delay, lag: [s], NaN where the learner has none.
        latency: from datagram to updated estimate [ms]: "median", "p99", "max". processing: without the time for which
            samples are held back.
        excitation: root mean square (6,) of the wrench asked for over ten seconds; empty where none was.
        likely: known configurations and how probable each is, since the last change. remarks: what contradicts it.
        trouble: why learning has stopped, "" where it has not. paused: whether somebody has halted it.
        silent: time [s] of the last commands, where they came steadily and have stopped; None while they come.
        left_out: what is not learned from now, and why, up to the latest instant; None where everything counts.
        cuts: the stretches that were not learned from before.
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
    remarks: tuple[str, ...] = ()
    trouble: str = ""
    paused: bool = False
    silent: float | None = None
    left_out: LeftOut | None = None
    cuts: tuple[LeftOut, ...] = ()

    @property
    def not_learning(self) -> str:
        """Why nothing is learned from now, and since when, in words; "" where something is."""
        cut = self.left_out
        return "" if cut is None else f"{cut.reason} since {int(max(cut.end - cut.start, 0.0))} s"


class Learning:
    """Learns what comes down the lane.

    Args:
        vehicle, learner: what is learned. lane, sorter: where samples come from.
        checkpoint: written every five seconds.
        interval: [s] between two readings of the estimate.
        timed: whether latencies mean anything: not where samples are read as fast as they are learned from.
        events: takes what happens.
        attributes: returns what each link says of its samples, as of a recording.
        keep_all: learn from everything, also where the vehicle does not move freely in water.

    Attributes:
        learner: touched by the learning thread alone while that runs.
        now: where learning stands, renewed every `interval` [s].
        errands: what other threads ask of the learner. recent: what was learned from in the last minute.
        tap: called with time [s] and arguments of every instant, by the learning thread; must be quick.
        listeners: called likewise. followers: keep what is learned from, `recent` first.
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
        attributes: Callable[[], Sequence[Attributes]] = tuple,
        keep_all: bool = False,
    ) -> None:
        self.learner, self.preference = learner, Preference()
        self._lane, self._sorter = lane, sorter
        self._instants, self._excitation = Instants(vehicle), Excitation(vehicle)
        self._checkpoint, self._interval, self._timed = checkpoint, interval, timed
        self._latency, self._processing = Latency(), Latency()
        self._pending: dict[str, float] = {}
        self._pending_t = self._last = self._seen = -math.inf
        self._moments: list[tuple[float, float]] = []  # came, might have gone
        self._taken = 0
        self._resumed = False
        self._trouble = ""
        self._paused = False
        self._events, self._sight = EventLog() if events is None else events, Sight()
        self._silence, self.recent = Silence(), Recent()
        self._water = None if keep_all else OnlineFreeMotion(vehicle)
        self._attributes, self._said, self._renewed = attributes, tuple[Attributes, ...](), -math.inf
        self._held: list[tuple[float, dict[str, float], dict[str, Any]]] = []  # in doubt: not learned from yet
        self._apart = False  # what counts next is not joined to what counted last
        self._left_out: LeftOut | None = None
        self._cuts: deque[LeftOut] = deque(maxlen=_MOST_CUTS)
        self._told = False  # of what is left out now, by an event
        self.errands = Errands()
        self.tap: Callable[[float, Mapping[str, Any]], None] | None = None
        self.listeners: tuple[Callable[[float, Mapping[str, Any]], None], ...] = ()
        self.followers: tuple[Follower, ...] = (self.recent,)
        self.now = self._read_learner()
        self._read = self._saved = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="learning", daemon=True)

    def catch_up(
        self,
        rows: Iterable[Row],
        *,
        since: float = -math.inf,
        inputs: Mapping[str, float] | None = None,
        attributes: Attributes | None = None,
    ) -> None:
        """Learn from what was recorded before; to be called before `start`.

        Args:
            rows: of the recording, later than `since`.
            since: time [s] up to which the learner has learned already. inputs: in force then, and states.
            attributes: of the recording.
        """
        self._last = self._seen = since
        self._said = (attributes or {},)
        self._instants.arguments(inputs or {})
        if self._water is not None and inputs:
            self._water.see(since, inputs, self._said[0])
        for t, names, values in rows:
            sample = dict(zip(names, values, strict=True))
            if self._apart_from_last(t, sample):
                self._break_off()
            self._update(t, sample)
            self.learner.settle()
        self._learn_held()
        self._resumed = math.isfinite(self._last)
        if self._resumed:
            self._events.add(Event(self._last, "resume", f"resumed, {self._taken} instants learned from again"))
        self.now = self._read_learner()

    def start(self) -> None:
        """Begin to learn."""
        self._thread.start()

    def pause(self, paused: bool) -> None:
        """Halt learning, or go on; samples are recorded and shown all the same."""
        if paused != self._paused:
            self._paused = paused
            word = "paused" if paused else "resumed"
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
            self._learn_held()  # what was in doubt to the end has not lasted
            self.learner.settle()
            if self._checkpoint is not None and math.isfinite(self._last):
                self._checkpoint.save(self.learner, self._last, wait=True)
        except Exception as error:  # recording goes on, whatever a learner does
            self._trouble = f"learning has stopped: {type(error).__name__}: {' '.join(str(error).split())}"
        self.now = self._read_learner()
        self.errands.close()
        while more:  # no link waits for a learner that is gone
            more = self._lane.get(_IDLE)[1]

    def _turn(self) -> bool:
        """Take what has come and learn from what is due; return whether more may come."""
        if time.monotonic() - self._renewed >= _RENEWED:
            self._renewed, self._said = time.monotonic(), tuple(self._attributes())
        wait = min(self._sorter.wait(time.monotonic()), _IDLE)
        items, more = self._lane.get(wait)
        self.errands.run()
        for item in items:
            if isinstance(item, Arrival):
                self._sorter.put(item)
            elif isinstance(item, Break):
                self._drain(math.inf)
                if isinstance(item, Gap):
                    text = "learning could not keep up: samples are passed over"
                    self._events.add(Event(max(self._last, 0.0), "overload", text))
                self._break_off()
            elif isinstance(item, Ended):
                self._sorter.ended(item.rank)
        now = time.monotonic()
        self._drain(now)
        if now - self._read >= self._interval:
            self._read = now
            self.now = self._read_learner()
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
            if not self._paused and (self._resumed or self._apart_from_last(self._pending_t, self._pending)):
                self._break_off()
            self._update(self._pending_t, self._pending)
            self._pending = {}
        if self._timed:
            done = time.monotonic()
            for came, ready in self._moments:
                self._latency.add(done - came)
                self._processing.add(done - ready)
        self._moments.clear()

    def _apart_from_last(self, t: float, sample: Mapping[str, float]) -> bool:
        """Whether what came before says nothing of the instant t [s]: not for long, or not what the thrusters did."""
        if t - self._seen > _BREAK:
            return True
        return self._silence.lost(t - self._seen) and not self._instants.goes_on(sample)

    def _update(self, t: float, sample: dict[str, float]) -> None:
        arguments = self._instants.arguments(sample)
        for listener in (self.tap, *self.listeners):
            if listener is not None:
                listener(t, arguments)
        back = self._sight.see(t, arguments)
        if back is not None:
            self._events.add(back)
        counts = Decision() if self._water is None else self._water.see(t, sample, self._of_samples())
        if self._paused:
            self._held.clear()
            self._resumed = True  # a new stretch follows
            return
        if arguments:
            self._seen = t
            gone = self._silence.see(t, arguments)
            if gone is not None:
                self._events.add(gone)
                self._break_off(silent=True)
        if counts.standing is Standing.LEFT_OUT:
            self._leave_out(t, counts)
            return
        if arguments:
            in_force = self._instants.in_force() if self._apart and not self._held else {}
            self._held.append((t, sample, in_force | arguments))
        if counts.standing is Standing.COUNTS:
            self._go_on(self._held[0][0] if self._held else t)  # what was in doubt counts
            self._learn_held()

    def _learn_held(self) -> None:
        """Learn from what was held back, in order; one instant, where nothing was in doubt."""
        for t, sample, arguments in self._held:
            if self._apart:
                self._apart = False
                self._break_followers_off()
                if math.isfinite(self._last):
                    self.learner.restart()
            self.learner.update(t, **arguments)
            self._excitation.see(t, arguments)
            for each in self.followers:
                each.add(t, sample)
            self._last = t
            self._taken += 1
        self._held.clear()

    def _leave_out(self, t: float, counts: Decision) -> None:
        """Pass an instant over, with those that were in doubt before it, and say so once it is worth it."""
        self._held.clear()
        self._apart = True
        now = self._left_out
        if now is None or now.kind != counts.kind:
            start = counts.since if now is None else max(counts.since, now.end)
            self._go_on(start)
            self._left_out = now = LeftOut(min(start, t), t, counts.kind, counts.reason)
        self._left_out = now = replace(now, end=t)
        if not self._told and now.end - now.start >= UNCOMMANDED:
            self._told = True
            details = {"state": "begun", "kind": now.kind, "reason": now.reason}
            self._events.add(Event(now.start, "left out", f"not learning: {now.reason}", details))

    def _go_on(self, t: float) -> None:
        """Take that from t [s] on what was left out is over, if anything was."""
        cut = self._left_out
        if cut is None:
            return
        cut = replace(cut, end=max(t, cut.start))
        if self._told:
            seconds = cut.end - cut.start
            details: dict[str, float | str] = {"state": "over", "kind": cut.kind, "seconds": seconds}
            self._events.add(Event(cut.end, "left out", f"learning again after {seconds:.1f} s: {cut.reason}", details))
            self._cuts.append(cut)
        self._left_out, self._told = None, False

    def _of_samples(self) -> Attributes:
        """Return what the links say of the samples that are learned from, as the attributes of a recording."""
        if not self._said:
            return {}
        modes = next((each["modes"] for each in self._said if "modes" in each), "")
        key, value = DEPTH_BELOW_SURFACE
        source = self.preference.source_of("z") or 0
        by_pressure = source < len(self._said) and self._said[source].get(key) == value
        return {"modes": modes, key: value if by_pressure else ""}

    def _break_off(self, *, silent: bool = False) -> None:
        """Begin a new stretch; which commands are in force is not known any more."""
        self._resumed = self._apart = False
        self._held.clear()
        self._break_followers_off()
        if not silent:
            self._silence.forget()
        if math.isfinite(self._last):
            self.learner.restart()
            self._instants.forget()

    def _break_followers_off(self) -> None:
        for each in self.followers:
            each.break_off()

    def _read_learner(self) -> Learnt:
        learner = self.learner
        self._events.take(learner.events)
        return Learnt(
            t=self._last,
            instants=self._taken,
            estimate=learner.estimate,
            delay=learner.delay,
            lag=learner.lag,
            latency=self._latency.milliseconds(),
            processing=self._processing.milliseconds(),
            excitation=self._excitation.rms,
            likely=learner.likely,
            remarks=learner.remarks,
            trouble=self._trouble,
            paused=self._paused,
            silent=self._silence.since,
            left_out=self._left_out if self._told else None,
            cuts=tuple(self._cuts),
        )
