"""MAVLink telemetry logs (.tlog): packets of MAVLink 1 and 2, each behind its time of receipt.

The time has 8 bytes (us, Unix, big endian). A packet counts where its checksum is right. One with a wrong checksum
between two others is damaged, or of a message that its sender defines otherwise; after bytes that are no packet at all
the search goes on from the next right one.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from towtank.errors import InputError
from towtank.readers.common.clock import epoch_of, one_clock
from towtank.readers.common.mapped_tables import mapped_recording
from towtank.readers.common.tables import Table, Tables
from towtank.readers.mavlink.autopilot import with_autopilot
from towtank.readers.mavlink.format import MessageLayout, checksum, layouts
from towtank.readers.mavlink.meaning import mavlink_recording, with_autopilot_states
from towtank.readers.mavlink.senders import Sender, named_tables
from towtank.readers.mavlink.tables import tables_by_instance
from towtank.readers.registry import AnyMapping
from towtank.recording.recording import Recording
from towtank.recording.repairs import Repairs

__all__ = ["Group", "decode", "read", "scan_tlog", "tables_of"]

_STAMP = 8
_MAVLINK_1, _MAVLINK_2 = 0xFE, 0xFD
_MAGIC = re.compile(b"[\xfd\xfe]")
_STAMPED = re.compile(b"\0[\0-\x0e][\0-\xff]{6}[\xfd\xfe]")
_MANY_VAIN, _MOST_VAIN = 20_000, 500_000  # checksums that were wrong where no packet was
_SIGNED = 1
_CRC = 2
_SHOWN = 6


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


def decode(data: bytes, source: str) -> tuple[Tables, dict[str, Sender]]:
    """Return the tables of a log and the sender of each, t = 0 at its first packet.

    Raises:
        InputError: there is no packet with a right checksum.
    """
    known = layouts()
    packets = scan_tlog(data, known)
    if not packets.groups:
        raise InputError(
            f"{source}: no MAVLink packet with a right checksum in it; expected the telemetry log of a ground station"
        )
    groups = list(packets.groups.items())
    stamps = [np.array(group.stamps, dtype=np.uint64) for _, group in groups]
    order = np.argsort(np.concatenate([np.array(group.places) for _, group in groups]), kind="stable")
    found = one_clock(1e-6 * np.concatenate(stamps)[order].astype(np.float64), absolute=True)
    keep = np.empty_like(found.keep)
    keep[order] = found.keep
    masks = np.split(keep, np.cumsum([own.size for own in stamps])[:-1])
    first = min(int(own[mask].min()) for own, mask in zip(stamps, masks, strict=True) if mask.any())
    pieces: list[tuple[Sender, str, Table]] = []
    for ((number, system, component), group), own, mask in zip(groups, stamps, masks, strict=True):
        if mask.any():
            t = (own[mask] - np.uint64(first)).astype(np.float64) * 1e-6
            payloads = [group.payloads[i] for i in np.flatnonzero(mask)]
            for instance, table in tables_by_instance(known[number], payloads, t):
                pieces.append((Sender(system, component), instance, table))
    tables, senders = named_tables(pieces)
    epoch = epoch_of(first * 1e-6)
    notes = [found.note] if found.note else []
    if not epoch:
        notes.append(
            f"the first stamp is {first * 1e-6:.6g} s after 1970, expected one before 2100: the ground station's clock "
            "was wrong, and the date is not known"
        )
    whole = Tables(
        source=source,
        tables=tables,
        notes=tuple(notes),
        repairs=_repairs(packets, found.stray, known),
        attributes={"clock": "ground station", **epoch},
    )
    return whole, senders


def read(path: Path, mapping: AnyMapping) -> Recording:
    """Return the recording of a log; with a mapping, of what it names. The autopilot's states are always in it."""
    tables, senders = decode(path.read_bytes(), str(path))
    if mapping is not None:
        known = with_autopilot(tables, senders)
        return with_autopilot_states(mapped_recording(known, mapping), known, senders)
    return mavlink_recording(tables, senders)


def tables_of(path: Path) -> Tables:
    """Return all tables of a log, as a mapping finds them."""
    return with_autopilot(*decode(path.read_bytes(), str(path)))


def _repairs(packets: Packets, stray: int, known: dict[int, MessageLayout]) -> Repairs:
    details = []
    if packets.wrong:
        by_sender = packets.wrong.most_common(_SHOWN)
        listed = ", ".join(
            f"{n} {known[number].name} of {system}.{component}" for (number, system, component), n in by_sender
        )
        more = "" if len(packets.wrong) <= _SHOWN else ", ..."
        details.append(f"wrong checksum, or defined otherwise by the sender: {listed}{more}")
    if packets.unknown:
        numbers = ", ".join(str(number) for number, _ in packets.unknown.most_common(_SHOWN))
        details.append(f"{packets.unknown.total()} messages of unknown numbers ({numbers}) were skipped")
    if packets.skipped:
        details.append(f"{packets.skipped} bytes that are no message were skipped")
    if packets.given_up:
        details.append("the file is mostly something else; the search for messages was given up in the last stretch")
    return Repairs(damaged=packets.wrong.total() + packets.stretches + stray, details=tuple(details))
