"""The water there is: a tank as a box, how close a vehicle may come to its walls, and how it may move in it.

NED with its origin in the middle of the water's surface: x and y lie within half a size on both sides, z between 0, the
surface, and the depth. The surface counts as a wall.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.vehicle import AnyVehicle, vehicle_of

__all__ = ["Space", "radius_of"]

_WATER = 1000.0  # kg/m^3
_THRUSTER = 0.05  # m, from the middle of a thruster to the end of its duct
_ROOM = 0.4  # m, that a vehicle must be able to move in each direction to show anything
_NUMBER = re.compile(r"[0-9]*\.?[0-9]+(?:e[-+]?[0-9]+)?", re.IGNORECASE)
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Space:
    """A tank and what a vehicle may do in it.

    Attributes:
        size: length, width and depth (3,) [m], along x, y and z of NED.
        margin: that is to stay free between the vehicle and every wall, the surface too [m].
        start: place of the body origin at the start [m], NED; None for the middle.
        tilt: largest angle between the body's z axis and the vertical [rad].
        speed: largest speed over ground [m/s].
        turn: largest rate of turn about any axis [rad/s].

    Raises:
        InputError: a number is not finite or out of range, or the start lies within the margin or outside.
    """

    size: tuple[float, float, float]
    margin: float = 0.2
    start: tuple[float, float, float] | None = None
    tilt: float = math.radians(45.0)
    speed: float = 1.0
    turn: float = 2.0

    def __post_init__(self) -> None:
        size = _three("space", self.size)
        for value, axis in zip(size, _AXES, strict=True):
            if value <= 0.0:
                raise InputError(f"space: found a size of {value:g} m along {axis}, expected a number above 0")
        object.__setattr__(self, "size", size)
        for name, unit in (("speed", "m/s"), ("turn", "rad/s")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"space: {name}: found {value:g} {unit}, expected a number above 0")
        if not 0.0 < self.tilt < math.pi:
            raise InputError(f"space: tilt: found {self.tilt:g} rad, expected an angle between 0 and pi")
        if not 0.0 <= self.margin < 0.5 * min(size):
            raise InputError(f"space: margin: found {self.margin:g} m, expected 0 or more and less than half the size")
        if self.start is not None:
            start = _three("start", self.start)
            object.__setattr__(self, "start", start)
            if self.clearance(np.array(start), 0.0) < self.margin:
                raise InputError(f"start: found {_place(start)} m, expected a place {self.margin:g} m off every wall")

    @classmethod
    def from_text(
        cls, size: str, *, start: str | None = None, margin: float = 0.2, tilt: float = math.radians(45.0)
    ) -> Space:
        """Return the space of texts such as "5x5x2.5" [m], and "0,0,1.2" of the start [m].

        Raises:
            InputError: a text that is not three numbers, or what the record refuses.
        """
        place = None if start is None else _numbers("start", start, ",", '"0,0,1.2" (x, y, z in metres)')
        return cls(
            _numbers("space", size, "x", '"5x5x2.5" (length, width, depth in metres)'),
            margin=margin,
            start=place,
            tilt=tilt,
        )

    @property
    def lower(self) -> Array:
        """The corner (3,) [m] with the least coordinates, NED."""
        return np.array([-0.5 * self.size[0], -0.5 * self.size[1], 0.0])

    @property
    def upper(self) -> Array:
        """The corner (3,) [m] with the largest coordinates, NED."""
        return np.array([0.5 * self.size[0], 0.5 * self.size[1], self.size[2]])

    @property
    def middle(self) -> Array:
        """The middle (3,) [m], NED."""
        return 0.5 * (self.lower + self.upper)

    @property
    def eta0(self) -> Array:
        """Pose at the start (6,) [m, rad]: level, heading north."""
        return np.concatenate([self.middle if self.start is None else np.array(self.start), np.zeros(3)])

    def clearance(self, places: Array, radius: float) -> Array:
        """Return the distance (...) [m] from a sphere about each of the places (..., 3) to the nearest wall.

        Below 0 where it is through. A place that is not finite gives NaN.
        """
        return np.asarray(np.minimum(places - self.lower, self.upper - places).min(axis=-1) - radius)

    def require_room(self, vehicle: AnyVehicle) -> float:
        """Return the radius [m] of a vehicle that has room to move here.

        Raises:
            InputError: the vehicle with its margins is larger than the space, less what it needs to move.
        """
        vehicle = vehicle_of(vehicle)
        radius = radius_of(vehicle)
        needed = 2.0 * (radius + self.margin) + _ROOM
        for value, axis in zip(self.size, _AXES, strict=True):
            if value < needed:
                raise InputError(
                    f"space: {vehicle.name} is {2.0 * radius:.2g} m across and needs {needed:.2g} m along {axis} with"
                    f" {self.margin:g} m to each wall and {_ROOM:g} m to move, found {value:g} m; take a tank of"
                    f" {needed:.2g} x {needed:.2g} x {needed:.2g} m at least"
                )
        if self.start is not None and self.clearance(np.array(self.start), radius) < self.margin:
            raise InputError(
                f"start: at {_place(self.start)} m {vehicle.name}, {2.0 * radius:.2g} m across, is closer than"
                f" {self.margin:g} m to a wall; begin nearer to the middle, {_place(self.middle)} m"
            )
        return radius


def radius_of(vehicle: AnyVehicle) -> float:
    """Return the radius [m] of a sphere about the body origin that holds the vehicle, as far as its file says.

    The farthest of the thrusters, with their ducts, and the sphere about a cube of water of the vehicle's mass at its
    centre of gravity. Frames and tethers are in no file: the margin is theirs.
    """
    vehicle = vehicle_of(vehicle)
    body = vehicle.rigid_body
    cube = 0.5 * math.sqrt(3.0) * (body.mass / _WATER) ** (1.0 / 3.0) + math.hypot(*body.centre_of_gravity)
    return float(max([cube, *(math.hypot(*each.position) + _THRUSTER for each in vehicle.thrusters)]))


def _numbers(name: str, text: str, separator: str, example: str) -> tuple[float, float, float]:
    parts = [part.strip() for part in text.strip().lower().removesuffix("m").split(separator)]
    signed = [part.removeprefix("-") if name == "start" else part for part in parts]
    if len(parts) != 3 or not all(_NUMBER.fullmatch(part) for part in signed):
        raise InputError(f'{name}: found "{text}", expected three numbers, as {example}')
    return float(parts[0]), float(parts[1]), float(parts[2])


def _three(name: str, values: tuple[float, ...]) -> tuple[float, float, float]:
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        raise InputError(f"{name}: found {_place(values)}, expected three finite numbers [m]")
    x, y, z = (float(value) for value in values)
    return x, y, z


def _place(values: tuple[float, ...] | Array) -> str:
    return ", ".join(f"{value:g}" for value in values)
