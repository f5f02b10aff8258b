"""ROS 1 bags, version 2.0, read from the beginning to wherever they end.

The index at the end of a bag is not used: a bag that was never closed has none. A chunk that cannot be unpacked is left
out, and behind bytes that make no record reading goes on at the next chunk; both are counted.
"""

from __future__ import annotations

import bz2
import re
import struct
from collections.abc import Callable, Iterator
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from towtank.errors import InputError
from towtank.readers.common.raw_messages import Collector, Topic
from towtank.recording.repairs import Repairs

__all__ = ["scan_rosbag1"]

Wanted = Callable[[str, str], bool]
_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_CHUNK_MARK = re.compile(re.escape(b"\x04\x00\x00\x00op=\x05"))
_LONGEST_HEADER = 1 << 16
_BEFORE_MARK = 100  # bytes of a chunk's header before the mark
_MOST_NAMED = 6  # chunks that are named one by one
_MOST_VAIN = 20_000  # marks of chunks where none was
_ALWAYS_ALLOWED, _LARGEST_GAIN = 1 << 26, 1024  # bytes that a chunk may unpack to, or times its size


class _Record(NamedTuple):
    header: dict[bytes, bytes]
    body: tuple[int, int]  # from, to
    cut: bool  # the file ends within it

    @property
    def opcode(self) -> int:
        return int.from_bytes(self.header.get(b"op", b"\0"), "little")

    def number(self, name: bytes) -> int:
        return int.from_bytes(self.header[name], "little")


def scan_rosbag1(path: Path, wanted: Wanted) -> tuple[list[Topic], Repairs]:
    """Return the topics of a bag, with the messages of those for which `wanted(topic, type)` holds.

    Raises:
        InputError: the file is no bag of version 2.0.
    """
    with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
        if data[: len(_MAGIC)] != _MAGIC:
            found = bytes(data[:16]).partition(b"\n")[0].decode(errors="replace")
            raise InputError(f"{path}: found {found!r}, expected a ROS bag of version 2.0; convert older ones")
        scan = _Scan(wanted)
        scan.file(data, len(_MAGIC))
        return scan.topics()


class _Scan:
    def __init__(self, wanted: Wanted) -> None:
        self._wanted = wanted
        self._connections: dict[int, Collector] = {}
        self._collectors: dict[tuple[str, str], Collector] = {}
        self._damaged = self._lost_bytes = 0
        self._chunks = self._listed = self._vain = 0
        self._details: list[str] = []

    def file(self, data: mmap, at: int) -> None:
        """Take the records of a file, then those of its chunks."""
        while at < len(data):
            record = _record(data, at, len(data))
            if record is None or (record.cut and record.opcode != _CHUNK):
                new = self._next_chunk(data, at + 1)
                self._lost_bytes += new - at
                at = new
                continue
            start, end = record.body
            if record.opcode == _CHUNK:
                self._chunk(record, data[start:end], at)
            else:
                self._take(record, data[start:end])
            at = end

    def topics(self) -> tuple[list[Topic], Repairs]:
        found = [collector.topic() for collector in self._collectors.values()]
        if self._lost_bytes:
            self._details.append(f"{self._lost_bytes} bytes that make no record (left out)")
        if self._listed < max(self._chunks, 1):
            self._details.append("the bag has no end: its recording was interrupted, or it was cut")
        repairs = Repairs(disorder=sum(late for _, late in found), damaged=self._damaged, details=tuple(self._details))
        return [topic for topic, _ in found], repairs

    def _chunk(self, record: _Record, packed: bytes, at: int) -> None:
        self._chunks += 1
        try:
            records = _unpack(record, packed)
        except ValueError as error:
            self._damaged += 1
            if self._damaged <= _MOST_NAMED:
                self._details.append(f"chunk at byte {at} left out: {error}")
            return
        place = 0
        while place < len(records):
            inner = _record(records, place, len(records))
            if inner is None or inner.cut:
                self._damaged += 1
                return
            start, place = inner.body
            self._take(inner, records[start:place])

    def _take(self, record: _Record, body: bytes) -> None:
        try:
            if record.opcode == _MESSAGE:
                seconds, nanoseconds = _TIME.unpack(record.header[b"time"])
                self._connections[record.number(b"conn")].add(seconds * 10**9 + nanoseconds, body)
            elif record.opcode == _CONNECTION:
                self._connect(record, body)
            elif record.opcode == 6:  # information about a chunk, at the end
                self._listed += 1
        except (KeyError, ValueError, struct.error):
            self._damaged += 1

    def _next_chunk(self, data: mmap, at: int) -> int:
        """Return where the next chunk begins; the size of the file where none does, or too many marks were of none."""
        for mark in _CHUNK_MARK.finditer(data, at):
            for start in _header_starts(data, mark.start(), at):
                record = _record(data, start, len(data))
                if record is not None and record.opcode == _CHUNK and b"compression" in record.header:
                    return start
            self._vain += 1
            if self._vain > _MOST_VAIN:
                self._details.append("the file is mostly something else; the search for messages was given up")
                break
        return len(data)

    def _connect(self, record: _Record, body: bytes) -> None:
        about = _header(body)
        if about is None:
            raise ValueError("a connection without a header")
        name = record.header[b"topic"].decode()
        name = "/" * name.startswith("/") + "/".join(part for part in name.split("/") if part)
        kind = normalize_msgtype(about[b"type"].decode())
        if (name, kind) not in self._collectors:
            definition = about.get(b"message_definition", b"").decode(errors="replace")
            topic = Topic(name, kind, "ros1", np.empty(0, np.int64), None, (definition, "ros1msg"))
            self._collectors[name, kind] = Collector(topic, wanted=self._wanted(name, kind))
        self._connections[record.number(b"conn")] = self._collectors[name, kind]


