"""What MAVLink messages mean as channels: those of a telemetry log, of a recorder on the vehicle, of a live link.

The autopilot's messages are used, and those by which others tell it what their sensors measure: a DVL, motion capture.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.readers.ardupilot.aiding import Aiding, Evidence, aided, aiding_of
from towtank.readers.ardupilot.dvl import at_the_origin, displacement_source
from towtank.readers.ardupilot.states import heartbeat_states, with_states
from towtank.readers.ardupilot.thruster_outputs import command_sources
from towtank.readers.ardupilot.water_pressure import Pressure, depth_sources
from towtank.readers.common.interpretation import Reading, in_order, recording_of, sources_of_table, times_of
from towtank.readers.common.sources import Source
from towtank.readers.common.tables import Table, Tables
from towtank.readers.mavlink.autopilot import DVL, TO_AUTOPILOT, with_autopilot
from towtank.readers.mavlink.senders import Autopilot, Sender, autopilot_of, message_of
from towtank.recording.recording import Recording
from towtank.recording.standard import ACCELERATIONS, QUATERNION, RATES

__all__ = [
    "aiding_of_messages",
    "mavlink_recording",
    "mavlink_sources",
    "pressures_of",
    "pulses_of",
    "sources_of_messages",
    "with_autopilot",
    "with_autopilot_states",
]

_MILLI, _CENTI = 1e-3, 1e-2
_MILLI_G = 9.80665e-3  # m/s^2
_XYZ = ("x", "y", "z")
_EULER = {"phi": "roll", "theta": "pitch", "psi": "yaw"}
_TURN_RATES = {"p": "rollspeed", "q": "pitchspeed", "r": "yawspeed"}
_WORLD_VELOCITY = {"vn": "vx", "ve": "vy", "vd": "vz"}
_SCALED_IMU = ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
_STATUS = ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")  # of ArduPilot, of PX4: the bits mean the same
_FILTERED = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")
_PRESSURES = {"SCALED_PRESSURE": 0, "SCALED_PRESSURE2": 1, "SCALED_PRESSURE3": 2}
_SURFACE = (  # by sensor; the second names are those of ArduSub before 4.1
    ("BARO1_GND_PRESS", "GND_ABS_PRESS"), ("BARO2_GND_PRESS", "GND_ABS_PRESS2"), ("BARO3_GND_PRESS", "GND_ABS_PRESS3"),
)  # fmt: skip
_FRESH_WATER = 9800.0  # N/m^3, as ArduPilot takes it; times BARO_SPEC_GRAV
_HECTO = 100.0
_FIX = 3.0
_MAVLINK_GPS = 14.0  # GPS_TYPE: positions that others send, as acoustic systems do
_UNKNOWN_VOLTAGE = 65535.0
_WORLD_FRAMES, _BODY_FRAMES = (1.0, 20.0), (8.0, 12.0)  # MAV_FRAME: LOCAL_NED, LOCAL_FRD; BODY_NED, BODY_FRD
_REASONS = {
    "RC_CHANNELS": "what the pilot asked for, not what the thrusters got",
    "MANUAL_CONTROL": "what the pilot asked for, not what the thrusters got",
    "VFR_HUD": "rounded for a display",
    "GPS_RAW_INT": "the filter uses it",
    "GPS_INPUT": "the filter uses it",
    "PARAM_VALUE": "parameters: they tell which output drives which thruster",
    "DISTANCE_SENSOR": "a range to the bottom is no depth",
}


def _axes(channels: tuple[str, ...], suffix: str, scale: float = 1.0) -> dict[str, tuple[str, float]]:
    return {channel: (axis + suffix, scale) for channel, axis in zip(channels, _XYZ, strict=True)}


# Of equals the first one is used. ArduPilot's RAW_IMU is scaled as SCALED_IMU is: mrad/s and mG.
_READINGS: tuple[Reading, ...] = (
    Reading("HIGHRES_IMU", "rates", _axes(RATES, "gyro")),
    *(Reading(name, "rates", _axes(RATES, "gyro", _MILLI)) for name in _SCALED_IMU),
    Reading("ATTITUDE", "rates", _TURN_RATES, 1),
    Reading("ATTITUDEQUATERNION", "rates", _TURN_RATES, 1),
    Reading("HIGHRES_IMU", "specific force", _axes(ACCELERATIONS, "acc")),
    *(Reading(name, "specific force", _axes(ACCELERATIONS, "acc", _MILLI_G)) for name in _SCALED_IMU),
    Reading("ATT_POS_MOCAP", "attitude", {name: f"q[{i}]" for i, name in enumerate(QUATERNION)}, 1),
    Reading("VISION_POSITION_ESTIMATE", "attitude", _EULER, 1),
    Reading("ATTITUDEQUATERNION", "attitude", {name: f"q{i}" for i, name in enumerate(QUATERNION, 1)}, 2),
    Reading("ATTITUDE", "attitude", _EULER, 2),
    Reading("AHRS2", "attitude", _EULER, 3),
    Reading("VISION_SPEED_ESTIMATE", "velocity", dict(zip(_WORLD_VELOCITY, _XYZ, strict=True))),
    Reading("LOCAL_POSITION_NED", "velocity", _WORLD_VELOCITY, 2),
    Reading("GLOBAL_POSITION_INT", "velocity", {name: (field, _CENTI) for name, field in _WORLD_VELOCITY.items()}, 2),
    Reading("VISION_POSITION_ESTIMATE", "position", {"x": "x", "y": "y"}, 1),
    Reading("ATT_POS_MOCAP", "position", {"x": "x", "y": "y"}, 1),
    Reading("LOCAL_POSITION_NED", "position", {"x": "x", "y": "y"}, 2),
    Reading("VISION_POSITION_ESTIMATE", "depth", {"z": "z"}, 1),
    Reading("ATT_POS_MOCAP", "depth", {"z": "z"}, 1),
    Reading("LOCAL_POSITION_NED", "depth", {"z": "z"}, 2),
    Reading("GLOBAL_POSITION_INT", "depth", {"z": ("relative_alt", -_MILLI)}, 2),
)


def mavlink_recording(tables: Tables, senders: Mapping[str, Sender]) -> Recording:
    """Return the recording of MAVLink messages.

    Args:
        tables: by name of message, [instance] and @sender where there are several (`mavlink.senders.named_tables`);
            their columns are the fields of the message, "position_delta[0]" the elements of arrays.
        senders: the sender of each table.
    """
    autopilot = autopilot_of(tables.tables, senders)
    known = with_autopilot(tables, senders)
    reasons: dict[str, str] = {}
    for name in tables.tables:
        who = autopilot.others.get(senders[name])
        if who is not None and message_of(name) not in TO_AUTOPILOT:
            reasons[name] = f"sent by {who} ({senders[name]})"
        elif message_of(name) == "RAW_IMU" and not autopilot.is_ardupilot:
            reasons[name] = "in units of its own, which only ArduPilot's are known"
        elif message_of(name) in _REASONS:
            reasons[name] = _REASONS[message_of(name)]
    recording = recording_of(known, mavlink_sources(known, senders, autopilot), reasons=reasons)
    return at_the_origin(with_autopilot_states(recording, known, senders), known.parameters, (DVL,))


def with_autopilot_states(recording: Recording, tables: Tables, senders: Mapping[str, Sender]) -> Recording:
    """Return a recording of these tables with what the autopilot's heartbeats tell of it."""
    autopilot = autopilot_of(tables.tables, senders)
    beats = (table for name, table in tables.tables.items() if senders.get(name) == autopilot.sender)
    table = next((each for each in beats if message_of(each.name) == "HEARTBEAT" and len(each)), None)
    return with_states(recording, *(({}, {}) if table is None else heartbeat_states(table)))


