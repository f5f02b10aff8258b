"""What goes through the socket: numbers in binary frames, everything else as JSON; told in docs/design/page.md."""

from __future__ import annotations

import struct
from enum import IntEnum

import numpy as np

from towtank.core.arrays import Array

__all__ = ["HEADER", "VERSION", "Kind", "decode", "encode"]

VERSION = 1
HEADER = struct.Struct("<BBHIII")  # version, kind, columns, rows, sequence, nothing


class Kind(IntEnum):
    """What a frame holds."""

    SIGNALS = 1  # rows to append: the columns of "signals" in the greeting
    COEFFICIENTS = 2  # rows to append: values, then deviations, of "coefficients" in the greeting
    PREDICTION = 3  # rows to replace: u .. r measured, u .. r predicted
    TRACK = 4  # rows to append: x, y, z [m]


def encode(kind: Kind, t: Array, values: Array, sequence: int = 0) -> bytes:
    """Return a frame of times (n,) [s] and values (n, m): header, n Float64, then m columns of n Float32."""
    rows, columns = values.shape
    head = HEADER.pack(VERSION, kind, columns, rows, sequence & 0xFFFFFFFF, 0)
    return head + t.astype("<f8").tobytes() + np.ascontiguousarray(values.T, dtype="<f4").tobytes()


def decode(frame: bytes) -> tuple[Kind, int, Array, Array]:
    """Return kind, sequence, times (n,) and values (n, m) of a frame."""
    version, kind, columns, rows, sequence, _ = HEADER.unpack_from(frame)
    if version != VERSION or len(frame) != HEADER.size + 8 * rows + 4 * rows * columns:
        raise ValueError(f"not a frame: version {version}, {rows} rows, {columns} columns, {len(frame)} bytes")
    t = np.frombuffer(frame, "<f8", rows, HEADER.size)
    values = np.frombuffer(frame, "<f4", rows * columns, HEADER.size + 8 * rows).reshape(columns, rows).T
    return Kind(kind), sequence, t, values.astype(np.float64)
