"""A live session: a thread reads each link, one records, one learns, and none of them waits for another."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from towtank.digits import some_of
from towtank.identification import Learner
from towtank.live.events import EventLog
from towtank.live.learning import Learning
from towtank.live.links.source import Raw, Sample, Source
from towtank.live.pipeline.clock import HostClock, SourceClock, steady_time
from towtank.live.pipeline.hearing import Hearing, no_data
from towtank.live.pipeline.lane import Lane
from towtank.live.pipeline.sorter import Arrival, Sorter
from towtank.live.recording.checkpoint import Checkpoint
from towtank.live.recording.messages import Kept
from towtank.live.recording.recorder import Disk, Recorder, RecordingState
from towtank.live.status import SourceStatus, Status
from towtank.recording.event import Event
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE
from towtank.recording.mcap.log import McapLog
from towtank.recording.standard import COMMAND_PREFIX, STATES, is_command, is_standard
from towtank.vehicle import Vehicle

__all__ = ["CommandNames", "Session"]

_MOST, _LONGEST = 20, 60  # names that are shown, and their characters
_NAMED = 5  # of them in one warning
_READ = 0.1  # s for which a link is waited for
_SETTLING = 1.5  # s that samples wait at most for their source's clock
_ROOM = 20_000  # samples that wait to be learned from
_LISTENED = 0.25  # s at most between two looks at whether links are lost
_ENOUGH = 30.0  # s that are waited for what is left to learn from at the end


class CommandNames:
    """Renames cmd_1, cmd_2, ... in the order of the vehicle's thrusters; commands by name stay.

    Attributes:
        foreign: channels that are none of the vehicle's, or not standard ones: they are passed over.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        own = [each.name for each in vehicle.thrusters]
        self._known = {f"{COMMAND_PREFIX}{k}": f"{COMMAND_PREFIX}{name}" for k, name in enumerate(own, 1)}
        self._known |= {f"{COMMAND_PREFIX}{name}": f"{COMMAND_PREFIX}{name}" for name in own}
        self._any = not own
        self._bound: dict[tuple[str, ...], tuple[str, ...]] = {}  # names -> the vehicle's, "" where passed over
        self.foreign: dict[str, None] = {}

    def bound(self, sample: Sample) -> Sample:
        """Return the sample with the vehicle's names."""
        names = self._bound.get(sample.names)
        if names is None:
            names = tuple(self._own(name) for name in sample.names)
            if len(self._bound) < 1000:
                self._bound[sample.names] = names
        if names == sample.names:
            return sample
        kept = [(name, value) for name, value in zip(names, sample.values, strict=True) if name]
        return replace(sample, names=tuple(name for name, _ in kept), values=tuple(value for _, value in kept))

    def _own(self, name: str) -> str:
        found = self._known.get(name, "") if is_command(name) and not self._any else name if _is_kept(name) else ""
        if not found and len(self.foreign) < _MOST:
            self.foreign.setdefault(ascii(name[:_LONGEST])[1:-1])  # it will stand on a terminal
        return found


def _is_kept(name: str) -> bool:
    """True for channels of a vehicle, and for what its autopilot says of itself."""
    return is_standard(name) or name in STATES


def _of_states(sample: Sample) -> bool:
    """Whether a sample tells of the autopilot alone: nothing to learn from, as heartbeats are."""
    return all(name in STATES for name in sample.names)


class _Early(NamedTuple):
    """A sample, the moment it came, and its time [s of the session]; NaN until the clock of its source has settled."""

    sample: Sample
    moment: float
    t: float


