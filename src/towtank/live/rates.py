"""How often what comes: counts by topic, and rates over the last seconds."""

from __future__ import annotations

import time
from collections.abc import Mapping

__all__ = ["Rates"]

_SPAN = 2.0  # s over which a rate is counted
_MOST = 200  # topics


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
