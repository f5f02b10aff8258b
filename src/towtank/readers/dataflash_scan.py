"""Finds the records of a binary DataFlash log, whatever its damage.

Each record says where the next one begins, so that a whole log is walked record by record. There are no checksums: a
record counts only where it is followed by another one, by the end of the file or by the padding of a flash page. After
any other bytes the walk goes on at the next place from which two records follow one another.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from towtank.readers.dataflash_format import FMT, FMT_KIND, HEADER, MessageFormat, parse_fmt

__all__ = ["Scan", "scan"]

_PADDING = b"\0\xff"


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
    layouts = [_Layout(FMT)]
    places: list[array[int]] = [layouts[0].offsets] * 256
    lengths[FMT_KIND] = FMT.length
    current: dict[int, MessageFormat] = {FMT_KIND: FMT}
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
            form = parse_fmt(data, at)
            if form is None:
                damaged, skipped = damaged + 1, skipped + FMT.length
            elif form.kind != FMT_KIND and form != current.get(form.kind):
                current[form.kind] = form
                lengths[form.kind] = form.length
                layouts.append(_Layout(form))
                places[form.kind] = layouts[-1].offsets
        at = end
    records = tuple((each.form, np.array(each.offsets, dtype=np.int64)) for each in layouts if each.offsets)
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
