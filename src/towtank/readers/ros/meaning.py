"""What the messages of ROS mean: of each type the quantities that it gives, row by row.

A function takes a table, or some rows of one, and returns the sources in it; what depends on the whole log, such as a
reading that never changes, is judged in `ros.doubts`. Every assumption is in a source's note.

Thrusters that have a topic of numbers each, as simulators have them, are numbered by their names, in natural order:

    /rov/thrusters/0/input, /rov/thrusters/1/input, ...                          UUV Simulator
    /model/rov/joint/thruster1_joint/cmd_thrust, .../thruster2_joint/...         Gazebo
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from itertools import count, takewhile

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.readers.common.sources import Quantity, Source
from towtank.readers.common.tables import Table
from towtank.readers.ros.frames import (
    body_of,
    body_vector,
    is_world,
    position,
    quaternion,
    vector,
    world_of,
    world_vector,
)
from towtank.recording.standard import (
    ACCELERATIONS,
    COMMAND_PREFIX,
    LINEAR_VELOCITY,
    RATES,
    RELATIVE_VELOCITY,
    WORLD_VELOCITY,
    WRENCH,
)

__all__ = ["LISTED", "MEANINGS", "has_meaning", "is_thruster_topic", "meaning_of", "thruster_order", "thruster_sources"]

SCALARS = frozenset(f"std_msgs/msg/{kind}" for kind in ("Float32", "Float64", "Int16", "Int32", "UInt16", "UInt32"))
_ONE = re.compile(r"^(.*(?:thrust|propeller)[a-z_]*?/?_?)(\d+)(.*)$", re.IGNORECASE)
_INPUT = re.compile(r"(^|[/_])(input|cmd|command|cmd_thrust|cmd_vel|setpoint|thrust|pwm)$", re.IGNORECASE)
_WATER_TRACK = 2.0  # velocity_mode of marine_acoustic_msgs/Dvl
_TRACKED = re.compile(r"vrpn|mocap|motion_capture|qualisys|qtm|optitrack|natnet|vicon|ground_truth|pose_gt|april|aruco")
_TOLD = re.compile(
    r"vision_(pose|speed)|odometry/out|(^|[/_])(cmd|commands?|setpoints?|desired|goal|target|ref(erence)?)([/_]|$)"
)
_DEAD_RECKONING = re.compile(r"dead_?reck|(^|[/_])dr([/_]|$)")
_SATELLITE = re.compile(r"(^|[/_])(gps|gnss|fix)([/_]|$)")
_COMMANDS = re.compile(r"thrust|pwm|motor|actuator|servo|esc")
_WATER, _GRAVITY, _AIR = 1000.0, 9.80665, 101_325.0  # kg/m^3, m/s^2, Pa
_ARRAYS = {f"std_msgs/msg/{kind}MultiArray" for kind in ("Float32", "Float64", "Int16", "Int32", "UInt16", "UInt32")}
LISTED = {
    "sensor_msgs/msg/NavSatFix": "satellites are not seen under water",
    "sensor_msgs/msg/MagneticField": "a heading takes more than a compass: attitude is taken where a message tells it",
    "mavros_msgs/msg/VfrHud": "a pilot's display: its sources are taken instead",
    "tf2_msgs/msg/TFMessage": "transforms between frames: frames are taken by their names",
}


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
        match = _ONE.match(name)
        if match is not None and is_thruster_topic(name, kind):
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
    numbered = "a topic for each thruster, in the order of their numbers: " + ", ".join((main, *rest))
    found = [Source(main, "commands", t, channels, 0, note=numbered)]
    none = np.empty(0)
    return found + [Source(name, "commands", none, {}, 0, refused=f"joined to {main}") for name in rest]


def has_meaning(name: str, kind: str) -> bool:
    """Whether anything is taken from a topic by itself, so that its messages are worth decoding."""
    if kind in SCALARS:
        return is_thruster_topic(name, kind)
    if kind in _ARRAYS:
        return bool(_COMMANDS.search(name.lower()))
    return kind in MEANINGS


def meaning_of(table: Table) -> list[Source]:
    """Return the sources in a table of ROS messages; none where its messages lack a field of their type."""
    try:
        return [source for source in MEANINGS[table.kind](table) if source.channels]
    except KeyError:
        return []


def _source(
    table: Table, quantity: Quantity, channels: Mapping[str, Array], distance: int, note: str = "", refused: str = ""
) -> Source:
    if not refused:
        refused = _by_name(table, quantity)
    note = f"{table.name}: {note}" if note else ""
    return Source(table.name, quantity, table.t, channels, distance, refused, note)


def _by_name(table: Table, quantity: Quantity) -> str:
    """Return why a topic's name says that this is no measurement."""
    name = table.name.lower()
    if _TOLD.search(name) and quantity not in ("commands", "wrench"):
        return "what something is told, not what was measured"
    if _DEAD_RECKONING.search(name) and quantity in ("position", "velocity"):
        return "dead reckoning: position summed up from velocity, which tells nothing of its own"
    if _SATELLITE.search(name) and quantity in ("position", "depth", "velocity"):
        return "satellites are not seen under water"
    return ""


