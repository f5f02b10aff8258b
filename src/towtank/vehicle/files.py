"""Vehicle files (TOML): reading with errors that name the place, writing whole or not at all.

The vehicles that come with towtank: one TOML file each, with the provenance of every number.
"""

from __future__ import annotations

import os
import re
import tomllib
import warnings
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import tomlkit
from pydantic import ValidationError
from tomlkit.items import InlineTable, Table

from towtank.errors import InputError, nearest
from towtank.outputs import write_text
from towtank.printable import toml_escaped
from towtank.vehicle.base import Record, described, first_line
from towtank.vehicle.checks import faults
from towtank.vehicle.names import RESTORING
from towtank.vehicle.posterior import Posterior
from towtank.vehicle.records import Coefficient, Thruster
from towtank.vehicle.thrusters.curves import Curve
from towtank.vehicle.vehicle import Vehicle

__all__ = [
    "AnyVehicle",
    "VehicleWarning",
    "catalog_names",
    "catalog_text",
    "curve_text",
    "load_vehicle",
    "parse_vehicle",
    "save_vehicle",
    "vehicle_of",
    "vehicle_text",
]

AnyVehicle: TypeAlias = Vehicle | str | os.PathLike[str]  # itself, a name of the catalog, the path of a file
_WHOLE = 1e15  # numbers that are whole and below this are written so
_LINE_COLUMN = re.compile(r"^(.*) \(at line (\d+), column (\d+)\)$", re.DOTALL)


@cache
def catalog_names() -> tuple[str, ...]:
    """Return the names of the catalog, in alphabetical order."""
    folder = files("towtank.vehicle") / "catalog"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def catalog_text(name: str) -> str:
    """Return the TOML text of a vehicle of the catalog. Raises InputError for an unknown name."""
    if name not in catalog_names():
        raise InputError(f'"{name}" is not in the catalog{nearest(name, catalog_names())}')
    return (files("towtank.vehicle") / "catalog" / f"{name}.toml").read_text(encoding="utf-8")


class VehicleWarning(UserWarning):
    """A vehicle was read that is not physical."""


def load_vehicle(name_or_path: str | os.PathLike[str]) -> Vehicle:
    """Return a vehicle of the catalog by its name, or of a file by its path.

    A vehicle that is not physical (indefinite mass, drag that feeds energy in, ...) is read and a `VehicleWarning` is
    issued for each such thing; `vehicle.warnings` lists these and the milder doubts.

    Raises:
        InputError: no such vehicle or file; not TOML; a key, type or value that the schema does not allow.
    """
    if isinstance(name_or_path, str) and name_or_path in catalog_names():
        vehicle = parse_vehicle(catalog_text(name_or_path), f"{name_or_path} (catalog)")
    else:
        vehicle = parse_vehicle(_read(name_or_path), str(name_or_path))
    for fault in faults(vehicle):
        warnings.warn(f"{name_or_path}: {fault}", VehicleWarning, stacklevel=2)
    return vehicle


def vehicle_of(vehicle: AnyVehicle) -> Vehicle:
    """Return a vehicle as it is given, or by its name in the catalog or the path of its file, as `load_vehicle`.

    The names of the catalog are read once: in a loop they cost nothing.

    Raises:
        InputError: as `load_vehicle`, or what is given is neither a vehicle nor a name nor a path.
    """
    if isinstance(vehicle, Vehicle):
        return vehicle
    if isinstance(vehicle, str) and vehicle in catalog_names():
        return _of_catalog(vehicle)
    if isinstance(vehicle, str | os.PathLike):
        return load_vehicle(vehicle)
    raise InputError(f"vehicle: found {described(vehicle)}, expected a Vehicle, a name of the catalog or a path")


@cache
def _of_catalog(name: str) -> Vehicle:
    return load_vehicle(name)


