"""Definitions of ROS messages: from the recording where it has them, else of the types that towtank knows."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

__all__ = ["Fields", "Types", "numbers_of", "types_of"]

Fields = list[tuple[str, Any]]  # name and description, as in rosbags
Types = Mapping[str, Fields]
_TIME: Fields = [("sec", (Nodetype.BASE, ("int32", 0))), ("nanosec", (Nodetype.BASE, ("uint32", 0)))]
_TIMES = {"builtin_interfaces/msg/Time": _TIME, "builtin_interfaces/msg/Duration": _TIME}
_UNTOLD = ("std_msgs/msg/Header", "std_msgs/msg/MultiArrayLayout", *_TIMES)
_DEEPEST = 16  # levels of messages in messages
_LISTED = 8  # fields in a reason
# Types that recordings of underwater vehicles hold and that come with no distribution of ROS.
_KNOWN = {
    "marine_acoustic_msgs/msg/Dvl": """
        std_msgs/Header header
        uint8 velocity_mode
        uint8 dvl_type
        geometry_msgs/Vector3 velocity
        float64[9] velocity_covar
        float64 altitude
        float64 course_gnd
        float64 speed_gnd
        uint8 num_good_beams
        float32 sound_speed
        bool beam_ranges_valid
        bool beam_velocities_valid
        geometry_msgs/Vector3[4] beam_unit_vec
        float64[4] range
        float32[4] range_covar
        float32[4] beam_quality
        float32[4] beam_velocity
        float32[4] beam_velocity_covar""",
    "dvl_msgs/msg/DVLBeam": """
        int64 id
        float64 velocity
        float64 distance
        float64 rssi
        float64 nsd
        bool valid""",
    "dvl_msgs/msg/DVL": """
        std_msgs/Header header
        float64 time
        geometry_msgs/Vector3 velocity
        float64 fom
        float64[] covariance
        float64 altitude
        dvl_msgs/DVLBeam[] beams
        bool velocity_valid
        int64 status
        string form""",
    "dvl_msgs/msg/DVLDR": """
        std_msgs/Header header
        float64 time
        geometry_msgs/Vector3 position
        float64 pos_std
        float64 roll
        float64 pitch
        float64 yaw
        string type
        int64 status
        string format""",
    "mavros_msgs/msg/RCOut": """
        std_msgs/Header header
        uint16[] channels""",
    "mavros_msgs/msg/State": """
        std_msgs/Header header
        bool connected
        bool armed
        bool guided
        bool manual_input
        string mode
        uint8 system_status""",
}


@cache
def types_of(kind: str, definition: str, language: str, ros1: bool) -> Types:
    """Return the fields of a type and of all that it is made of.

    Raises:
        ValueError: there is no definition, or it cannot be understood.
    """
    types = dict(_standard(ros1))
    if definition.strip():
        types |= _parsed(kind, definition, language)
    elif kind in _KNOWN:
        for name, text in _KNOWN.items():
            types |= _parsed(name, text, "ros2msg")
    elif kind not in types:
        raise ValueError("its definition is neither in the file nor known")
    for name, fields in _TIMES.items():
        types.setdefault(name, fields)
    if kind not in types:
        raise ValueError("the definition in the file is of another type")
    return types


def numbers_of(kind: str, types: Types) -> list[str]:
    """Return the paths of the numbers of a type, arrays as "name[3]" or "name[]", for a person to choose from."""
    found: list[str] = []
    with contextlib.suppress(KeyError, RecursionError):
        _collect(kind, types, "", found, 0)
    return found[:_LISTED] + ["..."] * (len(found) > _LISTED)


def _collect(kind: str, types: Types, prefix: str, found: list[str], depth: int) -> None:
    if depth > _DEEPEST or len(found) > _LISTED:
        return
    for name, (node, detail) in types[kind]:
        path, inner, array = f"{prefix}{name}", (node, detail), ""
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            inner, length = detail
            array = f"[{length if node == Nodetype.ARRAY else ''}]"
        if inner[0] == Nodetype.NAME:
            if inner[1] not in _UNTOLD:
                _collect(inner[1], types, f"{path}{array}.", found, depth + 1)
        elif inner[1][0] not in ("string", "wstring"):
            found.append(path + array)


@cache
def _standard(ros1: bool) -> Types:
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    return {name: fields for name, (_, fields) in store.fielddefs.items()}


def _parsed(kind: str, definition: str, language: str) -> dict[str, Fields]:
    try:
        if language in ("ros2idl", "omgidl"):
            found: dict[str, Any] = {}
            separator = "=" * 80 + "\n"
            for part in definition.split(separator) if definition.startswith(separator) else [definition]:
                text = part.partition("\n")[2] if part.startswith("IDL: ") else part
                found |= get_types_from_idl(text) if text.strip() else {}
        else:
            found = dict(get_types_from_msg(definition, kind))
    except Exception as error:  # the library raises many kinds on broken definitions
        raise ValueError(
            f"its definition cannot be understood ({str(error).splitlines()[0] if str(error) else ''})"
        ) from error
    return {name: fields for name, (_, fields) in found.items()}
