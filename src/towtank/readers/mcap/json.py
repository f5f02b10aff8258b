"""JSON messages in MCAP: MAVLink as BlueOS records it, and topics of any other kind.

BlueOS writes every MAVLink message to the topic `mavlink/out`, and a second time to a topic of its type, as
`{"header": {"system_id", "component_id", ...}, "message": {"type": "ATTITUDE", ...}}`; enumerations by name. They
become the tables that a telemetry log gives, so that their meaning is found in one place.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.raw_messages import Topic
from towtank.readers.common.tables import Table
from towtank.readers.mavlink.format import layouts
from towtank.readers.mavlink.senders import KIND, Sender, named_tables

__all__ = ["is_mavlink", "json_table", "mavlink_tables"]

_ALL = "mavlink/out"
_LONGEST = 64  # elements of an array that become columns
_DEEPEST = 8  # levels of objects in objects
_MOST_COLUMNS = 512
_MOST_INSTANCES = 64
_SENDER = ("system_id", "component_id")
Message = Mapping[str, Any]


def is_mavlink(name: str, encoding: str) -> bool:
    """Whether a topic bears MAVLink messages as BlueOS writes them."""
    return encoding == "json" and name.lstrip("/").startswith("mavlink/")


def mavlink_tables(topics: Sequence[Topic], origin: int) -> tuple[dict[str, Table], dict[str, Sender], int]:
    """Return the tables of MAVLink topics, the sender of each, and how many messages could not be understood.

    Args:
        topics: with their messages; where one bears all messages the others are passed over.
        origin: time of t = 0 [ns].
    """
    chosen = [topic for topic in topics if topic.name.strip("/") == _ALL] or topics
    times: dict[tuple[Sender, str], list[int]] = {}
    rows: dict[tuple[Sender, str], list[Message]] = {}
    damaged = 0
    for topic in chosen:
        messages = [] if topic.raw is None else topic.raw.messages()
        for moment, message in zip(topic.log_time.tolist(), messages, strict=True):
            try:
                whole = json.loads(message)
                header, content = whole["header"], whole["message"]
                key = Sender(*(int(header[field]) for field in _SENDER)), str(content["type"])
            except (ValueError, KeyError, TypeError, RecursionError):
                damaged += 1
                continue
            times.setdefault(key, []).append(moment)
            rows.setdefault(key, []).append(content)
    instance_of = {layout.name: layout.instance for layout in layouts().values()}
    pieces: list[tuple[Sender, str, Table]] = []
    for (sender, name), moments in times.items():
        t = (np.array(moments, dtype=np.int64) - origin) / 1e9
        columns, texts = _columns(rows[sender, name], named=True)
        table = Table(name, t, columns, KIND, text=texts)
        pieces += [(sender, instance, part) for instance, part in _by_instance(table, instance_of.get(name, ""))]
    tables, senders = named_tables(pieces)
    return tables, senders, damaged


def json_table(topic: Topic, origin: int) -> tuple[Table, int]:
    """Return a topic of JSON messages as a table, and how many of them could not be read; times alone if not kept."""
    if topic.raw is None:
        return Table(topic.name, (topic.log_time - origin) / 1e9, {}, topic.kind or "JSON"), 0
    times, rows = [], []
    messages = topic.raw.messages()
    for moment, message in zip(topic.log_time.tolist(), messages, strict=True):
        try:
            content = json.loads(message)
        except (ValueError, RecursionError):
            continue
        rows.append(content if isinstance(content, dict) else {"value": content})
        times.append(moment)
    t = (np.array(times, dtype=np.int64) - origin) / 1e9
    columns, texts = _columns(rows, named=False)
    return Table(topic.name, t, columns, topic.kind or "JSON", text=texts), len(messages) - len(rows)


def _columns(rows: Sequence[Message], *, named: bool) -> tuple[dict[str, Array], dict[str, tuple[str, ...]]]:
    """Return columns of numbers by path and columns of text; with `named`, names of MAVLink's constants as numbers."""
    found = _Columns({}, {}, named)
    for key in dict.fromkeys(key for row in rows for key in row):
        if not (named and key == "type"):  # the message's own; that of a vehicle is called "mavtype"
            found.add("type" if named and key == "mavtype" else str(key), [row.get(key) for row in rows], 0)
    return found.numbers, found.texts


