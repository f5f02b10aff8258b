"""The records of an MCAP file, one after the other, searched for behind bytes that make none.

Where the messages of a chunk stand is taken from the index behind it where that is right, else from a walk through it.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from mmap import mmap
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.readers.common.raw_messages import Bytes, Integers, gather
from towtank.recording.mcap.format import MAGIC, MESSAGE_HEAD, RECORD_HEAD

__all__ = [
    "CHANNEL",
    "CHUNK",
    "CONTENT_HEAD",
    "HEADER",
    "SCHEMA",
    "Chunk",
    "Fields",
    "Places",
    "Record",
    "count",
    "gaps",
    "indexed",
    "records_of",
    "signed",
]

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
STATISTICS, METADATA, DATA_END = 11, 12, 15
_CHUNK_HEAD = struct.Struct("<QQQI")
_START = re.compile(rb"[\x01-\x0f][\s\S]{5}\x00\x00\x00")  # an opcode, then a length below 2^40
_CHAIN = 3  # records in a row that make a new start
_SMALLEST = {FOOTER: 20, SCHEMA: 14, CHANNEL: 16, MESSAGE: 22, CHUNK: 40, MESSAGE_INDEX: 6}
_ALWAYS_ALLOWED, _LARGEST_GAIN = 1 << 26, 1024  # bytes that a chunk may unpack to, or times its size
CONTENT_HEAD = np.dtype(MESSAGE_HEAD.descr[2:])  # of a message record's content


class Record(NamedTuple):
    """One record: where it stands, what it is, and its content. `lost` bytes before it made no record."""

    at: int
    opcode: int
    body: bytes
    lost: int = 0
    cut: bool = False  # the file ends within it


def records_of(data: mmap, at: int = len(MAGIC)) -> Iterator[Record]:
    """Yield the records of a file; a last one without content and of opcode 0 tells of bytes lost at its end."""
    lost = 0
    while at < len(data):
        if data[at : at + len(MAGIC)] == MAGIC:  # between files that were put one behind the other
            at += len(MAGIC)
            continue
        size = _size(data, at)
        if size is None:
            cut = _cut_chunk(data, at)
            new = _new_start(data, at + 1)
            if new is None and cut is not None:
                yield Record(at, CHUNK, cut, lost, cut=True)
                return
            new = len(data) if new is None else new
            lost += new - at
            at = new
            continue
        head = RECORD_HEAD.size
        yield Record(at, data[at], data[at + head : at + head + size], lost)
        lost = 0
        at += head + size
    if lost:
        yield Record(at, 0, b"", lost)


def _size(data: mmap, at: int) -> int | None:
    """Return the bytes of a record's content, None where none can begin here."""
    if at + RECORD_HEAD.size > len(data):
        return None
    opcode, size = RECORD_HEAD.unpack_from(data, at)
    end = at + RECORD_HEAD.size + size
    if not opcode or size < _SMALLEST.get(opcode, 0) or end > len(data):
        return None
    if opcode == CHUNK:
        return size if _is_chunk(data, at, size) else None
    return size if _may_begin(data, end) else None


def _is_chunk(data: mmap, at: int, size: int) -> bool:
    """Whether the lengths within a chunk add up to its own."""
    names = at + RECORD_HEAD.size + _CHUNK_HEAD.size
    length = int.from_bytes(data[names : names + 4], "little")
    if length > size - 40:
        return False
    return int.from_bytes(data[names + 4 + length : names + 12 + length], "little") == size - 40 - length


def _may_begin(data: mmap, at: int) -> bool:
    """Whether a record, or the end of a file, may stand here; of one that is cut off by the end there is no saying."""
    if at + RECORD_HEAD.size > len(data) or data[at : at + len(MAGIC)] == MAGIC:
        return True
    opcode, size = RECORD_HEAD.unpack_from(data, at)
    return bool(opcode) and (size < 1 << 40) and (opcode < 16 or opcode >= 0x80)


def _new_start(data: mmap, at: int) -> int | None:
    """Return where the next three records in a row, or the last ones of the file, begin."""
    for found in _START.finditer(data, at):
        place = found.start()
        for _ in range(_CHAIN):
            size = _size(data, place)
            if size is None:
                break
            place += RECORD_HEAD.size + size
            if place == len(data) or data[place : place + len(MAGIC)] == MAGIC:
                return found.start()
        else:
            return found.start()
    return None


def _cut_chunk(data: mmap, at: int) -> bytes | None:
    """Return the content of a chunk that the end of the file cuts off, None where it is none."""
    head = data[at : at + RECORD_HEAD.size + 40]
    if len(head) < RECORD_HEAD.size + 40 or head[0] != CHUNK:
        return None
    return data[at + RECORD_HEAD.size :]


