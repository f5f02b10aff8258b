"""A decoded log read by a mapping: its columns are "TABLE.field", and each channel keeps its table's own times.

    thrusters = ["RCOU.C1", "RCOU.C2"]
    [columns]
    p = "IMU[0].GyrX"
    u = "/rov/dvl.twist.linear.x"

The messages bring their own times, so that the mapping names none; `t = "stamp"` takes the messages' own stamps in
place of the times of receipt, where both are recorded.
"""

from __future__ import annotations

import os
import re

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.readers.common.interpretation import contents_of, table_names
from towtank.readers.common.tables import Table, Tables
from towtank.recording.channel import Channel
from towtank.recording.columns import assemble, in_standard_frames, name_list
from towtank.recording.mapping import ColumnMapping, load_mapping
from towtank.recording.recording import Recording

__all__ = ["mapped_recording"]

_STAMP = "stamp"
_BRACKETS = re.compile(r"\[[^]]*\]|@[\d.]*\d")  # instance and sender in the name of a table


def mapped_recording(tables: Tables, mapping: ColumnMapping | str | os.PathLike[str]) -> Recording:
    """Return the recording of what the mapping names, and of nothing else.

    Raises:
        InputError: the mapping names a time or a rate, a table or field that the log lacks, or nothing at all; fewer
            than 4 samples; a clock that restarts.
    """
    where = "mapping: " if isinstance(mapping, ColumnMapping) else f"{mapping}: "
    known = mapping if isinstance(mapping, ColumnMapping) else load_mapping(mapping)
    stamped = _takes_stamps(tables, known, where)
    wanted = known.channels()
    if not wanted:
        raise InputError(f"{where}the mapping names no measurement of {tables.source}; add [columns] or thrusters")
    pieces: dict[str, dict[str, Array]] = {}
    for name, column in wanted.items():
        table, path = _find(tables, column.source, where)
        pieces.setdefault(table.name, {})[name] = column.apply(table[path])
    channels: dict[str, Channel] = {}
    used: dict[str, tuple[str, ...]] = {}
    repairs, notes = tables.repairs, list(tables.notes)
    for table_name, columns in pieces.items():
        table = tables.tables[table_name]
        times = table.stamp if stamped and table.stamp is not None else table.t
        piece = assemble(times, columns, place=f"{tables.source}: {table_name}", source=tables.source)
        channels.update(piece.channels)
        used[table_name] = piece.names
        repairs += piece.repairs
        notes += [f"{table_name}: {note}" for note in piece.notes]
    ordered = {name: channels[name] for name in wanted if name in channels}
    contents = contents_of(tables, used, {}, "not named by the mapping")
    recording = Recording(ordered, tables.source, tuple(notes), dict(tables.attributes), repairs, contents=contents)
    return in_standard_frames(recording, known)


def _takes_stamps(tables: Tables, mapping: ColumnMapping, where: str) -> bool:
    """Return whether the messages' own stamps are asked for; refuse any other time."""
    if mapping.rate is not None:
        raise InputError(f"{where}rate = {mapping.rate:g}: the messages of {tables.source} have times; leave it out")
    time = mapping.columns.get("t")
    if time is None:
        return False
    if time.source != _STAMP or (time.scale, time.offset) != (1.0, 0.0):
        raise InputError(
            f'{where}columns.t: found "{time.source}", but the messages of {tables.source} have times; leave it out, '
            f'or write t = "{_STAMP}" for the messages\' own stamps'
        )
    if not any(table.stamp is not None for table in tables.tables.values()):
        raise InputError(
            f'{where}columns.t: found "{_STAMP}", but {tables.source} has messages without stamps of their own'
        )
    return True


def _find(tables: Tables, source: str, where: str) -> tuple[Table, str]:
    """Return the table and the field of "TABLE.field"; either part may hold dots, the longest table wins."""
    for name in sorted(tables.tables, key=len, reverse=True):
        path = source.removeprefix(f"{name}.")
        if path != source and path in tables.tables[name]:
            return tables.tables[name], path
    owner = max((name for name in tables.tables if source.startswith(f"{name}.")), key=len, default=None)
    if owner is not None:
        fields = tables.tables[owner].columns
        hint = nearest(source, (f"{owner}.{path}" for path in fields))
        raise InputError(f'{where}no "{source}" in {tables.source}{hint}; {owner} has {name_list(list(fields))}')
    paths = [f"{name}.{path}" for name, table in tables.tables.items() for path in table.columns]
    instance = next((path for path in paths if _BRACKETS.sub("", path) == _BRACKETS.sub("", source)), None)
    hint = nearest(source, paths) if instance is None else f'; did you mean "{instance}"?'
    raise InputError(
        f'{where}no "{source}" in {tables.source}{hint}; expected TABLE.field, '
        f"where TABLE is one of {table_names(tables)}"
    )
