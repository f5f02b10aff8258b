"""The autopilot's share in a MAVLink log: its parameters, and its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timedelta

from towtank.readers.mavlink_senders import Autopilot, Sender, autopilot_of, message_of
from towtank.readers.own_stamps import from_zero, own_clock, with_own_stamps, with_sender_stamps
from towtank.readers.tables import Tables

__all__ = ["DVL", "TO_AUTOPILOT", "with_autopilot"]

DVL = "VISION_POSITION_DELTA"
TO_AUTOPILOT = (DVL, "ATT_POS_MOCAP", "ODOMETRY", "VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE")


def with_autopilot(tables: Tables, senders: Mapping[str, Sender]) -> Tables:
    """Return the tables with the autopilot's parameters, and its messages on its own clock where it tells it."""
    autopilot = autopilot_of(tables.tables, senders)
    own = {name: table for name, table in tables.tables.items() if senders[name] == autopilot.sender}
    parameters = dict(tables.parameters)
    for name, table in own.items():
        if message_of(name) == "PARAM_VALUE" and "param_id" in table.text and "param_value" in table:
            parameters |= dict(zip(table.text["param_id"], table["param_value"].tolist(), strict=True))
    notes = [_about(autopilot)]
    attributes = dict(tables.attributes)
    clock = own_clock(own)
    stamped = {
        name: with_sender_stamps(table) if message_of(name) in TO_AUTOPILOT and name not in own else table
        for name, table in tables.tables.items()
    }
    if clock is not None:
        stamped |= {name: with_own_stamps(table, clock) for name, table in own.items()}
        attributes["clock"] = f"{attributes.get('clock', 'receiver')}; stamps of the autopilot where it gives them"
        notes.append(
            f"the autopilot's stamps are used in place of times of receipt, which are {1e3 * clock.usual_delay:.0f} ms "
            f"later as a rule and up to {1e3 * clock.longest_delay:.0f} ms"
        )
    stamped, start = from_zero(stamped)
    if start and "epoch" in attributes:
        attributes["epoch"] = (datetime.fromisoformat(attributes["epoch"]) + timedelta(seconds=start)).isoformat()
    return replace(tables, tables=stamped, parameters=parameters, notes=(*tables.notes, *notes), attributes=attributes)


def _about(autopilot: Autopilot) -> str:
    others = ", ".join(f"{what} ({sender})" for sender, what in sorted(autopilot.others.items()))
    if autopilot.sender is None:
        return f"no autopilot speaks; heard: {others}" if others else "no autopilot speaks"
    return f"the autopilot is {autopilot.sender}" + (f"; also heard: {others}" if others else "")