@dataclass(frozen=True)
class Chunk:
    """Messages packed together."""

    start: int
    end: int
    size: int
    checksum: int
    compression: str
    packed: bytes

    @classmethod
    def of(cls, body: bytes) -> Chunk:
        """Return a chunk by its record's content, which may be cut off."""
        start, end, size, checksum = _CHUNK_HEAD.unpack_from(body, 0)
        fields = Fields(body, _CHUNK_HEAD.size)
        return cls(start, end, size, checksum, fields.text(), body[fields.at + 8 :])

    def records(self, *, cut: bool = False) -> bytes:
        """Return the records, or those before the cut.

        Raises:
            ValueError: they cannot be unpacked, or the checksum is wrong.
        """
        if self.size > max(_ALWAYS_ALLOWED, _LARGEST_GAIN * len(self.packed)):
            raise ValueError(f"it says that it unpacks to {self.size} bytes")
        records = _unpack(self.compression, self.packed, self.size)
        if cut:
            return records
        if len(records) != self.size:
            raise ValueError(f"it unpacks to {len(records)} bytes, not to {self.size}")
        if self.checksum and zlib.crc32(records) != self.checksum:
            raise ValueError("its checksum is wrong")
        return records


def _unpack(compression: str, packed: bytes, size: int) -> bytes:
    if not compression:
        return packed[:size]
    if compression == "zstd":
        import zstandard

        try:
            with zstandard.ZstdDecompressor().stream_reader(packed) as stream:
                return stream.read(size)
        except zstandard.ZstdError as error:
            raise ValueError("it cannot be unpacked") from error
    if compression == "lz4":
        import lz4.frame

        try:
            unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
        except (RuntimeError, EOFError) as error:
            raise ValueError("it cannot be unpacked") from error
        return unpacked
    raise ValueError(f'its compression "{compression}" is not known')


class Fields:
    """Reads the content of a record field by field."""

    def __init__(self, body: bytes, at: int = 0) -> None:
        self._body, self.at = body, at

    def number(self, size: int) -> int:
        """Return an unsigned integer of `size` bytes."""
        return int.from_bytes(self.take(size), "little")

    def take(self, size: int) -> bytes:
        """Return the next bytes. Raises ValueError where there are fewer."""
        part = self._body[self.at : self.at + size]
        if len(part) < size:
            raise ValueError("a record ends too early")
        self.at += size
        return part

    def block(self) -> bytes:
        """Return bytes behind their length."""
        return self.take(self.number(4))

    def text(self) -> str:
        """Return a text behind its length. Raises ValueError (UnicodeDecodeError) where it is none."""
        return self.block().decode()

    def texts(self) -> dict[str, str]:
        """Return texts by key."""
        part = Fields(self.block())
        found: dict[str, str] = {}
        while part.at < len(part._body):
            key = part.text()
            found[key] = part.text()
        return found


class Places(NamedTuple):
    """Messages in a buffer: where their data begin, sizes, channels, times; (n,) each."""

    start: Integers
    size: Integers
    channel: Integers
    log_time: Integers


def count(index: list[bytes]) -> int:
    """Return how many messages the index of a chunk names."""
    return sum(max(len(body) - 6, 0) // 16 for body in index)


def indexed(buffer: Bytes, index: list[bytes]) -> Places:
    """Return the messages that the index of a chunk names; none of them where one is not where it says."""
    nothing = Places(*(np.empty(0, dtype=np.int64) for _ in range(4)))
    parts, channels = [], []
    for body in index:
        if len(body) < 6 or (len(body) - 6) % 16:
            return nothing
        entries = np.frombuffer(body, dtype="<u8", offset=6).reshape(-1, 2)
        parts.append(entries)
        channels.append(np.full(len(entries), int.from_bytes(body[:2], "little"), dtype=np.int64))
    if not parts or not sum(map(len, parts)) or buffer.size < MESSAGE_HEAD.itemsize:
        return nothing
    offset = np.concatenate(parts)[:, 1]
    if (offset > buffer.size - MESSAGE_HEAD.itemsize).any():
        return nothing
    order = np.argsort(offset, kind="stable")
    place = offset[order].astype(np.int64)
    heads = np.ascontiguousarray(gather(buffer, place, MESSAGE_HEAD.itemsize)).view(MESSAGE_HEAD).reshape(-1)
    length = heads["length"]
    right = (heads["opcode"] == MESSAGE) & (length >= 22) & (length <= buffer.size)
    right &= heads["channel"] == np.concatenate(channels)[order]
    if not right.all():
        return nothing
    size = length.astype(np.int64) - 22
    ends = place + MESSAGE_HEAD.itemsize + size
    if (ends[:-1] > place[1:]).any() or ends[-1] > buffer.size:
        return nothing
    return Places(place + MESSAGE_HEAD.itemsize, size, heads["channel"].astype(np.int64), signed(heads["log_time"]))


def signed(times: NDArray[np.uint64]) -> Integers:
    """Return times [ns] as signed numbers, those beyond their range as the largest."""
    return np.minimum(times, np.uint64(2**63 - 1)).astype(np.int64)


def gaps(starts: Integers, ends: Integers, size: int) -> list[tuple[int, int]]:
    """Return the stretches (from, to) of a buffer that no message covers."""
    left, right = np.concatenate([[0], ends]), np.concatenate([starts, [size]])
    open_ = np.flatnonzero(right > left)
    return list(zip(left[open_].tolist(), right[open_].tolist(), strict=True))