def _rank(table: Table, usual: int) -> int:
    """Return the distance from the sensor: tracking cameras and a simulator's truth are sensors."""
    return 0 if _TRACKED.search(table.name.lower()) else usual


def _assumed(what: str, frame: str, named: str) -> str:
    return f'taken as {what} (frame "{frame}")' if frame else f"taken as {what}, no frame is named{named}"


def _pose(table: Table, path: str, body_frame: str, usual: int) -> list[Source]:
    frame = table.frame
    world = world_of(frame)
    body = body_of(body_frame, _body_under(world))
    place = position(table, f"{path}.position", world)
    attitude = quaternion(table, f"{path}.orientation", body, world)
    note = _assumed(world, frame, "")
    rank = _rank(table, usual)
    return [
        _source(table, "position", {"x": place["x"], "y": place["y"]}, rank, note),
        _source(table, "depth", {"z": place["z"]}, 0 if "depth" in table.name.lower() else rank, note),
        _source(table, "attitude", attitude, rank, f"attitude of a body in {body}, {note}"),
    ]


def _body_under(world: str) -> str:
    """Return the axes that bodies have whose name says nothing of it."""
    return "FRD" if world == "NED" else "FLU"


def _twist(table: Table, path: str, frame: str, usual: int, cause: str = "", default: str = "FLU") -> list[Source]:
    """Return the sources of a twist: in the body, or where its frame is one of the world, of velocity alone."""
    linear, angular = f"{path}.linear", f"{path}.angular"
    rank = _rank(table, usual)
    if is_world(frame):
        world = world_of(frame)
        note = f'velocity taken as {world} (frame "{frame}")'
        return [_source(table, "velocity", world_vector(table, linear, WORLD_VELOCITY, world), rank, note)]
    body = body_of(frame, default)
    note = _assumed(body, frame, cause)
    return [
        _source(table, "velocity", body_vector(table, linear, LINEAR_VELOCITY, body), rank, f"velocity {note}"),
        _source(table, "rates", body_vector(table, angular, RATES, body), rank, f"rates {note}"),
    ]


def _odometry(table: Table) -> list[Source]:
    child = _first(table, "child_frame_id")
    found = _pose(table, "pose.pose", "" if is_world(child) else child, 2)
    if is_world(child):
        return found  # a twist of one still frame in another
    return [*found, *_twist(table, "twist.twist", child, 2, " for the twist", _body_under(world_of(table.frame)))]


def _first(table: Table, path: str) -> str:
    return next((text for text in table.text.get(path, ()) if text), "")


def _imu(table: Table) -> list[Source]:
    frame = table.frame
    body = body_of(frame)
    note = _assumed(body, frame, "")
    world = "NED" if body == "FRD" else "ENU"
    attitude = _where_given(table, "orientation", quaternion(table, "orientation", body, world))
    rates = _where_given(table, "angular_velocity", body_vector(table, "angular_velocity", RATES, body))
    force = _where_given(table, "linear_acceleration", body_vector(table, "linear_acceleration", ACCELERATIONS, body))
    return [
        _source(table, "attitude", attitude, 1, f"attitude from {body} to {world}, by convention"),
        _source(table, "rates", rates, 0, f"rates {note}"),
        _source(table, "specific force", force, 0, f"specific force {note}"),
    ]


def _where_given(table: Table, field: str, channels: Mapping[str, Array]) -> dict[str, Array]:
    """Return the channels, NaN where the field's covariance begins with -1: it is not measured."""
    path = f"{field}_covariance[0]"
    absent = table[path] == -1.0 if path in table else np.zeros(len(table), dtype=np.bool_)
    return {name: np.where(absent, np.nan, values) for name, values in channels.items()}


def _dvl(table: Table, quantity: Quantity, names: tuple[str, str, str], valid: NDArray[np.bool_]) -> Source:
    """Return the velocity of a DVL; DVL messages have z where it points to, down, and x forward."""
    body = body_of(table.frame, "FRD")
    channels = body_vector(table, "velocity", names, body)
    note = f"{quantity} in {body}, at the DVL's own place; state its position as [marker] of a mapping if it is far off"
    return _source(table, quantity, {name: np.where(valid, each, np.nan) for name, each in channels.items()}, 0, note)


def _dvl_a50(table: Table) -> list[Source]:
    return [_dvl(table, "velocity", LINEAR_VELOCITY, table["velocity_valid"] != 0.0)]


def _dvl_marine(table: Table) -> list[Source]:
    """Return the velocity over ground, and that through the water where the beams tracked the water."""
    still = (vector(table, "velocity") == 0.0).all(axis=1)
    valid = ~(still & (table["num_good_beams"] == 0.0))
    water = table["velocity_mode"] == _WATER_TRACK
    over_ground = _dvl(table, "velocity", LINEAR_VELOCITY, ~water & valid)
    if not water.any():
        return [over_ground]
    return [over_ground, _dvl(table, "velocity through the water", RELATIVE_VELOCITY, water & valid)]


