"""Which fields of a message are which channels: stated as a table, applied row by row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.sources import Quantity, Source
from towtank.readers.tables import Table

__all__ = ["DEGREE", "Reading", "in_order", "sources_of_table", "times_of"]

DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class Reading:
    """One quantity of a message type.

    Attributes:
        message: the type.
        quantity: what it tells. distance: steps from the sensor (`sources.Source`).
        fields: channel -> field, or field and scale: channel = scale * field.
        positive: a field that has to be above 0 where the message is valid.
    """

    message: str
    quantity: Quantity
    fields: Mapping[str, str | tuple[str, float]]
    distance: int = 0
    positive: str = ""

    def source(self, table: Table) -> Source | None:
        """Return the quantity as a table tells it, None where the table lacks a field."""
        plain = {name: (field, 1.0) if isinstance(field, str) else field for name, field in self.fields.items()}
        needed = [field for field, _ in plain.values()] + ([self.positive] if self.positive else [])
        if not all(field in table for field in needed):
            return None
        channels = {name: scale * table[field] for name, (field, scale) in plain.items()}
        if self.positive:
            valid = table[self.positive] > 0.0
            channels = {name: np.where(valid, values, np.nan) for name, values in channels.items()}
        return Source(table.name, self.quantity, times_of(table), channels, self.distance)


def times_of(table: Table) -> Array:
    """Return the times (n,) [s] of a table: its messages' own stamps where the clocks agree, else those of receipt."""
    return table.t if table.stamp is None else table.stamp


def sources_of_table(table: Table, kind: str, readings: Sequence[Reading]) -> list[Source]:
    """Return what the messages of one type tell."""
    found = (reading.source(table) for reading in readings if reading.message == kind)
    return [source for source in found if source is not None]


def in_order(sources: Iterable[Source], readings: Sequence[Reading], kind: Callable[[str], str]) -> list[Source]:
    """Return sources in the order in which their readings are stated, so that of equals the preferred one comes first.

    Args:
        sources: in any order, which holds among those of one message type.
        readings: the statement.
        kind: name of a table -> type of its messages.
    """
    places = {(reading.message, reading.quantity): i for i, reading in reversed(list(enumerate(readings)))}
    return sorted(sources, key=lambda source: places.get((kind(source.table), source.quantity), -1))
