"""CSV: one row per distinct time, SI, NED/FRD, an empty cell or NaN where not measured.

What the fast reader refuses a patient one reads, and names what is wrong by line and column.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, TextIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.outputs import write_atomically
from towtank.recording.columns import recording_of_columns
from towtank.recording.mapping import ColumnMapping
from towtank.recording.recording import Recording
from towtank.recording.tables.dataframes import on_all_times

__all__ = ["numbers_of", "read_columns", "read_csv", "to_table", "write_csv"]

_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|inf(?:inity)?|nan)?", re.IGNORECASE | re.ASCII)
_NOT_A_NUMBER = pa.Array.from_buffers(pa.float64(), 1, [None, pa.py_buffer(np.array([np.nan]))])[0]
_MISSING = ("", "NaN", "nan", "NAN", "-nan", "-NaN")


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


def read_slowly(path: Path, names: Sequence[str], needed: Sequence[str]) -> dict[str, Array]:
    """Return the columns `needed`, or raise InputError with line, column and content of the first fault."""
    indices = [names.index(name) for name in needed]
    columns: list[list[float]] = [[] for _ in needed]
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
                    for i, name, column in zip(indices, needed, columns, strict=True):
                        column.append(_number(path, line, i + 1, name, row[i]))
                line = reader.line_num + 1
        except csv.Error as error:
            raise InputError(
                f"{path}:{line}: found a cell or a quotation that does not end, expected a number in each cell"
            ) from error
    return {name: np.array(column) for name, column in zip(needed, columns, strict=True)}


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


def read_csv(path: str | os.PathLike[str], mapping: ColumnMapping | str | os.PathLike[str] | None = None) -> Recording:
    """Read a CSV file. Without a mapping its columns bear standard names and `t`; others are ignored and
    noted.

    Args:
        path: the file, UTF-8, comma separated, the names of the columns in the first line.
        mapping: a `ColumnMapping` or the TOML file of one.

    Raises:
        InputError: the file is missing, empty or not a CSV; a column is missing; a cell is not a number
            (file:line:column); fewer than 4 samples.
    """
    path = Path(path)
    names = _read_header(path)
    return recording_of_columns(path, names, lambda needed: _read_numbers(path, names, needed), mapping)


def read_columns(path: Path) -> dict[str, Array]:
    """Return every column (n,) that holds numbers, by its name in the first line; others, and doubles, are left out.

    Raises:
        InputError: the file is no CSV, or a line has more or fewer cells than the first.
    """
    names = _read_header(path)
    keys = [f"c{i}" for i in range(len(names))]
    try:
        table = arrow_csv.read_csv(
            pa.OSFile(os.fsencode(path)),  # as text, a name that is not UTF-8 is refused
            read_options=arrow_csv.ReadOptions(column_names=keys, skip_rows=1, block_size=1 << 23),
            convert_options=arrow_csv.ConvertOptions(null_values=list(_MISSING), strings_can_be_null=True),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        read_slowly(path, names, [])  # says where
        raise InputError(f"{path}: cannot be read as CSV ({error})") from error
    found: dict[str, Array] = {}
    for name, key in zip(names, keys, strict=True):
        kind = table.schema.field(key).type
        if name and names.count(name) == 1 and (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            found[name] = numbers_of(table.column(key).cast(pa.float64(), safe=False))
    return found


def _read_header(path: Path) -> tuple[str, ...]:
    if path.is_dir():
        raise InputError(f"{path}: this is a folder, expected a CSV file")
    try:
        with path.open("rb") as stream:
            first = stream.readline(1 << 20)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if not first:
        raise InputError(f"{path}: the file is empty, expected a line of column names")
    if b"\0" in first or first[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(f"{path}: not a text file in UTF-8, expected a CSV; save it as UTF-8 text")
    line = first.decode("utf-8-sig", errors="replace").rstrip("\r\n")
    try:
        names = tuple(name.strip() for name in next(csv.reader([line]), []))
    except csv.Error as error:
        raise InputError(
            f"{path}:1: found a line of {len(line)} characters that names no columns, expected names with commas "
            "between them, the line ended by LF or CR LF"
        ) from error
    check_header(path, line, names)
    return names


def _read_numbers(path: Path, names: Sequence[str], needed: Sequence[str]) -> dict[str, Array]:
    """Columns as float64, NaN where empty. On any trouble a slower reader says exactly where it is."""
    indices = [names.index(name) for name in needed]
    keys = [f"c{i}" for i in range(len(names))]
    try:
        table = arrow_csv.read_csv(
            pa.OSFile(os.fsencode(path)),  # as text, a name that is not UTF-8 is refused
            read_options=arrow_csv.ReadOptions(column_names=keys, skip_rows=1, block_size=1 << 23),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=[keys[i] for i in indices],
                column_types={keys[i]: pa.float64() for i in indices},
                null_values=list(_MISSING),
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return read_slowly(path, names, needed)
    numbers = {name: numbers_of(table.column(keys[i])) for name, i in zip(needed, indices, strict=True)}
    del table
    pa.default_memory_pool().release_unused()
    return numbers


def numbers_of(column: pa.ChunkedArray) -> Array:
    """Return a column of float64, NaN where null.

    Not by `to_numpy`, which imports pandas wherever that is installed: most of a second of a command's start.
    """
    filled = column.fill_null(_NOT_A_NUMBER) if column.null_count else column
    values: Array = np.array(np.from_dlpack(filled.combine_chunks()))
    return values


def to_table(recording: Recording) -> pa.Table:
    """Return the Arrow table of a recording: `t`, then the channels, null where not measured."""
    times, channels = on_all_times(recording)
    columns = [pa.array(times), *(pa.array(values, from_pandas=True) for values in channels.values())]
    return pa.Table.from_arrays(columns, names=["t", *channels])


def write_csv(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write the channels to `path`; every number reads back as exactly the same float64.

    Units, frames, notes and attributes have no place in a CSV; Parquet keeps them.
    """
    table = to_table(recording)
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(table.column_names)

    def write(stream: BinaryIO) -> None:
        stream.write(header.getvalue().encode())
        arrow_csv.write_csv(table, stream, arrow_csv.WriteOptions(include_header=False))

    write_atomically(path, write)
