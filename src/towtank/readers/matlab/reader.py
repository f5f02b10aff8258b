"""MATLAB files: vectors side by side, structs of them, arrays of structs, and Simulink's structures with time.

Every struct that holds a vector of times is a table of what stands in it at those times: vectors, the columns of
matrices as "name[k]", and structs within it that have no times of their own. Variables beside a time at the top level
are a table too.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.readers.common.tables import Table, Tables
from towtank.readers.matlab.variables import load_variables
from towtank.recording.channel import Channel
from towtank.recording.columns import assemble, in_standard_frames
from towtank.recording.grids.timing import sampling_rate
from towtank.recording.mapping import Column, ColumnMapping, load_mapping
from towtank.recording.recording import Recording
from towtank.recording.repairs import Content, Repairs
from towtank.recording.standard import is_standard

__all__ = ["read", "tables_of"]

_TIMES = ("t", "time", "Time", "times", "timestamp", "timestamps", "stamp", "tout")
_DATA = ("values", "Data", "data")
_FEWEST = 2  # times that make a table
_DAYS = (600_000.0, 900_000.0)  # datenum of the years 1643 to 2464
_TOP = "top level"


@dataclass(frozen=True)
class _Table:
    """Columns (n,) by path from the top level, at times (n,); `time` is the path of the times."""

    name: str
    time: str
    t: Array
    columns: Mapping[str, Array]


def read(path: Path, mapping: ColumnMapping | str | os.PathLike[str] | None = None) -> Recording:
    """Read a .mat file of any version; 7.3 takes h5py.

    Args:
        path: the file; of a damaged one what can be read is.
        mapping: "struct.field" or "struct.field[k]" columns, k from 0; without it the standard names are taken, at the
            top level or within structs, with a time beside them.

    Raises:
        InputError: the file is no .mat file, is damaged, or holds nothing that can be used.
    """
    variables, damaged = load_variables(path)
    tables = _tables(variables)
    lost = Repairs(damaged=damaged, details=("variables of the file are damaged",) if damaged else ())
    if mapping is not None:
        where = "mapping: " if isinstance(mapping, ColumnMapping) else f"{mapping}: "
        known = mapping if isinstance(mapping, ColumnMapping) else load_mapping(mapping)
        return _mapped(path, variables, tables, known, where).with_notes(repairs=lost)
    return _by_name(path, variables, tables).with_notes(repairs=lost)


def tables_of(path: Path) -> Tables:
    """Return the tables of a file; the columns bear whole paths, as a mapping names them."""
    variables, _ = load_variables(path)
    found = {each.name: Table(each.name, each.t, each.columns, "MATLAB") for each in _tables(variables)}
    return Tables(str(path), found)


def _by_name(path: Path, variables: Mapping[str, Any], tables: list[_Table]) -> Recording:
    channels: dict[str, Channel] = {}
    used: dict[str, tuple[str, ...]] = {}
    notes: list[str] = []
    repairs = Repairs()
    standard = {table.name: _standard(table) for table in tables}
    for table in sorted(tables, key=lambda each: -len(standard[each.name])):
        own = {name: values for name, values in standard[table.name].items() if name not in channels}
        if not own:
            continue
        _check_unit(path, table)
        piece = assemble(table.t, own, place=f"{path}: {table.name}", source=str(path))
        channels.update(piece.channels)
        used[table.name] = piece.names
        repairs += piece.repairs
        notes += piece.notes
    if not channels:
        found = ", ".join(_paths(variables)[:20]) or "no numbers"
        raise InputError(
            f"{path}: no struct with a time (t, time) and standard names (u, psi, cmd_..., ...) beside it; "
            f"found {found}; name the columns with --map FILE.toml"
        )
    return Recording(channels, str(path), tuple(notes), {}, repairs, _contents(tables, used))


def _standard(table: _Table) -> dict[str, Array]:
    """Return the columns with standard names; Simulink's values bear the name of their struct."""
    found: dict[str, Array] = {}
    for full, values in table.columns.items():
        name = full.rpartition(".")[2]
        if not is_standard(name):
            name = re.sub(r"(\.signals(\[\d+\])?)?\.(values|Data|data)$", "", full).rpartition(".")[2]
        if is_standard(name) and name not in found:
            found[name] = values
    return found


