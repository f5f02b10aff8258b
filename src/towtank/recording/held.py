"""Held inputs: a command acts from its own stamp until the next one comes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.recording.channel import Channel

__all__ = ["held_at", "held_mean", "stack_held"]


def stack_held(channels: Sequence[Channel]) -> tuple[Array, Array]:
    """Return the distinct stamps (k,) of all channels and the values held then (k, m); NaN before a first."""
    known = [channel.measured for channel in channels]
    stamps = {id(channel.t): channel.t for channel in known}
    if not stamps:
        return np.empty(0), np.empty((0, 0))
    times = np.unique(np.concatenate(list(stamps.values()))) if len(stamps) > 1 else next(iter(stamps.values()))
    return times, np.column_stack([held_at(channel.t, channel.values[:, None], times)[:, 0] for channel in known])


def held_at(t_command: Array, values: Array, at: Array, delay: float = 0.0, tolerance: float = 0.0) -> Array:
    """Return the held values (n, m) in force at the times `at` (n,); NaN before the first stamp.

    Args:
        t_command: stamps (k,) [s], strictly increasing.
        values: commands (k, m).
        at: times (n,) [s].
        delay: from a stamp to its effect [s].
        tolerance: a stamp that comes this little late [s] counts as in time; rounding is always allowed for.
    """
    if not t_command.size:
        return np.full((at.size, values.shape[1]), np.nan)
    latest = at - delay + (tolerance + 4.0 * np.spacing(np.abs(at)))
    index = np.searchsorted(t_command, latest, "right") - 1
    result: Array = np.where(index[:, None] >= 0, values[np.maximum(index, 0)], np.nan)
    return result


@kernel
def held_mean(t_command: Array, values: Array, t: Array, delay: float) -> Array:
    """Return the exact mean (n - 1, m) of held commands over each interval t[i] .. t[i+1].

        mean_i = 1 / (t[i+1] - t[i]) * integral from t[i] to t[i+1] of command(s - delay) ds

    NaN where part of the interval lies before the first stamp (by more than a millionth of the interval).

    Args:
        t_command: stamps (k,) [s], strictly increasing; each row of `values` holds from its stamp to the
            next.
        values: commands (k, m).
        t: times (n,) [s], increasing.
        delay: from a stamp to its effect [s].
    """
    k, m, n = t_command.shape[0], values.shape[1], t.shape[0]
    out = np.empty((max(n - 1, 0), m))
    row = -1  # the last stamp at or before the start of the interval
    for i in range(n - 1):
        start, end = t[i] - delay, t[i + 1] - delay
        slack = 1e-6 * (end - start)
        while row + 1 < k and t_command[row + 1] <= start + slack:
            row += 1
        if row + 1 >= k or t_command[row + 1] >= end - slack:
            for j in range(m):
                out[i, j] = values[row, j] if row >= 0 else np.nan
            continue
        for j in range(m):
            out[i, j] = 0.0
        at, current = start, row
        while at < end:
            until = end
            if current + 1 < k and t_command[current + 1] < end:
                until = t_command[current + 1]
            share = (until - at) / (end - start)
            for j in range(m):
                out[i, j] += share * (values[current, j] if current >= 0 else np.nan)
            at = until
            current += 1
    return out
