"""From sources of quantities to a Recording that says of every table what it was used for, or why not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from towtank.errors import InputError
from towtank.readers.sources import Source, choose
from towtank.readers.tables import Tables
from towtank.recording.assemble import assemble
from towtank.recording.channel import Channel
from towtank.recording.contents import Content
from towtank.recording.recording import Recording

__all__ = ["contents_of", "recording_of", "table_names"]

_UNKNOWN = "holds nothing that towtank takes by itself"


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
    return Recording(
        channels, tables.source, tuple(dict.fromkeys(notes)), dict(tables.attributes), repairs, contents=contents
    )


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
    names = list(tables.tables)
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "") or "no messages"
