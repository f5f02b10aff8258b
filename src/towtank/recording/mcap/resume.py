"""What an MCAP file of ours holds, record by record, so that a later session can go on writing it.

Chunks are not unpacked: their indexes say how many messages they hold. The first record that is not whole, or the
summary of a file that was closed, is where the file is gone on with.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, MessageIndex, Metadata, MetadataIndex, Schema

from towtank.errors import InputError
from towtank.recording.event import EVENT_ENCODING
from towtank.recording.mcap.container import Summary
from towtank.recording.mcap.format import ABOUT, MAGIC, RAW_ENCODING, RECORD_HEAD, About, SourceFormat

__all__ = ["Interrupted", "interrupted"]

_CHUNK = struct.Struct("<QQQI")  # start, end, size, checksum


@dataclass
class Interrupted:
    """A file to go on with.

    Attributes:
        length: bytes of whole records. summary: what they hold.
        sources: our sources by the id of their channel. raw: topics of bytes by the id of theirs.
        texts: id of the channel of each topic of JSON.
    """

    length: int = 0
    about: About = field(default_factory=About)
    summary: Summary = field(default_factory=Summary)
    sources: dict[int, SourceFormat] = field(default_factory=dict)
    raw: dict[int, str] = field(default_factory=dict)
    texts: dict[str, int] = field(default_factory=dict)


def interrupted(path: Path) -> Interrupted:
    """Return what a file holds.

    Raises:
        InputError: there is no such file, or it is no recording of ours.
    """
    try:
        with path.open("rb") as stream:
            end = stream.seek(0, io.SEEK_END)
            stream.seek(0)
            if stream.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: not MCAP, so it cannot be resumed")
            before = _scan(stream, end)
    except FileNotFoundError:
        raise InputError(f"{path}: no such recording to resume") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, McapError, struct.error, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: damaged, cannot be resumed ({error})") from error
    if ABOUT not in {entry.name for entry in before.summary.metadata if isinstance(entry, MetadataIndex)}:
        raise InputError(f"{path}: not a recording of towtank, so it cannot be resumed")
    return before


def _scan(stream: BinaryIO, end: int) -> Interrupted:
    before = Interrupted(length=len(MAGIC))
    summary = before.summary
    last: ChunkIndex | None = None
    while before.length + RECORD_HEAD.size <= end:
        at = before.length
        stream.seek(at)
        opcode, size = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
        if not opcode or opcode == Opcode.DATA_END or at + RECORD_HEAD.size + size > end:
            break
        if opcode == Opcode.CHUNK:
            if last is not None:
                summary.add_chunk(last)
            last = _chunk(stream, at, size)
        elif opcode == Opcode.MESSAGE_INDEX and last is not None:
            index = MessageIndex.read(ReadDataStream(stream))
            last.message_index_offsets[index.channel_id] = at
            last.message_index_length += RECORD_HEAD.size + size
            summary.counts[index.channel_id] = summary.counts.get(index.channel_id, 0) + len(index.records)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            _take(before, opcode, stream, at, size)
        before.length += RECORD_HEAD.size + size
    if last is not None:
        summary.add_chunk(last)
    return before


def _chunk(stream: BinaryIO, at: int, size: int) -> ChunkIndex:
    start, end, unpacked, _ = _CHUNK.unpack(stream.read(_CHUNK.size))
    length = int.from_bytes(stream.read(4), "little")
    compression = stream.read(length).decode()
    return ChunkIndex(
        message_start_time=start,
        message_end_time=end,
        chunk_start_offset=at,
        chunk_length=RECORD_HEAD.size + size,
        message_index_offsets={},
        message_index_length=0,
        compression=compression,
        compressed_size=int.from_bytes(stream.read(8), "little"),
        uncompressed_size=unpacked,
    )


def _take(before: Interrupted, opcode: int, stream: BinaryIO, at: int, size: int) -> None:
    """Take a schema, a channel or metadata."""
    data = ReadDataStream(stream)
    if opcode == Opcode.SCHEMA:
        before.summary.schemas.append(Schema.read(data))
    elif opcode == Opcode.METADATA:
        record = Metadata.read(data)
        before.summary.metadata.append(MetadataIndex(offset=at, length=RECORD_HEAD.size + size, name=record.name))
        if record.name == ABOUT:
            before.about = About.of_metadata(record.metadata)
    else:
        channel = Channel.read(data)
        before.summary.channels.append(channel)
        form = SourceFormat.of_metadata(channel.topic, channel.metadata)
        if form is not None:
            before.sources[channel.id] = form
        elif channel.message_encoding == RAW_ENCODING:
            before.raw[channel.id] = channel.topic
        elif channel.message_encoding == EVENT_ENCODING:
            before.texts[channel.topic] = channel.id
