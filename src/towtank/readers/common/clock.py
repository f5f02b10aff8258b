"""One clock for the messages of a file: stamps that cannot be, and clocks that start anew."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.recording.tables.gate import LATEST

__all__ = ["OneClock", "epoch_of", "one_clock"]

_NEIGHBOURS = 5
_STRAY = 2.0  # s off the messages around, or back
_OVERLAP = 1.0  # s that two stretches share before they count as two logs


@dataclass(frozen=True)
class OneClock:
    """Which messages stand on one clock.

    Attributes:
        keep: (n,), in the order of the messages. stray: messages left out for stamps off those around them.
        note: what else was left out, empty where nothing was.
    """

    keep: NDArray[np.bool_]
    stray: int
    note: str


def epoch_of(unix: float) -> dict[str, str]:
    """Return an instant [s] on the Unix clock as the attribute "epoch"; nothing where it cannot be one: before 1970 or
    from 2100 on, as a damaged stamp or a clock that was never set gives it."""
    return {"epoch": datetime.fromtimestamp(unix, UTC).isoformat()} if 0.0 <= unix < LATEST else {}


def one_clock(t: Array, *, absolute: bool) -> OneClock:
    """Judge the stamps (n,) [s] of messages in the order in which they were written, which all but increase.

    A stamp that stands off its neighbours' is damaged. Where all of them go back, the clock has started anew: of
    stretches that cannot stand on one clock the longest is kept.

    Args:
        t: stamps.
        absolute: whether the clock is that of the world, so that stretches that do not overlap are all kept.
    """
    keep = np.abs(t - _local_median(t)) <= _STRAY
    if not keep.any():
        return OneClock(np.ones(t.size, dtype=np.bool_), 0, "")
    stray = int(t.size - np.count_nonzero(keep))
    rows = np.flatnonzero(keep)
    cuts = np.flatnonzero(np.diff(t[rows]) < -_STRAY) + 1
    stretches = np.split(rows, cuts)
    spans = [(float(t[each].min()), float(t[each].max())) for each in stretches]
    if not cuts.size or (absolute and not _overlap(spans)):
        return OneClock(keep, stray, "")
    longest = max(stretches, key=lambda each: float(np.ptp(t[each])))
    keep[:] = False
    keep[longest] = True
    times = "once" if cuts.size == 1 else f"{cuts.size} times"
    note = (
        f"the clock goes back {times}, as if several logs were in one file: the longest is used, "
        f"{rows.size - longest.size} messages of the others are left out"
    )
    return OneClock(keep, stray, note)


def _overlap(spans: list[tuple[float, float]]) -> bool:
    spans = sorted(spans)
    return any(spans[i][1] - spans[i + 1][0] > _OVERLAP for i in range(len(spans) - 1))


def _local_median(t: Array) -> Array:
    """Return the median of each value and the two on either side."""
    if t.size < _NEIGHBOURS:
        return np.full_like(t, np.median(t))
    half = _NEIGHBOURS // 2
    padded = np.concatenate((t[half:0:-1], t, t[-2 : -half - 2 : -1]))
    medians: Array = np.median(np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS), axis=1)
    return medians
