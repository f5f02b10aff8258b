"""Which columns of a table become which channels: by their standard names, or by a mapping."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording.assemble import assemble
from towtank.recording.contents import Content
from towtank.recording.conversion import to_ned_frd
from towtank.recording.lever_arm import marker_to_origin
from towtank.recording.mapping import Column, ColumnMapping, load_mapping
from towtank.recording.recording import Recording
from towtank.recording.repairs import Repairs
from towtank.recording.standard import WORLD_VELOCITY, is_standard
from towtank.recording.world_velocity import with_body_velocity

__all__ = ["Carried", "in_standard_frames", "recording_of_columns"]

ReadNumbers = Callable[[Sequence[str]], Mapping[str, Array]]


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
    wanted = [name for name in names if is_standard(name) or name in carried.units]
    if "t" not in names:
        hint = " (standard names are case sensitive)" if "T" in names else ""
        raise InputError(
            f'{path}:1: no column "t" (time in s){hint}; found {_listed(names)}; name the columns with --map FILE.toml'
        )
    if not wanted:
        raise InputError(
            f"{path}:1: no column with a standard name (u, psi, cmd_..., ...); found {_listed(names)}; "
            "name the columns with --map FILE.toml"
        )
    _check_once(path, names, ["t", *wanted])
    ignored = [name for name in names if name and name != "t" and name not in wanted]
    notes = (*carried.notes, *_ignored_note(ignored))
    numbers = dict(read(["t", *wanted]))
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
            raise InputError(f'{where}no column "{name}" in {path}{nearest(name, names)}; it has {_listed(names)}')
    if time is None:
        raise InputError(
            f'{where}{path} has no column "t"; name its time under [columns] as t = "...", '
            f"or give the rate of its rows as rate = ... (Hz); it has {_listed(names)}"
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


def _check_once(path: Path, names: Sequence[str], wanted: Sequence[str]) -> None:
    counts = Counter(names)
    for name in wanted:
        if counts[name] > 1:
            raise InputError(f'{path}:1: column "{name}" stands {counts[name]} times, expected once; rename the others')


def _ignored_note(names: Sequence[str]) -> tuple[str, ...]:
    return (f"ignored columns: {_listed(names)}",) if names else ()


def _listed(names: Sequence[str], most: int = 30) -> str:
    shown = [name or '""' for name in names[:most]]
    return ", ".join(shown) + (f" and {len(names) - most} more" if len(names) > most else "")
