"""Bodies of a simulator's file put together: poses, masses and displaced volumes of several links as one body."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.exporters.frames import parallel_axes, turned_matrix, turned_vector
from towtank.vehicle import RigidBody

__all__ = ["IDENTITY", "Placed", "Solid", "composite", "pose", "rigid_body_of", "volume_of"]


class Placed(NamedTuple):
    """A frame within another: rotation (3, 3) and origin (3,) [m]."""

    R: Array
    p: Array

    def within(self, outer: Placed) -> Placed:
        """Return this frame, given in `outer`, in the frame in which `outer` is given."""
        return Placed(outer.R @ self.R, outer.p + outer.R @ self.p)

    @property
    def inverse(self) -> Placed:
        """The outer frame, given in this one."""
        return Placed(self.R.T, -self.R.T @ self.p)


IDENTITY = Placed(np.eye(3), np.zeros(3))


class Solid(NamedTuple):
    """Mass [kg], centre (3,) [m], and inertia (3, 3) about it [kg m^2], all in one frame."""

    mass: float
    centre: Array
    tensor: Array


def pose(values: Iterable[float], *, degrees: bool = False) -> Placed:
    """Return the frame of x y z roll pitch yaw, as SDF and URDF mean it: R_z R_y R_x."""
    x, y, z, *angles = values
    if not any(angles):
        return Placed(np.eye(3), np.array([x, y, z]))
    roll, pitch, yaw = (math.radians(each) if degrees else each for each in angles)
    cx, sx, cy, sy, cz, sz = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    R = np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )
    return Placed(R, np.array([x, y, z]))


def composite(solids: Iterable[Solid]) -> Solid:
    """Return the body that several, fixed to each other, are."""
    every = list(solids)
    mass = math.fsum(each.mass for each in every)
    centre = sum((each.mass * each.centre for each in every), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for each in every:
        tensor += each.tensor + parallel_axes(each.mass, each.centre - centre)
    return Solid(mass, centre, tensor)


def rigid_body_of(solid: Solid, place: str) -> RigidBody:
    """Return a body given in FLU. Raises InputError for a mass or inertia that no body has."""
    tensor = turned_matrix(solid.tensor)
    if not solid.mass > 0.0 or np.linalg.eigvalsh(tensor)[0] <= 0.0:
        raise InputError(
            f"{place}: found a mass of {solid.mass:g} kg with moments of inertia"
            f" {', '.join(f'{each:g}' for each in np.diag(tensor))} kg m^2, expected a body's"
        )
    inertia: object = tuple(np.diag(tensor).tolist())
    if np.abs(tensor - np.diag(np.diag(tensor))).max() > 1e-12 * np.trace(tensor):
        tensor = 0.5 * (tensor + tensor.T)
        inertia = tuple(tuple(row) for row in tensor.tolist())
    centre = tuple(turned_vector(solid.centre).tolist())
    return RigidBody(mass=solid.mass, inertia=inertia, centre_of_gravity=centre)


def volume_of(shape: str, sizes: tuple[float, ...]) -> float | None:
    """Return the volume [m^3] of a box, sphere, cylinder, capsule or ellipsoid; None of anything else."""
    match shape, sizes:
        case "box", (a, b, c):
            return a * b * c
        case "sphere", (radius,):
            return 4.0 / 3.0 * math.pi * radius**3
        case "cylinder", (radius, length):
            return math.pi * radius**2 * length
        case "capsule", (radius, length):
            return math.pi * radius**2 * (length + 4.0 / 3.0 * radius)
        case "ellipsoid", (a, b, c):
            return 4.0 / 3.0 * math.pi * a * b * c
    return None