def mavlink_sources(tables: Tables, senders: Mapping[str, Sender], autopilot: Autopilot) -> list[Source]:
    """Return what the messages of a log tell, with what they tell of the filter judged by what aids it."""
    own, external = _own_and_external(tables, senders, autopilot)
    sources = depth_sources(pressures_of(own, tables.parameters), tables.parameters)
    aiding = aiding_of(_evidence(own, external, tables, sources))
    sources += _commands(own, tables.parameters)
    for table in external:
        sources += sources_of_messages(table, aiding, measured=True)
    for table in own:
        sources += sources_of_messages(table, aiding, measured=False)
    return in_order(sources, _READINGS, message_of)


def aiding_of_messages(tables: Tables, senders: Mapping[str, Sender], autopilot: Autopilot) -> Aiding:
    """Return where the autopilot's filter is aided, judged by all that the tables hold."""
    own, external = _own_and_external(tables, senders, autopilot)
    depths = depth_sources(pressures_of(own, tables.parameters), tables.parameters)
    return aiding_of(_evidence(own, external, tables, depths))


def _own_and_external(
    tables: Tables, senders: Mapping[str, Sender], autopilot: Autopilot
) -> tuple[list[Table], list[Table]]:
    """Return the autopilot's tables, and those by which others tell it what they measure."""
    own = [
        table
        for name, table in tables.tables.items()
        if senders[name] == autopilot.sender and (autopilot.is_ardupilot or message_of(name) != "RAW_IMU")
    ]
    external = [
        table
        for name, table in tables.tables.items()
        if senders[name] != autopilot.sender and message_of(name) in TO_AUTOPILOT
    ]
    return own, external


