"""Readers of log files: the suffix and the first bytes choose one, and every one yields a `Recording`."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from towtank.errors import InputError
from towtank.recording.csv_read import read_csv
from towtank.recording.mapping import ColumnMapping
from towtank.recording.parquet import read_parquet
from towtank.recording.recording import Recording

__all__ = ["SUFFIXES", "read"]

Mapping = ColumnMapping | str | os.PathLike[str] | None
SUFFIXES: dict[str, Callable[[str | os.PathLike[str], Mapping], Recording]] = {
    ".csv": read_csv,
    ".parquet": read_parquet,
}
_TEXT_SUFFIXES = ("", ".txt", ".dat", ".log")
_KNOWN_CONTENT = {
    b"\xa3\x95": "ArduPilot DataFlash",
    b"\x89MCAP0": "MCAP",
    b"#ROSBAG": "a ROS 1 bag",
    b"MATLAB 5.0": "MATLAB",
    b"\x89HDF": "HDF5",
    b"\x1f\x8b": "gzip, unpack it first",
    b"PK\x03\x04": "a zip archive or a spreadsheet, unpack it or save it as CSV",
}


def read(path: str | os.PathLike[str], mapping: Mapping = None) -> Recording:
    """Read a log file.

    Args:
        path: `.csv` or `.parquet`; a Parquet file is known by its content whatever its name.
        mapping: for columns with names, units or frames of their own: a `ColumnMapping` or its TOML file.

    Raises:
        InputError: the file is missing, cannot be read, or is of a kind that cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: this is a folder, expected a log file ({', '.join(SUFFIXES)})")
    try:
        with path.open("rb") as stream:
            head = stream.read(16)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if head.startswith(b"PAR1"):
        return read_parquet(path, mapping)
    kind = next((name for magic, name in _KNOWN_CONTENT.items() if head.startswith(magic)), None)
    suffix = path.suffix.lower()
    if kind is None and suffix in SUFFIXES:
        return SUFFIXES[suffix](path, mapping)
    if kind is None and suffix in _TEXT_SUFFIXES:
        return read_csv(path, mapping)
    what = kind or (f'"{path.suffix}"' if suffix else "a file of unknown kind")
    raise InputError(f"{path}: cannot read this file ({what}); can be read: {', '.join(SUFFIXES)}")
