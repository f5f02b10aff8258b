"""Every column of numbers that a log holds, whatever it is called: what a mapping could name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.errors import InputError
from towtank.readers import recognised
from towtank.readers.common.tables import Tables
from towtank.recording.grids.timing import sampling_rate

__all__ = ["FoundColumn", "FoundTable", "found_tables"]

_TABLES = {
    "ArduPilot DataFlash": "towtank.readers.dataflash.reader",
    "MAVLink telemetry log": "towtank.readers.mavlink.tlog",
    "MATLAB": "towtank.readers.matlab.reader",
    "MCAP": "towtank.readers.mcap.reader",
    "ROS bag": "towtank.readers.ros.reader",
}
_COLUMNS = {"CSV": "towtank.recording.tables.csv", "Parquet": "towtank.recording.tables.parquet"}


@dataclass(frozen=True, eq=False)
class FoundColumn:
    """A column of numbers.

    Attributes:
        source: as a mapping names it. path: within its table. values: (n,), NaN where there is none.
    """

    source: str
    path: str
    values: Array

    @property
    def range(self) -> str:
        """Its values in words: "-0.21 .. 0.34", "always 3", "no values"."""
        known = self.values[np.isfinite(self.values)]
        if not known.size:
            return "no values"
        low, high = float(known.min()), float(known.max())
        return f"always {short(low)}" if low == high else f"{short(low)} .. {short(high)}"


@dataclass(frozen=True, eq=False)
class FoundTable:
    """The columns of a table; `name` is "" where the file has but one.

    Attributes:
        t: its own times (n,) [s], None where it has none. kind: type of its messages.
    """

    name: str
    columns: tuple[FoundColumn, ...]
    t: Array | None = None
    kind: str = ""

    @property
    def rate(self) -> float | None:
        """Usual rate [Hz] of its own times, None where it has none."""
        known = np.unique(self.t[np.isfinite(self.t)]) if self.t is not None else np.empty(0)
        return sampling_rate(known) if known.size > 1 else None


def found_tables(path: Path) -> list[FoundTable]:
    """Return the tables of a log, of any kind that can be read, those without numbers left out.

    Raises:
        InputError: the file is missing or damaged, or holds no number.
    """
    reader = recognised(path)
    try:
        with np.errstate(invalid="ignore", over="ignore"):
            if reader.name in _COLUMNS:
                columns = importlib.import_module(_COLUMNS[reader.name]).read_columns(path)
                tables = [_table("", columns, None, reader.name, joined=False)]
            else:
                found: Tables = importlib.import_module(_TABLES[reader.name]).tables_of(path)
                tables = [
                    _table(name, table.columns, table.t, table.kind, joined=reader.name != "MATLAB")
                    for name, table in found.tables.items()
                ]
    except (InputError, MemoryError):
        raise
    except Exception as error:
        text = str(error).strip() or type(error).__name__
        raise InputError(f"{path}: damaged, cannot be read as {reader.name} ({text.splitlines()[0][:200]})") from error
    tables = [table for table in tables if table.columns]
    if not tables:
        raise InputError(f"{path}: holds no column of numbers that a mapping could name")
    return tables


def _table(name: str, columns: Mapping[str, Array], t: Array | None, kind: str, *, joined: bool) -> FoundTable:
    """Return a table; `joined` where a mapping names its columns by "TABLE.field"."""
    found = (
        FoundColumn(f"{name}.{path}" if joined and name else path, path, values) for path, values in columns.items()
    )
    return FoundTable(name, tuple(found), t, kind)
