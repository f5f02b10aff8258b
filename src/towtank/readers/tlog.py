"""MAVLink telemetry logs (.tlog), as ground stations write them."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from towtank.errors import InputError
from towtank.readers.clock import one_clock
from towtank.readers.mapped_tables import mapped_recording
from towtank.readers.mavlink_autopilot import with_autopilot
from towtank.readers.mavlink_format import MessageLayout, layouts
from towtank.readers.mavlink_meaning import mavlink_recording
from towtank.readers.mavlink_senders import Sender, named_tables
from towtank.readers.mavlink_tables import tables_by_instance
from towtank.readers.registry import AnyMapping
from towtank.readers.tables import Table, Tables
from towtank.readers.tlog_scan import Packets, scan_tlog
from towtank.recording.recording import Recording
from towtank.recording.repairs import Repairs

__all__ = ["decode", "read"]

_SHOWN = 6


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
    whole = Tables(
        source=source,
        tables=tables,
        notes=(found.note,) if found.note else (),
        repairs=_repairs(packets, found.stray, known),
        attributes={
            "clock": "ground station",
            "epoch": datetime.fromtimestamp(first * 1e-6, UTC).isoformat(),
        },
    )
    return whole, senders


def read(path: Path, mapping: AnyMapping) -> Recording:
    """Return the recording of a log; with a mapping, of what it names."""
    tables, senders = decode(path.read_bytes(), str(path))
    if mapping is not None:
        return mapped_recording(with_autopilot(tables, senders), mapping)
    return mavlink_recording(tables, senders)


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
