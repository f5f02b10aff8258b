"""MCAP: our own recordings, ROS 2 in CDR, MAVLink and other messages in JSON, told apart channel by channel."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from towtank.errors import InputError
from towtank.readers.common.interpretation import contents_of
from towtank.readers.common.mapped_tables import mapped_recording
from towtank.readers.common.raw_messages import Topic
from towtank.readers.common.tables import Table, Tables
from towtank.readers.mavlink.autopilot import with_autopilot
from towtank.readers.mavlink.meaning import mavlink_recording, with_autopilot_states
from towtank.readers.mavlink.senders import Sender
from towtank.readers.mcap.json import is_mavlink, json_table, mavlink_tables
from towtank.readers.mcap.own import own_recording, own_tables
from towtank.readers.mcap.scan import Heading, McapContent, scan_mcap
from towtank.readers.ros.meaning import LISTED
from towtank.readers.ros.tables import RosLog, epoch_of, is_wanted, origin_of, ros_recording, ros_tables
from towtank.recording.mapping import ColumnMapping, load_mapping
from towtank.recording.mcap.format import KEY
from towtank.recording.recording import Recording
from towtank.recording.repairs import Repairs

__all__ = ["read", "tables_of"]


def read(path: Path, mapping: ColumnMapping | str | os.PathLike[str] | None = None) -> Recording:
    """Read an MCAP file.

    Args:
        path: the file; truncated and damaged ones are read as far as they go.
        mapping: "TOPIC.field" columns, of MAVLink "MESSAGE.field"; without it what the messages mean is taken.

    Raises:
        InputError: the file is not MCAP, or nothing in it can be used.
    """
    known = mapping if isinstance(mapping, ColumnMapping) or mapping is None else load_mapping(mapping)
    content = _scanned(path, lambda name, kind: is_wanted(name, kind, known))
    if any(KEY in topic.metadata for topic in content.topics):
        return own_recording(path, content) if known is None else mapped_recording(own_tables(path, content), known)
    return _foreign(str(path), content, known)


def tables_of(path: Path) -> Tables:
    """Return all tables of a file, as a mapping finds them."""
    content = _scanned(path, lambda name, kind: kind not in LISTED)
    if any(KEY in topic.metadata for topic in content.topics):
        return own_tables(path, content)
    mavlink = [topic for topic in content.topics if is_mavlink(topic.name, topic.encoding)]
    rest = [topic for topic in content.topics if topic not in mavlink]
    if not mavlink:
        return _all(Tables(str(path), {}, repairs=content.repairs), rest, origin_of(rest))
    known, senders = _of_mavlink(str(path), content, mavlink)
    return _all(with_autopilot(known, senders), rest, origin_of(mavlink))


def _scanned(path: Path, wanted: Callable[[str, str], bool]) -> McapContent:
    """Return the messages of our own, of MAVLink, and of the topics that are wanted by name and type."""

    def kept(heading: Heading) -> bool:
        own = KEY in heading.metadata or is_mavlink(heading.name, heading.encoding)
        return own or wanted(heading.name, heading.kind)

    content = scan_mcap(path, kept)
    if not any(len(topic) for topic in content.topics):
        lost = "; ".join(content.repairs.lines)
        raise InputError(f"{path}: no message in it{f' ({lost})' if lost else ''}, expected samples, ROS or MAVLink")
    return content


def _of_mavlink(source: str, content: McapContent, mavlink: Sequence[Topic]) -> tuple[Tables, dict[str, Sender]]:
    origin = origin_of(mavlink)
    tables, senders, damaged = mavlink_tables(mavlink, origin)
    repairs = content.repairs + Repairs(damaged=damaged)
    attributes = {"clock": "companion computer", **epoch_of(origin)}
    return Tables(source, tables, repairs=repairs, attributes=attributes), senders


def _foreign(source: str, content: McapContent, mapping: ColumnMapping | None) -> Recording:
    """Return the recording of messages that others wrote."""
    mavlink = [topic for topic in content.topics if is_mavlink(topic.name, topic.encoding)]
    plain = [topic for topic in content.topics if topic.encoding == "json" and topic not in mavlink]
    rest = [topic for topic in content.topics if topic.encoding != "json"]
    if not mavlink:
        log = ros_tables(source, rest, content.repairs, origin=origin_of(content.topics))
        return ros_recording(_with_json(log, plain, origin_of(content.topics)), mapping)
    origin = origin_of(mavlink)
    known, senders = _of_mavlink(source, content, mavlink)
    if mapping is None:
        return _beside(mavlink_recording(known, senders), known, [*plain, *rest], origin)
    known = with_autopilot(known, senders)
    mapped = mapped_recording(_all(known, [*plain, *rest], origin), mapping)
    return with_autopilot_states(mapped, known, senders)


def _with_json(log: RosLog, topics: Sequence[Topic], origin: int) -> RosLog:
    """Return the log with topics of JSON, which a mapping may name."""
    tables, reasons, repairs = dict(log.tables.tables), dict(log.reasons), log.tables.repairs
    for topic in topics:
        table, damaged = json_table(topic, origin)
        tables[topic.name] = table
        reasons[topic.name] = "means nothing by its type; its numbers can be mapped"
        repairs += Repairs(damaged=damaged)
    return RosLog(replace(log.tables, tables=tables, repairs=repairs), reasons)


def _all(known: Tables, topics: Sequence[Topic], origin: int) -> Tables:
    """Return the tables of MAVLink together with all others."""
    ros = ros_tables(known.source, [topic for topic in topics if topic.encoding != "json"], Repairs(), origin=origin)
    others = _with_json(ros, [topic for topic in topics if topic.encoding == "json"], origin).tables
    return replace(known, tables={**others.tables, **known.tables}, repairs=known.repairs + others.repairs)


def _beside(recording: Recording, known: Tables, topics: Sequence[Topic], origin: int) -> Recording:
    """Return the recording with what else the file holds among its contents."""
    tables = {
        topic.name: Table(topic.name, (topic.log_time - origin) / 1e9, {}, topic.kind or topic.encoding)
        for topic in topics
        if topic.name not in known.tables
    }
    others = contents_of(replace(known, tables=tables), {}, {}, "beside MAVLink messages nothing else is taken")
    return replace(recording, contents=(*recording.contents, *others))
