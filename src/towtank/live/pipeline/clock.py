"""A source's own clock against ours: what is received can be late, never early.

The smallest difference between receipt and stamp over the last half minute leads from one clock to the other; a line
below the smallest of every second tells how one drifts against the other. So every source's samples stand on one clock,
freed from what a link, a router or a busy computer held up; what the quickest message takes remains.

Our own clock never jumps, whatever becomes of the computer's: it is the time of day once, and counts on from there.
"""

from __future__ import annotations

import math
import time
from collections import deque

__all__ = ["HostClock", "SourceClock", "steady_time"]

_SETTLES = 0.4  # s for which samples wait for the offset: what waits is lost where the process is killed
_BLOCK = 1.0  # s of which the quickest message is kept
_BLOCKS = 30
_FEWEST = 8  # blocks that tell a drift
_FASTEST_DRIFT = 1e-3
_SLEW = 1e-3  # s per s by which the offset follows what is found, after the first second
_LATE, _EARLY = 10.0, 0.25  # s by which a stamp is off that is not believed,
_CONVINCED = 20  # unless so many follow each other: then the source's clock was set anew;
_BACK = 0.25  # or so many lie so far [s] before the newest
_SPAN, _BEHIND = 5.0, 0.25  # s: over two such spans all were so late, and not less and less: it was set back as well
_SAME = 2.0  # s within which a stamp is of the clock that is known, or out of order behind a link that was held up
_STEP = 1.0  # s by which the computer's clock moves against ours before it counts as set


def _counting() -> float:
    """Return seconds that count on through every setting of the clock, and while the computer sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


_BEGAN = time.time() - _counting()


def steady_time() -> float:
    """Return Unix time [s] as it was when this was imported, counted on since: no setting of the clock moves it."""
    return _BEGAN + _counting()


class HostClock:
    """Notices that the computer's clock was set."""

    def __init__(self) -> None:
        self._ahead = time.time() - steady_time()

    def stepped(self) -> float:
        """Return by how much [s] it was set since the last call; 0 where it was not."""
        before, ahead = self._ahead, time.time() - steady_time()
        if abs(ahead - before) < _STEP:
            return 0.0
        self._ahead = ahead
        return ahead - before


