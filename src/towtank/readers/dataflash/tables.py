"""From the messages of a DataFlash log, binary or text, to tables: clock, instances, parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.readers.common.clock import epoch_of, one_clock
from towtank.readers.common.tables import RecordColumns, Table, Tables
from towtank.recording.repairs import Repairs

__all__ = ["KEPT_TEXTS", "KIND", "Messages", "Read", "instance_fields", "tables_of"]

KIND = "DataFlash"
KEPT_TEXTS = {"PARM": ("Name",), "MSG": ("Message",), "FMTU": ("UnitIds",)}
_DICTIONARY = ("FMT", "FMTU", "UNIT", "MULT")  # what the log says of itself
_CLOCKS = {"TimeUS": 1e-6, "TimeMS": 1e-3}  # s
_INSTANCES = ("I", "Instance", "Inst", "C", "IMU", "chan")  # where no FMTU record tells
_INSTANCE_UNIT = "#"
_GPS_EPOCH = 315_964_800.0  # s, 1980-01-06 on the Unix clock
_LEAP_SECONDS = 18.0  # of GPS time over UTC since 2017
_WEEK = 604_800.0
_FIXED = 3.0
Columns = RecordColumns | dict[str, Array]
Rows = NDArray[np.intp] | NDArray[np.bool_]


@dataclass(frozen=True)
class Messages:
    """The messages of one format.

    Attributes:
        places: where in the file each stands (n,), increasing: bytes or lines.
        columns: numbers (n,) by field. text: texts (n,) by field, of the fields that are kept.
    """

    name: str
    places: NDArray[np.int64]
    columns: Columns
    text: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def take(self, rows: Rows) -> Messages:
        """Return some of the messages."""
        chosen = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        text = {name: tuple(texts[i] for i in chosen) for name, texts in self.text.items()}
        columns: Columns
        if isinstance(self.columns, RecordColumns):
            columns = self.columns.take(rows)
        else:
            columns = {name: column[rows] for name, column in self.columns.items()}
        return Messages(self.name, self.places[rows], columns, text)


@dataclass(frozen=True)
class Read:
    """What a decoder found: messages, instance fields by name of message where the log tells them, losses."""

    messages: Sequence[Messages]
    instances: Mapping[str, str]
    damaged: int
    details: tuple[str, ...]


def instance_fields(
    messages: Sequence[Messages], formats: Mapping[float, tuple[str, tuple[str, ...]]]
) -> dict[str, str]:
    """Return name of message -> its field of instances, as FMTU messages tell: the one whose unit is "#".

    Args:
        messages: all of a log.
        formats: number of a format -> name of its messages and their fields.
    """
    found: dict[str, str] = {}
    for each in messages:
        if each.name == "FMTU" and "FmtType" in each.columns and "UnitIds" in each.text:
            for number, units in zip(each.columns["FmtType"].tolist(), each.text["UnitIds"], strict=True):
                name, fields = formats.get(number, ("", ()))
                place = units.find(_INSTANCE_UNIT)
                if 0 <= place < len(fields):
                    found[name] = fields[place]
    return found


def tables_of(source: str, read: Read) -> Tables:
    """Return the tables of a log, t = 0 at its earliest message.

    Raises:
        InputError: no message has a time.
    """
    timed = [each for each in read.messages if _clock(each) is not None and each.places.size]
    if not timed:
        raise InputError(
            f"{source}: no DataFlash message with a time in it; this ArduPilot log is cut too short or damaged"
        )
    kept, stray, notes = _one_clock(timed)
    start = min(float(t.min()) for _, t in kept)
    tables: dict[str, Table] = {}
    parameters: dict[str, float] = {}
    for messages, t in sorted(kept, key=lambda each: int(each[0].places[0])):
        if messages.name == "PARM" and "Name" in messages.text and "Value" in messages.columns:
            parameters |= dict(zip(messages.text["Name"], messages.columns["Value"].tolist(), strict=True))
        if messages.name not in _DICTIONARY:
            for table in _split(messages, t - start, read.instances.get(messages.name)):
                tables[table.name] = _joined(tables[table.name], table) if table.name in tables else table
    attributes = {"clock": f"autopilot; t = 0 is {start:.6f} s after its start", "since_boot_s": f"{start:.6f}"}
    epoch = _epoch(tables)
    if epoch is not None:
        attributes |= epoch_of(epoch)
    return Tables(
        source=source,
        tables=tables,
        parameters=parameters,
        notes=notes,
        repairs=Repairs(damaged=read.damaged + stray, details=read.details),
        attributes=attributes,
    )


def _clock(messages: Messages) -> str | None:
    return next((name for name in _CLOCKS if name in messages.columns), None)


def _one_clock(timed: Sequence[Messages]) -> tuple[list[tuple[Messages, Array]], int, tuple[str, ...]]:
    """Return messages with their times [s], without those that stand on no clock or on another start's."""
    times = [each.columns[clock] * _CLOCKS[clock] for each in timed if (clock := _clock(each)) is not None]
    order = np.argsort(np.concatenate([each.places for each in timed]), kind="stable")
    found = one_clock(np.concatenate(times)[order], absolute=False)
    keep = np.empty_like(found.keep)
    keep[order] = found.keep
    masks = np.split(keep, np.cumsum([own.size for own in times])[:-1])
    kept = [
        (each, own) if mask.all() else (each.take(mask), own[mask])
        for each, own, mask in zip(timed, times, masks, strict=True)
        if mask.any()
    ]
    return kept, found.stray, (found.note,) if found.note else ()


