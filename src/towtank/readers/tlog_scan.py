"""Finds the packets of a .tlog: MAVLink 1 and 2, each behind the time of receipt in 8 bytes (us, Unix, big endian).

A packet counts where its checksum is right. One with a wrong checksum between two others is damaged, or of a message
that its sender defines otherwise; after bytes that are no packet at all the search goes on from the next right one.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from towtank.readers.mavlink_checksum import checksum
from towtank.readers.mavlink_format import MessageLayout

__all__ = ["Group", "Packets", "scan_tlog"]

_STAMP = 8
_MAVLINK_1, _MAVLINK_2 = 0xFE, 0xFD
_MAGIC = re.compile(b"[\xfd\xfe]")
_STAMPED = re.compile(b"\0[\0-\x0e][\0-\xff]{6}[\xfd\xfe]")
_MANY_VAIN, _MOST_VAIN = 20_000, 500_000  # checksums that were wrong where no packet was
_SIGNED = 1
_CRC = 2


@dataclass
class Group:
    """The packets of one message type by one sender: places in the file, times of receipt [us], payloads."""

    places: array[int] = field(default_factory=lambda: array("q"))
    stamps: array[int] = field(default_factory=lambda: array("Q"))
    payloads: list[bytes] = field(default_factory=list)


@dataclass(frozen=True)
class Packets:
    """What a file holds.

    Attributes:
        groups: (message number, system, component) -> its packets.
        wrong: (message number, system, component) -> packets with a wrong checksum.
        unknown: packets of message numbers that the dialect lacks, so that they cannot be checked.
        stretches: stretches of bytes that are no packets. skipped: how many bytes these are.
        given_up: whether the search for packets was given up in the last one.
    """

    groups: Mapping[tuple[int, int, int], Group]
    wrong: Counter[tuple[int, int, int]]
    unknown: Counter[int]
    stretches: int
    skipped: int
    given_up: bool = False


def scan_tlog(data: bytes, layouts: Mapping[int, MessageLayout]) -> Packets:
    """Find the packets of a file."""
    groups: dict[tuple[int, int, int], Group] = {}
    wrong: Counter[tuple[int, int, int]] = Counter()
    unknown: Counter[int] = Counter()
    stretches = skipped = at = vain = 0
    lost_since = -1
    size = len(data)
    while at + _STAMP + 3 <= size:
        start = at + _STAMP
        magic = data[start]
        if magic == _MAVLINK_2:
            head, tail = 10, 13 if data[start + 2] & _SIGNED else 0
        elif magic == _MAVLINK_1:
            head, tail = 6, 0
        else:
            head = tail = 0
        end = start + head + data[start + 1]
        after = end + _CRC + tail
        good = follows = False
        layout = None
        if head and after <= size:
            if magic == _MAVLINK_2:
                key = int.from_bytes(data[start + 7 : start + 10], "little"), data[start + 5], data[start + 6]
            else:
                key = data[start + 5], data[start + 3], data[start + 4]
            layout = layouts.get(key[0])
            if layout is not None:
                good = checksum(data[start + 1 : end] + layout.crc_extra) == data[end] | data[end + 1] << 8
            follows = after + _STAMP < size and data[after + _STAMP] in (_MAVLINK_1, _MAVLINK_2)
        if good:
            group = groups.get(key)
            if group is None:
                group = groups[key] = Group()
            group.places.append(at)
            group.stamps.append(int.from_bytes(data[at:start], "big"))
            group.payloads.append(data[start + head : end])
        elif follows and lost_since < 0:
            if layout is None:
                unknown[key[0]] += 1
            else:
                wrong[key] += 1
        else:
            if lost_since < 0:
                lost_since = at
            vain += layout is not None
            if vain > _MOST_VAIN:
                break
            at = _next_start(data, start + 1, stamped=vain > _MANY_VAIN) - _STAMP
            continue
        if lost_since >= 0:
            stretches, skipped, lost_since = stretches + 1, skipped + at - lost_since, -1
        at = after
    if lost_since >= 0 or at < size:
        stretches, skipped = stretches + 1, skipped + size - (at if lost_since < 0 else lost_since)
    return Packets(groups, wrong, unknown, stretches, skipped, given_up=vain > _MOST_VAIN)


def _next_start(data: bytes, at: int, *, stamped: bool) -> int:
    """Return where a packet may next begin, if `stamped` behind a time before 2100; else the size of the file."""
    found = _STAMPED.search(data, at - _STAMP) if stamped else _MAGIC.search(data, at)
    return found.end() - 1 if found else len(data)
