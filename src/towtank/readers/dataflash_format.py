"""The formats that a DataFlash log states of itself: each message type is a record of fixed size.

A record of type FMT names a type, the length of its records, one letter for the type of each field, and the fields.
All records begin with the bytes A3 95 and the number of their type.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from towtank.readers.record_columns import Place

__all__ = ["FMT", "FMT_KIND", "HEADER", "LETTERS", "MessageFormat", "parse_fmt"]

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
