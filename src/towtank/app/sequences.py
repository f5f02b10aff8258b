"""Commands over time as a file that another program plays: a table, MCAP, or a ROS 2 bag."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from towtank.errors import InputError
from towtank.recording import Recording
from towtank.recording.standard import COMMAND_PREFIX
from towtank.vehicle import Vehicle

__all__ = ["TOPIC", "sequence_place", "write_sequence"]

TOPIC = "/towtank/commands"
_TYPE = "std_msgs/msg/Float64MultiArray"
_VERSION: Final = 8  # of bags: what Iron and later write, and Humble reads
_SUFFIXES = (".csv", ".parquet", ".mcap")


def sequence_place(path: Path) -> Path:
    """Return the place of a sequence. Raises InputError, before any work is done, if it cannot be written there."""
    if path.suffix.lower() not in ("", *_SUFFIXES):
        raise InputError(
            f'--sequence: found "{path}", expected a name that ends in {", ".join(_SUFFIXES)}, or one without a suffix '
            "for the folder of a ROS 2 bag"
        )
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first or choose another place")
    if path.suffix and path.is_dir():
        raise InputError(f"{path}: this is a folder, expected the name of a file to write")
    if not path.suffix and path.exists() and not (path / "metadata.yaml").is_file():
        raise InputError(f"{path}: is there and is no ROS 2 bag; remove it or choose another place")
    return path


def write_sequence(sequence: Recording, vehicle: Vehicle, path: Path) -> None:
    """Write the commands of a sequence, whole or not at all: by the suffix, without one as the folder of a ROS 2 bag.

    The bag has one message for each instant, a `std_msgs/Float64MultiArray` with a number for each thruster in the
    order of the vehicle file, whose names stand in the label of its dimension: every ROS 2 knows the type, and all
    thrusters change at one time. Times begin at 0.
    """
    if path.suffix:
        sequence.write(path)
        return
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        made = Path(folder) / path.name
        _write_bag(sequence, vehicle, made)
        if path.exists():
            shutil.rmtree(path)
        made.rename(path)


def _write_bag(sequence: Recording, vehicle: Vehicle, path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    names = [thruster.name for thruster in vehicle.thrusters]
    channels = [sequence[f"{COMMAND_PREFIX}{name}"] for name in names]
    values = np.column_stack([each.values for each in channels])
    dimension = kinds["std_msgs/msg/MultiArrayDimension"](", ".join(names), len(names), len(names))
    layout = kinds["std_msgs/msg/MultiArrayLayout"]([dimension], 0)
    with Writer(path, version=_VERSION, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection(TOPIC, _TYPE, typestore=store)
        for t, row in zip(channels[0].t, values, strict=True):
            message = kinds[_TYPE](layout, np.ascontiguousarray(row))
            writer.write(connection, round(float(t) * 1e9), store.serialize_cdr(message, _TYPE))
