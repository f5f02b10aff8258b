"""One sample's numbers brought from other frames to NED and FRD, and from a marker to the body origin.

The same as `recording.to_ned_frd` and `marker_to_origin` do for a whole recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_from_euler
from towtank.recording.frames import convert_euler, convert_quaternion
from towtank.recording.lever_arm import origin_position, origin_velocity
from towtank.recording.mapping import Marker
from towtank.recording.standard import EULER, POSITION, QUATERNION

__all__ = ["MarkerArm", "to_ned_frd"]

_REVERSED_BY_FLU = frozenset(("v", "w", "q", "r", "ay", "az", "Y", "Z", "M", "N"))
_ENU_POSITION = {"x": ("y", 1.0), "y": ("x", 1.0), "z": ("z", -1.0)}
_SPEEDS, _RATES = ("u", "v", "w"), ("p", "q", "r")


def to_ned_frd(sample: Mapping[str, float], body: str, world: str) -> dict[str, float]:
    """Return a sample (standard name -> value) in NED and FRD.

    Args:
        sample: in the frames `body` (FRD or FLU) and `world` (NED or ENU). A quaternion that is not whole, or not of
            length 1 within a tenth, is left out.
    """
    out: dict[str, float] = {}
    flu, enu = body == "FLU", world == "ENU"
    for name, value in sample.items():
        if name in _ENU_POSITION and enu:
            target, sign = _ENU_POSITION[name]
            out[target] = sign * value
        elif name in EULER:
            out[name] = float(convert_euler(np.asarray(value), name, body=body, world=world)) if flu or enu else value
        elif (flu and name in _REVERSED_BY_FLU) or (enu and name == "vd"):
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
        if all(name in sample for name in _RATES):
            self._rates = tuple(sample[name] for name in _RATES)
        if "position" in self._of:
            _move(out, POSITION, origin_position(np.zeros(3), np.array(self._q), self._arm) if self._q else None)
        if "velocity" in self._of:
            _move(out, _SPEEDS, origin_velocity(np.zeros(3), np.array(self._rates), self._arm) if self._rates else None)
        return out


def _move(out: dict[str, float], names: tuple[str, ...], way: Array | None) -> None:
    for k, name in enumerate(names):
        if name in out:
            if way is None:
                del out[name]
            else:
                out[name] += float(way[k])
