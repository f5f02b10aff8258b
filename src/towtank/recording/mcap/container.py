"""An MCAP file written record by record, with a summary at its end; readable up to the last record without it.

The records are those of https://mcap.dev/spec; `mcap.records` serialises all of them but the messages, which are laid
out as arrays so that a hundred thousand of them cost no loop.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from towtank.recording.mcap.format import MAGIC, MESSAGE_HEAD, RECORD_HEAD

__all__ = ["McapFile", "Messages", "Summary", "index_record", "message_records"]

_LEVEL = 1  # of zstd: half the size, at the speed of the disk


def message_records(channel: int, log_time: NDArray[np.uint64], data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the message records (n, 31 + size) of one channel.

    Args:
        channel: id of the channel.
        log_time: times (n,) [ns].
        data: the messages (n, size).
    """
    size = data.shape[1]
    layout = np.dtype([*MESSAGE_HEAD.descr, ("data", "u1", (size,))])
    records = np.zeros(len(data), dtype=layout)
    records["opcode"] = int(Opcode.MESSAGE)
    records["length"] = MESSAGE_HEAD.itemsize - RECORD_HEAD.size + size
    records["channel"] = channel
    records["log_time"] = records["publish_time"] = log_time
    records["data"] = data
    return records.view(np.uint8).reshape(len(data), layout.itemsize)


def index_record(channel: int, log_time: NDArray[np.uint64], offset: NDArray[np.uint64]) -> bytes:
    """Return the record that says where the messages of a channel stand in the chunk before it."""
    body = np.column_stack([log_time, offset]).astype("<u8").tobytes()
    head = channel.to_bytes(2, "little") + len(body).to_bytes(4, "little")
    return bytes([int(Opcode.MESSAGE_INDEX)]) + (len(head) + len(body)).to_bytes(8, "little") + head + body


@dataclass(frozen=True)
class Messages:
    """Where the messages of one channel stand in a chunk: times (n,) [ns] and offsets (n,) in its records."""

    log_time: NDArray[np.uint64]
    offset: NDArray[np.uint64]


@dataclass
class Summary:
    """What the end of the file repeats and counts.

    A chunk may come ten times in a second: their indexes, `chunks` of them, are kept as the bytes that end the file.
    """

    schemas: list[McapRecord] = field(default_factory=list)
    channels: list[McapRecord] = field(default_factory=list)
    chunks: int = 0
    chunk_indexes: bytearray = field(default_factory=bytearray)
    metadata: list[McapRecord] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    start: int = 0
    end: int = 0

    def add_chunk(self, entry: ChunkIndex) -> None:
        """Take the index of a chunk."""
        self.start = min(self.start, entry.message_start_time) if self.chunks else entry.message_start_time
        self.end = max(self.end, entry.message_end_time)
        self.chunks += 1
        self.chunk_indexes += _bytes(entry)


