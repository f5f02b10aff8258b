"""CSV as of the contract: one row per time, SI, NED/FRD, an empty cell or NaN where not measured."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording.columns import recording_of_columns
from towtank.recording.csv_diagnosis import check_header, read_slowly
from towtank.recording.mapping import ColumnMapping
from towtank.recording.recording import Recording

__all__ = ["read_csv"]

_MISSING = ("", "NaN", "nan", "NAN", "-nan", "-NaN")


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
    return recording_of_columns(path, names, lambda wanted: _read_numbers(path, names, wanted), mapping)


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
        raise InputError(f"{path}:1: cannot be read as a line of column names ({error})") from error
    check_header(path, line, names)
    return names


def _read_numbers(path: Path, names: Sequence[str], wanted: Sequence[str]) -> dict[str, Array]:
    """Columns as float64, NaN where empty. On any trouble a slower reader says exactly where it is."""
    indices = [names.index(name) for name in wanted]
    keys = [f"c{i}" for i in range(len(names))]
    try:
        table = arrow_csv.read_csv(
            path,
            read_options=arrow_csv.ReadOptions(column_names=keys, skip_rows=1, block_size=1 << 23),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=[keys[i] for i in indices],
                column_types={keys[i]: pa.float64() for i in indices},
                null_values=list(_MISSING),
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return read_slowly(path, names, wanted)
    numbers = {name: _to_numpy(table.column(keys[i])) for name, i in zip(wanted, indices, strict=True)}
    del table
    pa.default_memory_pool().release_unused()
    return numbers


def _to_numpy(column: pa.ChunkedArray) -> Array:
    values: Array = np.array(column.to_numpy(), dtype=np.float64)
    return values
