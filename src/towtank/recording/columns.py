"""From the columns of a table to a Recording, by standard names or by a mapping: what all readers of tables share.

What cannot have been measured is kept out (`gate`), rows are put in order of time, rows of one time are merged (the
last value that is not NaN wins), and every repair is counted. Columns may hold several rates interleaved: a channel
keeps the times where it has a value.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording.channel import Channel, read_only, standard_channel
from towtank.recording.frames.conversion import to_ned_frd
from towtank.recording.frames.lever_arm import marker_to_origin
from towtank.recording.frames.world_velocity import with_body_velocity
from towtank.recording.mapping import Column, ColumnMapping, load_mapping
from towtank.recording.recording import Recording
from towtank.recording.repairs import Content, Repairs
from towtank.recording.standard import WORLD_VELOCITY, is_standard
from towtank.recording.tables.gate import admitted

__all__ = ["MINIMUM_SAMPLES", "Carried", "assemble", "in_standard_frames", "name_list", "recording_of_columns"]

MINIMUM_SAMPLES = 4
_RESTART_OVERLAP = 1.0  # s that two stretches of a channel must share before the clock counts as restarted
_RESTART_SAMPLES = 20
_DRAFT = "towtank inspect LOG --map-skeleton -o FILE.toml writes a first draft"
ReadNumbers = Callable[[Sequence[str]], Mapping[str, Array]]


def assemble(
    t: Array,
    columns: Mapping[str, Array],
    *,
    place: str,
    source: str,
    notes: Iterable[str] = (),
    attributes: Mapping[str, str] | None = None,
    repairs: Repairs | None = None,
    units: Mapping[str, tuple[str, str]] | None = None,
    contents: tuple[Content, ...] = (),
) -> Recording:
    """Return the recording of a table.

    Args:
        t: times (n,) [s], in any order, repeated or NaN.
        columns: values (n,) by channel name, NaN where not measured.
        place: the file, for messages.
        source: the source that the recording names.
        notes, attributes, repairs, contents: carried over to the recording.
        units: unit and frame of the channels that are not standard ones.

    Raises:
        InputError: fewer than 4 times, no values at all, columns of unequal length, or a clock that restarts.
    """
    remarks = list(notes)
    if not columns:
        raise InputError(f"{place}: no column with a measurement; map its columns with --map FILE.toml")
    passed = admitted(t, columns, place=place)
    t, columns = passed.t, passed.columns
    times, order = _ordered_times(t)
    if times.size < MINIMUM_SAMPLES:
        raise InputError(f"{place}: found {times.size} samples, expected at least {MINIMUM_SAMPLES}")

    table = _Table(t, times, order, place)
    channels: dict[str, Channel] = {}
    for name, column in columns.items():
        own, values = table.channel(name, column)
        if not values.size:
            remarks.append(f'channel "{name}" holds no value; left out')
            continue
        if is_standard(name):
            channels[name] = standard_channel(name, own, values)
        else:
            channels[name] = Channel(name, own, values, *(units or {}).get(name, ("", "")))
    if not channels:
        raise InputError(f"{place}: no column holds any value, expected at least one measurement")
    known_holes = repairs is not None  # counted when the data was first read
    repaired = (repairs or Repairs()) + Repairs(
        disorder=table.disorder,
        duplicates=table.duplicates,
        untimed=passed.untimed,
        nan=0 if known_holes else table.missing,
        infinities=passed.infinities,
        beyond=passed.beyond,
        details=passed.details,
    )
    return Recording(channels, source, tuple(remarks), attributes or {}, repaired, contents)


def _ordered_times(t: Array) -> tuple[Array, NDArray[np.intp] | None]:
    """Distinct times in order, and the stable order of the rows (None where they increase already)."""
    if t.size < 2 or bool((t[1:] > t[:-1]).all()):
        return read_only(t), None
    order = np.argsort(t, kind="stable")
    ordered = t[order]
    return read_only(ordered[np.concatenate(([True], ordered[1:] > ordered[:-1]))]), order


class _Table:
    """Takes one column after the other; counts repairs, each row once however many columns it touches."""

    def __init__(self, t: Array, times: Array, order: NDArray[np.intp] | None, place: str) -> None:
        self._t, self._times, self._order, self._place = t, times, order, place
        self._stamps: dict[bytes, Array] = {}
        self._late = np.zeros(t.size if order is not None else 0, dtype=np.bool_)
        self._repeated = np.zeros_like(self._late)
        self.missing = 0

    @property
    def disorder(self) -> int:
        return int(np.count_nonzero(self._late))

    @property
    def duplicates(self) -> int:
        return int(np.count_nonzero(self._repeated))

    def channel(self, name: str, column: Array) -> tuple[Array, Array]:
        """Times and values of a column where it is measured, in order, one value a time."""
        if self._order is None:
            known = ~np.isnan(column)
            values = column[known]
        else:
            known, values = self._merged(name, column)
        if values.size == self._times.size:
            return self._times, values
        own = self._stamps.setdefault(np.packbits(known).tobytes(), read_only(self._times[known]))
        self.missing += _count_missing(known, own)
        return own, values

    def _merged(self, name: str, column: Array) -> tuple[NDArray[np.bool_], Array]:
        rows = np.flatnonzero(~np.isnan(column))
        t = self._t[rows]
        latest = np.maximum.accumulate(t)
        late = t < latest
        if late.any():
            self._check_restart(name, rows, t)
            self._late[rows[late]] = True
        by_time = np.argsort(t, kind="stable")
        ordered = t[by_time]
        last = np.ones(ordered.size, dtype=np.bool_)
        last[:-1] = ordered[1:] > ordered[:-1]
        self._repeated[rows[by_time[~last]]] = True
        known = np.zeros(self._times.size, dtype=np.bool_)
        known[np.searchsorted(self._times, ordered[last])] = True
        return known, column[rows[by_time[last]]]

    def _check_restart(self, name: str, rows: NDArray[np.intp], t: Array) -> None:
        """Refuse a file whose clock restarts: sorting would shuffle two runs into one."""
        cuts = np.flatnonzero(t[1:] < t[:-1]) + 1
        starts, ends = np.concatenate(([0], cuts)), np.concatenate((cuts, [t.size]))
        long = ends - starts >= _RESTART_SAMPLES
        if np.count_nonzero(long) < 2:
            return
        starts, ends = starts[long], ends[long]
        for i in range(1, starts.size):
            overlap = min(t[ends[i] - 1], t[ends[i - 1] - 1]) - max(t[starts[i]], t[starts[i - 1]])
            if overlap > _RESTART_OVERLAP:
                back = t[ends[i - 1] - 1] - t[starts[i]]
                raise InputError(
                    f"{self._place}: the clock restarts at data row {rows[starts[i]] + 1} ({back:.6g} s "
                    f'back) and "{name}" is measured twice over {overlap:.6g} s; expected one run in a file: '
                    "split it there"
                )


def _count_missing(known: NDArray[np.bool_], own: Array) -> int:
    """Empty cells inside a channel that has a value in most rows, where they make a hole in its own time."""
    if own.size < 2 or 2 * own.size <= known.size:
        return 0
    steps = np.diff(own)
    hole = steps > 1.5 * np.median(steps)
    return int((np.diff(np.flatnonzero(known))[hole] - 1).sum())


@dataclass(frozen=True)
class Carried:
    """What a file says beside its table: source, notes, attributes, repairs, units of further channels, contents."""

    source: str = ""
    notes: tuple[str, ...] = ()
    attributes: Mapping[str, str] = field(default_factory=dict)
    repairs: Repairs | None = None
    units: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    contents: tuple[Content, ...] = ()


def recording_of_columns(
    path: Path,
    names: Sequence[str],
    read: ReadNumbers,
    mapping: ColumnMapping | str | os.PathLike[str] | None,
    carried: Carried | None = None,
) -> Recording:
    """Return the recording of a table with the columns `names`, of which `read` gives the numbers.

    Raises:
        InputError: no time, no measurement, a column that is missing or stands twice, or any trouble with the
            numbers.
    """
    carried = carried or Carried()
    if mapping is None:
        return _by_name(path, names, read, carried)
    if isinstance(mapping, ColumnMapping):
        return _by_mapping(path, names, read, mapping, "mapping: ")
    return _by_mapping(path, names, read, load_mapping(mapping), f"{mapping}: ")


def _by_name(path: Path, names: Sequence[str], read: ReadNumbers, carried: Carried) -> Recording:
    needed = [name for name in names if is_standard(name) or name in carried.units]
    if "t" not in names:
        hint = " (standard names are case sensitive)" if "T" in names else ""
        raise InputError(
            f'{path}:1: no column "t" (time in s){hint}; found {name_list(names)}; '
            f"name the columns with --map FILE.toml; {_DRAFT}"
        )
    if not needed:
        raise InputError(
            f"{path}:1: no column with a standard name (u, psi, cmd_..., ...); found {name_list(names)}; "
            f"name the columns with --map FILE.toml; {_DRAFT}"
        )
    _check_once(path, names, ["t", *needed])
    ignored = [name for name in names if name and name != "t" and name not in needed]
    notes = (*carried.notes, *_ignored_note(ignored))
    numbers = dict(read(["t", *needed]))
    t = numbers.pop("t")
    return assemble(
        t,
        numbers,
        place=str(path),
        source=carried.source or str(path),
        notes=notes,
        attributes=carried.attributes,
        repairs=carried.repairs,
        units=carried.units,
        contents=carried.contents,
    )


def _by_mapping(path: Path, names: Sequence[str], read: ReadNumbers, mapping: ColumnMapping, where: str) -> Recording:
    time, sources = mapping.time(names), mapping.channels()
    needed = dict.fromkeys(column.source for column in sources.values())
    if isinstance(time, Column):
        needed.setdefault(time.source)
    for name in needed:
        if name not in names:
            raise InputError(f'{where}no column "{name}" in {path}{nearest(name, names)}; it has {name_list(names)}')
    if time is None:
        raise InputError(
            f'{where}{path} has no column "t"; name its time under [columns] as t = "...", '
            f"or give the rate of its rows as rate = ... (Hz); it has {name_list(names)}"
        )
    if not sources:
        raise InputError(f"{where}the mapping names no measurement of {path}; add [columns] or thrusters")
    _check_once(path, names, list(needed))
    numbers = read(list(needed))
    if isinstance(time, Column):
        t = time.apply(numbers[time.source])
    else:
        t = np.arange(next(iter(numbers.values())).size) / time
    recording = assemble(
        t,
        {name: column.apply(numbers[column.source]) for name, column in sources.items()},
        place=str(path),
        source=str(path),
        notes=_ignored_note([name for name in names if name and name not in needed]),
    )
    return in_standard_frames(recording, mapping)


def in_standard_frames(recording: Recording, mapping: ColumnMapping) -> Recording:
    """Return what a mapping read, brought from its frames to NED and FRD and from its marker to the body origin."""
    recording = to_ned_frd(recording, body=mapping.body, world=mapping.world)
    if mapping.marker is not None:
        if "velocity" in mapping.marker.of:
            recording = with_body_velocity(recording).without(*WORLD_VELOCITY)  # these stay the marker's
        recording = marker_to_origin(recording, mapping.marker.position, mapping.marker.of)
    return recording


def _check_once(path: Path, names: Sequence[str], needed: Sequence[str]) -> None:
    counts = Counter(names)
    for name in needed:
        if counts[name] > 1:
            raise InputError(f'{path}:1: column "{name}" stands {counts[name]} times, expected once; rename the others')


def _ignored_note(names: Sequence[str]) -> tuple[str, ...]:
    return (f"ignored columns: {name_list(names)}",) if names else ()


def name_list(names: Sequence[str], most: int = 30) -> str:
    """Return names for a message, of many the first ones and how many more there are."""
    shown = [name or '""' for name in names[:most]]
    return ", ".join(shown) + (f" and {len(names) - most} more" if len(names) > most else "")
