"""ROS 1 bags, and ROS 2 bags in SQLite files and in folders."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from towtank.readers.common.tables import Tables
from towtank.readers.ros.bag1 import scan_rosbag1
from towtank.readers.ros.bag2 import scan_rosbag2
from towtank.readers.ros.meaning import LISTED
from towtank.readers.ros.tables import RosLog, is_wanted, ros_recording, ros_tables
from towtank.recording.mapping import ColumnMapping, load_mapping
from towtank.recording.recording import Recording

__all__ = ["read", "tables_of"]


def read(path: Path, mapping: ColumnMapping | str | os.PathLike[str] | None = None) -> Recording:
    """Read a bag.

    Args:
        path: a .bag of ROS 1, a .db3 of ROS 2, or the folder of a bag of ROS 2.
        mapping: "TOPIC.field" columns; without it what the messages mean is taken.

    Raises:
        InputError: the file is no bag, or nothing in it can be used.
    """
    known = mapping if isinstance(mapping, ColumnMapping) or mapping is None else load_mapping(mapping)
    return ros_recording(_log(path, lambda name, kind: is_wanted(name, kind, known)), known)


def tables_of(path: Path) -> Tables:
    """Return all tables of a bag, as a mapping finds them."""
    return _log(path, lambda name, kind: kind not in LISTED).tables


def _log(path: Path, wanted: Callable[[str, str], bool]) -> RosLog:
    scan = scan_rosbag1 if path.is_file() and _starts(path, b"#ROSBAG") else scan_rosbag2
    topics, repairs = scan(path, wanted)
    return ros_tables(str(path), topics, repairs)


def _starts(path: Path, mark: bytes) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(mark)) == mark