def _record(data: mmap | bytes, at: int, end: int) -> _Record | None:
    """Return the record that begins at `at`, None where there is none."""
    if at + 4 > end:
        return None
    (length,) = _LENGTH.unpack_from(data, at)
    start = at + 4 + length
    if length > _LONGEST_HEADER or start + 4 > end:
        return None
    header = _header(data[at + 4 : start])
    if header is None or b"op" not in header:
        return None
    (size,) = _LENGTH.unpack_from(data, start)
    return _Record(header, (start + 4, min(start + 4 + size, end)), start + 4 + size > end)


def _header(text: bytes) -> dict[bytes, bytes] | None:
    """Return the fields of a header, None where it is none."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(text):
        if at + 4 > len(text):
            return None
        (size,) = _LENGTH.unpack_from(text, at)
        at += 4
        name, sign, value = text[at : at + size].partition(b"=")
        if not sign or at + size > len(text):
            return None
        fields[name] = value
        at += size
    return fields


def _header_starts(data: mmap, mark: int, at: int) -> Iterator[int]:
    """Yield where a header may begin whose length takes in the mark, the nearest first."""
    first = max(mark - _BEFORE_MARK + 1, at)
    before = data[first : mark + 4]
    for start in range(mark - 4, first - 1, -1):
        (length,) = _LENGTH.unpack_from(before, start - first)
        if mark - start + 4 <= length <= _LONGEST_HEADER:
            yield start


def _unpack(record: _Record, packed: bytes) -> bytes:
    """Return the records of a chunk, or those before the cut. Raises ValueError where they cannot be unpacked."""
    compression = record.header.get(b"compression", b"none").decode(errors="replace")
    size = int.from_bytes(record.header.get(b"size", b""), "little")
    if size > max(_ALWAYS_ALLOWED, _LARGEST_GAIN * len(packed)):
        raise ValueError(f"it says that it unpacks to {size} bytes")
    if compression == "none":
        return packed
    try:
        if compression == "bz2":
            return bz2.BZ2Decompressor().decompress(packed, max_length=size)
        if compression == "lz4":
            unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
            return unpacked
    except (OSError, EOFError, RuntimeError) as error:
        raise ValueError("it cannot be unpacked") from error
    raise ValueError(f'its compression "{compression}" is not known')