def _split(messages: Messages, t: Array, stated: str | None) -> Iterable[Table]:
    """Return one table for each instance of a message, of a sensor or an estimator of which there are several."""
    fields = list(messages.columns)
    instance = stated if stated in fields else fields[1] if len(fields) > 1 and fields[1] in _INSTANCES else None
    if instance is None:
        yield Table(messages.name, t, messages.columns, KIND, text=messages.text)
        return
    numbers = messages.columns[instance]
    for number in np.unique(numbers[np.isfinite(numbers)]):
        rows = np.flatnonzero(numbers == number)
        own = messages if rows.size == numbers.size else messages.take(rows)
        yield Table(f"{messages.name}[{number:.0f}]", t[rows], own.columns, KIND, text=own.text)


def _joined(first: Table, second: Table) -> Table:
    """Return two tables of one name as one: the log defined its format anew in between."""
    sizes = len(first), len(second)

    def column(name: str) -> Array:
        parts = (table.columns.get(name, np.full(n, np.nan)) for table, n in zip((first, second), sizes, strict=True))
        return np.concatenate(list(parts))

    names = dict.fromkeys([*first.columns, *second.columns])
    texts = {
        name: (*first.text.get(name, ("",) * sizes[0]), *second.text.get(name, ("",) * sizes[1]))
        for name in dict.fromkeys([*first.text, *second.text])
    }
    t = np.concatenate((first.t, second.t))
    joined = Table(first.name, t, {name: column(name) for name in names}, KIND, text=texts)
    if not all(sizes) or second.t[0] >= first.t[-1]:
        return joined
    order = np.argsort(t, kind="stable")  # the log went to and fro between the two
    texts = {name: tuple(each[i] for i in order) for name, each in texts.items()}
    return Table(first.name, t[order], {name: joined[name][order] for name in names}, KIND, text=texts)


def _epoch(tables: Mapping[str, Table]) -> float | None:
    """Return t = 0 on the Unix clock [s], as satellites told it, None where they did not."""
    for name, table in tables.items():
        if name.partition("[")[0] == "GPS" and all(field in table for field in ("Status", "GWk", "GMS")):
            fixed = (table["Status"] >= _FIXED) & (table["GWk"] > 0)
            unix = _GPS_EPOCH + _WEEK * table["GWk"] + 1e-3 * table["GMS"] - _LEAP_SECONDS - table.t
            if fixed.any():
                found = float(np.median(unix[fixed]))
                return found
    return None
