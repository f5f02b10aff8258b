"""What is wrong with a CSV file, by line and column; and a patient reader for what the fast one refuses."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError

__all__ = ["check_header", "read_slowly"]

_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|inf(?:inity)?|nan)?", re.IGNORECASE | re.ASCII)


def check_header(path: Path, line: str, names: Sequence[str]) -> None:
    """Raise InputError for a first line that does not hold the names of comma separated columns."""
    if not line.strip():
        raise InputError(f"{path}:1: the first line is blank, expected the names of the columns")
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(names) <= line.count(separator):
            raise InputError(
                f"{path}:1: the columns are separated by {word}, expected commas (and decimal points); "
                "save it as comma separated values"
            )
    if all(_is_number(name) for name in names):
        raise InputError(
            f'{path}:1: the first line holds numbers ("{_shown(line)}"), expected the names of the columns'
        )


def read_slowly(path: Path, names: Sequence[str], wanted: Sequence[str]) -> dict[str, Array]:
    """Return the wanted columns, or raise InputError with line, column and content of the first fault."""
    indices = [names.index(name) for name in wanted]
    columns: list[list[float]] = [[] for _ in wanted]
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        reader = csv.reader(_without_nul(stream, path))
        line = 1
        try:
            next(reader)
            line = reader.line_num + 1
            for row in reader:
                if row and not (len(row) == 1 and len(names) > 1 and not row[0].strip()):
                    if len(row) != len(names):
                        raise InputError(
                            f"{path}:{line}: found {len(row)} cells, expected {len(names)} "
                            f"(one for each name in the first line){_comma_hint(row, names)}"
                            f"{_cut_hint(path, stream)}"
                        )
                    for i, name, column in zip(indices, wanted, columns, strict=True):
                        column.append(_number(path, line, i + 1, name, row[i]))
                line = reader.line_num + 1
        except csv.Error as error:
            raise InputError(f"{path}:{line}: not readable as CSV ({error})") from error
    return {name: np.array(column) for name, column in zip(wanted, columns, strict=True)}


def _without_nul(stream: Iterable[str], path: Path) -> Iterator[str]:
    for number, text in enumerate(stream, 1):
        if "\0" in text:
            raise InputError(f"{path}:{number}: found a NUL character, expected text; the file may be damaged there")
        yield text


def _number(path: Path, line: int, column: int, name: str, cell: str) -> float:
    text = cell.strip()
    if not text:
        return float("nan")
    if text[-1] not in "+-" and _is_number(text):
        return float(text)
    hint = "; decimals take a point, not a comma" if _is_number(text.replace(",", ".", 1)) else ""
    raise InputError(
        f'{path}:{line}:{column}: found "{_shown(cell)}" in column "{name}", '
        f"expected a number (empty or NaN where not measured){hint}"
    )


def _is_number(text: str) -> bool:
    return bool(text) and _NUMBER.fullmatch(text) is not None


def _comma_hint(row: Sequence[str], names: Sequence[str]) -> str:
    doubled = len(row) == 2 * len(names) and all(_is_number(cell.strip()) for cell in row)
    return "; decimals take a point, not a comma" if doubled else ""


def _cut_hint(path: Path, stream: TextIO) -> str:
    """A hint where the row just read is the last of the file and lacks its end."""
    if stream.read(1):
        return ""
    with path.open("rb") as raw:
        raw.seek(-1, os.SEEK_END)
        return "" if raw.read(1) == b"\n" else "; the last line is cut off: delete it"


def _shown(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."
