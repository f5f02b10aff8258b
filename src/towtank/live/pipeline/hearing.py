"""Whether a link still hands over data: with nothing for two seconds, and for three of its usual periods, it is lost.

A link is heard by its samples: heartbeats alone are nothing to learn from.
"""

from __future__ import annotations

import math
import time

from towtank.recording.event import Event

__all__ = ["Hearing", "no_data"]

_LEAST, _PERIODS = 2.0, 3.0  # s, and usual periods, without any sample
_ALIKE = 1.5  # times the long gap just before, at most: then that is the usual period
_FOLLOWS = 0.1  # share of the latest period in the usual one


class Hearing:
    """Listens to one link; `heard` is called by the link's thread, `notice` by the session's, `silent` by any."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._usual = 0.0
        self._last = time.monotonic()
        self._t = math.nan  # s of the session, of the last sample
        self._gap = 0.0
        self._slow = 0.0  # s, of the gap just before, where it was a long one
        self._lost: tuple[float, float] | None = None  # moment and time of the last sample before

    def begin(self) -> None:
        """Take that the link is open from now on."""
        self._last = time.monotonic()

    def heard(self, t: float, moment: float | None = None) -> None:
        """Take samples up to t [s of the session] that came at a moment (monotonic [s]), now where omitted."""
        now = time.monotonic() if moment is None else moment
        gap = now - self._last
        if not self.ever:
            self._gap = gap
        elif gap > self._limit:
            if gap < _ALIKE * self._slow:  # one after the other: not lost, but slow
                self._usual = gap
            self._gap = self._slow = gap
        else:
            self._slow = 0.0
            self._usual += _FOLLOWS * (gap - self._usual)
        self._t, self._last = t, now

    @property
    def ever(self) -> bool:
        """Whether anything has come."""
        return self._t == self._t

    def silent(self, moment: float | None = None) -> float | None:
        """Return for how long [s] nothing has come; None where that is not too long."""
        passed = (time.monotonic() if moment is None else moment) - self._last
        return passed if passed > self._limit else None

    def notice(self, moment: float | None = None) -> Event | None:
        """Return the event of a link that has just been lost, or has come back; one that never sent is not lost."""
        lost = self._lost
        if lost is None:
            if self.ever and self.silent(moment) is not None:
                self._lost = self._last, self._t
                text = f"{self._text}: link lost, no data from here on"
                return Event(self._t, "link", text, {"link": self._text, "state": "lost"})
            return None
        if self._last == lost[0]:
            return None
        self._lost = None
        text = f"{self._text}: link back after {self._gap:.1f} s without data"
        return Event(lost[1] + self._gap, "link", text, {"link": self._text, "state": "back", "seconds": self._gap})

    @property
    def _limit(self) -> float:
        return max(_LEAST, _PERIODS * self._usual)


def no_data(seconds: float) -> str:
    """Return that nothing has come for so long.

    >>> no_data(12.7)
    'no data since 12 s'
    """
    return f"no data since {int(seconds)} s"
