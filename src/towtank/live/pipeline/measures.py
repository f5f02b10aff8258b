"""How hard the vehicle is driven, and how late the learner is.

Forces asked for are summed over the last seconds; latencies stand in a histogram of constant size, by which median and
percentiles are known to 5 %.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.vehicle import Vehicle, thruster_wrench

__all__ = ["Excitation", "Latency"]

_STEP, _SPAN = 0.1, 10.0  # s
_NOTHING = 1e-9  # of the strongest: rounding
_LEAST, _BIN_RATIO = 1e-6, 1.05  # s; each bin is 5 % wider than the one before
_BINS = 400  # up to 300 s
_LOG = math.log(_BIN_RATIO)


class Excitation:
    """Looks at the commands ten times a second of the samples' time, over the last ten seconds."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._seen: deque[Array] = deque(maxlen=round(_SPAN / _STEP))
        self._last = -np.inf

    def see(self, t: float, arguments: dict[str, Any]) -> None:
        """Take the inputs among the learner's arguments of time t [s]."""
        if t - self._last < _STEP and t >= self._last:
            return
        if "commands" in arguments:
            self._seen.append(thruster_wrench(self._vehicle, arguments["commands"], arguments.get("voltage")))
        elif "wrench" in arguments:
            self._seen.append(np.nan_to_num(arguments["wrench"]))
        else:
            return
        self._last = t

    @property
    def rms(self) -> tuple[float, ...]:
        """Root mean square (6,) of X Y Z [N] K M N [N m] over the last ten seconds; empty where nothing was asked."""
        if not self._seen:
            return ()
        level = np.sqrt(np.mean(np.array(self._seen) ** 2, axis=0))
        return tuple(np.where(level > _NOTHING * level.max(), level, 0.0).tolist())


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
                return min(_LEAST * _BIN_RATIO**k, self.longest)
        return self.longest

    def milliseconds(self) -> dict[str, float]:
        """Return median, 99th percentile and maximum [ms]."""
        longest = 1e3 * self.longest if self.count else math.nan
        return {"median": 1e3 * self.percentile(0.5), "p99": 1e3 * self.percentile(0.99), "max": longest}
