"""`towtank convert`: a log of any kind as a file of channels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from towtank.app.commands.arguments import LOG_KINDS, Json, Map, Merge, Merged, MergeMap, output_place
from towtank.errors import InputError

__all__ = ["convert"]


def convert(
    source: Annotated[
        Path, typer.Argument(metavar="IN", help=f"Log to read ({LOG_KINDS}) or the folder of a ROS 2 bag.")
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write: .csv, .parquet or .mcap.")],
    mapping: Map = None,
    merge: Merge = None,
    merge_map: MergeMap = None,
    json: Json = False,
) -> None:
    """Write the channels of a log as CSV, Parquet or MCAP: SI units, NED and FRD, each channel at its own times.

    \b
    Example:
      towtank convert surge.csv surge.parquet
    """
    merged = Merged.parse(merge, merge_map, [source])
    from towtank.app.files import merged_with
    from towtank.app.tables.repairs import contents_document
    from towtank.app.terminal.output import Output
    from towtank.digits import short
    from towtank.readers import read
    from towtank.recording.tables.writing import WRITABLE

    output_place("OUT", target, WRITABLE)
    if target.exists() and source.exists() and target.samefile(source):
        raise InputError(f"{target}: this is the log itself, expected another name; a log is never written over")
    output = Output(json=json)
    with output.progress("converting") as progress:
        progress(f"reading {source.name}", 0.0)
        recording = merged_with(read(source, mapping), merged)
        progress(f"writing {target.name}", 0.5)
        recording.write(target)
    output.line(f"{source} -> {target}", "bold")
    what = "channel" if len(recording) == 1 else "channels"
    samples = sum(len(channel) for channel in recording.channels.values())
    output.line(
        f"{short(recording.duration, 5)} s, {len(recording)} {what}, {samples} samples: {', '.join(recording.names)}"
    )
    for line in (*recording.repairs.lines, *recording.notes):
        output.item(line)
    output.document(
        {
            "from": str(source),
            "to": str(target),
            "duration_s": recording.duration,
            "channels": {name: len(channel) for name, channel in recording.channels.items()},
            "repairs": {"lines": recording.repairs.lines},
            "notes": recording.notes,
            "attributes": recording.attributes,
            "contents": contents_document(recording),
        }
    )