class SourceClock:
    """Turns the stamps of one source into our times.

    In the first second the offset falls with every quicker message, mostly in the first tenths, so that stamps had
    better wait until it has `settled`; after that second it moves by a millisecond a second at most, and no instant
    jumps against its neighbour.

    Attributes:
        offset: ours less the source's clock [s], as applied last; NaN before the first stamp.
        drift: by which ours gains on the source's [s/s].
        restarts: how often the source's clock was set anew.
        strange: stamps that were not believed.
    """

    def __init__(self, *, keeps_time: bool = False) -> None:
        """With `keeps_time` the stamps are ours already."""
        self.offset, self.drift, self.restarts, self.strange = math.nan, 0.0, 0, 0
        self._keeps_time = keeps_time
        self._in_a_row = 0
        self._span_start, self._least, self._least_before = 0.0, math.inf, 0.0  # s: of the span, lateness in it, before
        self._forget()

    @property
    def settled(self) -> bool:
        """Whether the offset is known well enough for what comes to be placed, and nothing contradicts it."""
        return self._first is None or (self._last - self._first > _SETTLES and not self._in_a_row)

    def is_of(self, t: float, received: float) -> bool:
        """Whether a stamp t [s] can be of this clock: as late as usual, or near the newest of what a link held up."""
        return self._first is not None and min(abs(received - t - self.offset), abs(t - self._last)) <= _SAME

    def believes(self, t: float, received: float) -> bool:
        """Take the stamp t [s] of what was received at `received` [s, ours]; return whether it can be believed."""
        if t != t or self._keeps_time:
            return True
        late = received - t
        if not math.isfinite(late):
            self.strange += 1
            return False
        first = t if self._first is None else self._first
        if self._first is None:
            self._begin(t, late)
        elif self._cannot_be(t, late):
            self.strange += 1
            self._in_a_row += 1
            if self._in_a_row < _CONVINCED:
                return False
            first = self._begin_anew(t, late)
        elif t < self._last - _BACK:  # late on its way, unless all that follow are
            self._in_a_row += 1
            if self._in_a_row >= _CONVINCED:
                first = self._begin_anew(t, late)
        else:
            self._in_a_row = 0
            if self._stays_behind(late - self.offset, received):
                first = self._begin_anew(t, late)
        self._see(t, late, t - first)
        return True

    def _cannot_be(self, t: float, late: float) -> bool:
        """Whether a stamp is ahead of its receipt, or far behind it and others; what a link held up goes on."""
        return late - self.offset < -_EARLY or (late - self.offset > _LATE and t < self._last - _SAME)

    def _stays_behind(self, lateness: float, received: float) -> bool:
        """Whether everything is late for so long, and by so much, that the source's clock was set back."""
        if received - self._span_start < _SPAN:
            self._least = min(self._least, lateness)
            return False
        before, least = self._least_before, self._least
        self._span_start, self._least_before, self._least = received, least, lateness
        return min(before, least) > _BEHIND and least > before - _EARLY

    def _begin_anew(self, t: float, late: float) -> float:
        """Take that the source's clock was set; return its first stamp."""
        self.restarts += 1
        self._in_a_row = 0
        self._forget()
        self._begin(t, late)
        return t

    def ours(self, t: float, received: float) -> float:
        """Take a stamp t [s] and return its instant on our clock; NaN where it cannot be believed."""
        return self.place(t, received) if self.believes(t, received) else math.nan

    def place(self, t: float, received: float) -> float:
        """Return the instant of a stamp t [s] on our clock, as it is known by now; of receipt where t is NaN."""
        if t != t:
            return received
        return t if self._keeps_time else t + self.offset

    def _forget(self) -> None:
        self._first: float | None = None
        self._blocks: deque[tuple[float, float]] = deque(maxlen=_BLOCKS)  # stamp, smallest lateness
        self.drift = 0.0

    def _begin(self, t: float, late: float) -> None:
        self._first = self._block_start = self._last = t
        self._quickest = (t, late)
        self._floor = (t, late)  # the line: lateness at a stamp, rising by `drift`
        self.offset = late
        self._span_start, self._least, self._least_before = t + late, math.inf, 0.0

    def _see(self, t: float, late: float, known: float) -> None:
        """Follow a stamp t [s]; known: since the first one [s]."""
        if late < self._quickest[1]:
            self._quickest = (t, late)
        target = self._floor[1] + self.drift * (t - self._floor[0])
        if late < target:
            self._floor = (t, late)
            target = late
        if t - self._block_start >= _BLOCK or t < self._block_start:
            if self._quickest[1] - self.offset <= _BEHIND:  # what a link held up tells nothing of the clock
                self._blocks.append(self._quickest)
            self._quickest, self._block_start = (t, late), t
            self._fit()
            target = self._floor[1] + self.drift * (t - self._floor[0])
        most = _SLEW * min(max(t - self._last, 0.0), _BLOCK)
        settled = known > _BLOCK
        self._last = max(t, self._last)
        self.offset += min(max(target - self.offset, -most), most) if settled else min(target - self.offset, 0.0)

    def _fit(self) -> None:
        """Lay the line below the quickest messages of all blocks."""
        n = len(self._blocks)
        if n >= _FEWEST:
            mean_t = sum(t for t, _ in self._blocks) / n
            mean = sum(late for _, late in self._blocks) / n
            spread = sum((t - mean_t) ** 2 for t, _ in self._blocks)
            slope = sum((t - mean_t) * (late - mean) for t, late in self._blocks) / spread if spread else 0.0
            self.drift = min(max(slope, -_FASTEST_DRIFT), _FASTEST_DRIFT)
        if self._blocks:
            self._floor = min(self._blocks, key=lambda block: block[1] - self.drift * block[0])
