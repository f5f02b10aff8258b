"""Decodes a binary DataFlash log (.BIN), whatever its damage.

The log states its own formats: a record of type FMT names a type, the length of its records, one letter for the type of
each field, and the fields. So the records of each type are one structured array: a 16 MB log takes a fraction of a
second where a message at a time takes several (benchmarks/bench_readers.py proves both the same, then times them).

All records begin with the bytes A3 95 and the number of their type, and each says where the next one begins, so that a
whole log is walked record by record. There are no checksums: a record counts only where it is followed by another one,
by the end of the file or by the padding of a flash page. After any other bytes the walk goes on at the next place from
which two records follow one another.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from towtank.readers.common.tables import Place, RecordColumns, Tables, texts
from towtank.readers.dataflash.tables import KEPT_TEXTS, Messages, Read, instance_fields, tables_of

__all__ = ["LETTERS", "Scan", "decode_binary"]

HEADER = b"\xa3\x95"
FMT_KIND = 0x80
# letter -> type of the field as NumPy names it, what its number is divided by; None: text
LETTERS: dict[str, tuple[str, float | None]] = {
    "a": ("32<i2", 1.0),
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "g": ("<f2", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "n": ("S4", None),
    "N": ("S16", None),
    "Z": ("S64", None),
    "c": ("<i2", 1e2),
    "C": ("<u2", 1e2),
    "e": ("<i4", 1e2),
    "E": ("<u4", 1e2),
    "L": ("<i4", 1e7),
    "M": ("u1", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}
_NAME = re.compile(r"[A-Za-z]\w{0,3}")
_COLUMN = re.compile(r"\w+")
_PADDING = b"\0\xff"
_MOST_FORMATS = 8  # that one number may have in turn; a log states each once, two logs in one file twice


@dataclass(frozen=True)
class MessageFormat:
    """One message type: number, name, length of its records [bytes], a letter and a name for each field."""

    kind: int
    name: str
    length: int
    letters: str
    columns: tuple[str, ...]

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The record without its header, fields named f0, f1, ..."""
        return np.dtype([(f"f{i}", LETTERS[letter][0]) for i, letter in enumerate(self.letters)])

    @property
    def fits(self) -> bool:
        """Whether letters, columns and length agree, so that records can be decoded."""
        return (
            bool(_NAME.fullmatch(self.name))
            and all(letter in LETTERS for letter in self.letters)
            and 0 < len(self.columns) <= len(self.letters)
            and len(set(self.columns)) == len(self.columns)
            and all(_COLUMN.fullmatch(column) for column in self.columns)
            and self.dtype.itemsize + len(HEADER) + 1 == self.length
        )

    @property
    def places(self) -> dict[str, Place]:
        """Where each column of numbers stands; texts are left out."""
        found: dict[str, Place] = {}
        for i, (name, letter) in enumerate(zip(self.columns, self.letters, strict=False)):
            divisor = LETTERS[letter][1]
            if letter == "a":
                found |= {f"{name}[{k}]": Place(f"f{i}", k) for k in range(32)}
            elif divisor is not None:
                found[name] = Place(f"f{i}", None, divisor)
        return found

    def field(self, column: str) -> str:
        """Return the field of the record in which a column stands."""
        return f"f{self.columns.index(column)}"

    def rows(self, data: bytes, offsets: NDArray[np.int64]) -> NDArray[np.void]:
        """Return the records (n,) that begin at `offsets`, in one copy."""
        if not offsets.size:
            return np.empty(0, self.dtype)
        windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), self.length)
        return np.ascontiguousarray(windows[offsets][:, len(HEADER) + 1 :]).view(self.dtype)[:, 0]


FMT = MessageFormat(FMT_KIND, "FMT", 89, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


def parse_fmt(data: bytes, at: int) -> MessageFormat | None:
    """Return the format that the FMT record at `at` states, None where it cannot be one."""
    row = np.frombuffer(data, FMT.dtype, 1, at + len(HEADER) + 1)[0]
    name, letters, columns = (row[f"f{i}"].decode("latin-1").rstrip("\0 ") for i in (2, 3, 4))
    found = MessageFormat(int(row["f0"]), name, int(row["f1"]), letters, tuple(columns.split(",")))
    return found if found.fits else None


@dataclass
class _Layout:
    """A format and where the records that were written in it begin."""

    form: MessageFormat
    offsets: array[int] = field(default_factory=lambda: array("q"))


@dataclass(frozen=True)
class Scan:
    """The records of each format, in the order of the file, and what lies between them.

    Attributes:
        records: formats and the offsets (n,) of their records; a type that was defined anew stands twice.
        damaged: stretches of bytes that are no records. skipped: how many bytes these are.
    """

    records: tuple[tuple[MessageFormat, NDArray[np.int64]], ...]
    damaged: int
    skipped: int


def scan(data: bytes) -> Scan:
    """Find the records of a log."""
    size, at, damaged, skipped = len(data), 0, 0, 0
    lengths = [0] * 256
    stated: dict[bytes, MessageFormat | None] = {}  # by the record that states it, None where it cannot be one
    layouts: dict[MessageFormat, _Layout] = {}
    anew = Counter[int]()
    places: list[array[int]] = [array("q")] * 256
    lengths[FMT_KIND] = FMT.length
    while at + 3 <= size:
        kind = data[at + 2]
        end = at + lengths[kind]
        if not (end > at and data[at : at + 2] == HEADER and (end == size or data[end : end + 2] == HEADER)):
            following = _next(data, at + 1, lengths)
            whole = end > at and data[at : at + 2] == HEADER and end <= size
            if following < size or not (whole and _is_padding(data, end)):
                if following == size and _is_padding(data, at):
                    break
                damaged, skipped, at = damaged + 1, skipped + following - at, following
                continue
        if kind != FMT_KIND:
            places[kind].append(at)
        else:
            record = data[at:end]
            if record not in stated:
                stated[record] = parse_fmt(data, at)
            form = stated[record]
            if form is None or (form not in layouts and anew[form.kind] >= _MOST_FORMATS):
                damaged, skipped = damaged + 1, skipped + FMT.length
            elif form.kind != FMT_KIND:
                if form not in layouts:
                    layouts[form] = _Layout(form)
                    anew[form.kind] += 1
                lengths[form.kind] = form.length
                places[form.kind] = layouts[form].offsets
        at = end
    found = layouts.values()
    records = tuple((each.form, np.array(each.offsets, dtype=np.int64)) for each in found if each.offsets)
    return Scan(records, damaged, skipped)


def _next(data: bytes, at: int, lengths: list[int]) -> int:
    """Return where two records next follow one another, or one ends with the file; the size where none does."""
    size = len(data)
    while True:
        at = data.find(HEADER, at)
        if at < 0 or at + 3 > size:
            return size
        length = lengths[data[at + 2]]
        end = at + length
        if length and (end == size or data[end : end + 2] == HEADER):
            return at
        at += 1


def _is_padding(data: bytes, at: int) -> bool:
    return not data[at:].strip(_PADDING)


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
