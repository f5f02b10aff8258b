"""Conversion of frames at the boundary: world ENU to NED, body FLU (x forward, y port, z up) to FRD.

With R the attitude, source body to source world, the attitude inside towtank is

    R(NED <- FRD) = R(NED <- ENU) R R(FLU <- FRD),

where R(NED <- ENU) swaps x and y and reverses z, R(FLU <- FRD) reverses y and z. Where only one of the two
frames
differs, the other factor is the identity: a level vehicle in ENU/FRD or NED/FLU axes is rolled by pi.
Every function is its own inverse up to the sign of a quaternion.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.rotations import multiply

__all__ = ["convert_body_vector", "convert_euler", "convert_quaternion", "convert_world_vector", "wrap_angle"]

_NED_ENU = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])
_FLU_FRD = np.array([0.0, 1.0, 0.0, 0.0])


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