def sources_of_messages(table: Table, aiding: Aiding, *, measured: bool) -> list[Source]:
    """Return what some messages of one table tell, row by row; commands and pressures apart.

    Args:
        table: the messages.
        aiding: where the autopilot's filter is aided.
        measured: whether another than the autopilot sent them, who measures what the filter only estimates.
    """
    message = message_of(table.name)
    found = sources_of_table(table, message, _READINGS)
    if message == DVL:
        found += _displacement(table)
    elif message == "ODOMETRY":
        found += _odometry(table, 1 if measured else 2)
    elif message in ("SYS_STATUS", "BATTERY_STATUS"):
        found += _voltage(table)
    filtered = message in _FILTERED or (message == "ODOMETRY" and not measured)
    return [
        aided(source, aiding, position=source.quantity == "position")
        if filtered and source.quantity in ("velocity", "position")
        else source
        for source in found
    ]


def _displacement(table: Table) -> list[Source]:
    """Return the velocity of a DVL."""
    fields = _elements("position_delta", 3)
    if not all(field in table for field in (*fields, "time_delta_usec")):
        return []
    confidence = table.get("confidence")
    moved = [table[field] for field in fields]
    return [displacement_source(table.name, times_of(table), moved, 1e-6 * table["time_delta_usec"], confidence)]


def _odometry(table: Table, distance: int) -> list[Source]:
    """Return what ODOMETRY tells in the frames that are understood: LOCAL_NED or LOCAL_FRD, BODY_FRD."""
    needed = (*_XYZ, *_WORLD_VELOCITY.values(), *_TURN_RATES.values(), "frame_id", "child_frame_id", *_elements("q", 4))
    if not all(field in table for field in needed):
        return []
    t = times_of(table)
    world, body = (
        np.isin(table[field], kinds) for field, kinds in (("frame_id", _WORLD_FRAMES), ("child_frame_id", _BODY_FRAMES))
    )
    pose = {name: _where(world, table[name]) for name in _XYZ}
    attitude = {name: _where(world, table[field]) for name, field in zip(QUATERNION, _elements("q", 4), strict=True)}
    velocity = {name: _where(body, table[field]) for name, field in zip("uvw", _WORLD_VELOCITY.values(), strict=True)}
    rates = {name: _where(body, table[field]) for name, field in _TURN_RATES.items()}
    return [
        Source(table.name, "position", t, {"x": pose["x"], "y": pose["y"]}, distance),
        Source(table.name, "depth", t, {"z": pose["z"]}, distance),
        Source(table.name, "attitude", t, attitude, distance),
        Source(table.name, "velocity", t, velocity, distance),
        Source(table.name, "rates", t, rates, distance),
    ]


