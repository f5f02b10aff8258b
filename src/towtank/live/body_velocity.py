"""Velocity as links give it, in the world or of a sensor off the origin, turned into that of the body origin.

The attitude that came last is carried on by the body rates to the instant of the velocity, so that nothing waits for
the next attitude.
"""

from __future__ import annotations

import math
from dataclasses import replace

from towtank.live.source import Sample
from towtank.recording.standard import EULER, LINEAR_VELOCITY, QUATERNION, WORLD_VELOCITY

__all__ = ["BodyVelocity"]

_RATES = ("p", "q", "r")
_OLDEST = 0.3  # s between a velocity and the attitude that turns it
_Vector = tuple[float, float, float]


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
        if _RATES[0] in known:
            rates = tuple(known[name] for name in _RATES)
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
