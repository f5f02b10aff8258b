"""`towtank inspect`: what is in a log and what can be learned from it."""

from __future__ import annotations

from typing import Annotated

import typer

from towtank.app.commands.arguments import Json, KeepAll, Log, Map, WindowTexts, log_places

__all__ = ["inspect"]


def inspect(
    log: Log,
    mapping: Map = None,
    vehicle: Annotated[
        str | None,
        typer.Option("--vehicle", metavar="VEHICLE", help="Catalog name or vehicle file, for verdicts by coefficient."),
    ] = None,
    window: WindowTexts = None,
    keep_all: KeepAll = False,
    json: Json = False,
) -> None:
    """Show what is in a log: its messages and channels, clock trouble, command delay, which axes can be identified.

    That, from what shows the vehicle moving freely in water; what does not is listed with the reason.

    \b
    Example:
      towtank inspect surge.csv --vehicle vlbv300
    """
    from towtank.app.files import parts_of, read_logs, read_vehicle
    from towtank.app.terminal.output import Output

    places = log_places([log], window)
    [place] = places
    output = Output(json=json)
    with output.progress("inspecting") as progress:
        read = read_logs([place.path], mapping, progress)
        known = None if vehicle is None else read_vehicle(vehicle, output)
        from towtank.app.inspection import (
            inspect_recording,  # a second of libraries: a file that is none is refused first
        )

        [parts] = parts_of(places, read, known, keep_all=keep_all)
        found = inspect_recording(parts, known, progress)
    from towtank.app.tables.inspection import show_inspection

    show_inspection(found, output)
    output.document({**found.document(), "vehicle": None if known is None else known.name})
