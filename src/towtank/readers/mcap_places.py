"""Where the messages of an MCAP chunk stand: by the index behind it where that is right, else found by walking."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.readers.mcap_records import MESSAGE
from towtank.readers.raw_messages import Bytes, Integers, gather

__all__ = ["HEAD", "MESSAGE_HEAD", "Places", "count", "gaps", "indexed", "signed"]

HEAD = 31  # bytes of a message record before its data
_RECORD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
MESSAGE_HEAD = np.dtype(_RECORD.descr[2:])  # of a message record's content


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
    if not parts or not sum(map(len, parts)) or buffer.size < HEAD:
        return nothing
    offset = np.concatenate(parts)[:, 1]
    if (offset > buffer.size - HEAD).any():
        return nothing
    order = np.argsort(offset, kind="stable")
    place = offset[order].astype(np.int64)
    heads = np.ascontiguousarray(gather(buffer, place, HEAD)).view(_RECORD).reshape(-1)
    length = heads["length"]
    right = (heads["opcode"] == MESSAGE) & (length >= 22) & (length <= buffer.size)
    right &= heads["channel"] == np.concatenate(channels)[order]
    if not right.all():
        return nothing
    size = length.astype(np.int64) - 22
    ends = place + HEAD + size
    if (ends[:-1] > place[1:]).any() or ends[-1] > buffer.size:
        return nothing
    return Places(place + HEAD, size, heads["channel"].astype(np.int64), signed(heads["log_time"]))


def signed(times: NDArray[np.uint64]) -> Integers:
    """Return times [ns] as signed numbers, those beyond their range as the largest."""
    return np.minimum(times, np.uint64(2**63 - 1)).astype(np.int64)


def gaps(starts: Integers, ends: Integers, size: int) -> list[tuple[int, int]]:
    """Return the stretches (from, to) of a buffer that no message covers."""
    left, right = np.concatenate([[0], ends]), np.concatenate([starts, [size]])
    open_ = np.flatnonzero(right > left)
    return list(zip(left[open_].tolist(), right[open_].tolist(), strict=True))
