"""What an autopilot says of itself: whether it is armed, in which mode, whether it stands on the bottom.

These are no measurements, and commands are the thrusters' own in any case; but they tell which part of a log shows a
vehicle that swims (`recording.grids.free_motion`). A `.BIN` has them as they change (ARM, EV, MODE), MAVLink once a
second in HEARTBEAT, ROS in the topic of MAVROS.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.readers.common.tables import Table, Tables
from towtank.recording.channel import Channel, read_only
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE
from towtank.recording.recording import Recording
from towtank.recording.standard import STATES

__all__ = [
    "States",
    "dataflash_states",
    "heartbeat_channels",
    "heartbeat_modes",
    "heartbeat_states",
    "mavros_channels",
    "mavros_modes",
    "mavros_states",
    "modes_text",
    "tells_pressure",
    "with_depth_by_pressure",
    "with_states",
]

_ARMED, _DISARMED, _BOTTOMED, _NOT_BOTTOMED = 10.0, 11.0, 165.0, 166.0  # EV.Id, ArduPilot's LogEvent
_SAFETY_ARMED = 128  # of HEARTBEAT.base_mode
_SUB = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 7: "CIRCLE", 9: "SURFACE", 16: "POSHOLD",
    19: "MANUAL", 20: "MOTOR_DETECT", 21: "SURFTRAK",
}  # fmt: skip
_ROVER = {
    0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE", 8: "DOCK", 9: "CIRCLE",
    10: "AUTO", 11: "RTL", 12: "SMART_RTL", 15: "GUIDED", 16: "INITIALISING",
}  # fmt: skip
_ROVERS = (10.0, 11.0)  # MAV_TYPE: ground rover, surface boat
_THROTTLES = (26.0, 70.0, 73.0, 74.0)  # SERVOn_FUNCTION: steering, throttle, throttle left and right, of Rover alone
_FROM_PRESSURE = re.compile(r"(BARO|BAR2|BAR3|SCALED_PRESSURE[23]?)(\[|@|$)")
_DISTINCT, _BEFORE = 1e-6, 1e9  # s; before any log
States = Mapping[str, tuple[str, Channel]]  # state -> the table that tells it, and the channel


def with_states(recording: Recording, states: States, modes: Mapping[int, str]) -> Recording:
    """Return a recording with the states of its autopilot, and, where its depth is from pressure, with that said.

    Args:
        modes: names of modes by number, of which those that occur are kept.
    """
    recording = with_depth_by_pressure(recording)
    attributes = dict(recording.attributes)
    if "mode" in states:
        seen = sorted(set(states["mode"][1].values.astype(np.int64).tolist()))
        attributes["modes"] = modes_text({number: modes.get(number, f"mode {number}") for number in seen})
    used: dict[str, list[str]] = {}
    channels = []
    for name, (table, channel) in states.items():
        held = _within(channel, recording.start, recording.end)
        if len(held) and name not in recording:
            used.setdefault(table, []).append(name)
            channels.append(held)
    contents = tuple(
        replace(each, used=(*each.used, *used[each.name]), reason=each.reason if each.used else "")
        if each.name in used
        else each
        for each in recording.contents
    )
    return replace(recording.replace(channels), attributes=attributes, contents=contents)


def modes_text(modes: Mapping[int, str]) -> str:
    """Return the names of modes by number as the attribute "modes" has them."""
    return ", ".join(f"{number} {name}" for number, name in modes.items())


def with_depth_by_pressure(recording: Recording) -> Recording:
    """Return a recording with it said that its z is the depth below the surface, where its table measures pressure."""
    if not any("z" in each.used and tells_pressure(each.name) for each in recording.contents):
        return recording
    return replace(recording, attributes={**recording.attributes, **dict([DEPTH_BELOW_SURFACE])})


def tells_pressure(name: str) -> bool:
    """Whether a table, or a topic of a live recording, is one of the messages that tell the water's pressure."""
    return _FROM_PRESSURE.match(name.rpartition("/")[2]) is not None


def _within(state: Channel, start: float, end: float) -> Channel:
    """Return a state from `start` on, where what was in force is restated, to `end` [s]; it makes no log longer."""
    first = max(int(np.searchsorted(state.t, start, "right")) - 1, 0)
    rows = slice(first, int(np.searchsorted(state.t, end, "right")))
    return Channel(state.name, read_only(np.maximum(state.t[rows], start)), state.values[rows], state.unit, state.frame)


