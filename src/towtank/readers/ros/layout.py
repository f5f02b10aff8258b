"""Many messages of one type decoded at once.

Messages of a fixed type differ in layout only by the lengths of their texts and arrays, and these hardly ever change
within a topic. So one message is walked field by field, which tells where every number stands; all others of the same
lengths are then read by one view of the bytes, whole columns at a time. What does not fit is walked anew.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from towtank.core.arrays import Array
from towtank.readers.common.raw_messages import RawMessages
from towtank.readers.ros.types import Types

__all__ = ["Decoded", "decode"]

_CODES = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_SKIPPED = {"float128": 16}
_LONGEST = 64  # numbers of one array that become columns
_STEPS = 20_000  # fields of one message that are walked
_LAYOUTS = 500  # layouts of one topic
_DEEPEST = 32
_MISFITS = 200  # messages of one topic that are looked at in vain
_TEXTS = ("frame_id", "mode")  # the texts that matter


@dataclass(frozen=True)
class Decoded:
    """Columns (n,) by path, texts by path, and which messages (n,) could be decoded."""

    columns: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]]
    good: NDArray[np.bool_]


@dataclass
class _Layout:
    """Where everything stands in messages of some lengths: numbers, texts, and the lengths themselves."""

    numbers: list[tuple[str, str, int]] = field(default_factory=list)  # path, type, offset
    texts: list[tuple[str, int, int]] = field(default_factory=list)  # path, offset, length
    lengths: list[tuple[int, int]] = field(default_factory=list)  # offset, value


def decode(raw: RawMessages, kind: str, types: Types, *, ros1: bool) -> Decoded:
    """Return the numbers of messages of one type, NaN where a message has none there."""
    count = len(raw)
    columns: dict[str, Array] = {}
    texts: dict[str, list[str]] = {}
    good = np.zeros(count, dtype=np.bool_)
    left = np.arange(count)
    misfits = layouts = 0
    starts = raw.start
    while left.size and misfits < _MISFITS and layouts < _LAYOUTS:
        first = int(left[0])
        message = raw.data[starts[first] : starts[first] + raw.size[first]].tobytes()
        try:
            layout, order = _walk(message, kind, types, ros1)
        except (ValueError, KeyError, struct.error):
            misfits += 1
            left = left[1:]
            continue
        layouts += 1
        alike = left[raw.size[left] == len(message)]
        matrix = raw.matrix(alike)
        fits = _fits(matrix, layout, order, ros1)
        rows, matrix = alike[fits], matrix[fits]
        _fill(columns, texts, rows, matrix, layout, order, count)
        good[rows] = True
        left = left[~np.isin(left, rows, assume_unique=True)]
    return Decoded(columns, {path: tuple(each) for path, each in texts.items()}, good)


def _fits(matrix: NDArray[np.uint8], layout: _Layout, order: str, ros1: bool) -> NDArray[np.bool_]:
    """Which of the messages (k, size) have the lengths of the layout."""
    fits = np.ones(len(matrix), dtype=np.bool_)
    if not ros1:
        fits &= (matrix[:, :2] == matrix[0, :2]).all(axis=1)
    for offset, value in layout.lengths:
        fits &= np.ascontiguousarray(matrix[:, offset : offset + 4]).view(f"{order}u4").reshape(-1) == value
    return fits


def _fill(
    columns: dict[str, Array],
    texts: dict[str, list[str]],
    rows: NDArray[np.intp],
    matrix: NDArray[np.uint8],
    layout: _Layout,
    order: str,
    count: int,
) -> None:
    """Put the numbers and texts of the messages (k, size) into their rows."""
    for path, code, offset in layout.numbers:
        size = int(code[1])
        values = np.ascontiguousarray(matrix[:, offset : offset + size]).view(order + code).reshape(-1)
        if path not in columns:
            columns[path] = np.full(count, np.nan)
        columns[path][rows] = values
    for path, offset, length in layout.texts:
        part = np.ascontiguousarray(matrix[:, offset : offset + length])
        each = texts.setdefault(path, [""] * count)
        if (part == part[0]).all():
            words = [_word(part[0].tobytes())] * len(rows)
        else:
            words = [_word(row.tobytes()) for row in part]
        for row, word in zip(rows.tolist(), words, strict=True):
            each[row] = word


def _word(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="replace")


def _walk(message: bytes, kind: str, types: Types, ros1: bool) -> tuple[_Layout, str]:
    """Return the layout of a message and its byte order. Raises ValueError or struct.error where it does not fit."""
    if ros1:
        walker = _Walker(message, types, 0, "<", aligned=False)
    else:
        if len(message) < 4 or message[0] != 0 or message[1] > 1:
            raise ValueError("not plain CDR")
        walker = _Walker(message, types, 4, "<" if message[1] else ">", aligned=True)
    walker.record(kind, "", 0)
    spare = len(message) - walker.at
    if spare < 0 or spare > (0 if ros1 else 7):
        raise ValueError("the message is not as long as its type says")
    return walker.layout, walker.order


class _Walker:
    """Goes through one message; `at` is where it stands."""

    def __init__(self, message: bytes, types: Types, at: int, order: str, *, aligned: bool) -> None:
        self.message, self.types, self.at, self.order = message, types, at, order
        self.layout = _Layout()
        self._origin, self._aligned, self._steps = at, aligned, 0

    def record(self, kind: str, prefix: str, depth: int) -> None:
        """Walk a message or a part of one."""
        if depth > _DEEPEST:
            raise ValueError("messages within messages without end")
        for name, description in self.types[kind]:
            self._field(f"{prefix}{name}", description, depth)

    def _field(self, path: str, description: Any, depth: int) -> None:
        node, detail = description
        self._steps += 1
        if self._steps > _STEPS:
            raise ValueError("more fields than towtank reads")
        if node == Nodetype.BASE:
            self._scalar(path, detail[0])
        elif node == Nodetype.NAME:
            self.record(detail, f"{path}.", depth + 1)
        else:
            inner, length = detail
            if node == Nodetype.SEQUENCE:
                length = self._length()
            self._array(path, inner, length, depth)

    def _scalar(self, path: str, name: str) -> None:
        if name == "string":
            length = self._length()
            if path.endswith(_TEXTS):
                self.layout.texts.append((path, self.at, length))
            self._skip(length)
            return
        size = self._align(name)
        if name in _CODES:
            self.layout.numbers.append((path, _CODES[name], self.at))
        self._skip(size)

    def _array(self, path: str, inner: Any, length: int, depth: int) -> None:
        if length > len(self.message):
            raise ValueError("an array is longer than the message")
        if inner[0] == Nodetype.BASE and inner[1][0] != "string":
            name = inner[1][0]
            if not length:
                return
            size = self._align(name)
            if name in _CODES:
                taken = _taken(path, length)
                self.layout.numbers += [(f"{path}[{k}]", _CODES[name], self.at + k * size) for k in taken]
            self._skip(length * size)
            return
        for k in range(length):
            self._field(f"{path}[{k}]", inner, depth)

    def _length(self) -> int:
        self._align("uint32")
        offset = self.at
        (length,) = struct.unpack_from(f"{self.order}I", self.message, offset)
        self._skip(4)
        self.layout.lengths.append((offset, length))
        return int(length)

    def _align(self, name: str) -> int:
        if name in _CODES:
            size = int(_CODES[name][1])
        elif name in _SKIPPED:
            size = _SKIPPED[name]
        else:
            raise ValueError(f'fields of type "{name}" are not read')
        if self._aligned:
            self.at += -(self.at - self._origin) % min(size, 8)
        return size

    def _skip(self, size: int) -> None:
        self.at += size
        if self.at > len(self.message):
            raise ValueError("the message ends too early")


def _taken(path: str, length: int) -> range | list[int]:
    """Which elements of an array become columns: of a covariance the diagonal, of a long array the first ones."""
    side = round(length**0.5)
    if "covar" in path.rpartition(".")[2] and side > 1 and side * side == length:
        return [k * (side + 1) for k in range(side)]
    return range(min(length, _LONGEST))