def _check_unit(path: Path, table: _Table) -> None:
    """Refuse times in days, as MATLAB's datenum gives them."""
    known = table.t[np.isfinite(table.t)]
    if known.size and _DAYS[0] < known.min() and known.max() < _DAYS[1] and np.ptp(known) < 30.0:
        raise InputError(
            f'{path}: "{table.time}" is in days (datenum), expected seconds; map it: '
            f't = {{ from = "{table.time}", scale = 86400.0 }}'
        )


def _mapped(
    path: Path, variables: Mapping[str, Any], tables: list[_Table], mapping: ColumnMapping, where: str
) -> Recording:
    wanted = mapping.channels()
    if not wanted:
        raise InputError(f"{where}the mapping names no measurement of {path}; add [columns] or thrusters")
    shared = _mapped_time(path, variables, mapping, where)
    pieces: dict[bytes, tuple[Array, dict[str, Array]]] = {}
    used: dict[str, tuple[str, ...]] = {}
    for name, column in wanted.items():
        table = next((each for each in tables if column.source in each.columns), None)
        values = None if table is None else table.columns[column.source]
        if values is None:
            values = _vector(variables, column.source)
        if values is None:
            raise InputError(f"{where}{_missing(path, variables, tables, column.source)}")
        t = shared if isinstance(shared, np.ndarray) else None
        if isinstance(shared, float):
            t = np.arange(values.size) / shared
        elif t is None and table is not None:
            t = table.t
        if t is None or t.shape != values.shape:
            raise InputError(
                f'{where}"{column.source}" of {path} has {values.size} values, '
                + ("and no time beside it" if t is None else f"the time {t.size}")
                + '; name its time under [columns] as t = "...", or give rate = ... (Hz)'
            )
        pieces.setdefault(t.tobytes(), (t, {}))[1][name] = column.apply(values)
        if table is not None:
            used[table.name] = (*used.get(table.name, ()), name)
    channels: dict[str, Channel] = {}
    repairs = Repairs()
    notes: list[str] = []
    for t, columns in pieces.values():
        piece = assemble(t, columns, place=str(path), source=str(path))
        channels.update(piece.channels)
        repairs += piece.repairs
        notes += piece.notes
    ordered = {name: channels[name] for name in wanted if name in channels}
    recording = Recording(ordered, str(path), tuple(notes), {}, repairs, _contents(tables, used, "not named"))
    return in_standard_frames(recording, mapping)


def _mapped_time(path: Path, variables: Mapping[str, Any], mapping: ColumnMapping, where: str) -> Array | float | None:
    """Return the times that a mapping names, else its rate, else None: every table has its own."""
    time = mapping.time(())
    if not isinstance(time, Column):
        return time
    values = _vector(variables, time.source)
    if values is None:
        raise InputError(f"{where}{_missing(path, variables, [], time.source)}")
    return time.apply(values)


def _missing(path: Path, variables: Mapping[str, Any], tables: list[_Table], source: str) -> str:
    paths = [name for table in tables for name in table.columns] + _paths(variables)
    listed = list(dict.fromkeys(paths))
    return f'no vector "{source}" in {path}{nearest(source, listed)}; it has {", ".join(listed[:20]) or "no numbers"}'


def _vector(variables: Mapping[str, Any], source: str) -> Array | None:
    """Return the vector at a path: a vector, or a column of a matrix by [k]; None where there is none."""
    match = re.fullmatch(r"(.+)\[(\d+)\]", source)
    flat = _flat(variables, "")
    if source in flat and _is_vector(flat[source]):
        return _as_vector(flat[source])
    if match and match[1] in flat:
        matrix = np.squeeze(flat[match[1]])
        k = int(match[2])
        if matrix.ndim == 2:
            tall = matrix if matrix.shape[0] >= matrix.shape[1] else matrix.T
            return np.asarray(tall[:, k], dtype=np.float64) if k < tall.shape[1] else None
    return None