def dataflash_states(tables: Tables) -> tuple[States, Mapping[int, str]]:
    """Return what ARM, EV and MODE tell, and the names of modes."""
    states: dict[str, tuple[str, Channel]] = {}
    for table in (*tables.named("ARM"), *tables.named("EV")):
        if "ArmState" in table:
            _add(states, "armed", table, _changes(table.t, table["ArmState"] > 0.0))
        elif "Id" in table:
            for name, on, off in (("armed", _ARMED, _DISARMED), ("bottomed", _BOTTOMED, _NOT_BOTTOMED)):
                mine = np.isin(table["Id"], (on, off))
                _add(states, name, table, _changes(table.t[mine], table["Id"][mine] == on))
    for table in tables.named("MODE"):
        number = table.get("ModeNum") if "ModeNum" in table else table.get("Mode")
        if number is not None:
            _add(states, "mode", table, _ordered(table.t, number))
    return states, _ROVER if _is_rover(tables) else _SUB


def _is_rover(tables: Tables) -> bool:
    functions = [value for name, value in tables.parameters.items() if re.fullmatch(r"SERVO\d+_FUNCTION", name)]
    said = " ".join(text for table in tables.named("MSG") for text in table.text.get("Message", ())[:50])
    return "Rover" in said or any(function in _THROTTLES for function in functions)


def heartbeat_states(table: Table) -> tuple[States, Mapping[int, str]]:
    """Return what the heartbeats of the autopilot tell, once a second: it counts as armed between two that say so."""
    states: dict[str, tuple[str, Channel]] = {}
    told = heartbeat_channels(table)
    if "armed" in told:
        _add(states, "armed", table, _sampled(table.t, told["armed"] > 0.5))
    if "mode" in told:
        _add(states, "mode", table, _ordered(table.t, told["mode"]))
    return states, heartbeat_modes(table)


def heartbeat_channels(table: Table) -> dict[str, Array]:
    """Return what each heartbeat (n,) tells: "armed", 0 or 1, and the number of the "mode"."""
    out: dict[str, Array] = {}
    if "base_mode" in table:
        out["armed"] = ((table["base_mode"].astype(np.int64) & _SAFETY_ARMED) > 0).astype(np.float64)
    if "custom_mode" in table:
        out["mode"] = table["custom_mode"]
    return out


def heartbeat_modes(table: Table) -> Mapping[int, str]:
    """Return the names of modes by number, by the kind of vehicle that heartbeats tell."""
    kind = table.get("type")
    return _ROVER if kind is not None and len(table) and np.isin(kind, _ROVERS).mean() > 0.5 else _SUB


def mavros_states(table: Table) -> tuple[States, Mapping[int, str]]:
    """Return what mavros_msgs/State tells; its modes are names already, numbered as they come."""
    states: dict[str, tuple[str, Channel]] = {}
    numbers: dict[str, int] = {}
    told = mavros_channels(table, numbers)
    if "armed" in told:
        _add(states, "armed", table, _sampled(table.t, told["armed"] > 0.5))
    if "mode" in told:
        _add(states, "mode", table, _ordered(table.t, told["mode"]))
    return states, mavros_modes(numbers)


def mavros_channels(table: Table, numbers: dict[str, int]) -> dict[str, Array]:
    """Return what each message (n,) of mavros_msgs/State tells: "armed", and the number of its mode by name.

    Args:
        numbers: of the modes so far, by name; those that are new are added.
    """
    out = {"armed": (table["armed"] > 0.0).astype(np.float64)} if "armed" in table else {}
    names = table.text.get("mode", ())
    for name in names:
        numbers.setdefault(name, len(numbers))
    if len(names) == len(table):
        out["mode"] = np.array([float(numbers[name]) for name in names])
    return out


def mavros_modes(numbers: Mapping[str, int]) -> Mapping[int, str]:
    """Return the names of modes by number, fit for the attribute "modes"."""
    return {k: name.replace(",", " ").upper() or "none" for name, k in numbers.items()}


def _add(states: dict[str, tuple[str, Channel]], name: str, table: Table, found: tuple[Array, Array]) -> None:
    t, values = found
    if t.size and name not in states:
        states[name] = table.name, Channel(name, read_only(t), read_only(values), *STATES[name][:2])


def _changes(t: Array, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return a state that is told as it changes: before its first change it was the other way round."""
    times, values = _ordered(t, on.astype(np.float64))
    if not times.size:
        return times, values
    return np.append(times[0] - _BEFORE, times), np.append(1.0 - values[0], values)


def _sampled(t: Array, on: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return a state that is told now and then: on from one sample that says so to the next one that does."""
    times, values = _ordered(t, on.astype(np.float64))
    values[:-1] = np.minimum(values[:-1], values[1:])
    return times, values


def _ordered(t: Array, values: Array) -> tuple[Array, Array]:
    """Return times in order, each once, and the last value of each."""
    known = np.isfinite(t) & np.isfinite(values)
    order = np.argsort(t[known], kind="stable")
    times, sorted_values = t[known][order], values[known][order]
    last = np.append(np.diff(times) > _DISTINCT, True) if times.size else np.zeros(0, dtype=np.bool_)
    return times[last], sorted_values[last].copy()
