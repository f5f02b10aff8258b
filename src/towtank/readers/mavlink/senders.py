"""Who speaks on a MAVLink link: the autopilot, companions and ground stations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from towtank.readers.common.tables import Table

__all__ = ["ANOTHER", "KIND", "Autopilot", "Sender", "autopilot_of", "message_of", "named_tables"]

KIND = "MAVLink"
ANOTHER = "another autopilot"
_GENERIC, _ARDUPILOT, _NO_AUTOPILOT = 0.0, 3.0, 8.0  # MAV_AUTOPILOT
_GROUND_STATION = 6.0  # MAV_TYPE_GCS
_TYPICAL = ("ATTITUDE", "ATTITUDE_QUATERNION", "RAW_IMU", "SERVO_OUTPUT_RAW", "LOCAL_POSITION_NED", "SYS_STATUS")


class Sender(NamedTuple):
    """System and component, as messages bear them."""

    system: int
    component: int

    def __str__(self) -> str:
        return f"{self.system}.{self.component}"


@dataclass(frozen=True)
class Autopilot:
    """The autopilot whose messages are used.

    Attributes:
        sender: it, None where none speaks.
        others: every other sender and what it is.
        is_ardupilot: whether it is ArduPilot, as it is taken to be where it does not say.
    """

    sender: Sender | None
    others: Mapping[Sender, str]
    is_ardupilot: bool = True


def named_tables(pieces: Iterable[tuple[Sender, str, Table]]) -> tuple[dict[str, Table], dict[str, Sender]]:
    """Name tables by message; [instance] where a sender has several, @system.component where several send it.

    Args:
        pieces: sender, instance ("" for none) and the table under the message's bare name.

    Returns:
        The tables and the sender of each, by name.
    """
    parts = list(pieces)
    senders: dict[str, set[Sender]] = {}
    instances: Counter[tuple[str, Sender]] = Counter()
    for sender, _, table in parts:
        senders.setdefault(table.name, set()).add(sender)
        instances[table.name, sender] += 1
    tables: dict[str, Table] = {}
    by_name: dict[str, Sender] = {}
    for sender, instance, table in parts:
        name = table.name
        if instances[table.name, sender] > 1:
            name += f"[{instance}]"
        if len(senders[table.name]) > 1:
            name += f"@{sender}"
        tables[name] = replace(table, name=name)
        by_name[name] = sender
    return tables, by_name


def message_of(name: str) -> str:
    """Return the message of a table by its name."""
    return name.partition("@")[0].partition("[")[0]


def autopilot_of(tables: Mapping[str, Table], senders: Mapping[str, Sender]) -> Autopilot:
    """Find the autopilot: by its heartbeat, else by the messages that only autopilots send; the busiest of several."""
    kinds: dict[Sender, tuple[float, float]] = {}
    busy: Counter[Sender] = Counter()
    typical: Counter[Sender] = Counter()
    for name, table in tables.items():
        sender, message = senders[name], message_of(name)
        busy[sender] += len(table)
        typical[sender] += len(table) if message in _TYPICAL else 0
        if message == "HEARTBEAT" and "autopilot" in table and "type" in table:
            kinds[sender] = _usual(table, "autopilot"), _usual(table, "type")
    able = [
        sender for sender, (autopilot, kind) in kinds.items() if autopilot != _NO_AUTOPILOT and kind != _GROUND_STATION
    ]
    if not able:
        able = [sender for sender, count in typical.items() if count and sender not in kinds]
    chosen = max(able, key=lambda sender: (typical[sender], busy[sender]), default=None)
    rivals = frozenset(able)
    others = {sender: _what(sender, kinds, sender in rivals) for sender in busy if sender != chosen}
    is_ardupilot = chosen not in kinds or kinds[chosen][0] in (_GENERIC, _ARDUPILOT)
    return Autopilot(chosen, others, is_ardupilot)


def _usual(table: Table, field: str) -> float:
    values, counts = np.unique(table[field], return_counts=True)
    return float(values[np.argmax(counts)])


def _what(sender: Sender, kinds: Mapping[Sender, tuple[float, float]], able: bool) -> str:
    if able:
        return ANOTHER
    kind = kinds.get(sender, (0.0, 0.0))[1]
    if kind == _GROUND_STATION or (sender not in kinds and sender.system >= 250):
        return "a ground station"
    return "a companion"
