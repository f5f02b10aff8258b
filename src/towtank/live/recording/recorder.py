"""The recording of a session: a thread of its own, so that neither a slow disk nor learning holds up the links."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from towtank.live.links.source import Raw
from towtank.live.pipeline.sorter import Arrival
from towtank.recording.event import Event
from towtank.recording.mcap.format import Quantity
from towtank.recording.mcap.log import McapLog
from towtank.recording.standard import standard_of

__all__ = ["Disk", "Form", "Message", "Recorder", "RecordingState"]

_PATIENCE = 1 << 26  # bytes that wait for the disk
_OFTEN = 0.05  # s between two looks at whether to flush


@dataclass(frozen=True)
class Form:
    """A kind of message: its topic, and its schema as (name, encoding, text)."""

    topic: str
    schema: tuple[str, str, bytes]


@dataclass(frozen=True)
class Message:
    """A published message, in JSON: its kind, its time [s of the session], and itself."""

    form: Form
    t: float
    text: str


@dataclass(frozen=True)
class RecordingState:
    """How the recording fares.

    Attributes:
        path: its file. size: bytes in it. count: samples and packets taken. lost: of them, those not recorded.
        trouble: what is wrong, "" where nothing is. incidents: what befell the file from outside.
        complete: whether it was closed with its index.
    """

    path: Path
    size: int
    count: int
    lost: int
    trouble: str
    incidents: tuple[str, ...] = ()
    complete: bool = False


class Recorder:
    """Writes samples and bytes to a log; `put` never waits.

    Each topic is one source of the recording, with the columns of its first sample; columns that come later are a
    further one, so that no channel stands in two of one topic.
    """

    def __init__(self, log: McapLog) -> None:
        self._log = log
        self._queue: deque[Arrival | Event | Message | dict[str, str | None] | tuple[float, Raw]] = deque()
        self._waiting = self._lost = self._count = 0  # bytes, items, items
        self._changed = threading.Condition()
        self._closing = False
        self._fault = ""
        self._places: dict[tuple[str, str], dict[str, str]] = {}  # source, topic -> channel -> name in the log
        self._columns: dict[str, tuple[str, ...]] = dict(log.sources)
        for name, columns in self._columns.items():
            source, _, topic = name.partition("/")
            self._places.setdefault((source, topic.partition(" ")[0]), {}).update(dict.fromkeys(columns, name))
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def put(self, arrivals: Sequence[Arrival], raw: Sequence[tuple[float, Raw]]) -> None:
        """Take samples, and bytes each with its time [s of the recording]."""
        if not arrivals and not raw:
            return
        size = sum(100 + 8 * len(each.sample.values) for each in arrivals) + sum(100 + len(r.data) for _, r in raw)
        with self._changed:
            if self._waiting + size > _PATIENCE:
                self._lost += len(arrivals) + len(raw)
                return
            self._waiting += size
            self._queue.extend(arrivals)
            self._queue.extend(raw)
            self._count += len(arrivals) + len(raw)
            self._changed.notify()

    def put_text(self, message: Message) -> None:
        """Take a message."""
        with self._changed:
            if self._waiting <= _PATIENCE:
                self._queue.append(message)
                self._changed.notify()

    def put_event(self, event: Event) -> None:
        """Take an event."""
        with self._changed:
            self._queue.append(event)
            self._changed.notify()

    def put_attributes(self, attributes: Mapping[str, str | None]) -> None:
        """Take what is known of the recording by now; None: no longer."""
        with self._changed:
            self._queue.append(dict(attributes))
            self._changed.notify()

    def state(self) -> RecordingState:
        """Return how it fares."""
        log = self._log
        return RecordingState(
            log.path,
            log.size,
            self._count,
            self._lost + log.lost,
            log.trouble or self._fault,
            tuple(log.incidents),
            log.complete,
        )

    def close(self, notes: Sequence[str] = ()) -> None:
        """Write what waits, and end the file."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()
        lost = (f"{self._lost} samples and packets were lost: the disk did not take them",) if self._lost else ()
        self._log.close((*notes, *lost))

    def _run(self) -> None:
        while True:
            with self._changed:
                if not self._queue and not self._closing:
                    self._changed.wait(_OFTEN)
                items, self._queue, self._waiting = self._queue, deque(), 0
                if self._closing and not items:
                    return
            for item in items:
                try:
                    self._write(item)
                except Exception as error:  # one sample that cannot be written does not end the recording
                    self._lost += 1
                    self._fault = f"{type(error).__name__}: {' '.join(str(error).split())}"
            self._log.flush_if_due()

    def _write(self, item: Arrival | Event | Message | dict[str, str | None] | tuple[float, Raw]) -> None:
        if isinstance(item, Arrival):
            self._sample(item)
        elif isinstance(item, Event):
            self._log.write_event(item)
        elif isinstance(item, dict):
            self._log.describe(item)
        elif isinstance(item, Message):
            self._log.write_text(item.form.topic, item.form.schema, item.t, item.text)
        else:
            self._log.write_raw(f"{item[1].source}/{item[1].topic.strip('/')}", item[0], item[1].data)

    def _sample(self, arrival: Arrival) -> None:
        sample = arrival.sample
        topic = sample.topic.strip("/").replace(" ", "_")
        places = self._places.setdefault((sample.source, topic), {})
        new = [name for name in sample.names if name not in places]
        if new:
            self._announce(f"{sample.source}/{topic}", new, places)
        values = dict(zip(sample.names, sample.values, strict=True))
        for place in dict.fromkeys(places[name] for name in values):
            self._log.write(place, arrival.t, *(values.get(name, float("nan")) for name in self._columns[place]))

    def _announce(self, name: str, channels: Sequence[str], places: dict[str, str]) -> None:
        """Make a source of the log for channels."""
        number, place = 1, name
        while place in self._columns:
            number += 1
            place = f"{name} {number}"
        self._log.source(place, [Quantity(each, *standard_of(each)[:2]) for each in channels])
        self._columns[place] = tuple(channels)
        places.update(dict.fromkeys(channels, place))


class Disk:
    """Tells what becomes of a recording: that it cannot be written, that it goes on and what was lost, and so on."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._since: float | None = None
        self._lost = self._told = 0

    def notice(self, t: float) -> list[Event]:
        """Return the events that are new at time t [s of the session]."""
        state, now = self._recorder.state(), time.monotonic()
        found = [Event(t, "recording", text, {"state": "mended"}) for text in state.incidents[self._told :]]
        self._told = len(state.incidents)
        if self._since is None:
            if state.trouble:
                self._since = now
                text = f"recording: {state.trouble}; what comes waits for the disk, learning goes on"
                return [*found, Event(t, "recording", text, {"state": "trouble"})]
            self._lost = state.lost
        elif not state.trouble:
            seconds, lost = now - self._since, state.lost - self._lost
            self._since, self._lost = None, state.lost
            losses = f"{lost} samples and packets lost" if lost else "nothing lost"
            text = f"recording goes on after {seconds:.0f} s, {losses}"
            found.append(Event(t, "recording", text, {"state": "back", "seconds": seconds, "lost": lost}))
        return found