def _read(name_or_path: str | os.PathLike[str]) -> str:
    path = Path(name_or_path)
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        if path.suffix or len(path.parts) > 1 or not isinstance(name_or_path, str):
            raise InputError(f"{path}: no such file; give a vehicle file (.toml) or a name of the catalog") from None
        raise InputError(
            f'"{name_or_path}" is neither a file nor a vehicle of the catalog{nearest(name_or_path, catalog_names())}'
            f"; the catalog has {', '.join(catalog_names())}"
        ) from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a folder, expected a vehicle file (.toml)") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8 text, expected a vehicle file (.toml)") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def parse_vehicle(text: str, place: str) -> Vehicle:
    """Return the vehicle of a TOML text; `place` stands before every error. Raises InputError."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = _LINE_COLUMN.match(str(error))
        where = f"{place}:{match[2]}:{match[3]}" if match else place
        raise InputError(f"{where}: not valid TOML: {match[1] if match else error}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{place}: not valid TOML: {error}") from None
    try:
        return Vehicle.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{place}: {first_line(error, data)}") from None


def save_vehicle(vehicle: AnyVehicle, path: str | os.PathLike[str]) -> None:
    """Write a vehicle file, whole or not at all; reading it gives an equal vehicle. Raises InputError."""
    write_text(path, vehicle_text(vehicle_of(vehicle)))


def vehicle_text(vehicle: Vehicle) -> str:
    """Return the TOML text of a vehicle."""
    document = tomlkit.document()
    document.add("name", tomlkit.item(vehicle.name))
    document.add("description", tomlkit.item(vehicle.description))
    if vehicle.command_delay:
        document.add("command_delay", tomlkit.item(vehicle.command_delay))
    if vehicle.scale_std is not None:
        document.add("scale_std", tomlkit.item(vehicle.scale_std))
    document.add("rigid_body", _table(vehicle.rigid_body, ("mass", "inertia", "centre_of_gravity")))
    document.add("buoyancy", _table(vehicle.buoyancy, ("centre",)))
    measured = {name: getattr(vehicle.restoring, name) for name in RESTORING}
    if any(measured.values()):
        document.add("restoring", _coefficients({n: c for n, c in measured.items() if c is not None}))
    document.add("hydrodynamics", _coefficients(vehicle.hydrodynamics))
    if vehicle.prior:
        document.add("prior", _coefficients(vehicle.prior))
    if vehicle.thrusters:
        blocks = tomlkit.aot()
        for thruster in vehicle.thrusters:
            blocks.append(_thruster(thruster))
        document.add("thrusters", blocks)
    provenance = tomlkit.table()
    provenance.add("source", vehicle.provenance.source)
    notes = tomlkit.array()
    notes.extend(vehicle.provenance.notes)
    provenance.add("notes", notes.multiline(len(vehicle.provenance.notes) > 0))
    document.add("provenance", provenance)
    text = toml_escaped(tomlkit.dumps(document))
    return text if vehicle.posterior is None else f"{text}\n{_posterior(vehicle.posterior)}"


def _posterior(posterior: Posterior) -> str:
    """Return the table [posterior], a row of the triangle on each line, behind it whose row it is."""
    quoted = ", ".join(f'"{name}"' for name in posterior.names)
    lines = [
        "[posterior]",
        f"names = [{quoted}]",
        f"mean = [{', '.join(map(_compact, posterior.mean))}]",
        f"std = [{', '.join(map(_compact, posterior.std))}]",
        f"prior_std = [{', '.join(map(_compact, posterior.prior_std))}]",
        "cholesky = [",
        *(
            f"[{','.join(map(_compact, row))}], # {name}"
            for name, row in zip(posterior.names, posterior.cholesky, strict=True)
        ),
        "]",
    ]
    return "\n".join(lines) + "\n"


def _compact(number: float) -> str:
    """Return the shortest text that TOML reads as this very number."""
    if number.is_integer() and abs(number) < _WHOLE:
        return str(int(number))
    fixed = np.format_float_positional(number, trim="-")
    return min(fixed, np.format_float_scientific(number, trim="-", exp_digits=1), key=len)


def curve_text(curve: Curve) -> str:
    """Return the line `curve = { ... }` of a vehicle file."""
    return tomlkit.dumps({"curve": _curve(curve)}).strip()


def _plain(value: Any) -> Any:
    """Return tuples as lists, ready for TOML."""
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _given(record: Record, always: tuple[str, ...]) -> dict[str, Any]:
    """Return the fields of a record that differ from their defaults, and those of `always`."""
    out = {}
    for name, field in type(record).model_fields.items():
        value = getattr(record, name)
        if value is not None and (name in always or field.is_required() or value != field.default):
            out[name] = value
    return out


def _table(record: Record, always: tuple[str, ...]) -> Table:
    table = tomlkit.table()
    for name, value in _given(record, always).items():
        table.add(name, _plain(value))
    return table


def _inline(values: Mapping[str, Any]) -> InlineTable:
    table = tomlkit.inline_table()
    table.update({name: _plain(value) for name, value in values.items()})
    return table


def _coefficients(coefficients: Mapping[str, Coefficient]) -> Table:
    table = tomlkit.table()
    for name, coefficient in coefficients.items():
        table.add(name, _inline(_given(coefficient, ("unit",) if coefficient.unit else ())))
    return table


def _curve(curve: Curve) -> InlineTable:
    values = {"kind": "", **_given(curve, ("kind",))}
    if curve.voltage is not None:
        values["voltage"] = _inline(_given(curve.voltage, ()))
    return _inline(values)


def _thruster(thruster: Thruster) -> Table:
    table = tomlkit.table()
    for name, value in _given(thruster, ("time_constant",)).items():
        table.add(name, _curve(value) if isinstance(value, Curve) else _plain(value))
    return table
