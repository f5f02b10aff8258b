"""One sample's numbers brought from other frames to NED and FRD, and from a marker to the body origin.

The same as `recording.to_ned_frd` and `marker_to_origin` do for a whole recording. Velocity comes in the world or of a
sensor off the origin; the attitude that came last is carried on by the body rates to its instant, so that nothing waits
for the next attitude.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_from_euler
from towtank.live.links.source import Sample
from towtank.recording.frames.conversion import POSITION_OF_ENU, REVERSED_BY_FLU, convert_euler, convert_quaternion
from towtank.recording.frames.lever_arm import origin_position, origin_velocity
from towtank.recording.mapping import Marker
from towtank.recording.standard import EULER, LINEAR_VELOCITY, POSITION, QUANTITIES, QUATERNION, RATES, WORLD_VELOCITY

__all__ = ["BodyVelocity", "MarkerArm", "to_ned_frd"]

_OLDEST = 0.3  # s between a velocity and the attitude that turns it
_Vector = tuple[float, float, float]


def to_ned_frd(sample: Mapping[str, float], body: str, world: str) -> dict[str, float]:
    """Return a sample (standard name -> value) in NED and FRD.

    Args:
        sample: in the frames `body` (FRD or FLU) and `world` (NED or ENU). A quaternion that is not whole, or not of
            length 1 within a tenth, is left out.
    """
    out: dict[str, float] = {}
    flu, enu = body == "FLU", world == "ENU"
    for name, value in sample.items():
        if name in POSITION_OF_ENU and enu:
            target, sign = POSITION_OF_ENU[name]
            out[target] = sign * value
        elif name in EULER:
            out[name] = float(convert_euler(np.asarray(value), name, body=body, world=world)) if flu or enu else value
        elif (flu and name in REVERSED_BY_FLU) or (enu and name == "vd"):
            out[name] = -value
        elif name not in QUATERNION:
            out[name] = value
    quaternion = [sample.get(name, math.nan) for name in QUATERNION]
    length = math.hypot(*quaternion)
    if abs(length - 1.0) < 0.1:
        turned = convert_quaternion(np.array(quaternion) / length, body=body, world=world)
        out.update(zip(QUATERNION, turned.tolist(), strict=True))
    return out


class MarkerArm:
    """Moves position and velocity from the marker to the body origin, with the attitude and rates known last."""

    def __init__(self, marker: Marker) -> None:
        self._arm = np.array(marker.position)
        self._of = marker.of
        self._q: tuple[float, ...] = ()
        self._rates: tuple[float, ...] = ()

    def to_origin(self, sample: Mapping[str, float]) -> dict[str, float]:
        """Return a sample in NED and FRD, moved; what cannot be moved yet, for want of attitude or rates, left out."""
        out = dict(sample)
        if all(name in sample for name in QUATERNION):
            self._q = tuple(sample[name] for name in QUATERNION)
        elif all(name in sample for name in EULER):
            self._q = quaternion_from_euler(*(sample[name] for name in EULER))
        if all(name in sample for name in RATES):
            self._rates = tuple(sample[name] for name in RATES)
        if "position" in self._of:
            _move(out, POSITION, origin_position(np.zeros(3), np.array(self._q), self._arm) if self._q else None)
        if "velocity" in self._of:
            arm = origin_velocity(np.zeros(3), np.array(self._rates), self._arm) if self._rates else None
            for quantity in QUANTITIES:
                if quantity.swept:
                    _move(out, quantity.channels, arm)
        return out


def _move(out: dict[str, float], names: tuple[str, ...], shift: Array | None) -> None:
    for k, name in enumerate(names):
        if name in out:
            if shift is None:
                del out[name]
            else:
                out[name] += float(shift[k])


class BodyVelocity:
    """Follows attitude and rates of one source and gives its velocities in the body."""

    def __init__(self) -> None:
        self._axes: tuple[_Vector, _Vector, _Vector] | None = None  # columns of the rotation from body to world
        self._at = -math.inf
        self._rates: _Vector = (0.0, 0.0, 0.0)
        self.unturned = 0

    def of(self, sample: Sample, place: _Vector | None = None) -> Sample:
        """Return the sample with u v w of the body origin in place of vn ve vd.

        Args:
            sample: of any kind; its attitude and rates are remembered.
            place: of the sensor of velocity in the body [m], where it is not the origin.
        """
        known = dict(zip(sample.names, sample.values, strict=True))
        t = sample.received if math.isnan(sample.t) else sample.t
        self._remember(known, t)
        if WORLD_VELOCITY[0] in known:
            world = [known.pop(name) for name in WORLD_VELOCITY]
            known |= dict(zip(LINEAR_VELOCITY, self._turned(world, t), strict=True))
        elif place is None or LINEAR_VELOCITY[0] not in known:
            return sample
        if place is not None:
            arm = _cross(self._rates, place)
            known |= {name: known[name] - arm[k] for k, name in enumerate(LINEAR_VELOCITY)}
        return replace(sample, names=tuple(known), values=tuple(known.values()))

    def _remember(self, known: dict[str, float], t: float) -> None:
        if RATES[0] in known:
            rates = tuple(known[name] for name in RATES)
            if all(map(math.isfinite, rates)):
                self._rates = rates  # type: ignore[assignment]
        if QUATERNION[0] in known:
            q = [known[name] for name in QUATERNION]
        elif all(name in known for name in EULER):
            q = _quaternion(*(known[name] for name in EULER))
        else:
            return
        norm = math.sqrt(sum(each * each for each in q))
        if math.isfinite(norm) and norm > 0.5:
            self._axes, self._at = _axes(*(each / norm for each in q)), t

    def _turned(self, world: list[float], t: float) -> _Vector:
        if self._axes is None or abs(t - self._at) > _OLDEST:
            self.unturned += 1
            return (math.nan, math.nan, math.nan)
        u, v, w = (sum(a * b for a, b in zip(axis, world, strict=True)) for axis in self._axes)
        step = t - self._at
        turn = _cross(self._rates, (u, v, w))
        return u - step * turn[0], v - step * turn[1], w - step * turn[2]


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _quaternion(phi: float, theta: float, psi: float) -> list[float]:
    cr, sr, cp, sp = math.cos(phi / 2), math.sin(phi / 2), math.cos(theta / 2), math.sin(theta / 2)
    cy, sy = math.cos(psi / 2), math.sin(psi / 2)
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


def _axes(w: float, x: float, y: float, z: float) -> tuple[_Vector, _Vector, _Vector]:
    """Return forward, starboard and down of the body in the world."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
