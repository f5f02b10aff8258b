"""A recording as an MCAP file, whole or not at all; its format is that of `mcap.format`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.outputs import write_atomically
from towtank.recording.channel import Channel
from towtank.recording.mcap.container import McapFile, Messages, message_records
from towtank.recording.mcap.format import (
    ABOUT,
    ENCODING,
    LIBRARY,
    MESSAGE_HEAD,
    About,
    Quantity,
    SourceFormat,
    encode_samples,
    log_times,
)
from towtank.recording.recording import Recording

__all__ = ["write_mcap"]

_CHUNK = 1 << 18  # bytes of messages in a chunk, about: what a damaged byte costs


def write_mcap(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write every sample to the bit, with units, frames, source, notes, attributes, repairs and contents.

    Raises:
        InputError: the folder does not exist or cannot be written, or `path` is a folder.
    """
    write_atomically(path, lambda stream: _write(recording, stream))


def _write(recording: Recording, stream: BinaryIO) -> None:
    file = McapFile(lambda data: _append(stream, data), LIBRARY)
    about = About.of(recording)
    file.metadata(ABOUT, about.metadata())
    sources = list(_sources(recording, file, about.base))
    for records, messages in _chunks(sources):
        file.chunk(records, messages)
    file.finish()


def _append(stream: BinaryIO, data: bytes) -> None:
    stream.write(data)


@dataclass(frozen=True)
class _Source:
    """Channels that share their times, with the id of their MCAP channel."""

    identity: int
    form: SourceFormat
    channels: Sequence[Channel]
    log_time: NDArray[np.uint64]

    def records(self, rows: slice) -> NDArray[np.uint8]:
        values: Array = np.column_stack([channel.values[rows] for channel in self.channels])
        data = encode_samples(self.channels[0].t[rows], values)
        return message_records(self.identity, self.log_time[rows], data)


def _sources(recording: Recording, file: McapFile, base: int) -> Iterator[_Source]:
    groups: dict[bytes, list[Channel]] = {}
    keys: dict[int, bytes] = {}
    for channel in recording.channels.values():
        groups.setdefault(keys.setdefault(id(channel.t), channel.t.tobytes()), []).append(channel)
    topics: list[str] = []
    for channels in groups.values():
        quantities = [Quantity(each.name, each.unit, each.frame) for each in channels]
        form = SourceFormat.named_after(quantities, topics)
        topics.append(form.topic)
        identity = file.channel(form.topic, ENCODING, form.metadata, form.schema)
        yield _Source(identity, form, channels, log_times(channels[0].t, base))


def _chunks(sources: Sequence[_Source]) -> Iterator[tuple[bytes, dict[int, Messages]]]:
    """Yield the message records of all sources in order of time, in chunks."""
    counts = [len(source.log_time) for source in sources]
    owner = np.repeat(np.arange(len(sources)), counts)
    order = np.argsort(np.concatenate([source.log_time for source in sources]), kind="stable")
    owner = owner[order]
    sizes = np.array([MESSAGE_HEAD.itemsize + source.form.message_size for source in sources])[owner]
    ends = np.cumsum(sizes)
    done = np.zeros(len(sources), dtype=np.intp)
    first = 0
    while first < order.size:
        begin = int(ends[first] - sizes[first])
        last = max(int(np.searchsorted(ends, begin + _CHUNK, "right")), first + 1)
        owners, offsets = owner[first:last], ends[first:last] - sizes[first:last] - begin
        records = np.empty(int(ends[last - 1]) - begin, dtype=np.uint8)
        messages: dict[int, Messages] = {}
        for k, source in enumerate(sources):
            places = offsets[owners == k]
            if places.size:
                rows = slice(int(done[k]), int(done[k]) + places.size)
                block = source.records(rows)
                records[places[:, None] + np.arange(block.shape[1])] = block
                messages[source.identity] = Messages(source.log_time[rows], places.astype(np.uint64))
                done[k] += places.size
        yield records.tobytes(), messages
        first = last
