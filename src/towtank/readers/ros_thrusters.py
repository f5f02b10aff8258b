"""Thrusters that have a topic of numbers each, as simulators have them: numbered by their names, in natural order.

/rov/thrusters/0/input, /rov/thrusters/1/input, ...                          UUV Simulator
/model/rov/joint/thruster1_joint/cmd_thrust, .../thruster2_joint/...         Gazebo
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from towtank.readers.sources import Source
from towtank.readers.tables import Table
from towtank.recording.standard import COMMAND_PREFIX

__all__ = ["SCALARS", "is_thruster_topic", "thruster_order", "thruster_sources"]

SCALARS = frozenset(f"std_msgs/msg/{kind}" for kind in ("Float32", "Float64", "Int16", "Int32", "UInt16", "UInt32"))
_ONE = re.compile(r"^(.*(?:thrust|propeller)[a-z_]*?/?_?)(\d+)(.*)$", re.IGNORECASE)
_INPUT = re.compile(r"(^|[/_])(input|cmd|command|cmd_thrust|cmd_vel|setpoint|thrust|pwm)$", re.IGNORECASE)


def is_thruster_topic(name: str, kind: str) -> bool:
    """Whether a topic of single numbers is the command of one of several thrusters, by its name."""
    match = _ONE.match(name) if kind in SCALARS else None
    return match is not None and (not match[3].strip("/") or _INPUT.search(match[3]) is not None)


def thruster_order(topics: Iterable[tuple[str, str]]) -> dict[str, int]:
    """Return topic -> number of its thruster, from 1, of the largest group of topics named alike.

    Args:
        topics: names and types. Those without numbers between them, or of other types, are no thrusters.
    """
    groups: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for name, kind in topics:
        if is_thruster_topic(name, kind):
            match = _ONE.match(name)
            assert match is not None
            groups.setdefault((match[1], match[3]), []).append((int(match[2]), name))
    largest = max(groups.values(), key=len, default=[])
    return {name: place for place, (_, name) in enumerate(sorted(largest), 1)}


def thruster_sources(tables: Mapping[str, Table]) -> list[Source]:
    """Return the commands of thrusters with a topic each, at all of their times; the first topic stands for all."""
    order = thruster_order((name, table.kind) for name, table in tables.items() if len(table) and "data" in table)
    parts = [(tables[name], f"{COMMAND_PREFIX}{number}") for name, number in order.items()]
    if not parts:
        return []
    main, rest = parts[0][0].name, [table.name for table, _ in parts[1:]]
    t = np.unique(np.concatenate([table.t for table, _ in parts]))
    channels = {}
    for table, channel in parts:
        channels[channel] = np.full(t.size, np.nan)
        channels[channel][np.searchsorted(t, table.t)] = table["data"]
    told = "a topic for each thruster, in the order of their numbers: " + ", ".join((main, *rest))
    found = [Source(main, "commands", t, channels, 0, note=told)]
    none = np.empty(0)
    return found + [Source(name, "commands", none, {}, 0, refused=f"joined to {main}") for name in rest]
