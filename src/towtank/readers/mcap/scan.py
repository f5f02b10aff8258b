"""An MCAP file as topics: of each, the times and, where they are wanted, the bytes of its messages.

A chunk whose checksum is wrong is left out; a file that is cut in the middle of a chunk yields what stands before the
cut; a chunk that stands twice is read once. Everything lost is counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import NamedTuple

import numpy as np

from towtank.errors import InputError
from towtank.readers.common.raw_messages import Bytes, Integers, RawMessages, Topic, gather, in_order
from towtank.readers.mcap import records as mcap
from towtank.readers.mcap.records import CONTENT_HEAD, Chunk, Fields, Places, Record, count, gaps, indexed, signed
from towtank.recording.mcap.format import MAGIC, MESSAGE_HEAD, RECORD_HEAD
from towtank.recording.repairs import Repairs

__all__ = ["Heading", "McapContent", "scan_mcap"]

Wanted = Callable[["Heading"], bool]
_MOST_NAMED = 6  # chunks that cannot be read are named one by one


class Heading(NamedTuple):
    """What a channel record says, with its schema."""

    name: str
    kind: str
    encoding: str
    definition: tuple[str, str]
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class McapContent:
    """What an MCAP file holds.

    Attributes:
        metadata: name -> content of the last metadata record of that name.
        repairs: what was lost, what was out of order.
    """

    topics: tuple[Topic, ...]
    metadata: Mapping[str, Mapping[str, str]]
    repairs: Repairs


def scan_mcap(path: Path, wanted: Wanted) -> McapContent:
    """Return the topics of a file; the messages of those that are wanted.

    Raises:
        InputError: the file is not MCAP.
    """
    with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
        if data[: len(MAGIC)] != MAGIC:
            raise InputError(f"{path}: found {data[:8]!r}, expected the first bytes of MCAP version 0")
        scan = _Scan(wanted)
        for record in mcap.records_of(data):
            scan.take(record)
        return scan.content()


@dataclass
class _Pieces:
    """The messages of one topic, chunk by chunk."""

    heading: Heading
    wanted: bool
    times: list[Integers] = field(default_factory=list)
    data: list[Bytes] = field(default_factory=list)
    sizes: list[Integers] = field(default_factory=list)

    def topic(self) -> tuple[Topic, int]:
        """Return the topic in order of time, and how many messages were out of it."""
        times = np.concatenate([np.empty(0, np.int64), *self.times])
        raw = None
        if self.wanted:
            data = np.concatenate([np.empty(0, np.uint8), *self.data])
            raw = RawMessages(data, np.concatenate([np.empty(0, np.int64), *self.sizes]))
        each = self.heading
        return in_order(Topic(each.name, each.kind, each.encoding, times, raw, each.definition, dict(each.metadata)))


class _Scan:
    """Takes record after record."""

    def __init__(self, wanted: Wanted) -> None:
        self._wanted = wanted
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._channels: dict[int, _Pieces] = {}
        self._topics: dict[tuple[str, str, str], _Pieces] = {}
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._seen: set[tuple[int, ...]] = set()
        self._chunk: Record | None = None  # waits for its index
        self._index: list[bytes] = []
        self._loose: list[bytes] = []  # messages outside of any chunk
        self._twice = self._damaged = self._broken = self._strange = self._lost_bytes = 0
        self._expected: int | None = None
        self._ended = False
        self._details: list[str] = []

    def take(self, record: Record) -> None:
        """Take the next record of the file."""
        self._lost_bytes += record.lost
        if record.opcode == mcap.MESSAGE_INDEX and self._chunk is not None:
            self._index.append(record.body)
            return
        self._finish_chunk()
        try:
            self._dispatch(record)
        except ValueError:
            self._damaged += 1

    def content(self) -> McapContent:
        """Return what was found."""
        self._finish_chunk()
        self._finish_loose()
        found = [pieces.topic() for pieces in self._topics.values()]
        total = sum(len(topic) for topic, _ in found)
        if self._expected is not None and self._expected > total + self._damaged + self._twice:
            self._damaged = self._expected - total - self._twice
        if self._lost_bytes:
            self._details.append(f"{self._lost_bytes} bytes that make no record (left out)")
        if not self._ended:
            self._details.append("the file has no end: its recording was interrupted, or it was cut")
        if self._twice:
            self._details.append(f"{self._twice} messages stand twice in the file (read once)")
        if self._strange:
            self._details.append(f"{self._strange} messages of channels that the file does not describe")
        repairs = Repairs(
            disorder=sum(late for _, late in found),
            damaged=self._damaged + self._strange,
            details=tuple(self._details),
        )
        return McapContent(tuple(topic for topic, _ in found), self._metadata, repairs)

    def _dispatch(self, record: Record) -> None:
        body = record.body
        if record.opcode == mcap.CHUNK:
            self._chunk = record
        elif record.opcode == mcap.MESSAGE:
            self._loose.append(body)
        elif record.opcode == mcap.HEADER:
            self._finish_loose()
            self._schemas, self._channels = {}, {}
            self._ended = False
        elif record.opcode == mcap.FOOTER:
            self._ended = True
        elif record.opcode == mcap.METADATA:
            fields = Fields(body)
            name = fields.text()
            self._metadata[name] = fields.texts()
        elif record.opcode == mcap.STATISTICS:
            self._expected = (self._expected or 0) + Fields(body).number(8)
        else:
            self._introduce(record.opcode, body)

    def _introduce(self, opcode: int, body: bytes) -> None:
        """Take a schema or a channel."""
        fields = Fields(body)
        if opcode == mcap.SCHEMA:
            number, name, encoding = fields.number(2), fields.text(), fields.text()
            self._schemas[number] = name, encoding, fields.block().decode(errors="replace")
        elif opcode == mcap.CHANNEL:
            number, schema = fields.number(2), fields.number(2)
            topic, encoding, metadata = fields.text(), fields.text(), fields.texts()
            kind, language, text = self._schemas.get(schema, ("", "", ""))
            heading = Heading(topic, kind, encoding, (text, language), metadata)
            key = (topic, kind, encoding)
            if key not in self._topics:
                self._topics[key] = _Pieces(heading, self._wanted(heading))
            self._channels[number] = self._topics[key]

    def _finish_chunk(self) -> None:
        record, self._chunk = self._chunk, None
        index, self._index = self._index, []
        if record is None:
            return
        try:
            chunk = Chunk.of(record.body)
            key = (chunk.start, chunk.end, chunk.size, chunk.checksum, len(chunk.packed))
            if chunk.checksum and key in self._seen:
                self._twice += max(count(index), 1)
                return
            records = chunk.records(cut=record.cut)
        except ValueError as error:
            self._damaged += max(count(index), 1)
            self._broken += 1
            if self._broken <= _MOST_NAMED:
                self._details.append(f"chunk at byte {record.at} left out: {error}")
            return
        self._seen.add(key)
        buffer = np.frombuffer(records, dtype=np.uint8)
        places = indexed(buffer, index)
        ends = places.start + places.size
        walked: list[tuple[int, int, int, int]] = []
        for start, stop in gaps(places.start - MESSAGE_HEAD.itemsize, ends, len(records)):
            walked += self._walk(records, start, stop, cut=record.cut)
        if walked:
            more = Places(*np.array(walked, dtype=np.int64).T)
            both = Places(*(np.concatenate(pair) for pair in zip(places, more, strict=True)))
            places = Places(*(column[np.argsort(both.start, kind="stable")] for column in both))
        self._add(buffer, places)

    def _finish_loose(self) -> None:
        bodies, self._loose = self._loose, []
        if not bodies:
            return
        raw = RawMessages.of(bodies)
        heads = np.frombuffer(b"".join(body[:22] for body in bodies), dtype=CONTENT_HEAD)
        channel = heads["channel"].astype(np.int64)
        self._add(raw.data, Places(raw.start + 22, raw.size - 22, channel, signed(heads["log_time"])))

    def _walk(self, records: bytes, at: int, stop: int, *, cut: bool) -> Iterator[tuple[int, int, int, int]]:
        """Yield start, size, channel and time of the messages between two places; take schemas and channels."""
        head = RECORD_HEAD
        while at + head.size <= stop:
            opcode, size = head.unpack_from(records, at)
            body = at + head.size
            at = body + size
            if at > stop:
                break
            if opcode == mcap.MESSAGE and size >= 22:
                channel = int.from_bytes(records[body : body + 2], "little")
                log_time = int.from_bytes(records[body + 6 : body + 14], "little")
                yield body + 22, size - 22, channel, min(log_time, 2**63 - 1)
            else:
                try:
                    self._introduce(opcode, records[body:at])
                except ValueError:
                    self._damaged += 1
        if at != stop and not cut:
            self._damaged += 1

    def _add(self, buffer: Bytes, places: Places) -> None:
        """Add the messages of a buffer to their topics."""
        for number in np.unique(places.channel):
            mine = places.channel == number
            pieces = self._channels.get(int(number))
            if pieces is None:
                self._strange += int(np.count_nonzero(mine))
                continue
            pieces.times.append(places.log_time[mine].astype(np.int64))
            if not pieces.wanted:
                continue
            start, size = places.start[mine], places.size[mine]
            pieces.sizes.append(size)
            if (size == size[0]).all():
                pieces.data.append(gather(buffer, start, int(size[0])).reshape(-1))
            else:
                pieces.data += [buffer[a : a + n] for a, n in zip(start.tolist(), size.tolist(), strict=True)]
