"""The table of readers: what each is called, which files it takes, and the module that is imported when it reads.

Nothing heavy is imported here, so that help texts may list the suffixes.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias

from towtank.readers import recognition

if TYPE_CHECKING:
    from towtank.recording.mapping import ColumnMapping
    from towtank.recording.recording import Recording

__all__ = ["READERS", "SUFFIXES", "AnyMapping", "Reader", "formats"]

AnyMapping: TypeAlias = "ColumnMapping | str | os.PathLike[str] | None"


class Reader(Protocol):
    """What reads one kind of file."""

    @property
    def name(self) -> str:
        """What the kind is called."""

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Suffixes that such files bear, in lower case."""

    def recognises(self, head: bytes, suffix: str) -> bool:
        """Whether a file is certainly of this kind, by its first 64 KiB (a folder: those of its metadata.yaml)."""

    def read(self, path: Path, mapping: AnyMapping) -> Recording:
        """Return the recording of a file; raise InputError where nothing in it can be read."""


@dataclass(frozen=True)
class _Lazy:
    """A reader whose module is imported on the first reading; there `read(path, mapping)` does it."""

    name: str
    suffixes: tuple[str, ...]
    module: str
    sign: Callable[[bytes, str], bool]
    function: str = "read"

    def recognises(self, head: bytes, suffix: str) -> bool:
        return self.sign(head, suffix)

    def read(self, path: Path, mapping: AnyMapping) -> Recording:
        recording: Recording = getattr(importlib.import_module(self.module), self.function)(path, mapping)
        return recording


def _is_table(head: bytes, suffix: str) -> bool:
    return recognition.is_text(head) and suffix not in _OTHERS


READERS: tuple[Reader, ...] = (
    _Lazy("Parquet", (".parquet",), "towtank.recording.tables.parquet", recognition.is_parquet, "read_parquet"),
    _Lazy("MCAP", (".mcap",), "towtank.readers.mcap.reader", recognition.is_mcap),
    _Lazy("ROS bag", (".bag", ".db3"), "towtank.readers.ros.reader", recognition.is_rosbag),
    _Lazy("MATLAB", (".mat",), "towtank.readers.matlab.reader", recognition.is_matlab),
    _Lazy("ArduPilot DataFlash", (".bin", ".log"), "towtank.readers.dataflash.reader", recognition.is_dataflash),
    _Lazy("MAVLink telemetry log", (".tlog",), "towtank.readers.mavlink.tlog", recognition.is_tlog),
    _Lazy("CSV", (".csv",), "towtank.recording.tables.csv", _is_table, "read_csv"),
)


SUFFIXES: tuple[str, ...] = tuple(dict.fromkeys(suffix for reader in reversed(READERS) for suffix in reader.suffixes))


_OTHERS = frozenset(SUFFIXES) - {".csv", ".log"}


def formats() -> str:
    """Return the suffixes that can be read, for a message."""
    return ", ".join(SUFFIXES)
