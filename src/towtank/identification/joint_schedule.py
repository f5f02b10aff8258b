"""When the streaming filter looks back: at times that grow, and soon after a coefficient became known late."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["STILL", "Schedule"]

_EARLY = 8.0  # s of motion until which looks are frequent
STILL = 30.0  # s of motion until which the water may be taken as still
_OFTEN = 0.25  # s between two looks at least
_FIRST = 0.5  # s of motion
_GROWS_EARLY, _GROWS = 0.25, 1.0  # share of the motion so far to the next look, until `_EARLY` and later
_GROWS_AGAIN, _GROWS_LEAST = 0.6, 0.06  # likewise, once a coefficient has called for a look; of all that was seen
_LAST = 120.0  # s of samples kept,
_MOST_ROWS = 40_000
_BOTH_STARTS, _STARTS_GROW = 30.0, 2.0  # s: until then looks at doubling times start from least squares too,
_BANK_UNTIL = 5.0  # s: and until then from a bank of delays


@dataclass
class Schedule:
    """Times [s] of motion seen: of the next look, the last, the next from other starts; since when all axes move."""

    next: float = _FIRST
    last: float = 0.0
    starts: float = _FIRST
    began: float = 0.0

    def looked(self, seen: float) -> None:
        """Set the next look after one at `seen`."""
        span = seen - self.began
        early = _GROWS_EARLY if self.began == 0.0 else _GROWS_AGAIN
        self.last = seen
        self.next = seen + max(_OFTEN, span * (early if span < _EARLY else _GROWS), seen * _GROWS_LEAST)

    def call(self, seen: float, *, at_once: bool = False) -> None:
        """Look now, and often for a while: an axis that was still has begun to tell something."""
        if at_once or seen > self.last + max(_OFTEN, self.last * _GROWS_LEAST):
            self.next = min(self.next, seen)
            self.began = self.last

    def behind(self, seen: float) -> bool:
        """Whether a look is due, or the last one saw far less than has been seen by now."""
        return seen >= min(self.next, max(_FIRST, (1.0 + _GROWS_EARLY) * self.last))

    def other_starts(self, seen: float) -> bool:
        """Whether this look begins elsewhere too."""
        due = self.starts <= seen < _BOTH_STARTS
        if due:
            self.starts = seen * _STARTS_GROW
        return due

    def bank(self, seen: float) -> bool:
        """Whether it begins from a bank of delays too."""
        return seen < _BANK_UNTIL

    def over(self, rows: int) -> bool:
        """Whether there are no more looks, with so many rows kept."""
        return self.next > _LAST or rows > _MOST_ROWS