def _tables(variables: Mapping[str, Any]) -> list[_Table]:
    """Return a table for every struct with a vector of times, the top level among them."""
    found: list[_Table] = []
    _collect(variables, "", found)
    return found


def _collect(node: Any, path: str, found: list[_Table]) -> None:
    if isinstance(node, list):
        stacked = _stacked(node)
        if stacked is not None:
            _collect(stacked, path, found)
        else:
            for k, inner in enumerate(node):
                _collect(inner, f"{path}[{k}]", found)
        return
    if not isinstance(node, dict):
        return
    prefix = f"{path}." if path else ""
    time = _time_of(node)
    if time is not None:
        t = _as_vector(node[time])
        columns: dict[str, Array] = {}
        for full, values in _flat(node, prefix, timed=False).items():
            if full != f"{prefix}{time}":
                columns |= _columns(full, values, t.size)
        found.append(_Table(path or _TOP, f"{prefix}{time}", t, columns))
    for name, inner in node.items():
        _collect(inner, f"{prefix}{name}", found)


def _time_of(node: Mapping[str, Any]) -> str | None:
    """Return the field that holds the times of a struct."""
    return next((name for name in _TIMES if name in node and _is_vector(node[name])), None)


def _flat(node: Mapping[str, Any], prefix: str, *, timed: bool = True) -> dict[str, Array]:
    """Return the arrays of numbers within a struct by path, those in structs with times of their own or not."""
    arrays: dict[str, Array] = {}
    for name, value in node.items():
        full = f"{prefix}{name}"
        if isinstance(value, np.ndarray):
            arrays[full] = value
        elif isinstance(value, dict):
            if timed or _time_of(value) is None:
                arrays |= _flat(value, f"{full}.", timed=timed)
        elif isinstance(value, list):
            stacked = _stacked(value)
            parts = {full: stacked} if stacked is not None else {f"{full}[{k}]": each for k, each in enumerate(value)}
            for part, inner in parts.items():
                if isinstance(inner, dict) and (timed or _time_of(inner) is None):
                    arrays |= _flat(inner, f"{part}.", timed=timed)
    return arrays


def _stacked(structs: list[Any]) -> dict[str, Any] | None:
    """Return an array of structs with one number a field as one struct of vectors; None where it is none."""
    if len(structs) < _FEWEST or not all(isinstance(each, dict) for each in structs):
        return None
    names = [
        name
        for name in structs[0]
        if all(isinstance(each.get(name), np.ndarray) and each[name].size == 1 for each in structs)
    ]
    if not names:
        return None
    return {name: np.array([float(each[name].reshape(-1)[0]) for each in structs]) for name in names}


def _columns(full: str, values: Array, count: int) -> dict[str, Array]:
    """Return the columns (count,) of an array: a vector, or the columns of a matrix by [k], whichever way it lies."""
    values = np.squeeze(values)
    if values.shape == (count,):
        return {full: values.astype(np.float64)}
    if values.ndim != 2 or count not in values.shape:
        return {}
    tall = values if values.shape[0] == count else values.T
    return {f"{full}[{k}]": tall[:, k].astype(np.float64) for k in range(min(tall.shape[1], 64))}


def _is_vector(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.size >= _FEWEST and value.size == max(value.shape)


def _as_vector(value: Array) -> Array:
    return np.asarray(value, dtype=np.float64).reshape(-1)


def _paths(variables: Mapping[str, Any]) -> list[str]:
    return [name for name, values in _flat(variables, "").items() if _is_vector(values)]


def _contents(
    tables: list[_Table], used: Mapping[str, tuple[str, ...]], otherwise: str = "no standard name"
) -> tuple[Content, ...]:
    lines = []
    for table in tables:
        known = np.unique(table.t[np.isfinite(table.t)])
        rate = sampling_rate(known) if known.size > 1 else None
        mine = used.get(table.name, ())
        lines.append(Content(table.name, "MATLAB", table.t.size, rate, mine, "" if mine else otherwise))
    return tuple(lines)