class McapFile:
    """The writer: channels, then chunks of messages, then `finish`.

    Every call that writes hands whole records to `append`; where that raises, the call may be repeated. Channels and
    texts wait for what is written next, so that none is lost where nothing can be written.
    """

    def __init__(self, append: Callable[[bytes], None], library: str) -> None:
        self._append = append
        self._length = 0
        self._summary = Summary()
        self._channels, self._texts = b"", dict[str, dict[str, str]]()  # that are not in the file yet
        self._put(MAGIC + _bytes(Header(profile="ros2", library=library)))

    @classmethod
    def resumed(cls, append: Callable[[bytes], None], length: int, summary: Summary) -> McapFile:
        """Return the writer of a file that has `length` bytes of whole records, told in `summary`, and no end."""
        file = cls.__new__(cls)
        file._append, file._length, file._summary = append, length, summary
        file._channels, file._texts = b"", {}
        return file

    def channel(
        self, topic: str, encoding: str, metadata: Mapping[str, str], schema: tuple[str, str, bytes] | None = None
    ) -> int:
        """Make a channel, with its schema (name, encoding, text) if it has one; return its id."""
        summary = self._summary
        records: list[McapRecord] = []
        number = 0
        if schema is not None:
            number = len(summary.schemas) + 1
            records.append(Schema(id=number, name=schema[0], encoding=schema[1], data=schema[2]))
        identity = len(summary.channels) + 1
        records.append(
            Channel(id=identity, topic=topic, message_encoding=encoding, metadata=dict(metadata), schema_id=number)
        )
        self._channels += _bytes(*records)
        summary.schemas += records[:-1]
        summary.channels.append(records[-1])
        return identity

    def chunk(self, records: bytes, messages: Mapping[int, Messages]) -> None:
        """Write message records as one compressed chunk, with the index of each channel behind it."""
        self.write_descriptions()
        summary = self._summary
        start = min(int(each.log_time.min()) for each in messages.values())
        end = max(int(each.log_time.max()) for each in messages.values())
        packed = zstandard.compress(records, _LEVEL)
        chunk = _bytes(
            Chunk(
                compression="zstd",
                data=packed,
                message_start_time=start,
                message_end_time=end,
                uncompressed_crc=zlib.crc32(records),
                uncompressed_size=len(records),
            )
        )
        index = bytearray()
        places: dict[int, int] = {}
        for channel, each in messages.items():
            places[channel] = self._length + len(chunk) + len(index)
            index += index_record(channel, each.log_time, each.offset)
        entry = ChunkIndex(
            message_start_time=start,
            message_end_time=end,
            chunk_start_offset=self._length,
            chunk_length=len(chunk),
            message_index_offsets=places,
            message_index_length=len(index),
            compression="zstd",
            compressed_size=len(packed),
            uncompressed_size=len(records),
        )
        self._put(chunk + bytes(index))
        summary.add_chunk(entry)
        for channel, each in messages.items():
            summary.counts[channel] = summary.counts.get(channel, 0) + len(each.offset)

    @property
    def summary(self) -> Summary:
        """What was written so far."""
        return self._summary

    def describe_again(self, before: Summary) -> None:
        """Make those schemas and channels of another summary that this file has not, under their ids."""
        own = self._summary
        schemas, channels = before.schemas[len(own.schemas) :], before.channels[len(own.channels) :]
        self._channels += _bytes(*schemas, *channels)
        own.schemas += schemas
        own.channels += channels

    def metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Say texts by key; a later record of the same name supersedes an earlier one."""
        self._texts[name] = dict(content)

    @property
    def undescribed(self) -> bool:
        """Whether channels or texts wait."""
        return bool(self._channels or self._texts)

    def write_descriptions(self) -> None:
        """Write the channels and the texts that wait."""
        if not self.undescribed:
            return
        data, entries = self._channels, list[McapRecord]()
        for name, content in self._texts.items():
            record = _bytes(Metadata(name=name, metadata=content))
            entries.append(MetadataIndex(offset=self._length + len(data), length=len(record), name=name))
            data += record
        self._put(data)
        self._channels, self._texts = b"", {}
        self._summary.metadata += entries

    def finish(self) -> None:
        """Write the summary, by which tools find their way without reading the whole file."""
        self.write_descriptions()
        summary = self._summary
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(summary.channels),
            channel_message_counts=summary.counts,
            chunk_count=summary.chunks,
            message_count=sum(summary.counts.values()),
            metadata_count=len(summary.metadata),
            message_start_time=summary.start,
            message_end_time=summary.end,
            schema_count=len(summary.schemas),
        )
        end = _bytes(DataEnd(data_section_crc=0))
        start = self._length + len(end)
        groups: dict[Opcode, bytes] = {
            Opcode.SCHEMA: _bytes(*summary.schemas),
            Opcode.CHANNEL: _bytes(*summary.channels),
            Opcode.STATISTICS: _bytes(statistics),
            Opcode.CHUNK_INDEX: bytes(summary.chunk_indexes),
            Opcode.METADATA_INDEX: _bytes(*summary.metadata),
        }
        text, offsets = b"", []
        for opcode, group in groups.items():
            if group:
                offsets.append(
                    SummaryOffset(group_opcode=opcode, group_start=start + len(text), group_length=len(group))
                )
            text += group
        footer = Footer(summary_start=start, summary_offset_start=start + len(text), summary_crc=0)
        text += _bytes(*offsets)
        footer.summary_crc = zlib.crc32(text + _bytes(footer)[:-4])
        self._put(end + text + _bytes(footer) + MAGIC)

    def _put(self, data: bytes) -> None:
        self._append(data)
        self._length += len(data)


def _bytes(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
