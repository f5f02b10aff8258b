"""An autopilot's own clock against the clock of whoever received its messages.

Many messages bear the time since the autopilot started. A message cannot be received before it was sent, and the
quickest ones are hardly late: the smallest difference between receipt and stamp, which drifts slowly, leads from one
clock to the other. The stamps so moved know nothing of what a link, a router or a busy computer held up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.tables import Table

__all__ = ["OwnClock", "from_zero", "own_clock", "with_own_stamps", "with_sender_stamps"]

_BOOT = "time_boot_ms"
_FIELDS = {_BOOT: 1e-3, "time_usec": 1e-6}  # s
_WRAP = 2.0**32 * 1e-6  # s, where time_usec has 32 bits
_FEWEST = 20
_WINDOW = 30.0  # s over which the quickest message is looked for
_QUICKEST = 1e-3  # share of the messages that may seem to arrive before they were sent
_FASTEST_DRIFT = 1e-3
_AGREES = 2.0  # s
_LONGEST = 60.0  # s; no link holds messages for so long, an autopilot has started anew


@dataclass(frozen=True)
class OwnClock:
    """Receipt = own time + offset + drift * own time, for a message that is not held up [s]; the usual and the longest
    time that messages are."""

    offset: float
    drift: float
    usual_delay: float
    longest_delay: float

    def received(self, own: Array) -> Array:
        """Return when messages of these own times (n,) [s] are received at the earliest."""
        earliest: Array = own * (1.0 + self.drift) + self.offset
        return earliest


def own_clock(tables: Mapping[str, Table]) -> OwnClock | None:
    """Find the autopilot's clock in its messages; None where they tell too little or it started anew in between."""
    parts = [(table.t, 1e-3 * table[_BOOT]) for table in tables.values() if _BOOT in table]
    if not parts:
        return None
    return _clock(np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]))


def with_sender_stamps(table: Table) -> Table:
    """Return a table of another sender, whose clock may be any, with its own stamps on the clock of receipt."""
    for field in ("time_usec", "usec"):
        if field in table:
            own = 1e-6 * table[field]
            clock = _clock(table.t, own)
            if clock is not None and (own > 0.0).all():
                return replace(table, stamp=clock.received(own))
    return table


def _clock(t: Array, own: Array) -> OwnClock | None:
    """Find the clock of the stamps `own` (n,) [s] of messages received at t (n,) [s]."""
    told = (own > 0.0) & np.isfinite(t)
    t, own = t[told], own[told]
    if t.size < _FEWEST:
        return None
    late = t - own
    windows = np.floor((own - own.min()) / _WINDOW).astype(np.int64)
    order = np.lexsort((late, windows))
    firsts = order[np.concatenate(([True], np.diff(windows[order]) > 0))]
    quickest, at = late[firsts], own[firsts]
    drift = 0.0
    if firsts.size >= 5:
        drift = float(np.polynomial.Polynomial.fit(at, quickest, 1).convert().coef[-1]) if np.ptp(at) else 0.0
    if abs(drift) > _FASTEST_DRIFT:
        return None
    rest = late - drift * own
    offset = float(np.quantile(rest, _QUICKEST))
    delays = rest - offset
    if np.median(delays) > _AGREES or float(np.abs(delays).max()) > _LONGEST:
        return None
    return OwnClock(offset, drift, float(np.median(delays)), float(delays.max()))


def with_own_stamps(table: Table, clock: OwnClock) -> Table:
    """Return a table of the autopilot with its own stamps on the clock of receipt; as it is where it bears none."""
    for field, unit in _FIELDS.items():
        if field in table and len(table):
            own = unit * table[field]
            expected = (table.t - clock.offset) / (1.0 + clock.drift)
            own = own + _WRAP * np.rint((expected - own) / _WRAP) if field != _BOOT else own
            if np.median(np.abs(own - expected)) <= _AGREES:
                return replace(table, stamp=clock.received(own))
    return table


def from_zero(tables: Mapping[str, Table]) -> tuple[dict[str, Table], float]:
    """Return the tables with their times moved so that none is below 0, and by how much [s] t = 0 moved."""
    start = min((float(table.stamp.min()) for table in tables.values() if table.stamp is not None), default=0.0)
    if start >= 0.0:
        return dict(tables), 0.0
    moved = {
        name: replace(table, t=table.t - start, stamp=None if table.stamp is None else table.stamp - start)
        for name, table in tables.items()
    }
    return moved, start