def _elements(name: str, count: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(count)]


def _where(known: NDArray[np.bool_], values: Array) -> Array:
    return np.where(known, values, np.nan)


def _voltage(table: Table) -> list[Source]:
    """Return the supply voltage; of a battery that tells its cells, their sum."""
    fields = ["voltage_battery"] if "voltage_battery" in table else _elements("voltages", 10)
    if not all(field in table for field in fields):
        return []
    cells = np.column_stack([table[field] for field in fields])
    cells = np.where(cells < _UNKNOWN_VOLTAGE, cells, 0.0)
    total = _MILLI * cells.sum(axis=1)
    return [Source(table.name, "voltage", times_of(table), {"voltage": _where(total > 0.0, total)})]


def _commands(own: list[Table], parameters: Mapping[str, float]) -> list[Source]:
    """Return the thruster commands; which outputs drive thrusters is chosen over the whole log."""
    parts = [
        (table.name, times_of(table), pulses_of(table)) for table in own if message_of(table.name) == "SERVO_OUTPUT_RAW"
    ]
    return command_sources(parts, parameters)


def pulses_of(table: Table) -> dict[int, Array]:
    """Return the pulses (n,) [us] by number of the output; NaN in the rows of another group of outputs."""
    port = table["port"] if "port" in table else np.zeros(len(table))
    found: dict[int, Array] = {}
    for group in sorted(set(port[np.isfinite(port)].tolist())):
        for field in table.columns:
            match = re.fullmatch(r"servo(\d+)_raw", field)
            if match:
                found[int(match[1]) + 16 * int(group)] = np.where(port == group, table[field], np.nan)
    return found


def pressures_of(own: Sequence[Table], parameters: Mapping[str, float]) -> list[Pressure]:
    """Return the pressure sensors, with depth as ArduPilot tells it: (p - p_surface) / (9800 specific gravity)."""
    weight = _FRESH_WATER * parameters.get("BARO_SPEC_GRAV", parameters.get("GND_SPEC_GRAV", 1.0))
    found = []
    for table in own:
        number = _PRESSURES.get(message_of(table.name))
        if number is not None and "press_abs" in table:
            pressure = _HECTO * table["press_abs"]
            surface = next((parameters[name] for name in _SURFACE[number] if name in parameters), 0.0)
            depth = (pressure - surface) / weight if surface > 0.0 and weight > 0.0 else None
            found.append(Pressure(number, table.name, times_of(table), pressure, depth))
    return found


def _evidence(own: list[Table], external: list[Table], tables: Tables, sources: list[Source]) -> Evidence:
    reports = next((table for name in _STATUS for table in own if message_of(table.name) == name), None)
    received = {message_of(table.name) for table in external if len(table)}
    depth = next((source for source in sources if source.quantity == "depth" and not source.refused), None)
    sent = any(message_of(name) == "GPS_INPUT" for name in tables.tables)
    acoustic = (
        sent and tables.parameters.get("GPS_TYPE", tables.parameters.get("GPS1_TYPE", _MAVLINK_GPS)) == _MAVLINK_GPS
    )
    fixes = [table["fix_type"] for table in own if message_of(table.name) == "GPS_RAW_INT" and "fix_type" in table]
    fixed = any(bool((fix >= _FIX).any()) for fix in fixes)
    return Evidence(
        t=None if reports is None or "flags" not in reports else times_of(reports),
        flags=None if reports is None or "flags" not in reports else reports["flags"],
        velocity=tuple(received & {DVL, "VISION_SPEED_ESTIMATE", "ODOMETRY"}),
        position=tuple(received & {"VISION_POSITION_ESTIMATE", "ATT_POS_MOCAP", "ODOMETRY"})
        + (("GPS_INPUT",) if acoustic else ()),
        satellites=fixed and not acoustic,
        depth_t=None if depth is None else depth.t,
        depth=None if depth is None else depth.channels["z"],
    )
