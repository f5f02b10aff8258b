"""Columns of binary records: a number is converted to float64 only where it is asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array

__all__ = ["Place", "RecordColumns", "texts"]


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
