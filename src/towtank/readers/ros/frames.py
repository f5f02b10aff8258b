"""Frames of ROS messages by their names (REP 103, 105, 147): ENU and FLU unless a name says otherwise.

Odometry gives pose and speed of a frame of its own choice. Where that is no base_link, and fixed transforms
(/tf_static) lead from it to one, they are applied; where none do, a note says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.tables import Table
from towtank.recording.frames.conversion import convert_body_vector, convert_quaternion, convert_world_vector
from towtank.recording.frames.rotations import conjugate, multiply, normalised, rotate

__all__ = [
    "TRANSFORMS",
    "at_base_link",
    "body_of",
    "body_vector",
    "is_static",
    "is_world",
    "position",
    "quaternion",
    "vector",
    "world_of",
    "world_vector",
]

_BODY = {"base", "body", "cg", "cog", "dvl", "flu", "frd", "fsd", "imu", "link", "robot", "sensor", "vehicle"}
_WORLD = {"earth", "enu", "global", "inertial", "map", "mocap", "ned", "odom", "origin", "utm", "vicon", "world"}
_FRD = {"frd", "fsd", "ned"}
TRANSFORMS = "tf2_msgs/msg/TFMessage"
_ODOMETRY = "nav_msgs/msg/Odometry"
_BASE = "base_link"
_CHILD = "child_frame_id"
_POSE, _TWIST = "pose.pose", "twist.twist"
_MOST = 64  # transforms in a message
_Edge = tuple[str, Array, Array]  # the other frame, and the first one's origin (3,) and attitude (4,) in it


def _words(frame: str) -> set[str]:
    return set(re.split(r"[^a-z0-9]+", frame.lower()))


def is_world(frame: str) -> bool:
    """Whether a frame stands still: `map`, `odom_ned`, but not `base_link_ned`."""
    words = _words(frame)
    return bool(words & _WORLD) and not words & _BODY


def body_of(frame: str, default: str = "FLU") -> str:
    """Return FRD for names like `base_link_frd`, `..._fsd`, `..._ned`, FLU for `..._flu`, else the default."""
    words = _words(frame)
    return "FRD" if words & _FRD else "FLU" if "flu" in words else default


def world_of(frame: str) -> str:
    """Return NED for names like `map_ned`, else ENU."""
    return "NED" if "ned" in _words(frame) else "ENU"


def vector(table: Table, path: str) -> Array:
    """Return the vectors (n, 3) of the fields x, y and z under a path."""
    return np.column_stack([table[f"{path}.{axis}"] for axis in "xyz"])


def body_vector(table: Table, path: str, names: tuple[str, str, str], body: str) -> dict[str, Array]:
    """Return a vector in the body by the names of its components, in FRD."""
    components = vector(table, path)
    if body == "FLU":
        components = convert_body_vector(components)
    return {name: components[:, k] for k, name in enumerate(names)}


def world_vector(table: Table, path: str, names: tuple[str, str, str], world: str) -> dict[str, Array]:
    """Return a vector in the world by the names of its components, in NED."""
    components = vector(table, path)
    if world == "ENU":
        components = convert_world_vector(components)
    return {name: components[:, k] for k, name in enumerate(names)}


def position(table: Table, path: str, world: str) -> dict[str, Array]:
    """Return x, y and z in NED."""
    return world_vector(table, path, ("x", "y", "z"), world)


def quaternion(table: Table, path: str, body: str, world: str) -> dict[str, Array]:
    """Return the attitude from body FRD to NED, NaN where the message has none (a quaternion of zeros)."""
    with np.errstate(over="ignore"):  # of damaged messages
        q = normalised(np.column_stack([table[f"{path}.{axis}"] for axis in "wxyz"]))
    q = convert_quaternion(q, body=body, world=world)
    return {name: q[:, k] for k, name in enumerate(("qw", "qx", "qy", "qz"))}


def is_static(topic: str, kind: str) -> bool:
    """Whether a topic holds transforms that never change."""
    return kind == TRANSFORMS and topic.rstrip("/").endswith("tf_static")


def at_base_link(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str], dict[str, str]]:
    """Return the tables with odometry at base_link, remarks, and reasons of the topics of transforms."""
    edges: dict[str, list[_Edge]] = {}
    static = [table for name, table in tables.items() if is_static(name, table.kind)]
    for table in static:
        _collect(table, edges)
    out, notes, moved = dict(tables), list[str](), list[str]()
    for name, table in tables.items():
        child = next((text for text in table.text.get(_CHILD, ()) if text), "")
        if table.kind != _ODOMETRY or not child or is_world(child) or _is_base(child) or not len(table):
            continue
        link = _link_to_base(child, edges)
        if link is None:
            if static:
                notes.append(f'{name}: no fixed transform leads from "{child}" to {_BASE}; taken for the body origin')
            continue
        out[name] = _moved(table, *link)
        moved.append(name)
        notes.append(f'{name}: moved from "{child}" to "{link[0]}" by the fixed transforms')
    reason = f"fixed transforms, applied to {', '.join(moved)}" if moved else "fixed transforms; nothing needs them"
    return out, notes, {table.name: reason for table in static}


def _is_base(frame: str) -> bool:
    return frame.strip("/").rpartition("/")[2].lower().startswith(_BASE)


def _collect(table: Table, edges: dict[str, list[_Edge]]) -> None:
    """Add the transforms of a topic, both ways."""
    for k in range(_MOST):
        path = f"transforms[{k}]"
        if f"{path}.transform.translation.x" not in table:
            return
        place = np.column_stack([table[f"{path}.transform.translation.{axis}"] for axis in "xyz"])
        turn = np.column_stack([table[f"{path}.transform.rotation.{axis}"] for axis in "wxyz"])
        parents, children = table.text.get(f"{path}.header.frame_id", ()), table.text.get(f"{path}.{_CHILD}", ())
        for row, (parent, child) in enumerate(zip(parents, children, strict=False)):
            p, q = place[row], turn[row]
            norm = float(np.linalg.norm(q))
            if parent and child and np.isfinite(p).all() and abs(norm - 1.0) < 0.1:
                q = q / norm
                back = conjugate(q)
                edges.setdefault(child.strip("/"), []).append((parent.strip("/"), p, q))
                edges.setdefault(parent.strip("/"), []).append((child.strip("/"), -rotate(back, p), back))


def _link_to_base(child: str, edges: Mapping[str, list[_Edge]]) -> _Edge | None:
    """Return the nearest base_link, and origin and attitude of `child` in it; None where no link leads there."""
    start = child.strip("/")
    reached: dict[str, tuple[Array, Array]] = {start: (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))}
    queue = [start]
    for frame in queue:
        if _is_base(frame):
            return (frame, *reached[frame])
        place, turn = reached[frame]
        for other, p, q in edges.get(frame, ()):
            if other not in reached:
                reached[other] = p + rotate(q, place), multiply(q, turn)
                queue.append(other)
    return None


def _moved(table: Table, base: str, place: Array, turn: Array) -> Table:
    """Return odometry of a frame that stands at `place` with attitude `turn` in `base`, as odometry of `base`."""
    columns = dict(table.columns)
    position = _vector(table, f"{_POSE}.position")
    attitude = np.column_stack([table[f"{_POSE}.orientation.{axis}"] for axis in "wxyz"])
    whole = np.abs(np.linalg.norm(attitude, axis=1) - 1.0) < 0.1
    attitude = np.where(whole[:, None], multiply(attitude, conjugate(turn)), np.nan)
    position = position - rotate(attitude, place)
    rates = rotate(turn, _vector(table, f"{_TWIST}.angular"))
    speed = rotate(turn, _vector(table, f"{_TWIST}.linear")) - np.cross(rates, place)
    for path, values in ((f"{_POSE}.position", position), (f"{_TWIST}.linear", speed), (f"{_TWIST}.angular", rates)):
        columns |= {f"{path}.{axis}": values[:, k] for k, axis in enumerate("xyz")}
    attitude = np.where(whole[:, None], attitude, 0.0)  # as a message without attitude has it
    columns |= {f"{_POSE}.orientation.{axis}": attitude[:, k] for k, axis in enumerate("wxyz")}
    return replace(table, columns=columns, text={**table.text, _CHILD: (base,) * len(table)})


def _vector(table: Table, path: str) -> Array:
    return np.column_stack([table[f"{path}.{axis}"] for axis in "xyz"])
