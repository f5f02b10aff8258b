"""Which source a quantity is learned from where several measure it: the one named first, while it sends."""

from __future__ import annotations

from towtank.live.sorter import Arrival

__all__ = ["Preference"]

_SILENT = 1.0  # s after which the next source takes over


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
            rank, last = self._owner.get(name, (arrival.rank, arrival.t))
            if arrival.rank > rank:
                self.doubled.setdefault(name)
                if arrival.t - last <= _SILENT:
                    continue
            self._owner[name] = arrival.rank, arrival.t
            out[name] = value
        return out
