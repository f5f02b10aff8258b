"""A Recording in other frames, brought to NED and FRD once, channel by channel at its own times."""

from __future__ import annotations

import numpy as np

from towtank.recording.channel import Channel, standard_channel
from towtank.recording.frames import convert_euler, convert_quaternion
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, POSITION, QUATERNION
from towtank.recording.synchrony import quaternion_samples

__all__ = ["to_ned_frd"]

_REVERSED_BY_FLU = ("v", "w", "q", "r", "ay", "az", "Y", "Z", "M", "N")
_POSITION_OF_ENU = {"x": ("y", 1.0), "y": ("x", 1.0), "z": ("z", -1.0)}


def to_ned_frd(recording: Recording, *, body: str = "FRD", world: str = "NED") -> Recording:
    """Return the recording in NED and FRD.

    Args:
        recording: channels whose body quantities stand in `body` (FRD or FLU), positions and attitude in
            `world` (NED or ENU), under the standard names of their axes. Of a velocity in the world `vn` and `ve` are
            named by direction; `vd` is reversed from ENU. Commands and voltage have no frame.
    """
    notes: list[str] = []
    if (body, world) != ("FRD", "NED"):
        done: dict[str, Channel] = {}
        for name in recording:
            if name in POSITION and world == "ENU":
                target, sign = _POSITION_OF_ENU[name]
                done[target] = standard_channel(target, recording[name].t, sign * recording[name].values)
            elif name not in QUATERNION:
                done[name] = _converted(recording[name], body, world)
        if all(name in recording for name in QUATERNION):
            t, q = quaternion_samples(recording)
            q = convert_quaternion(q, body=body, world=world)
            done |= {name: standard_channel(name, t, q[:, i]) for i, name in enumerate(QUATERNION)}
        order = dict.fromkeys([*recording, *done])
        recording = recording.with_channels(done[name] for name in order if name in done)
        notes.append(f"converted from {world} and {body} to NED and FRD")
    return recording.with_notes(*notes, *_doubts(recording))


def _converted(channel: Channel, body: str, world: str) -> Channel:
    if channel.name in EULER:
        return channel.with_values(convert_euler(channel.values, channel.name, body=body, world=world))
    if (body == "FLU" and channel.name in _REVERSED_BY_FLU) or (world == "ENU" and channel.name == "vd"):
        return channel.with_values(-channel.values)
    return channel


def _doubts(recording: Recording) -> list[str]:
    """Signs that the mapping states the wrong frames."""
    doubts = []
    if "phi" in recording and np.median(np.cos(recording["phi"].values)) < 0.0:
        doubts.append('the vehicle is upside down most of the time: check "body" and "world" of the mapping')
    if "az" in recording and np.median(recording["az"].values) > 5.0:
        doubts.append('"az" is mostly positive, about -9.8 is expected at rest: check "body" of the mapping')
    return doubts
