"""Depth from the pressure sensor that is in the water; autopilots have another one, of the air in their hull."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.sources import Source

__all__ = ["Pressure", "depth_sources"]

_DIVE = 3000.0  # Pa, 0.3 m of water; the air in a warming hull changes by less
_FAR_MORE = 10.0


@dataclass(frozen=True, eq=False)
class Pressure:
    """One sensor: its number from 0, its table, times (n,) [s], pressure (n,) [Pa] and the depth (n,) [m] it tells.

    `depth` is None where the pressure at the surface is unknown.
    """

    number: int
    table: str
    t: Array
    pressure: Array
    depth: Array | None


def depth_sources(sensors: Sequence[Pressure], parameters: Mapping[str, float]) -> list[Source]:
    """Return the depth by each sensor, refused but for the one in the water.

    That is the autopilot's primary one (ArduSub sets it so), unless another dives while that one does not; where the
    parameters are unknown, the one whose pressure changes most.
    """
    primary = parameters.get("BARO_PRIMARY", parameters.get("GND_PRIMARY"))
    widest = max(sensors, key=lambda sensor: _span(sensor.pressure), default=None)
    stated = next((sensor for sensor in sensors if sensor.number == primary), None)
    chosen = widest if stated is None or (widest is not None and _dives(widest, stated)) else stated
    return [_source(sensor, sensor is chosen) for sensor in sensors]


def _dives(one: Pressure, other: Pressure) -> bool:
    """Whether the pressure at one sensor changes as only water's does, and far more than at the other."""
    return _span(one.pressure) > max(_DIVE, _FAR_MORE * _span(other.pressure))


def _source(sensor: Pressure, chosen: bool) -> Source:
    if not chosen:
        why = "taken for the air in the hull: another pressure is primary or changes more"
    elif sensor.depth is None:
        why = "the pressure at the surface is not known (no BAROn_GND_PRESS among the parameters)"
    else:
        why = ""
    depth = np.full(sensor.t.shape, np.nan) if sensor.depth is None else sensor.depth
    return Source(sensor.table, "depth", sensor.t, {"z": depth}, 0, why)


def _span(pressure: Array) -> float:
    known = pressure[np.isfinite(pressure)]
    return float(np.ptp(known)) if known.size else 0.0
