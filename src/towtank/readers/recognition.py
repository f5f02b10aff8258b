"""What a file is, by its first bytes. Nothing here imports the library that will read it."""

from __future__ import annotations

import re
from itertools import pairwise

__all__ = [
    "FOLDER",
    "HEAD",
    "foreign_kind",
    "is_dataflash",
    "is_dataflash_text",
    "is_matlab",
    "is_mcap",
    "is_parquet",
    "is_rosbag",
    "is_text",
    "is_tlog",
]

HEAD = 1 << 16  # bytes of a file that are looked at
FOLDER = "/"  # stands for the suffix of a folder; its head is its metadata.yaml
_FOREIGN = {
    b"\x1f\x8b": "gzip; unpack it first",
    b"PK\x03\x04": "a zip archive or a spreadsheet; unpack it or save it as CSV",
    b"(\xb5/\xfd": "zstd; unpack it first",
    b"BZh": "bzip2; unpack it first",
    b"\xfd7zXZ\0": "xz; unpack it first",
    b"ULog\x01\x12\x35": "a PX4 ULog; convert it to CSV",
}
_FORMAT_RECORD = re.compile(rb"\xa3\x95\x80")
_FORMAT_LINE = re.compile(rb"^FMT, *\d+, *\d+, *\w+,", re.MULTILINE)
_MAVLINK_1, _MAVLINK_2 = 0xFE, 0xFD
_STAMP = 8  # bytes before each packet of a tlog
_LATEST = 4_102_444_800_000_000  # us, the year 2100
_NEIGHBOURS = 3_600_000_000  # us between packets that follow one another
_LINKED = 3  # packets in a row that make a tlog


def is_parquet(head: bytes, suffix: str) -> bool:
    """Parquet."""
    return head.startswith(b"PAR1")


def is_mcap(head: bytes, suffix: str) -> bool:
    """MCAP, written by anyone."""
    return head.startswith(b"\x89MCAP")


def is_rosbag(head: bytes, suffix: str) -> bool:
    """ROS 1 bag, ROS 2 SQLite file, or the folder of a ROS 2 bag."""
    if suffix == FOLDER:
        return b"rosbag2_bagfile_information" in head
    return head.startswith((b"#ROSBAG V", b"SQLite format 3\0"))


def is_matlab(head: bytes, suffix: str) -> bool:
    """MATLAB 5 to 7.3; version 4 has no mark and is known by its suffix."""
    return head.startswith((b"MATLAB 5.0 MAT", b"MATLAB 7.3 MAT", b"\x89HDF\r\n\x1a\n"))


def is_dataflash(head: bytes, suffix: str) -> bool:
    """ArduPilot DataFlash: binary, whole or cut at its beginning, or text."""
    return head.startswith(b"\xa3\x95") or len(_FORMAT_RECORD.findall(head)) >= _LINKED or is_dataflash_text(head)


def is_dataflash_text(head: bytes) -> bool:
    """ArduPilot DataFlash that was turned into text; some of its bytes may be broken."""
    return len(_FORMAT_LINE.findall(head)) > len(_FORMAT_RECORD.findall(head))


def is_tlog(head: bytes, suffix: str) -> bool:
    """MAVLink telemetry log: packets in a row, each behind a stamp of 8 bytes; a beginning may be broken."""
    starts = [at for at in range(_STAMP, min(len(head), 4096)) if head[at] in (_MAVLINK_1, _MAVLINK_2)]
    return any(_chain(head, at) for at in starts)


def _chain(head: bytes, at: int) -> bool:
    stamps: list[int] = []
    while len(stamps) < _LINKED:
        if at + 3 > len(head) or head[at] not in (_MAVLINK_1, _MAVLINK_2):
            return False
        stamps.append(int.from_bytes(head[at - _STAMP : at], "big"))
        signed = head[at] == _MAVLINK_2 and head[at + 2] & 1
        at += _STAMP + head[at + 1] + (8 if head[at] == _MAVLINK_1 else 12) + (13 if signed else 0)
    return 0 < stamps[0] < _LATEST and all(abs(later - stamp) < _NEIGHBOURS for stamp, later in pairwise(stamps))


def is_text(head: bytes) -> bool:
    """Whether the bytes are text in UTF-8, as a table is."""
    if b"\0" in head:
        return False
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        return error.start >= len(head) - 3 and len(head) == HEAD  # a character cut at the end of the head
    return True


def foreign_kind(head: bytes) -> str | None:
    """Return what a file is that no reader takes, where it can be told."""
    return next((kind for mark, kind in _FOREIGN.items() if head.startswith(mark)), None)
