"""A model out of towtank: checked, put into a target's files, and written whole."""

from __future__ import annotations

import hashlib
import keyword
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.exporters.heading import Heading, heading_of_request
from towtank.exporters.request import Kept, Request, is_definite, require_exportable, stem_of, wrench_error
from towtank.exporters.targets import Target, target_named
from towtank.outputs import write_atomically
from towtank.vehicle import AnyVehicle, Vehicle, catalog_names, catalog_text, vehicle_of, vehicle_text

__all__ = ["Exported", "export"]

_FASTEST = 20.0  # m/s
_IMPORTED = (".py", ".m")  # files that are called by their name without the suffix


class Exported(NamedTuple):
    """What was written.

    Attributes:
        target, version: of the format. vehicle: that was exported. files: that were written.
        heading: what opens them. kept: what the target keeps of the vehicle.
        error: largest error of the wrench (6,) [N, N m].
    """

    target: str
    version: str
    vehicle: Vehicle
    files: tuple[Path, ...]
    heading: Heading
    kept: Kept
    error: Array


def export(
    vehicle: AnyVehicle,
    to: str,
    output: str | os.PathLike[str] | None = None,
    *,
    target_version: str | None = None,
    at_speed: float | None = None,
    allow_unidentified: bool = False,
    options: Mapping[str, str | bool] | None = None,
) -> Exported:
    """Write a model for a simulator, a controller or a program; see `towtank export --list` for the targets.

    Args:
        vehicle: a Vehicle, a name of the catalog, or the path of a vehicle file or learned model.
        to: the target's name. output: the file or, for targets that write several, the folder; default: the vehicle's
            name in the working directory.
        target_version: of the target's format. at_speed: surge [m/s] at which terms are taken that the target knows
            only as constant numbers.
        allow_unidentified: export coefficients that the data did not narrow, too.
        options: switches of single targets, as {"engine": "bullet"} of gz-sim.

    Raises:
        InputError: an unknown target, version or option; a model that has unidentified coefficients or gains energy;
            what cannot be said in the target at all; a place that cannot be written.
    """
    target = target_named(to)
    found, source, data = _read(vehicle)
    request = Request(
        found,
        source,
        hashlib.sha256(data).hexdigest(),
        _version(target, target_version),
        _speed(at_speed),
        _options(target, dict(options or {})),
    )
    require_exportable(found, source, allow_unidentified=allow_unidentified)
    writer = target.writer
    kept = writer.kept(request)
    if not is_definite(kept.vehicle.mass_matrix):
        raise InputError(
            f"{source}: what {target.name} can say of its mass and inertia is not positive definite, so that it would"
            " gain energy; put the origin nearer to the centre of gravity, or choose another target"
        )
    away = wrench_error(found, kept.vehicle)
    heading = heading_of_request(f"{target.name} {request.version}", request, kept, away)
    written = writer.written(request, heading)
    try:
        files = _places(target, found, output, list(written))
        for place, content in zip(files, written.values(), strict=True):
            write_atomically(place, lambda stream, content=content: _all(stream, content))  # type: ignore[misc]
    except OSError as error:
        place = Path(error.filename or output or ".")
        raise InputError(f"{place}: cannot be written ({error.strerror}); choose another place") from error
    return Exported(target.name, request.version, found, files, heading, kept, away)


def _all(stream: object, content: bytes) -> None:
    stream.write(content)  # type: ignore[attr-defined]


def _read(vehicle: AnyVehicle) -> tuple[Vehicle, str, bytes]:
    """Return the vehicle, what its source is called, and the bytes of that source."""
    found = vehicle_of(vehicle)
    if isinstance(vehicle, Vehicle):
        return found, found.name, vehicle_text(found).encode()
    if isinstance(vehicle, str) and vehicle in catalog_names():
        return found, f"{vehicle} (catalog)", catalog_text(vehicle).encode()
    return found, Path(vehicle).name, Path(vehicle).read_bytes()


def _version(target: Target, wanted: str | None) -> str:
    if wanted is None:
        return target.versions[0]
    if wanted not in target.versions:
        raise InputError(
            f'--target-version: found "{wanted}", expected of {target.name} {" or ".join(target.versions)}'
            f"{nearest(wanted, target.versions)}"
        )
    return wanted


def _speed(at_speed: float | None) -> float | None:
    if at_speed is not None and not abs(at_speed) <= _FASTEST:
        raise InputError(f"--at-speed: found {at_speed:g}, expected a speed ahead of at most {_FASTEST:g} m/s")
    return at_speed


def _options(target: Target, given: dict[str, str | bool]) -> dict[str, str | bool]:
    wanted = {name: value for name, value in given.items() if value not in (None, False)}
    for name in wanted:
        if name not in target.options:
            has = f"it has {', '.join(f'--{each}' for each in target.options)}" if target.options else "it has none"
            raise InputError(f"--{name}: this is no option of the target {target.name}; {has}")
    return wanted


def _places(
    target: Target, vehicle: Vehicle, output: str | os.PathLike[str] | None, names: list[str]
) -> tuple[Path, ...]:
    """Return where each file goes. Raises InputError where it cannot."""
    stem = stem_of(vehicle) + target.ending
    if target.suffix in _IMPORTED:
        stem = _identifier(stem.lower() if target.suffix == ".m" else stem)  # as the function in it
    if target.suffix:
        place = Path(stem + target.suffix) if output is None else Path(output)
        if place.is_dir():
            place = place / (stem + target.suffix)
        if place.suffix.lower() != target.suffix:
            raise InputError(f'--output: found "{place}", expected a name that ends in {target.suffix}')
        return (place,)
    folder = Path(f"{stem}_{target.name}") if output is None else Path(output)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output {folder}: this is a file, expected a folder: {target.name} writes {target.writes}")
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: the folder {folder.parent} does not exist; create it first")
    places = tuple(folder / name for name in names)
    for each in {place.parent for place in places}:
        each.mkdir(parents=True, exist_ok=True)
    return places


def _identifier(stem: str) -> str:
    """Return the beginning of a file's name so that Python can import it, and MATLAB call it."""
    plain = re.sub(r"\W", "_", stem, flags=re.ASCII)
    taken = keyword.iskeyword(plain) or plain in sys.stdlib_module_names or plain in ("numpy", "end", "function")
    return f"v_{plain}" if taken or not plain[0].isalpha() else plain
