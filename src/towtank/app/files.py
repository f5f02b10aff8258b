"""The files that commands read: vehicles with their warnings, logs with their mapping and window."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from towtank.app.commands.arguments import Merged, Window
from towtank.app.terminal.output import Output, Progress
from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.recording import Recording
    from towtank.vehicle import Vehicle

__all__ = ["cut", "merged_with", "read_configurations", "read_logs", "read_prior", "read_vehicle"]


def read_vehicle(name_or_file: str, output: Output, *, silent: bool = False) -> Vehicle:
    """Return a vehicle; what is not physical about it is said on standard error unless `silent`."""
    from towtank.vehicle import VehicleWarning, load_vehicle

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", VehicleWarning)
        vehicle = load_vehicle(name_or_file)
    for warning in caught:
        if not issubclass(warning.category, VehicleWarning):
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
        elif not silent:
            output.warn(str(warning.message))
    return vehicle


def read_prior(name_or_file: str, output: Output) -> Vehicle:
    """Return a vehicle that says what is known beforehand. Raises InputError where it does not.

    It was learned, or has a table [prior], or coefficients that bear deviations.
    """
    from towtank.vehicle import COEFFICIENTS

    vehicle = read_vehicle(name_or_file, output)
    known = vehicle.posterior is not None or vehicle.prior
    if not known and not any(vehicle.deviation(name) for name in COEFFICIENTS):
        raise InputError(
            f"--prior {name_or_file}: no coefficient bears a std, so that nothing is known beforehand; write "
            "X_uu = { value = -40.0, std = 4.0 } in [hydrodynamics] or [prior], or give a model that learn wrote"
        )
    return vehicle


def read_configurations(folder: Path, output: Output) -> dict[str, Vehicle]:
    """Return the models in a folder by their names. Raises InputError where there is none, or one cannot be read."""
    from towtank.vehicle.configurations import Configurations

    if not folder.is_dir():
        raise InputError(f"--configurations {folder}: no such folder; towtank config save --folder {folder} makes one")
    found = Configurations(folder).all()
    if not found:
        output.warn(f"{folder}: holds no configuration yet; towtank config save puts one there")
    return {each.name: each.vehicle for each in found}


def read_logs(
    logs: Sequence[Path], mapping: Path | None, progress: Progress, merged: Sequence[Merged] = ()
) -> list[Recording]:
    """Return the recordings of some logs, all with one mapping; a velocity in the world is turned into the body.

    Args:
        merged: further files of the run of a single log.
    """
    from towtank.readers import read, recognised

    for log in (*logs, *(each.path for each in merged)):  # before anything that is slow to import
        recognised(log)
    from towtank.recording import load_mapping, with_body_velocity

    columns = None if mapping is None else load_mapping(mapping)
    recordings = []
    for k, log in enumerate(logs):
        progress(f"reading {log.name}", k / len(logs))
        recording = read(log, columns)
        recordings.append(with_body_velocity(merged_with(recording, merged)))
    return recordings


def merged_with(recording: Recording, merged: Sequence[Merged]) -> Recording:
    """Return a recording with the channels of further files of its run. Raises InputError."""
    from towtank.readers import read

    for each in merged:
        try:
            other = read(each.path, each.mapping)
        except InputError as error:
            raise InputError(str(error).replace("--map ", "--merge-map ")) from None
        recording = recording.merge(other, each.offset)
    return recording


def cut(recordings: Sequence[Recording], window: Window | None) -> list[Recording]:
    """Return the recordings, each cut to the window."""
    if window is None:
        return list(recordings)
    return [recording.window(*window.within(recording)) for recording in recordings]
