"""Write a Recording as CSV: one row per distinct time, blank where not measured."""

from __future__ import annotations

import csv
import io
import os
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv

from towtank.outputs import write_atomically
from towtank.recording.recording import Recording

__all__ = ["to_table", "write_csv"]


def to_table(recording: Recording) -> pa.Table:
    """Return the Arrow table of a recording: `t`, then the channels, null where not measured."""
    stamps = {id(channel.t): channel.t for channel in recording.channels.values()}
    times = np.unique(np.concatenate(list(stamps.values()))) if len(stamps) > 1 else next(iter(stamps.values()))
    rows = {key: None if t.size == times.size else np.searchsorted(times, t) for key, t in stamps.items()}
    columns = [pa.array(times)]
    for channel in recording.channels.values():
        place = rows[id(channel.t)]
        if place is None:
            values = channel.values
        else:
            values = np.full(times.size, np.nan)
            values[place] = channel.values
        columns.append(pa.array(values, from_pandas=True))
    return pa.Table.from_arrays(columns, names=["t", *recording.names])


def write_csv(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write the channels to `path`; every number reads back as exactly the same float64.

    Units, frames, notes and attributes have no place in a CSV; Parquet keeps them.
    """
    table = to_table(recording)
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(table.column_names)

    def write(stream: BinaryIO) -> None:
        stream.write(header.getvalue().encode())
        arrow_csv.write_csv(table, stream, arrow_csv.WriteOptions(include_header=False))

    write_atomically(path, write)
