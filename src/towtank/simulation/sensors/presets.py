"""The sensor sets by name."""

from __future__ import annotations

from towtank.errors import InputError, nearest
from towtank.simulation.sensors.ins import Ins
from towtank.simulation.sensors.mocap import Mocap
from towtank.simulation.sensors.sensor import Perfect, Sensors, Together
from towtank.simulation.sensors.water_track import WaterTrack

__all__ = ["SENSORS", "sensors_named"]

SENSORS: dict[str, Sensors] = {
    "perfect": Perfect(),
    "mocap": Mocap(),
    "ins": Ins(),
    "ins-water": Together((Ins(), WaterTrack())),
}


def sensors_named(sensors: str | Sensors | None) -> Sensors:
    """Return the sensors of this name; None is "perfect"; any other object is taken as it is.

    Raises:
        InputError: no preset has this name.
    """
    if sensors is None:
        return SENSORS["perfect"]
    if not isinstance(sensors, str):
        return sensors
    if sensors not in SENSORS:
        raise InputError(f'unknown sensors "{sensors}"{nearest(sensors, SENSORS)}; there are {", ".join(SENSORS)}')
    return SENSORS[sensors]
