"""Readers of log files: the content decides, the suffix where the content is silent; each yields a `Recording`."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from towtank.errors import InputError
from towtank.readers.recognition import FOLDER, HEAD, foreign_kind
from towtank.readers.registry import READERS, SUFFIXES, AnyMapping, Reader, formats

if TYPE_CHECKING:
    from towtank.recording.recording import Recording

__all__ = ["READERS", "SUFFIXES", "Reader", "read", "recognised"]


def read(path: str | os.PathLike[str], mapping: AnyMapping | Mapping[str, Any] = None) -> Recording:
    """Read a log: CSV, Parquet, ArduPilot .BIN or .log, MAVLink .tlog, ROS 1 or 2 bag, MCAP, MATLAB .mat.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        mapping: which column is which channel, where names, units or frames are its own, or where other messages are
            wanted than those that are taken by themselves: a `ColumnMapping`, its TOML file, or the tables of that file
            as a dictionary. In a log of messages a column is "TABLE.field".

    Raises:
        InputError: the file is missing, cannot be read, or nothing in it can be used. Nothing else escapes, however
            broken the file is.
    """
    path = Path(path)
    reader = recognised(path)
    import numpy as np

    if isinstance(mapping, Mapping):
        from towtank.recording.mapping import mapping_of

        mapping = mapping_of(mapping)
    from towtank.recording.consistency.rates import with_rates_in_radians

    try:
        with np.errstate(invalid="ignore", over="ignore"):  # a broken file holds any number
            return with_rates_in_radians(reader.read(path, mapping))
    except (InputError, MemoryError):
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:
        text = str(error).strip() or type(error).__name__
        raise InputError(f"{path}: damaged, cannot be read as {reader.name} ({text.splitlines()[0][:200]})") from error


def recognised(path: Path) -> Reader:
    """Return the reader of a file by its first bytes; nothing that is slow to import is needed for that.

    Raises:
        InputError: it is missing, empty, or of no kind that can be read.
    """
    return _reader_of(path, *_look(path))


def _look(path: Path) -> tuple[bytes, str]:
    """Return the first bytes of a file and its suffix; of a folder, those of its metadata.yaml and `FOLDER`."""
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            about = path / "metadata.yaml"
            if not about.is_file():
                raise InputError(f"{path}: this is a folder, expected a log file ({formats()}) or a ROS 2 bag")
            return about.read_bytes()[:HEAD], FOLDER
        if not stat.S_ISREG(mode):
            raise InputError(f"{path}: this is not a file, expected a log file ({formats()})")
        with path.open("rb") as stream:
            head = stream.read(HEAD)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if not head:
        raise InputError(f"{path}: the file is empty, expected a log ({formats()})")
    return head, path.suffix.lower()


def _reader_of(path: Path, head: bytes, suffix: str) -> Reader:
    kind = None if suffix == FOLDER else foreign_kind(head)
    if kind is None:
        for reader in READERS:
            if reader.recognises(head, suffix):
                return reader
        for reader in READERS:
            if suffix in reader.suffixes:
                return reader
    what = kind or ("a folder" if suffix == FOLDER else f'"{path.suffix}"' if suffix else "a file of unknown kind")
    raise InputError(f"{path}: cannot read this file ({what}); can be read: {formats()}")
