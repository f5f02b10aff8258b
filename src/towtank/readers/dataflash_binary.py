"""Decodes a binary DataFlash log (.BIN).

The log states its own formats, so that the records of each type are one structured array: a 16 MB log takes a fraction
of a second where a message at a time takes several (benchmarks/bench_readers.py proves both the same, then times them).
"""

from __future__ import annotations

from towtank.readers.dataflash_scan import scan
from towtank.readers.dataflash_tables import KEPT_TEXTS, Messages, Read, instance_fields, tables_of
from towtank.readers.record_columns import RecordColumns, texts
from towtank.readers.tables import Tables

__all__ = ["decode_binary"]


def decode_binary(data: bytes, source: str) -> Tables:
    """Return the tables of a log. Raises InputError where it holds no message with a time."""
    found = scan(data)
    messages: list[Messages] = []
    fields: dict[float, tuple[str, tuple[str, ...]]] = {}
    for form, offsets in found.records:
        rows = form.rows(data, offsets)
        columns = RecordColumns(rows, form.places)
        kept = [name for name in KEPT_TEXTS.get(form.name, ()) if name in form.columns and name not in columns]
        messages.append(Messages(form.name, offsets, columns, {name: texts(rows, form.field(name)) for name in kept}))
        fields[form.kind] = form.name, form.columns
    details = (f"{found.skipped} bytes that are no message were skipped",) if found.skipped else ()
    return tables_of(source, Read(messages, instance_fields(messages, fields), found.damaged, details))
