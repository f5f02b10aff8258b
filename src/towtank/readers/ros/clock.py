"""The clock of a ROS recording: stamps of the messages against the times at which they were recorded.

A header's stamp tells when something was measured, on the clock of the computer that measured it; the recorder notes
when the message reached it, on its own clock. The stamps are the better times, for they know nothing of waiting; but
clocks may differ by days. So each topic's stamps are shifted onto the recorder's clock by the smallest difference
between the two, which is the difference of the clocks and the shortest way: topics stamped by one clock get one shift,
so that between them nothing of the recording's delays remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.tables import Table

__all__ = ["Reconciled", "reconciled"]

_MINIMUM = 8  # stamped messages by which a clock is known
_SPREAD = 2.0  # s by which most messages of a topic may be late; beyond it its stamps are not of use
_SAME = 0.05  # s within which two topics' clocks are one
_LOWEST = 0.02  # quantile that stands for the shortest way
_DRIFT = 0.005  # s by which a clock may wander off before it is told
_SIMULATED = 0.002  # relative rate from which the stamps are of another time, as a simulator's


@dataclass(frozen=True)
class Reconciled:
    """Tables whose `t` is of one clock, and what there is to say of the clocks.

    Attributes:
        simulated: the clock is that of the stamps, not the recorder's.
    """

    tables: tuple[Table, ...]
    notes: tuple[str, ...] = ()
    simulated: bool = False


@dataclass(frozen=True)
class _Clock:
    """A topic's clock: log = stamp + shift + drift * (stamp - middle)."""

    table: Table
    shift: float
    drift: float
    middle: float

    def on_log(self, stamp: Array, shift: float) -> Array:
        return stamp + shift + self.drift * (stamp - self.middle)


def reconciled(tables: Sequence[Table]) -> Reconciled:
    """Return the tables on one clock, looking at the whole log."""
    clocks = [clock for clock in map(_clock, tables) if isinstance(clock, _Clock)]
    notes = [f"{table.name}: {clock}" for table in tables if isinstance(clock := _clock(table), str)]
    if not clocks:
        return Reconciled(tuple(tables), tuple(notes))
    rates = np.array([clock.drift for clock in clocks])
    if np.median(np.abs(rates)) > _SIMULATED:
        return _on_stamps(tables, clocks, notes)
    common = float(np.median([clock.shift for clock in clocks]))
    own = [clock for clock in clocks if abs(clock.shift - common) > _SAME]
    if abs(common) > _SAME:
        notes.insert(0, f"stamps of the messages are {_apart(common)} the recorder's clock; shifted onto it")
    notes += [
        f"{clock.table.name}: its stamps are {_apart(clock.shift - common)} those of the others; shifted onto them"
        for clock in own
    ]
    wandering = [clock for clock in clocks if clock.drift]
    if wandering:
        worst = max(wandering, key=lambda clock: abs(clock.drift))
        notes.append(f"{worst.table.name}: its clock runs {1e6 * -worst.drift:+.0f} ppm off the recorder's; followed")
    by_name = {clock.table.name: clock for clock in clocks}
    return Reconciled(tuple(_shifted(table, by_name.get(table.name), common) for table in tables), tuple(notes))


def _clock(table: Table) -> _Clock | str | None:
    """Return the clock of a topic's stamps, a reason why they are of no use, or None where it has none."""
    if table.stamp is None:
        return None
    known = np.isfinite(table.stamp) & np.isfinite(table.t)
    if np.count_nonzero(known) < _MINIMUM:
        return None
    t, stamp = table.t[known], table.stamp[known]
    if np.count_nonzero(known) < 0.9 * len(table):
        return "most of its stamps are missing; times of recording are used"
    if np.mean(np.diff(stamp) > 0.0) < 0.9:
        return "its stamps do not increase; times of recording are used"
    late = t - stamp
    fifth = max(len(late) // 5, 1)
    first, last = float(np.quantile(late[:fifth], _LOWEST)), float(np.quantile(late[-fifth:], _LOWEST))
    span = float(np.median(stamp[-fifth:]) - np.median(stamp[:fifth]))
    drift = (last - first) / span if span > 0.0 and abs(last - first) > _DRIFT else 0.0
    middle = float(np.median(stamp))
    straight = late - drift * (stamp - middle)
    shift = float(np.quantile(straight, _LOWEST))
    if np.quantile(straight, 0.8) - shift > _SPREAD:
        return "its stamps wander against the times of recording by seconds; times of recording are used"
    return _Clock(table, shift, drift, middle)


def _shifted(table: Table, clock: _Clock | None, common: float) -> Table:
    if clock is None or table.stamp is None:
        return table
    one_clock = abs(clock.shift - common) <= _SAME and not clock.drift
    shift = common if one_clock else clock.shift
    t = clock.on_log(table.stamp, shift)
    return replace(table, t=np.where(np.isfinite(t), t, table.t))


def _on_stamps(tables: Sequence[Table], clocks: Sequence[_Clock], notes: list[str]) -> Reconciled:
    """Put everything on the clock of the stamps: they are of a time that runs at another rate, as in a simulation."""
    best = max(clocks, key=lambda clock: len(clock.table)).table
    stamps = np.full(len(best), np.nan) if best.stamp is None else best.stamp
    known = np.isfinite(stamps)
    order = np.argsort(best.t[known], kind="stable")
    log, stamp = best.t[known][order], np.maximum.accumulate(stamps[known][order])
    rate = (stamp[-1] - stamp[0]) / max(log[-1] - log[0], 1e-9)
    stamped = {clock.table.name for clock in clocks}
    done = []
    for table in tables:
        own = table.stamp if table.name in stamped and table.stamp is not None else None
        t = _interpolated(table.t, log, stamp) if own is None else own
        done.append(replace(table, t=t - stamp[0]))
    note = (
        f"stamps run at {rate:.4g} times the recorder's clock, as in a simulation: all times are theirs; messages "
        f"without a stamp by those of {best.name}"
    )
    return Reconciled(tuple(done), (note, *notes), simulated=True)


def _interpolated(t: Array, log: Array, stamp: Array) -> Array:
    """Return times on the clock of the stamps, straight on beyond its ends."""
    rate = (stamp[-1] - stamp[0]) / max(log[-1] - log[0], 1e-9)
    before, after = np.minimum(t - log[0], 0.0), np.maximum(t - log[-1], 0.0)
    result: Array = np.interp(t, log, stamp) + rate * (before + after)
    return result


def _apart(seconds: float) -> str:
    """Return how far stamps are from a clock: `log - stamp` in words."""
    side = "behind" if seconds > 0.0 else "ahead of"
    size = abs(seconds)
    if size >= 172_800.0:
        return f"{size / 86_400.0:.2f} days ({size:.3f} s) {side}"
    return f"{size:.3f} s {side}"
