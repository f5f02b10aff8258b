"""Latencies in a histogram of constant size, by which median and percentiles are known to 5 %."""

from __future__ import annotations

import math

__all__ = ["Latency"]

_LEAST, _STEP = 1e-6, 1.05  # s; each bin is 5 % wider than the one before
_BINS = 400  # up to 300 s
_LOG = math.log(_STEP)


class Latency:
    """Counts durations [s]."""

    def __init__(self) -> None:
        self.count, self.longest = 0, 0.0
        self._bins = [0] * _BINS

    def add(self, seconds: float) -> None:
        """Count one."""
        k = 0 if seconds <= _LEAST else min(int(math.log(seconds / _LEAST) / _LOG) + 1, _BINS - 1)
        self._bins[k] += 1
        self.count += 1
        if seconds > self.longest:
            self.longest = seconds

    def percentile(self, share: float) -> float:
        """Return the duration [s] that the share 0 .. 1 of all stays within; NaN where there is none."""
        if not self.count:
            return math.nan
        wanted, seen = share * self.count, 0
        for k, count in enumerate(self._bins):
            seen += count
            if seen >= wanted:
                return min(_LEAST * _STEP**k, self.longest)
        return self.longest

    def milliseconds(self) -> dict[str, float]:
        """Return median, 99th percentile and maximum [ms]."""
        longest = 1e3 * self.longest if self.count else math.nan
        return {"median": 1e3 * self.percentile(0.5), "p99": 1e3 * self.percentile(0.99), "max": longest}