class Session:
    """Puts links, recording and learner together.

    Args:
        sources: each with its text, in order of preference where several measure the same.
        vehicle, learner: what is learned.
        epoch: Unix time [s] at which the session's time is 0.
        window: for which samples are held back so that late ones find their place [s].
        log: to record to. checkpoint: beside it.
        room: samples that may wait to be learned from.
        interval: [s] between two readings of the estimate.
        keep_all: learn from everything, also where the vehicle does not move freely in water.

    Attributes:
        epoch: as above. taps: called with the samples of a link as they come, by its thread, before they are sorted.
        before_end: called when the session ends, before its links are closed.
    """

    def __init__(
        self,
        sources: Sequence[tuple[str, Source]],
        vehicle: Vehicle,
        learner: Learner,
        *,
        epoch: float,
        window: float = 0.1,
        log: McapLog | None = None,
        checkpoint: Checkpoint | None = None,
        room: int = _ROOM,
        interval: float = 0.25,
        keep_all: bool = False,
    ) -> None:
        self._sources = tuple(sources)
        self._epoch = self.epoch = epoch
        self.taps: tuple[Callable[[Sequence[Arrival]], None], ...] = ()
        self.before_end: tuple[Callable[[], None], ...] = ()
        self._patient = all(source.patient for _, source in sources)
        self._clocks = tuple(SourceClock(keeps_time=source.keeps_time) for _, source in sources)
        self._commands = tuple(CommandNames(vehicle) for _ in sources)
        self._hearings = tuple(Hearing(text) for text, _ in sources)
        self._counts = [0] * len(self._sources)
        self._faults: dict[int, str] = {}
        self._newest, self._came = -math.inf, 0.0  # time of the newest sample, and when it came
        self._lane = Lane(room)
        self._sorter = Sorter(window, len(self._sources), patient=self._patient)
        self._recorder = None if log is None else Recorder(log)
        self._host = HostClock()
        self._checkpoint = checkpoint
        self.events = EventLog(None if self._recorder is None else self._recorder.put_event)
        self._disk = None if self._recorder is None else Disk(self._recorder)
        self.learning = Learning(
            vehicle,
            learner,
            self._lane,
            self._sorter,
            checkpoint=checkpoint,
            interval=interval,
            timed=not self._patient,
            events=self.events,
            attributes=lambda: [source.state().attributes for _, source in self._sources],
            keep_all=keep_all,
        )
        self._deep = [False] * len(self._sources)  # which have sent a depth
        self._described: dict[str, str] = {}
        self._stop = threading.Event()
        self._ended = False  # everything that came is learned from and recorded
        self._began = time.monotonic()
        self._first = self._longest = math.inf
        self._threads = [
            threading.Thread(target=self._follow, args=(rank,), name=f"link {text}", daemon=True)
            for rank, (text, _) in enumerate(self._sources)
        ]

    def open(self) -> None:
        """Open every link. Raises InputError, and then none is open."""
        opened: list[Source] = []
        try:
            for _, source in self._sources:
                source.open()
                opened.append(source)
        except BaseException:
            for source in opened:
                source.close()
            raise

    def run(
        self,
        stop: threading.Event,
        *,
        seconds: float | None = None,
        show: Callable[[Status], None] | None = None,
        period: float = 0.25,
    ) -> Status:
        """Run until `stop` is set, `seconds` have passed or every link has ended; return how it ended.

        Args:
            seconds: of the clock, or of the samples' own time where that is ahead of it.
            show: called every `period` [s] of the clock with how things stand.
        """
        self._began = time.monotonic()
        self._longest = math.inf if seconds is None or not self._patient else seconds
        if self._recorder is not None:
            kept = Kept(self._recorder.put_text, lambda: self.learning.now, self._epoch)
            self.learning.listeners += (kept.see,)
            self._recorder.start()
        self.learning.start()
        for hearing in self._hearings:
            hearing.begin()
        for thread in self._threads:
            thread.start()
        due = time.monotonic() + period
        try:
            while not stop.wait(min(period, 0.05 if self._patient else _LISTENED)):
                self._listen()
                if show is not None and (self._patient or time.monotonic() >= due):
                    due = time.monotonic() + period
                    show(self.status())
                if not any(thread.is_alive() for thread in self._threads):
                    break
                if seconds is not None and self._passed >= seconds:
                    break
        finally:
            self._finish()
        return self.status()

    def status(self) -> Status:
        """Return where the session stands."""
        sources = tuple(self._source_status(rank) for rank in range(len(self._sources)))
        recording = None if self._recorder is None else self._recorder.state()
        return Status(
            elapsed=time.monotonic() - self._began,
            learnt=self.learning.now,
            sources=sources,
            recording=recording,
            dropped=self._lane.dropped,
            gaps=self._lane.gaps,
            late=self._sorter.late + sum(each.state.late for each in sources),
            waiting=len(self._lane) + len(self._sorter),
            doubled=tuple(self.learning.preference.doubled),
            warnings=self._warnings(recording, sources),
            events=self.events.all,
            epoch=math.nan if self._patient else self._epoch,
            ending=self._stop.is_set() and not self._ended,
            ended=self._ended,
        )

    def mark(self, text: str) -> None:
        """Add an event of somebody's own to the session and its recording."""
        self.events.add(Event(max(self._newest, 0.0), "mark", text))

    def keep(self, t: float, sent: Raw) -> None:
        """Record what was sent at time t [s of the session]; nothing where nothing is recorded."""
        if self._recorder is not None:
            self._recorder.put([], [(t, sent)])

    @property
    def t(self) -> float:
        """The session's time now [s]: it goes on from the newest sample by the clock, unless links are patient."""
        return self._newest if self._patient else self._newest + (time.monotonic() - self._came)

    @property
    def _passed(self) -> float:
        return max(time.monotonic() - self._began, self._newest - self._first)

    def _source_status(self, rank: int) -> SourceStatus:
        (text, source), clock = self._sources[rank], self._clocks[rank]
        state = source.state()
        over = self._stop.is_set() or source.patient or state.ended
        silent = None if over else self._hearings[rank].silent()
        return SourceStatus(text, state, self._counts[rank], clock.strange, clock.offset, clock.drift, silent)

    def _listen(self) -> None:
        """Add the events of links that are lost, and of those that are back."""
        for (_, source), hearing in zip(self._sources, self._hearings, strict=True):
            event = None if source.patient or source.state().ended else hearing.notice()
            if event is not None:
                self.events.add(event)
        self._describe()

        set_by = self._host.stepped()
        if set_by:
            way = "forward" if set_by > 0.0 else "back"
            text = f"this computer's clock was set {way} by {abs(set_by):.0f} s; the session's times go on as before"
            self.events.add(Event(max(self._newest, 0.0), "clock", text, {"seconds": set_by}))
        self._notice_disk()

    def _notice_disk(self) -> None:
        for event in () if self._disk is None else self._disk.notice(max(self._newest, 0.0)):
            self.events.add(event)

    def _describe(self) -> None:
        """Let the recording say what the links say of their samples, for whoever reads it as a log."""
        said = [source.state().attributes for _, source in self._sources]
        modes = next((each["modes"] for each in said if "modes" in each), "")
        found = {"modes": modes} if modes else {}
        key, value = DEPTH_BELOW_SURFACE
        of_depth = [each.get(key) for each, deep in zip(said, self._deep, strict=True) if deep]
        if of_depth and all(each == value for each in of_depth):
            found[key] = value
        if self._recorder is not None and found != self._described:
            no_longer = dict.fromkeys(self._described.keys() - found.keys())
            self._described = found
            self._recorder.put_attributes({**no_longer, **found})

    def _warnings(self, recording: RecordingState | None, sources: Sequence[SourceStatus]) -> tuple[str, ...]:
        found = [text for text in (self.learning.now.trouble, *self._faults.values()) if text]
        if any(each.silent is None for each in sources):  # else the whole state says it
            found += [f"{each.text}: {no_data(each.silent)}" for each in sources if each.silent is not None]
        if recording is not None and recording.trouble:
            found.append(f"recording: {recording.trouble}; it is tried again, learning goes on")
        if recording is not None and recording.lost:
            found.append(f"recording: {recording.lost} samples and packets lost")
        if self._checkpoint is not None and self._checkpoint.trouble:
            found.append(f"checkpoint: {self._checkpoint.trouble}")
        silent = self.learning.now.silent
        if silent is not None:
            found.append(f"no commands since {silent:.1f} s while motion comes; learning waits for them")
        if self._lane.dropped:
            found.append(f"learning could not keep up: {self._lane.dropped} samples passed over (they are recorded)")
        for (text, _), names in zip(self._sources, self._commands, strict=True):
            if names.foreign:
                found.append(f"{text}: the vehicle has no thruster for {some_of(names.foreign, _NAMED)}; passed over")
        return tuple(found)

    def _follow(self, rank: int) -> None:
        """Read one link until the session ends or it does."""
        text, source = self._sources[rank]
        clock, commands = self._clocks[rank], self._commands[rank]
        early: list[_Early] = []  # until the clock has settled
        since = math.inf
        restarts = 0
        try:
            ended = False
            while not (ended or self._stop.is_set()):
                items = source.read(_READ)
                came, now = time.monotonic(), steady_time()
                raw = [(item.received - self._epoch, item) for item in items if isinstance(item, Raw)]
                measured = [item.received for item in items if not isinstance(item, Raw) and not _of_states(item)]
                if measured:
                    self._hearings[rank].heard(max(measured) - self._epoch, came)
                for item in items:
                    if not isinstance(item, Raw) and clock.believes(item.t, item.received):
                        t = clock.place(item.t, item.received) - self._epoch if clock.settled else math.nan
                        early.append(_Early(commands.bound(item), came - min(max(now - item.received, 0.0), 1.0), t))
                if clock.restarts + source.state().restarts > restarts:
                    restarts = clock.restarts + source.state().restarts
                    self.events.add(Event(max(self._newest, 0.0), "clock", f"{text}: its clock was set anew"))
                    self._lane.break_off()
                ended = not items and source.state().ended
                since = min(since, came) if early else math.inf
                waits = not clock.settled and came - since < _SETTLING
                if waits and not ended and not self._stop.is_set():
                    self._hand_over(rank, [], raw)
                    continue
                held = since < came
                samples = [each._replace(moment=came) if held else each for each in early if each.sample.names]
                early, since = [], math.inf
                ended = not self._hand_over(rank, self._placed(rank, samples), raw) or ended
            self._hand_over(rank, self._placed(rank, early), [])
        except Exception as error:  # one link that fails does not end the others
            self._faults[rank] = f"{text}: the link has failed ({type(error).__name__}: {' '.join(str(error).split())})"
        self._lane.ended(rank)

    def _placed(self, rank: int, samples: Sequence[_Early]) -> list[Arrival]:
        """Return samples on the session's clock; those that came before that was known, as it is known now."""
        clock = self._clocks[rank]
        return [
            Arrival(
                clock.place(sample.t, sample.received) - self._epoch if t != t else t,
                moment,
                rank,
                sample,
            )
            for sample, moment, t in samples
        ]

    def _hand_over(self, rank: int, arrivals: list[Arrival], raw: list[tuple[float, Raw]]) -> bool:
        """Give samples to the recording and to the learner; return whether the session goes on after them."""
        self._first = min(self._first, *(each.t for each in arrivals), math.inf)
        within = [each for each in arrivals if each.t <= self._first + self._longest]
        self._counts[rank] += len(within)
        self._deep[rank] = self._deep[rank] or any("z" in each.sample.names for each in within)
        if self._recorder is not None:
            self._recorder.put(within, raw)
        for tap in self.taps:
            tap(within)
        if within:
            newest = max((each.t for each in within), default=-math.inf)
            if newest > self._newest:
                self._newest, self._came = newest, time.monotonic()
            self._lane.put(within, patient=self._sources[rank][1].patient)
        return len(within) == len(arrivals)

    def _finish(self) -> None:
        for last in self.before_end:
            last()
        self._stop.set()
        deadline = time.monotonic() + _ENOUGH
        for thread in self._threads:
            thread.join(max(deadline - time.monotonic(), 0.1))
        self._lane.close()
        for _, source in self._sources:
            with contextlib.suppress(Exception):
                source.close()
        self.learning.join()
        if self._recorder is not None:
            self._describe()
            self._recorder.close(self._notes())
            self._notice_disk()  # what waited may have been written with the end of the file
        self._ended = True

    def _notes(self) -> list[str]:
        status = self.status()
        notes = []
        for each in status.sources:
            note = f"{each.samples} samples"
            if each.offset == each.offset:
                note += f", our clock less its own {each.offset:.6f} s, drift {1e6 * each.drift:.1f} ppm"
            if each.state.bad:
                note += f", {each.state.bad} bad messages"
            if each.state.dropped:
                note += f", {each.state.dropped} datagrams dropped by the system"
            if each.state.foreign:
                note += f", {each.state.foreign} messages and values of others passed over"
            if each.strange:
                note += f", {each.strange} stamps not believed"
            notes.append(f"live {each.text}: {note}")
        if status.late:
            notes.append(f"{status.late} samples came too late to be learned from")
        if status.dropped:
            notes.append(f"{status.dropped} samples were passed over in learning, {status.gaps} times")
        return notes
