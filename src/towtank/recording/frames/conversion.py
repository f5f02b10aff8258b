"""From other frames to NED and FRD, once, at the boundary: world ENU, body FLU (x forward, y port, z up).

With R the attitude, source body to source world, the attitude inside towtank is

    R(NED <- FRD) = R(NED <- ENU) R R(FLU <- FRD),

where R(NED <- ENU) swaps x and y and reverses z, R(FLU <- FRD) reverses y and z. Where only one of the two frames
differs, the other factor is the identity: a level vehicle in ENU/FRD or NED/FLU axes is rolled by pi.
Every function is its own inverse up to the sign of a quaternion. A Recording is converted channel by channel.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.channel import Channel, standard_channel
from towtank.recording.frames.rotations import multiply
from towtank.recording.grids.timing import quaternion_samples
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, POSITION, QUATERNION, STANDARD, TRIPLES, WRENCH

__all__ = [
    "POSITION_OF_ENU",
    "REVERSED_BY_FLU",
    "convert_body_vector",
    "convert_euler",
    "convert_quaternion",
    "convert_world_vector",
    "to_ned_frd",
    "wrap_angle",
]

_NED_ENU = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])
_FLU_FRD = np.array([0.0, 1.0, 0.0, 0.0])
REVERSED_BY_FLU = frozenset(
    name for names in (*TRIPLES, WRENCH[:3], WRENCH[3:]) if STANDARD[names[0]].frame == "FRD" for name in names[1:]
)
POSITION_OF_ENU = {"x": ("y", 1.0), "y": ("x", 1.0), "z": ("z", -1.0)}


def wrap_angle(angle: Array) -> Array:
    """Return the angle(s) [rad] in [-pi, pi)."""
    result: Array = np.remainder(np.asarray(angle) + np.pi, 2.0 * np.pi) - np.pi
    return result


def convert_world_vector(vector: Array) -> Array:
    """ENU to NED or back: (..., 3) to (..., 3)."""
    vector = np.asarray(vector, dtype=np.float64)
    return np.stack([vector[..., 1], vector[..., 0], -vector[..., 2]], axis=-1)


def convert_body_vector(vector: Array) -> Array:
    """FLU to FRD or back: (..., 3) to (..., 3); velocities, rates, forces and moments alike."""
    result: Array = np.asarray(vector, dtype=np.float64) * np.array([1.0, -1.0, -1.0])
    return result


def convert_quaternion(q: Array, *, body: str, world: str) -> Array:
    """Attitude (..., 4) [w x y z] from `body` (FRD or FLU) and `world` (NED or ENU) to FRD and NED."""
    q = np.asarray(q, dtype=np.float64)
    if world == "ENU":
        q = multiply(_NED_ENU, q)
    if body == "FLU":
        q = multiply(q, _FLU_FRD)
    return q


def convert_euler(angle: Array, name: str, *, body: str, world: str) -> Array:
    """One of phi, theta, psi [rad], Euler zyx, from the frames `body` and `world` to NED and FRD.

    ENU reverses pitch and turns yaw to pi/2 - psi; each of ENU and FLU adds pi to roll (both together:
    nothing).
    """
    enu, flu = world == "ENU", body == "FLU"
    if name == "phi":
        return wrap_angle(angle + np.pi) if enu != flu else angle
    if name == "theta":
        return -angle if enu else angle
    return np.pi / 2.0 - angle if enu else angle


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
                target, sign = POSITION_OF_ENU[name]
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
    if (body == "FLU" and channel.name in REVERSED_BY_FLU) or (world == "ENU" and channel.name == "vd"):
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
