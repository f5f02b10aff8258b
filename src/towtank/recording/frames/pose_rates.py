"""Velocity in the body from the derivative of a pose, as far as the pose is measured.

    nu_1 = R^T [x' y' z'],  p = phi' - psi' sin(theta),  ...

A depth alone tells heave, w = (z' + u sin(theta) - v sin(phi) cos(theta)) / (cos(phi) cos(theta)), with the u and v
that are measured; a heading alone tells yaw, roll and pitch angles their rates, each of a body that is level and still
as far as nothing else is measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array

__all__ = ["velocity_of_pose"]

_BLOCK = 20_000  # rows at once, so that the parts of a long recording need little room
_UPRIGHT = 0.2  # cosine of the tilt below which a depth tells nothing of heave


def velocity_of_pose(pose: Array, rate: Array, velocity: Array) -> Array:
    """Return body velocities (n, 6) [m/s, rad/s], body FRD; NaN where the pose does not tell them.

    Args:
        pose: (n, 6) x y z [m], NED, and Euler angles [rad]; columns without any value are not measured.
        rate: (n, 6) its derivative. velocity: (n, 6) u v w p q r as measured, of which u and v are used.
    """
    known = np.asarray(np.isfinite(pose).any(axis=0))
    ahead = np.where(np.isfinite(velocity[:, :2]).any(axis=0), velocity[:, :2], 0.0)
    blocks = [slice(first, first + _BLOCK) for first in range(0, max(len(pose), 1), _BLOCK)]
    return np.concatenate([_velocity(known, pose[rows], rate[rows], ahead[rows]) for rows in blocks])


def _velocity(known: NDArray[np.bool_], pose: Array, rate: Array, ahead: Array) -> Array:
    phi, theta, psi = np.where(known[3:], pose[:, 3:], 0.0).T
    x, y, z, f, g, h = np.where(known, rate, 0.0).T
    s1, c1, s2, c2, s3, c3 = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta), np.sin(psi), np.cos(psi)
    forward, right = c3 * x + s3 * y, c3 * y - s3 * x  # horizontal, ahead and to the right
    down = s2 * forward + c2 * z
    out = np.column_stack(
        [
            c2 * forward - s2 * z,
            c1 * right + s1 * down,
            c1 * down - s1 * right,
            f - s2 * h,
            c1 * g + s1 * c2 * h,
            c1 * c2 * h - s1 * g,
        ]
    )
    placed = known[0] and known[1] and known[5]
    if not placed:
        out[:, :2] = np.nan
        u, v = ahead.T
        upright = c1 * c2
        with np.errstate(divide="ignore", invalid="ignore"):
            out[:, 2] = np.where(upright > _UPRIGHT, (z + s2 * u - s1 * c2 * v) / upright, np.nan)
    out[:, np.append(np.full(2, not (placed and known[2])), ~known[2:])] = np.nan
    return out
