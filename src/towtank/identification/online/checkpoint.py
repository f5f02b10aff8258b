"""A learner on disk: plain arrays in one `.npz` file, so that a session goes on where it was cut off.

Nothing in the file is executed when it is read. It belongs to one vehicle, whose numbers are checked, and to one
version of the learner's layout.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from towtank.errors import InputError
from towtank.outputs import write_atomically
from towtank.vehicle import Vehicle

__all__ = ["read_checkpoint", "write_checkpoint"]

_VERSION = 9

T = TypeVar("T")


def write_checkpoint(path: str | os.PathLike[str], method: str, vehicle: Vehicle, arrays: Mapping[str, Any]) -> None:
    """Write what a learner of a method hands out, whole or not at all. InputError: the folder cannot be written."""
    about = {"version": _VERSION, "method": method, "vehicle": vehicle.name}
    head = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)

    def write(file: BinaryIO) -> None:
        np.savez(file, about=head, parameters=np.array(vehicle.parameters), **arrays)

    write_atomically(path, write)


def read_checkpoint(
    path: str | os.PathLike[str], vehicle: Vehicle, restored: Callable[[str, Mapping[str, Any]], T]
) -> T:
    """Return what `restored` makes of the method and the arrays in a file.

    Raises:
        InputError: the file is missing, damaged, of another version, or of another vehicle.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(arrays["about"].tobytes())
        if about["version"] != _VERSION:
            raise InputError(f"{path}: found a checkpoint of version {about['version']}, expected {_VERSION}")
        if not np.array_equal(arrays["parameters"], np.array(vehicle.parameters)):
            raise InputError(
                f'{path}: this checkpoint was made with other numbers of the vehicle "{about["vehicle"]}"; give the '
                "vehicle file that the session began with"
            )
        return restored(about["method"], arrays)
    except FileNotFoundError:
        raise InputError(f"{path}: no such checkpoint") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a checkpoint, or a damaged one ({error})") from error
