"""Parquet: the same table as CSV, with unit and frame in the metadata of each column."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as arrow_parquet

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.outputs import write_atomically
from towtank.recording.columns import Carried, recording_of_columns
from towtank.recording.mapping import ColumnMapping
from towtank.recording.recording import Recording
from towtank.recording.repairs import Content, Repairs
from towtank.recording.standard import is_standard, standard_of
from towtank.recording.tables.csv import numbers_of, to_table

__all__ = ["read_columns", "read_parquet", "write_parquet"]

_KEY = b"towtank"


def write_parquet(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write channels, units, frames, source, notes, attributes, repairs and contents to `path`."""
    table = to_table(recording)
    fields = [table.schema.field(0).with_metadata({"unit": "s"})]
    for i, channel in enumerate(recording.channels.values(), 1):
        fields.append(table.schema.field(i).with_metadata({"unit": channel.unit, "frame": channel.frame}))
    about = {
        "source": recording.source,
        "notes": list(recording.notes),
        "attributes": dict(recording.attributes),
        "repairs": asdict(recording.repairs),
        "contents": [asdict(content) for content in recording.contents],
    }
    table = table.cast(pa.schema(fields, metadata={_KEY: json.dumps(about).encode()}))
    write_atomically(path, lambda stream: arrow_parquet.write_table(table, stream, compression="zstd"))


def read_parquet(
    path: str | os.PathLike[str], mapping: ColumnMapping | str | os.PathLike[str] | None = None
) -> Recording:
    """Read a Parquet file with the columns of the CSV format; the inverse of `write_parquet`.

    Raises:
        InputError: the file is missing or not Parquet; a column is missing, is not numeric, or states another
            unit than the standard one; fewer than 4 samples.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: this is a folder, expected a Parquet file")
    try:
        schema = arrow_parquet.read_schema(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(_damaged(path)) from error
    units = {field.name: _unit(field) for field in schema if field.metadata and b"unit" in field.metadata}
    if mapping is None:
        _check_units(path, units)
    return recording_of_columns(
        path,
        tuple(schema.names),
        lambda needed: _read_numbers(path, schema, needed),
        mapping,
        _carried(path, schema, units),
    )


def read_columns(path: Path) -> dict[str, Array]:
    """Return every column (n,) that holds numbers, by its name. Raises InputError where the file cannot be read."""
    try:
        schema = arrow_parquet.read_schema(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(_damaged(path)) from error
    kinds = {field.name: field.type for field in schema}
    numbers = [name for name, kind in kinds.items() if pa.types.is_floating(kind) or pa.types.is_integer(kind)]
    return _read_numbers(path, schema, numbers)


def _read_numbers(path: Path, schema: pa.Schema, needed: Sequence[str]) -> dict[str, Array]:
    for name in needed:
        kind = schema.field(name).type
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind)):
            raise InputError(f'{path}: column "{name}" holds {kind}, expected numbers')
    try:
        table = arrow_parquet.read_table(path, columns=list(needed))
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(_damaged(path)) from error
    numbers = {name: numbers_of(table.column(name).cast(pa.float64(), safe=False)) for name in needed}
    del table
    pa.default_memory_pool().release_unused()  # as much again as the recording
    return numbers


def _unit(field: pa.Field) -> tuple[str, str]:
    return field.metadata[b"unit"].decode(), field.metadata.get(b"frame", b"").decode()


def _check_units(path: Path, units: Mapping[str, tuple[str, str]]) -> None:
    for name, (unit, frame) in units.items():
        expected = ("s", "") if name == "t" else standard_of(name)[:2] if is_standard(name) else None
        if expected is None:
            continue
        if unit != expected[0] or (frame and frame != expected[1]):
            raise InputError(
                f'{path}: column "{name}" is in "{unit}" ("{frame}"), '
                f'expected "{expected[0]}" ("{expected[1]}"); '
                "convert it with --map FILE.toml"
            )


def _carried(path: Path, schema: pa.Schema, units: Mapping[str, tuple[str, str]]) -> Carried:
    text = (schema.metadata or {}).get(_KEY)
    if text is None:
        return Carried(units={})
    own = {name: unit for name, unit in units.items() if name != "t" and not is_standard(name)}
    try:
        about: dict[str, Any] = json.loads(text)
        repairs: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in about["repairs"].items()
        }
        contents = tuple(Content(**{**each, "used": tuple(each["used"])}) for each in about.get("contents", ()))
        return Carried(about["source"], tuple(about["notes"]), about["attributes"], Repairs(**repairs), own, contents)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(
            f"{path}: the file is damaged where it tells its notes and repairs, expected them as it was written with; "
            "copy it again"
        ) from error


def _damaged(path: Path) -> str:
    return f"{path}: not a readable Parquet file: it is damaged or cut off, expected a whole one; copy it again"
