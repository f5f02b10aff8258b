"""The frame that ArduSub was set to: FRAME_CONFIG among its parameters."""

from __future__ import annotations

from collections.abc import Mapping

from towtank.vehicle.thrusters.ardusub import FRAMES

__all__ = ["frame_of"]


def frame_of(parameters: Mapping[str, float]) -> dict[str, str]:
    """Return the attribute of a recording that names the frame; nothing where it is not known."""
    number = parameters.get("FRAME_CONFIG")
    frame = FRAMES.get(int(number)) if number is not None and float(number).is_integer() else None
    return {} if frame is None else {"ardusub_frame": frame.name}