@dataclass(frozen=True)
class _Columns:
    numbers: dict[str, Array]
    texts: dict[str, tuple[str, ...]]
    named: bool

    def add(self, path: str, values: list[Any], depth: int) -> None:
        """Add what one field holds in all messages; None where a message lacks it."""
        if len(self.numbers) + len(self.texts) >= _MOST_COLUMNS:
            return
        kinds = set(map(type, values)) - {type(None)}
        if kinds <= {int, float, bool}:
            self.numbers[path] = np.array([_number(value) for value in values], dtype=np.float64)
        elif str in kinds:
            self._add_words(path, [value if isinstance(value, str) else "" for value in values])
        elif depth < _DEEPEST and list in kinds:
            self._add_lists(path, [value if isinstance(value, list) else [] for value in values], depth)
        elif depth < _DEEPEST:
            self._add_objects(path, [value if isinstance(value, dict) else {} for value in values], depth)

    def _add_words(self, path: str, words: list[str]) -> None:
        known = [_constant(word) if self.named and word else None for word in words]
        if any(number is not None for number in known):
            self.numbers[path] = np.array([np.nan if number is None else number for number in known])
        else:
            self.texts[path] = tuple(word.split("\0")[0] for word in words)

    def _add_lists(self, path: str, lists: list[list[Any]], depth: int) -> None:
        if all(isinstance(each, str) for values in lists for each in values):  # a text, character by character
            self.texts[path] = tuple("".join(values).split("\0")[0] for values in lists)
            return
        for k in range(min(max(map(len, lists)), _LONGEST)):
            self.add(f"{path}[{k}]", [values[k] if k < len(values) else None for values in lists], depth + 1)

    def _add_objects(self, path: str, objects: list[Message], depth: int) -> None:
        keys = dict.fromkeys(key for each in objects for key in each)
        if self.named and keys.keys() <= {"type", "bits"}:  # a constant: {"type": "MAV_STATE_ACTIVE"}, {"bits": 81}
            self.add(path, [each.get("bits", each.get("type")) for each in objects], depth + 1)
            return
        for key in keys:
            self.add(f"{path}.{key}", [each.get(key) for each in objects], depth + 1)


def _number(value: Any) -> float:
    try:
        return float("nan") if value is None else float(value)
    except OverflowError:
        return float("nan")


@cache
def _constant(word: str) -> float | None:
    """Return the number of a constant of MAVLink, or of several joined by |; None where it is none."""
    from pymavlink.dialects.v20 import ardupilotmega

    total = 0
    for part in word.split("|"):
        number = getattr(ardupilotmega, part.strip(), None) if part.strip().isupper() else None
        if not isinstance(number, int):
            return None
        total |= number
    return float(total)


def _by_instance(table: Table, field: str) -> list[tuple[str, Table]]:
    """Return instance and table, "" where the messages are of one instance."""
    if field in table.columns:
        keys = np.array([f"{number:g}" for number in table[field]])
    elif field in table.text:
        keys = np.array(table.text[field])
    else:
        return [("", table)]
    instances = np.unique(keys)
    if instances.size > _MOST_INSTANCES:
        return [("", table)]
    return [(str(instance), _rows(table, np.flatnonzero(keys == instance))) for instance in instances]


def _rows(table: Table, rows: Any) -> Table:
    return Table(
        table.name,
        table.t[rows],
        {path: column[rows] for path, column in table.columns.items()},
        table.kind,
        text={path: tuple(texts[i] for i in rows) for path, texts in table.text.items()},
    )
