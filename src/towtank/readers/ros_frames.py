"""Frames of ROS messages by the names that they bear: ENU and FLU unless a name says otherwise (REP 103, 105, 147)."""

from __future__ import annotations

import re

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.tables import Table
from towtank.recording.frames import convert_body_vector, convert_quaternion, convert_world_vector
from towtank.recording.rotations import normalised

__all__ = ["body_of", "body_vector", "is_world", "position", "quaternion", "vector", "world_of", "world_vector"]

_BODY = {"base", "body", "cg", "cog", "dvl", "flu", "frd", "fsd", "imu", "link", "robot", "sensor", "vehicle"}
_WORLD = {"earth", "enu", "global", "inertial", "map", "mocap", "ned", "odom", "origin", "utm", "vicon", "world"}
_FRD = {"frd", "fsd", "ned"}


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
