"""Vehicles out of simulators' files: the table of kinds, and what an import says of where a vehicle comes from.

A kind is a module with `recognises(root) -> bool` and `imported(root, text, place) -> Imported`.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from pydantic import ValidationError

from towtank.errors import InputError, nearest
from towtank.exporters.heading import Heading, heading_of
from towtank.exporters.importing.guarded import Imported, read_xml
from towtank.exporters.importing.xacro import expanded, is_xacro
from towtank.exporters.request import rounded
from towtank.vehicle import RESTORING, Coefficient, Provenance, Restoring, Vehicle

__all__ = ["SOURCES", "Source", "import_vehicle"]


class Source(NamedTuple):
    """A kind of file: its name as `--from` takes it, its module, and what it is, in words."""

    name: str
    module: str
    summary: str

    @property
    def reader(self) -> ModuleType:
        """The kind's module."""
        return importlib.import_module(f"towtank.exporters.importing.{self.module}")


SOURCES = (
    Source("gz-sim", "gz_sim", "SDF of Gazebo: Hydrodynamics, Buoyancy and Thruster systems"),
    Source("uuv-simulator", "uuv_simulator", "URDF, xacro or SDF with the plugins of uuv_simulator"),
    Source("urdf-hydrodynamics", "urdf", "URDF of blue and auv_controllers, thrusters.yaml beside it"),
)


def import_vehicle(path: str | os.PathLike[str], source: str = "auto") -> Imported:
    """Return the vehicle of a simulator's file, in SNAME coefficients, FRD and NED.

    Args:
        path: the file. source: one of `SOURCES`, or "auto": told by what the file holds.

    Raises:
        InputError: no such file or kind, hostile or broken XML, a number that is none, a body that is none.
    """
    names = [each.name for each in SOURCES]
    if source != "auto" and source not in names:
        raise InputError(f'--from: found "{source}"{nearest(source, names)}; there are {", ".join(names)} and auto')
    place = Path(path)
    root, text = read_xml(place)
    missing: tuple[str, ...] = ()
    if is_xacro(root):
        root, missing = expanded(root, place)
    known = [each for each in SOURCES if (each.reader.recognises(root) if source == "auto" else each.name == source)]
    if not known:
        raise InputError(
            f"{place}: found <{root.tag[:40]}>, expected one of {', '.join(names)}: none of them recognises it"
            f"{f'; {missing[0]}' if missing else ''}"
        )
    try:
        found: Imported = known[0].reader.imported(root, text, str(place))
        found = found._replace(left=(*found.left, *missing))
        heading = heading_of(text)
        vehicle = _with_origin(rounded(found.vehicle), place, found, heading)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(each) for each in first["loc"])
        raise InputError(f"{place}: {where}: {first['msg']}") from None
    except InputError:
        raise
    except (ArithmeticError, ValueError) as error:
        raise InputError(f"{place}: its numbers make no vehicle ({error})") from None
    return found._replace(vehicle=vehicle)


def _with_origin(vehicle: Vehicle, place: Path, found: Imported, heading: Heading | None) -> Vehicle:
    """Return the vehicle with its provenance; with name and deviations where towtank had written the file."""
    notes = (*(f"doubt: {each}" for each in found.doubts), *(f"not imported: {each}" for each in found.left))
    if heading is None:
        source = Provenance(source=f"imported from {place.name} ({found.source})", notes=notes)
        return vehicle.model_copy(update={"provenance": source})
    stds = heading.deviations
    values = {
        name: Coefficient(value=each.value, std=stds.get(name), unit=each.unit)
        for name, each in vehicle.hydrodynamics.items()
    }
    measured = {
        name: Coefficient(value=vehicle.coefficient(name), std=stds[name]) for name in RESTORING if name in stds
    }
    return vehicle.model_copy(
        update={
            "name": heading.vehicle,
            "hydrodynamics": type(vehicle.hydrodynamics)(values),
            "restoring": Restoring.model_validate(measured),
            "provenance": Provenance(source=heading.origin, notes=(*heading.notes, *notes)),
        }
    )