def _dvl_position(table: Table) -> list[Source]:
    place = position(table, "position", "NED")
    angles = {name: np.deg2rad(table[path]) for name, path in zip(("phi", "theta"), ("roll", "pitch"), strict=True)}
    angles["psi"] = np.deg2rad(table["yaw"])
    why = "dead reckoning of the DVL, from the velocity that it tells as well"
    return [
        _source(table, "position", {"x": place["x"], "y": place["y"]}, 2, refused=why),
        _source(table, "attitude", angles, 2, "attitude of the DVL's own gyros, in degrees; its yaw drifts"),
    ]


def _pressure(table: Table) -> list[Source]:
    note = f"depth from pressure: {_AIR:.0f} Pa at the surface, water of {_WATER:.0f} kg/m^3"
    depth = (table["fluid_pressure"] - _AIR) / (_WATER * _GRAVITY)
    return [_source(table, "depth", {"z": depth}, 1, note)]


def _battery(table: Table) -> list[Source]:
    voltage = np.where(table["voltage"] > 0.0, table["voltage"], np.nan)
    return [_source(table, "voltage", {"voltage": voltage}, 0)]


def _wrench(table: Table) -> list[Source]:
    path = "wrench." if "wrench.force.x" in table else ""
    body = body_of(table.frame)
    channels = body_vector(table, f"{path}force", ("X", "Y", "Z"), body)
    channels |= body_vector(table, f"{path}torque", ("K", "M", "N"), body)
    note = _assumed(body, table.frame, "") + ", about the body origin"
    return [_source(table, "wrench", {name: channels[name] for name in WRENCH}, 0, f"wrench {note}")]


def _vector(table: Table) -> list[Source]:
    """Return what a bare vector is, which only its topic's name tells."""
    name = table.name.lower()
    body = body_of(table.frame)
    note = _assumed(body, table.frame, "") + ", by the name of the topic"
    if re.search(r"gyro|angular_?vel|rates", name):
        return [_source(table, "rates", body_vector(table, "vector", RATES, body), 0, f"rates {note}")]
    if re.search(r"accel|specific_force", name):
        force = body_vector(table, "vector", ACCELERATIONS, body)
        return [_source(table, "specific force", force, 0, f"specific force {note}")]
    if re.search(r"dvl|linear_?vel|velocity", name):
        if is_world(table.frame):
            world = world_of(table.frame)
            linear = world_vector(table, "vector", WORLD_VELOCITY, world)
            return [_source(table, "velocity", linear, 1, f'velocity taken as {world} (frame "{table.frame}")')]
        return [_source(table, "velocity", body_vector(table, "vector", LINEAR_VELOCITY, body), 1, f"velocity {note}")]
    return []


def _array(table: Table) -> list[Source]:
    channels = _numbered(table, "data")
    return [_source(table, "commands", channels, 0, "the numbers are the commands of thrusters 1, 2, ... in order")]


def _outputs(table: Table) -> list[Source]:
    """Return the outputs of an autopilot: those that are driven are the thrusters, in order."""
    outputs = _numbered(table, "channels").values()
    driven = [np.where((each > 0.0) & (each < 65_535.0), each, np.nan) for each in outputs]
    channels = {f"cmd_{k}": each for k, each in enumerate(driven, 1)}
    note = "the recording does not say which output drives what: outputs 1, 2, ... are taken as thrusters in order"
    return [_source(table, "commands", channels, 1, note)]


def _numbered(table: Table, path: str) -> dict[str, Array]:
    fields = takewhile(lambda field: field in table, (f"{path}[{k}]" for k in count()))
    return {f"cmd_{k}": table[field] for k, field in enumerate(fields, 1)}


MEANINGS: dict[str, Callable[[Table], list[Source]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": lambda table: _pose(table, "pose", "", 1),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda table: _pose(table, "pose.pose", "", 1),
    "geometry_msgs/msg/TwistStamped": lambda table: _twist(table, "twist", table.frame, 1),
    "geometry_msgs/msg/TwistWithCovarianceStamped": lambda table: _twist(table, "twist.twist", table.frame, 1),
    "geometry_msgs/msg/WrenchStamped": _wrench,
    "geometry_msgs/msg/Wrench": _wrench,
    "geometry_msgs/msg/Vector3Stamped": _vector,
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/FluidPressure": _pressure,
    "sensor_msgs/msg/BatteryState": _battery,
    "mavros_msgs/msg/RCOut": _outputs,
    "marine_acoustic_msgs/msg/Dvl": _dvl_marine,
    "dvl_msgs/msg/DVL": _dvl_a50,
    "dvl_msgs/msg/DVLDR": _dvl_position,
    **dict.fromkeys(_ARRAYS, _array),
}
