"""Samples of several sources in order of time: each is held back for a moment, for those that come late.

A quantity that several measure is learned from the one named first, while it sends.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass

from towtank.live.links.source import Sample
from towtank.recording.standard import QUATERNION

__all__ = ["Arrival", "Preference", "Sorter"]

_SILENT = 1.0  # s after which the next source takes over
_SAME = dict.fromkeys(QUATERNION, ("psi",)) | dict.fromkeys(("phi", "theta", "psi"), (QUATERNION[0],))  # other names


@dataclass(frozen=True, slots=True)
class Arrival:
    """A sample on our clock.

    Attributes:
        t: its instant [s] since the session began. came: when it was received, by the monotonic clock [s].
        rank: place of its source on the command line. sample: itself.
    """

    t: float
    came: float
    rank: int
    sample: Sample


class Sorter:
    """Holds samples back for `window` [s], and lets them go in order of time.

    A sample goes when it has waited so long, or as soon as every source has sent one that is later by the window; with
    `patient` only then. What comes later than one already gone is refused, and counted in `late`.
    """

    def __init__(self, window: float, sources: int, *, patient: bool = False) -> None:
        self.window, self.late = window, 0
        self._patient = patient
        self._newest = [-math.inf] * sources
        self._heap: list[tuple[float, int, Arrival]] = []
        self._count = 0
        self._gone = -math.inf

    def __len__(self) -> int:
        return len(self._heap)

    def put(self, arrival: Arrival) -> None:
        """Take a sample."""
        if arrival.t < self._gone:
            self.late += 1
            return
        self._newest[arrival.rank] = max(self._newest[arrival.rank], arrival.t)
        self._count += 1
        heapq.heappush(self._heap, (arrival.t, self._count, arrival))

    def ended(self, rank: int) -> None:
        """Wait no longer for a source."""
        self._newest[rank] = math.inf

    def ready(self, now: float) -> Iterator[tuple[Arrival, float]]:
        """Yield samples that may go at `now` (monotonic) [s], each with the moment from which it might have gone.

        Args:
            now: infinity lets everything go.
        """
        safe = min(self._newest) - self.window
        while self._heap:
            arrival = self._heap[0][2]
            due = arrival.came + self.window
            waited = due <= now and (not self._patient or now == math.inf)
            if arrival.t > safe and not waited:
                return
            heapq.heappop(self._heap)
            self._gone = max(self._gone, arrival.t)
            yield arrival, due if waited and arrival.t > safe else max(arrival.came, min(now, due))

    def wait(self, now: float) -> float:
        """Return how long [s] it takes until one is due; infinity where none is held."""
        if not self._heap or self._patient:
            return math.inf
        return max(self._heap[0][2].came + self.window - now, 0.0)


class Preference:
    """Keeps every channel to one source at a time.

    Attributes:
        doubled: channels that a second source measured as well.
    """

    def __init__(self) -> None:
        self.doubled: dict[str, None] = {}
        self._owner: dict[str, tuple[int, float]] = {}  # name -> rank, time of its last sample

    def taken(self, arrival: Arrival) -> dict[str, float]:
        """Return those channels of a sample that are learned from."""
        out: dict[str, float] = {}
        for name, value in zip(arrival.sample.names, arrival.sample.values, strict=True):
            if not self._is_held(name, arrival):
                self._owner[name] = arrival.rank, arrival.t
                out[name] = value
        return out

    def _is_held(self, name: str, arrival: Arrival) -> bool:
        """Whether a source named earlier measures the same, and still sends."""
        held = False
        for each in (name, *_SAME.get(name, ())):
            rank, last = self._owner.get(each, (arrival.rank, arrival.t))
            if arrival.rank > rank:
                self.doubled.setdefault(name)
                held = held or arrival.t - last <= _SILENT
        return held

    def source_of(self, name: str) -> int | None:
        """Return the place of the source that a channel is taken from; None where none has sent it."""
        owner = self._owner.get(name)
        return None if owner is None else owner[0]
