"""Decodes a DataFlash log that was turned into text (.log): one message a line, values scaled already."""

from __future__ import annotations

import re

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.tables import Tables
from towtank.readers.dataflash.tables import KEPT_TEXTS, Messages, Read, instance_fields, tables_of

__all__ = ["decode_text"]

_FORMATS_OF_TEXT = "nNZ"
_NAME = re.compile(r"[A-Za-z]\w{0,3}")


def decode_text(data: bytes, source: str) -> Tables:
    """Return the tables of a log. Raises InputError where it holds no message with a time."""
    lines: dict[str, list[tuple[int, list[str]]]] = {}
    formats: dict[str, tuple[float, str, tuple[str, ...]]] = {}
    damaged = 0
    for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines()):
        name, _, rest = line.partition(",")
        if name == "FMT":
            found = _format(rest)
            if found is None:
                damaged += 1
            else:
                formats[found[1]] = found[0], found[2], found[3]
        elif name in formats:
            last = len(formats[name][2]) - 1  # a text may hold commas
            lines.setdefault(name, []).append((number, [value.strip() for value in rest.split(",", last)]))
        elif line.strip():
            damaged += 1
    messages: list[Messages] = []
    for name, rows in lines.items():
        whole = [row for row in rows if len(row[1]) == len(formats[name][2])]
        damaged += len(rows) - len(whole)
        if whole:
            messages.append(_messages(name, formats[name][1], formats[name][2], whole))
    fields = {number: (name, columns) for name, (number, _, columns) in formats.items()}
    details = (f"{damaged} lines could not be read",) if damaged else ()
    return tables_of(source, Read(messages, instance_fields(messages, fields), damaged, details))


def _format(rest: str) -> tuple[float, str, str, tuple[str, ...]] | None:
    """Return number, name, letters and fields of a line "FMT, 150, 31, ATT, Qcccc, TimeUS,Roll,Pitch,Yaw"."""
    parts = [part.strip() for part in rest.split(",")]
    if len(parts) < 5 or not parts[0].isdecimal() or not _NAME.fullmatch(parts[2]):
        return None
    columns = tuple(part for part in parts[4:] if part)
    return (float(parts[0]), parts[2], parts[3], columns) if len(set(columns)) == len(parts) - 4 else None


def _messages(name: str, letters: str, columns: tuple[str, ...], rows: list[tuple[int, list[str]]]) -> Messages:
    numbers: dict[str, Array] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for i, column in enumerate(columns):
        cells = [row[1][i] for row in rows]
        if letters[i : i + 1] not in _FORMATS_OF_TEXT or not letters[i : i + 1]:
            numbers[column] = _numbers(cells)
        elif column in KEPT_TEXTS.get(name, ()):
            texts[column] = tuple(cells)
    return Messages(name, np.array([row[0] for row in rows], dtype=np.int64), numbers, texts)


def _numbers(cells: list[str]) -> Array:
    """Return the numbers (n,), NaN where a cell is none."""
    try:
        return np.array(cells, dtype=np.float64)
    except ValueError:
        return np.array([_number(cell) for cell in cells], dtype=np.float64)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan
