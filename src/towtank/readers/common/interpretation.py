"""From a log's tables to a Recording: the fields that are channels, and of every table its use, or why it has none."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.readers.ardupilot.frame import frame_of
from towtank.readers.common.sources import Quantity, Source, choose
from towtank.readers.common.tables import Table, Tables
from towtank.recording.channel import Channel
from towtank.recording.columns import assemble, name_list
from towtank.recording.recording import Recording
from towtank.recording.repairs import Content

__all__ = [
    "DEGREE",
    "Reading",
    "contents_of",
    "in_order",
    "recording_of",
    "sources_of_table",
    "table_names",
    "times_of",
]

_UNKNOWN = "holds nothing that towtank takes by itself"
DEGREE = np.pi / 180.0


def recording_of(tables: Tables, sources: Sequence[Source], *, reasons: Mapping[str, str] | None = None) -> Recording:
    """Return the recording of a log: of each quantity the best source, each at its own times.

    Args:
        tables: the decoded log.
        sources: every source of a quantity found in it, refused ones as well.
        reasons: table -> why nothing is taken from it, where there is more to say than that it is unknown.

    Raises:
        InputError: nothing in the log can be used, or a clock restarts.
    """
    choice = choose(sources)
    why = _grouped(choice.reasons)
    if not choice.used:
        refused = next((f"; {source.table}: {source.refused}" for source in sources if source.refused), "")
        raise InputError(
            f"{tables.source}: no message that can be used{refused}; it has {table_names(tables)}; "
            'name what is what with --map FILE.toml (u = "TABLE.field")'
        )
    channels: dict[str, Channel] = {}
    used: dict[str, list[str]] = {}
    repairs, notes = tables.repairs, list(tables.notes)
    for source in choice.used:
        place = f"{tables.source}: {source.table}"
        piece = assemble(source.t, source.channels, place=place, source=tables.source)
        channels.update(piece.channels)
        used.setdefault(source.table, []).extend(piece.names)
        repairs += piece.repairs
        notes += [f"{source.table}: {note}" for note in piece.notes]
        notes += [source.note] if source.note else []
    contents = contents_of(tables, used, {**(reasons or {}), **why})
    attributes = {**tables.attributes, **frame_of(tables.parameters)}
    return Recording(channels, tables.source, tuple(dict.fromkeys(notes)), attributes, repairs, contents=contents)


def _grouped(reasons: Iterable[tuple[Source, str]]) -> dict[str, str]:
    """Return table -> "velocity, position: this; attitude: that"."""
    by_table: dict[str, dict[str, list[str]]] = {}
    for source, reason in reasons:
        by_table.setdefault(source.table, {}).setdefault(reason, []).append(source.quantity)
    return {
        table: "; ".join(f"{', '.join(dict.fromkeys(quantities))}: {reason}" for reason, quantities in own.items())
        for table, own in by_table.items()
    }


def contents_of(
    tables: Tables, used: Mapping[str, Iterable[str]], reasons: Mapping[str, str], otherwise: str = _UNKNOWN
) -> tuple[Content, ...]:
    """Return one line for each table; `otherwise` is the reason of those that are neither used nor explained."""
    return tuple(
        Content(
            name,
            table.kind,
            len(table),
            table.rate,
            tuple(used.get(name, ())),
            reasons.get(name, "" if name in used else otherwise),
        )
        for name, table in tables.tables.items()
    )


def table_names(tables: Tables, most: int = 20) -> str:
    """Return the names of the tables for a message."""
    return name_list(list(tables.tables), most) or "no messages"


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
