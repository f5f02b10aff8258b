"""The autopilot's share in a MAVLink log: its parameters, and its own clock against that of the receiver.

Many messages bear the time since the autopilot started. A message cannot be received before it was sent, and the
quickest ones are hardly late: the smallest difference between receipt and stamp, which drifts slowly, leads from one
clock to the other. The stamps so moved know nothing of what a link, a router or a busy computer held up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.tables import Table, Tables
from towtank.readers.mavlink.senders import Autopilot, Sender, autopilot_of, message_of

__all__ = ["DVL", "TO_AUTOPILOT", "OwnClock", "with_autopilot"]

_BOOT = "time_boot_ms"
_FIELDS = {_BOOT: 1e-3, "time_usec": 1e-6}  # s
_WRAP = 2.0**32 * 1e-6  # s, where time_usec has 32 bits
_FEWEST = 20
_WINDOW = 30.0  # s over which the quickest message is looked for
_QUICKEST = 1e-3  # share of the messages that may seem to arrive before they were sent
_FASTEST_DRIFT = 1e-3
_AGREES = 2.0  # s
_LONGEST = 60.0  # s; no link holds messages for so long, an autopilot has started anew
DVL = "VISION_POSITION_DELTA"
TO_AUTOPILOT = (DVL, "ATT_POS_MOCAP", "ODOMETRY", "VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE")


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
    stamped = (own > 0.0) & np.isfinite(t)
    t, own = t[stamped], own[stamped]
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


def with_autopilot(tables: Tables, senders: Mapping[str, Sender]) -> Tables:
    """Return the tables with the autopilot's parameters, and its messages on its own clock where it tells it."""
    autopilot = autopilot_of(tables.tables, senders)
    own = {name: table for name, table in tables.tables.items() if senders[name] == autopilot.sender}
    parameters = dict(tables.parameters)
    for name, table in own.items():
        if message_of(name) == "PARAM_VALUE" and "param_id" in table.text and "param_value" in table:
            parameters |= dict(zip(table.text["param_id"], table["param_value"].tolist(), strict=True))
    notes = [_about(autopilot)]
    attributes = dict(tables.attributes)
    clock = own_clock(own)
    stamped = {
        name: with_sender_stamps(table) if message_of(name) in TO_AUTOPILOT and name not in own else table
        for name, table in tables.tables.items()
    }
    if clock is not None:
        stamped |= {name: with_own_stamps(table, clock) for name, table in own.items()}
        attributes["clock"] = f"{attributes.get('clock', 'receiver')}; stamps of the autopilot where it gives them"
        notes.append(
            f"the autopilot's stamps are used in place of times of receipt, which are {1e3 * clock.usual_delay:.0f} ms "
            f"later as a rule and up to {1e3 * clock.longest_delay:.0f} ms"
        )
    stamped, start = from_zero(stamped)
    if start and "epoch" in attributes:
        attributes["epoch"] = (datetime.fromisoformat(attributes["epoch"]) + timedelta(seconds=start)).isoformat()
    return replace(tables, tables=stamped, parameters=parameters, notes=(*tables.notes, *notes), attributes=attributes)


def _about(autopilot: Autopilot) -> str:
    others = ", ".join(f"{what} ({sender})" for sender, what in sorted(autopilot.others.items()))
    if autopilot.sender is None:
        return f"no autopilot speaks; heard: {others}" if others else "no autopilot speaks"
    return f"the autopilot is {autopilot.sender}" + (f"; also heard: {others}" if others else "")
