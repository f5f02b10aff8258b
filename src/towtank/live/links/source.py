"""What a live link hands over: samples in standard channels, the bytes that came, and how the link fares."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

__all__ = ["Rates", "Raw", "Sample", "Source", "SourceState"]

_SPAN = 2.0  # s over which a rate is counted
_MOST = 200  # topics


@dataclass(frozen=True, slots=True)
class Sample:
    """One instant of one source.

    Attributes:
        source: "mavlink", "json", "replay", "ros2".
        topic: message type or topic.
        t: the source's own stamp [s], Unix where it is known; NaN where it has none.
        received: when it came [s], Unix.
        names: standard channels and states, SI, NED and FRD; commands are cmd_1, cmd_2, ... in the vehicle's order, or
            by name.
        values: one for each name; NaN where not measured.
    """

    source: str
    topic: str
    t: float
    received: float
    names: tuple[str, ...]
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Raw:
    """What came, as it came, for the recording.

    Attributes:
        source: as in `Sample`. topic: under which it is recorded.
        received: when it came [s], Unix.
        data: the bytes.
    """

    source: str
    topic: str
    received: float
    data: bytes


@dataclass(frozen=True)
class SourceState:
    """How a source fares.

    Attributes:
        said: lines for a person: whom it hears, what it asked for, what is wrong.
        asked: rate [Hz] that was asked for, by topic. rates: that came lately [Hz], by topic.
        bad: datagrams or messages that could not be decoded. late: those dropped by the source itself as too old.
        dropped: datagrams for which the system had no room, because more came than was read.
        foreign: messages and values of others that give themselves out for the one that is followed; passed over.
        restarts: how often the clock of the one that is followed began anew, where the source itself keeps time.
        senders: who sends.
        ended: nothing will come any more.
        attributes: of the samples, as of a recording: names of modes, and where z is the depth by pressure.
    """

    said: tuple[str, ...] = ()
    asked: Mapping[str, float] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    bad: int = 0
    late: int = 0
    dropped: int = 0
    foreign: int = 0
    restarts: int = 0
    senders: tuple[str, ...] = ()
    ended: bool = False
    attributes: Mapping[str, str] = field(default_factory=dict)


class Source(Protocol):
    """A live link. All methods but `state` are called by one thread."""

    @property
    def keeps_time(self) -> bool:
        """Whether its stamps are on our clock already."""
        ...

    @property
    def patient(self) -> bool:
        """Whether it can wait: nothing is lost where it is read late."""
        ...

    @property
    def name(self) -> str:
        """What it is called in messages and in the recording; the same as in its samples."""
        ...

    def open(self) -> None:
        """Begin. Raises InputError in one line where that cannot be."""
        ...

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return what has come, waiting for it at most so long [s]; bad data never raises: it is counted."""
        ...

    def state(self) -> SourceState:
        """Return how it fares; may be called by any thread."""
        ...

    def close(self) -> None:
        """End; may be called twice."""
        ...


class Rates:
    """Counts by topic; written by one thread, read by any."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._before: dict[str, int] = {}
        self._since = time.monotonic()
        self._rates: dict[str, float] = {}

    def add(self, topic: str, count: int = 1) -> None:
        """Count messages of a topic; those of topics beyond the 200th are counted together."""
        if topic not in self.counts and len(self.counts) >= _MOST:
            topic = "others"
        self.counts[topic] = self.counts.get(topic, 0) + count

    def now(self) -> Mapping[str, float]:
        """Return the rate [Hz] of each topic, counted over two seconds."""
        moment = time.monotonic()
        passed = moment - self._since
        if passed >= _SPAN or (not self._rates and passed > 0.5):
            counts = dict(self.counts)
            self._rates = {name: (count - self._before.get(name, 0)) / passed for name, count in counts.items()}
            if passed >= _SPAN:
                self._before, self._since = counts, moment
        return dict(self._rates)
