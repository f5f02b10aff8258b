"""`towtank inspect`: what is in a log and what can be learned from it."""

from __future__ import annotations

from typing import Annotated

import typer

from towtank.app.commands.arguments import Json, Log, Map, Merge, Merged, MergeMap, Window, WindowText

__all__ = ["inspect"]


def inspect(
    log: Log,
    mapping: Map = None,
    merge: Merge = None,
    merge_map: MergeMap = None,
    vehicle: Annotated[
        str | None,
        typer.Option("--vehicle", metavar="VEHICLE", help="Catalog name or vehicle file, for verdicts by coefficient."),
    ] = None,
    window: WindowText = None,
    json: Json = False,
) -> None:
    """Show what is in a log: its messages and channels, clock trouble, command delay, which axes can be identified.

    \b
    Example:
      towtank inspect surge.csv --vehicle vlbv300
    """
    from towtank.app.files import cut, read_logs, read_vehicle
    from towtank.app.terminal.output import Output

    stretch, merged = Window.parse(window), Merged.parse(merge, merge_map, [log])
    output = Output(json=json)
    with output.progress("inspecting") as progress:
        [recording] = cut(read_logs([log], mapping, progress, merged), stretch)
        known = None if vehicle is None else read_vehicle(vehicle, output)
        from towtank.app.inspection import (
            inspect_recording,  # a second of libraries: a file that is none is refused first
        )

        found = inspect_recording(str(log), recording, known, progress)
    from towtank.app.tables.inspection import show_inspection

    show_inspection(found, output)
    output.document({**found.document(), "vehicle": None if known is None else known.name})
