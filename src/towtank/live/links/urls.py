"""Which source a text on the command line means."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.live.links.source import Source
    from towtank.recording import ColumnMapping
    from towtank.vehicle import Vehicle

__all__ = ["KINDS", "open_source"]

KINDS = (
    "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, /dev/NAME,BAUD (MAVLink), ros2:[DOMAIN], dds:[DOMAIN] "
    "(ROS 2), qtm:HOST[/BODY], natnet:HOST[/BODY] (motion capture), json:HOST:PORT, - (JSON lines on standard input), "
    "replay:FILE[@SPEED]"
)
_MAVLINK = re.compile(r"(mavlink|udp|udpin|udpout|udpbcast|tcp|tcpin|serial):|/dev/|COM\d", re.IGNORECASE)


def open_source(text: str, vehicle: Vehicle, mapping: ColumnMapping | None = None) -> Source:
    """Return the source that a text means, not yet opened.

    Args:
        text: see `KINDS`.
        vehicle: whose thrusters the commands are for.
        mapping: names of the fields, body and world frames, where they are not the standard ones.

    Raises:
        InputError: no such kind of source, or one of its parts is wrong.
    """
    if text == "-" or text.startswith("json:"):
        from towtank.live.links.json import JsonSource

        return JsonSource(text, vehicle, mapping)
    if text.startswith("replay:"):
        from towtank.live.links.replay import ReplaySource

        return ReplaySource(text, vehicle, mapping)
    if text.startswith("qtm:"):
        from towtank.live.links.mocap.qtm import QtmSource

        return QtmSource(text, mapping)
    if text.startswith("natnet:"):
        from towtank.live.links.mocap.natnet import NatnetSource

        return NatnetSource(text, mapping)
    if text in ("ros2", "dds") or text.startswith(("ros2:", "dds:")):
        from towtank.live.links.ros2.source import Ros2Source

        return Ros2Source(text, mapping)
    if _MAVLINK.match(text):
        from towtank.live.links.mavlink.source import MavlinkSource

        return MavlinkSource(text.removeprefix("mavlink:"), vehicle)
    raise InputError(f'source "{text}": expected one of {KINDS}')
