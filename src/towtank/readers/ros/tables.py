"""Topics of ROS messages as tables, and from them a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.ardupilot.states import mavros_states, with_states
from towtank.readers.common.interpretation import recording_of
from towtank.readers.common.mapped_tables import mapped_recording
from towtank.readers.common.raw_messages import Integers, Topic
from towtank.readers.common.tables import Table, Tables
from towtank.readers.ros.clock import reconciled
from towtank.readers.ros.doubts import judged
from towtank.readers.ros.frames import at_base_link, is_static
from towtank.readers.ros.layout import decode
from towtank.readers.ros.meaning import LISTED, has_meaning, meaning_of, thruster_sources
from towtank.readers.ros.types import numbers_of, types_of
from towtank.recording.mapping import ColumnMapping
from towtank.recording.recording import Recording
from towtank.recording.repairs import Repairs

__all__ = [
    "STATE",
    "RosLog",
    "epoch_of",
    "is_wanted",
    "origin_of",
    "ros_recording",
    "ros_tables",
    "table_of",
]

STATE = "mavros_msgs/msg/State"  # of the autopilot: armed, mode
_STAMPS = ("header.stamp", "stamp")
_CLOCK = "recorder"


@dataclass(frozen=True)
class RosLog:
    """Tables of a ROS recording, and why some have no columns."""

    tables: Tables
    reasons: Mapping[str, str] = field(default_factory=dict)


def is_wanted(name: str, kind: str, mapping: ColumnMapping | None) -> bool:
    """Whether a topic is worth decoding: its type means something, or the mapping names it."""
    if kind == STATE:
        return True
    if mapping is None:
        return has_meaning(name, kind) or is_static(name, kind)
    return any(column.source.startswith(f"{name}.") for column in mapping.channels().values())


def ros_tables(source: str, topics: Sequence[Topic], repairs: Repairs, origin: int | None = None) -> RosLog:
    """Return the tables of the topics, on one clock; the columns of those whose messages were kept.

    Args:
        origin: time of t = 0 [ns], that of the first message unless it is given.
    """
    origin = origin_of(topics) if origin is None else origin
    tables: list[Table] = []
    reasons: dict[str, str] = {}
    for topic in topics:
        table, reason, damaged = table_of(topic, origin)
        tables.append(table)
        if reason:
            reasons[table.name] = reason
        repairs += Repairs(damaged=damaged)
    clocked = reconciled(tables)
    attributes = {"clock": "stamps" if clocked.simulated else _CLOCK}
    if not clocked.simulated:
        attributes |= epoch_of(origin)
    named = _named(clocked.tables)
    return RosLog(Tables(source, named, notes=clocked.notes, repairs=repairs, attributes=attributes), reasons)


def ros_recording(log: RosLog, mapping: ColumnMapping | None) -> Recording:
    """Return the recording of the tables: by the mapping, else by what the messages mean."""
    if mapping is not None:
        return _with_states(mapped_recording(log.tables, mapping), log.tables)
    tables, notes, static = at_base_link(log.tables.tables)
    sources = [source for table in tables.values() if len(table) for source in meaning_of(table)]
    sources += thruster_sources(tables)
    whole = replace(log.tables, tables=tables, notes=(*log.tables.notes, *notes))
    return _with_states(recording_of(whole, judged(sources, tables), reasons={**log.reasons, **static}), whole)


def _with_states(recording: Recording, tables: Tables) -> Recording:
    """Return the recording with what the autopilot says of itself, the first that says so."""
    table = next((each for each in tables.tables.values() if each.kind == STATE and "armed" in each), None)
    return recording if table is None else with_states(recording, *mavros_states(table))


def table_of(topic: Topic, origin: int) -> tuple[Table, str, int]:
    """Return a topic as a table, why it has no columns, and how many messages could not be decoded."""
    t = _seconds(topic.log_time, origin)
    if topic.kind in LISTED and topic.raw is None:
        return Table(topic.name, t, {}, topic.kind), LISTED[topic.kind], 0
    ros1 = topic.encoding == "ros1"
    if not ros1 and topic.encoding != "cdr":
        return Table(topic.name, t, {}, topic.kind), f'messages in "{topic.encoding}" are not decoded', 0
    try:
        types = types_of(topic.kind, *topic.definition, ros1)
    except ValueError as error:
        return Table(topic.name, t, {}, topic.kind), f"not decoded: {error}", len(topic) if topic.raw else 0
    if topic.raw is None:
        numbers = ", ".join(numbers_of(topic.kind, types))
        reason = f"means nothing by its type; to be mapped: {numbers}" if numbers else ""
        return Table(topic.name, t, {}, topic.kind), reason, 0
    decoded = decode(topic.raw, topic.kind, types, ros1=ros1)
    good = decoded.good
    columns = {path: column[good] for path, column in decoded.columns.items()}
    texts = {
        path: tuple(text for text, known in zip(each, good, strict=True) if known)
        for path, each in decoded.texts.items()
    }
    stamp = _stamp(columns, origin)
    columns = {path: column for path, column in columns.items() if not path.startswith(_STAMPS)}
    frame = ", ".join(dict.fromkeys(filter(None, texts.get("header.frame_id", ()))))
    table = Table(topic.name, t[good], columns, topic.kind, frame, texts, stamp)
    damaged = int(np.count_nonzero(~good))
    return table, "its messages do not fit their type" if damaged == len(topic) > 0 else "", damaged


def origin_of(topics: Sequence[Topic]) -> int:
    """Return the time [ns] of the first message of all."""
    return min((int(topic.log_time[0]) for topic in topics if len(topic)), default=0)


def epoch_of(origin: int) -> dict[str, str]:
    """Return the instant of t = 0 as an attribute, nothing where the times do not count from 1970."""
    if origin < 10**17:  # before 1973: a boot time
        return {}
    try:
        moment = datetime.fromtimestamp(origin // 10**9, UTC) + timedelta(microseconds=origin % 10**9 // 1000)
    except (OverflowError, ValueError, OSError):
        return {}
    return {"epoch": moment.isoformat()}


def _seconds(times: Integers, origin: int) -> Array:
    result: Array = (times - origin) / 1e9
    return result


def _stamp(columns: Mapping[str, Array], origin: int) -> Array | None:
    """Return the stamps of the messages [s] from the log's first message, NaN where there is none."""
    for path in _STAMPS:
        if f"{path}.sec" in columns and f"{path}.nanosec" in columns:
            seconds, fraction = columns[f"{path}.sec"], columns[f"{path}.nanosec"]
            absent = (seconds == 0.0) & (fraction == 0.0)
            if absent.all():
                return None
            whole, rest = divmod(origin, 10**9)
            return np.where(absent, np.nan, (seconds - whole) + (fraction - rest) * 1e-9)
    return None


def _named(tables: Sequence[Table]) -> dict[str, Table]:
    """Return the tables by name; a topic with messages of two types is two tables, the second with its type."""
    named: dict[str, Table] = {}
    for table in tables:
        name = table.name if table.name not in named else f"{table.name}[{table.kind}]"
        named[name] = table if name == table.name else Table(name, table.t, {}, table.kind)
    return named
