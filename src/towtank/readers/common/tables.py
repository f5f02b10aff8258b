"""A decoded log: named tables of numbers, before anything is known of what they mean.

Columns of binary records are converted to float64 only where they are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording.grids.timing import sampling_rate
from towtank.recording.repairs import Repairs

__all__ = ["Place", "RecordColumns", "Table", "Tables", "texts"]


@dataclass(frozen=True, eq=False)
class Table:
    """The messages of one topic, of one message type, or of one instance of it.

    Attributes:
        name: "IMU[0]", "SERVO_OUTPUT_RAW", "/rov/dvl"; an instance stands in brackets, `@system.component` follows
            only where several senders send the same.
        t: times (n,) [s] on the log's clock, 0 at its first message, in the order received: they may be out of order
            or repeated, which `recording.assemble` mends and counts.
        columns: path of a field -> values (n,), NaN where there is none; nested fields by dots, elements of arrays by
            [k]: "pose.position.x", "channels[3]".
        kind: type of the messages: "sensor_msgs/msg/Imu", "DataFlash", "MAVLink", "JSON".
        frame: frame in which the messages say that they stand, "" where they do not.
        text: path of a field -> texts (n,), of the few that matter: names of frames, modes.
        stamp: the messages' own stamps (n,) [s], where they differ from the times of receipt; on a clock of their own,
            0 where `t` is 0 if the clocks agree.
    """

    name: str
    t: Array
    columns: Mapping[str, Array]
    kind: str = ""
    frame: str = ""
    text: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    stamp: Array | None = None

    def __post_init__(self) -> None:
        for path, column in self.columns.items():
            if column.shape != self.t.shape:
                raise InputError(f"{self.name}.{path}: found {column.shape} values for {self.t.shape} times")

    def __len__(self) -> int:
        return int(self.t.size)

    def __contains__(self, path: object) -> bool:
        return path in self.columns

    def __getitem__(self, path: str) -> Array:
        return self.columns[path]

    def get(self, path: str) -> Array | None:
        """Return a column, None where there is none."""
        return self.columns.get(path)

    @property
    def rate(self) -> float | None:
        """Usual rate [Hz], None for fewer than two times."""
        known = np.unique(self.t[np.isfinite(self.t)])
        return sampling_rate(known) if known.size > 1 else None

    def rows(self, start: int, stop: int) -> Table:
        """Return the messages start .. stop - 1 alone."""
        part = slice(start, stop)
        return Table(
            self.name,
            self.t[part],
            {path: column[part] for path, column in self.columns.items()},
            self.kind,
            self.frame,
            {path: texts[part] for path, texts in self.text.items()},
            None if self.stamp is None else self.stamp[part],
        )


@dataclass(frozen=True, eq=False)
class Tables:
    """A decoded file.

    Attributes:
        source: the file, as messages name it.
        tables: by name, in the order in which they first appear.
        parameters: of the autopilot, the last value of each.
        notes: remarks for a person.
        repairs: what could not be decoded, counted.
        attributes: of the recording; "clock" says which clock `t` is on, "epoch" is t = 0 as ISO 8601 UTC where the
            log knows it.
    """

    source: str
    tables: Mapping[str, Table]
    parameters: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    repairs: Repairs = field(default_factory=Repairs)
    attributes: Mapping[str, str] = field(default_factory=dict)

    def named(self, kind: str) -> list[Table]:
        """Return the tables of a message type, every instance and sender: "IMU" finds IMU, IMU[1] and IMU@1.1."""
        return [table for name, table in self.tables.items() if _type_of(name) == kind]


def _type_of(name: str) -> str:
    return name.partition("@")[0].partition("[")[0]


class Place(NamedTuple):
    """Where a column stands: field of the record, element of it where it is an array, what it is divided by."""

    field: str
    element: int | None = None
    divisor: float = 1.0


class RecordColumns(Mapping[str, Array]):
    """The numbers of records (n,) by column."""

    def __init__(self, rows: NDArray[Any], places: Mapping[str, Place]) -> None:
        self._rows, self._places = rows, places

    def __getitem__(self, name: str) -> Array:
        field, element, divisor = self._places[name]
        values = self._rows[field] if element is None else self._rows[field][:, element]
        numbers: Array = values.astype(np.float64)
        return numbers if divisor == 1.0 else numbers / divisor

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> RecordColumns:
        """Return the columns of some of the records."""
        return RecordColumns(self._rows[rows], self._places)


def texts(rows: NDArray[Any], field: str) -> tuple[str, ...]:
    """Return a field of text of each record, up to its first zero byte."""
    return tuple(value.split(b"\0")[0].decode("utf-8", errors="replace") for value in rows[field].tolist())
