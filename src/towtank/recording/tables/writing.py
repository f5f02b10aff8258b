"""The files that a Recording is written to, by suffix."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.recording.recording import Recording

__all__ = ["WRITABLE", "write_recording"]

_WRITERS = {
    ".csv": ("tables.csv", "write_csv"),
    ".parquet": ("tables.parquet", "write_parquet"),
    ".mcap": ("mcap.write", "write_mcap"),
}
WRITABLE: tuple[str, ...] = tuple(_WRITERS)


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as its suffix says, whole or not at all.

    Raises:
        InputError: the suffix is none of `WRITABLE`, or the file cannot be written there.
    """
    suffix = Path(path).suffix
    if suffix.lower() not in _WRITERS:
        raise InputError(f'{path}: cannot write "{suffix}" files; expected one of {", ".join(WRITABLE)}')
    module, function = _WRITERS[suffix.lower()]
    getattr(importlib.import_module(f"towtank.recording.{module}"), function)(recording, path)
