"""Messages of ROS 2 as they are on the wire, made by rosbags: a vehicle as ROS tells it, in ENU and FLU."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

__all__ = ["ODOMETRY", "STATE", "WRENCH", "odometry", "state", "twist", "wrench"]

STORE = get_typestore(Stores.ROS2_HUMBLE)
STATE = "mavros_msgs/msg/State"
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nbool connected\nbool armed\nbool guided\nbool manual_input\nstring mode\n"
        "uint8 system_status",
        STATE,
    )
)
ODOMETRY, WRENCH = "nav_msgs/msg/Odometry", "geometry_msgs/msg/WrenchStamped"
TWIST = "geometry_msgs/msg/TwistStamped"


def _make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def _header(stamp: float, frame: str) -> Any:
    seconds = math.floor(stamp)
    time = _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=round(1e9 * (stamp - seconds)) % 10**9)
    return _make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def _vector(x: float, y: float, z: float, kind: str = "Vector3") -> Any:
    return _make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _bytes(message: Any, kind: str) -> bytes:
    return bytes(STORE.serialize_cdr(message, kind))


def odometry(stamp: float, xyz: tuple[float, ...], psi: float, nu: tuple[float, ...]) -> bytes:
    """Return nav_msgs/Odometry of a position in NED, a heading, and u v w p q r."""
    yaw = math.pi / 2 - psi
    turn = _make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    pose = _make("geometry_msgs/msg/Pose", position=_vector(xyz[1], xyz[0], -xyz[2], "Point"), orientation=turn)
    rate = _make(
        "geometry_msgs/msg/Twist", linear=_vector(nu[0], -nu[1], -nu[2]), angular=_vector(nu[3], -nu[4], -nu[5])
    )
    none = np.zeros(36)
    message = _make(
        ODOMETRY,
        header=_header(stamp, "odom"),
        child_frame_id="base_link",
        pose=_make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=none),
        twist=_make("geometry_msgs/msg/TwistWithCovariance", twist=rate, covariance=none),
    )
    return _bytes(message, ODOMETRY)


def wrench(stamp: float, tau: tuple[float, ...]) -> bytes:
    """Return geometry_msgs/WrenchStamped of X Y Z K M N."""
    force, torque = _vector(tau[0], -tau[1], -tau[2]), _vector(tau[3], -tau[4], -tau[5])
    message = _make(
        WRENCH,
        header=_header(stamp, "base_link"),
        wrench=_make("geometry_msgs/msg/Wrench", force=force, torque=torque),
    )
    return _bytes(message, WRENCH)


def twist(stamp: float, linear: tuple[float, ...], frame: str) -> bytes:
    """Return geometry_msgs/TwistStamped, as it is."""
    rate = _make("geometry_msgs/msg/Twist", linear=_vector(*linear), angular=_vector(0.0, 0.0, 0.0))
    return _bytes(_make(TWIST, header=_header(stamp, frame), twist=rate), TWIST)


def state(stamp: float, mode: str, *, armed: bool) -> bytes:
    """Return mavros_msgs/State."""
    flags = {"connected": True, "armed": armed, "guided": False, "manual_input": True, "system_status": 4}
    return _bytes(_make(STATE, header=_header(stamp, ""), mode=mode, **flags), STATE)
