"""`towtank inspect`: what is in a log and what can be learned from it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from towtank.app.commands.arguments import (
    Json,
    KeepAll,
    Log,
    Map,
    Merge,
    Merged,
    MergeMap,
    WindowTexts,
    log_places,
    output_place,
)
from towtank.app.terminal.completion import vehicles
from towtank.errors import InputError

__all__ = ["inspect"]


def inspect(
    log: Log,
    mapping: Map = None,
    merge: Merge = None,
    merge_map: MergeMap = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            "--vehicle",
            metavar="VEHICLE",
            autocompletion=vehicles,
            help="Catalog name or vehicle file; with it, the result says how well each coefficient will be known.",
        ),
    ] = None,
    window: WindowTexts = None,
    keep_all: KeepAll = False,
    map_skeleton: Annotated[
        bool,
        typer.Option(
            "--map-skeleton",
            help="Write a first draft of a mapping for --map instead: every column or message of the log, with the "
            "channel that it may be.",
        ),
    ] = False,
    file: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="With --map-skeleton: the mapping file to write; without it the draft is printed.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Show what is in a log: messages, channels, clock problems, command delay, and which axes can be identified.

    Only stretches in which the vehicle moves freely in water are used. The others are listed with the reason.

    \b
    Examples:
      towtank inspect surge.csv --vehicle vlbv300
      towtank inspect surge.csv --map-skeleton -o map.toml
    """
    if map_skeleton:
        [place] = log_places([log], None)
        unused = {
            "--map": mapping,
            "--vehicle": vehicle,
            "--window": window,
            f"the window in {log.name}": place.windows,
            "--keep-all": keep_all,
            "--merge": merge,
            "--merge-map": merge_map,
        }
        _write_skeleton(place.path, file, [name for name, value in unused.items() if value], json=json)
        return
    if file is not None:
        raise InputError(f"--output {file}: only --map-skeleton writes a file; give it too, or leave --output out")
    from towtank.app.files import parts_of, read_logs, read_vehicle
    from towtank.app.terminal.output import Output

    places = log_places([log], window)
    [place] = places
    merged = Merged.parse(merge, merge_map, [place.path])
    output = Output(json=json)
    with output.progress("inspecting") as progress:
        read = read_logs([place.path], mapping, progress, merged)
        known = None if vehicle is None else read_vehicle(vehicle, output)
        from towtank.app.inspection import (
            inspect_recording,  # a second of libraries: a file that is none is refused first
        )

        [parts] = parts_of(places, read, known, keep_all=keep_all)
        found = inspect_recording(parts, known, progress)
    from towtank.app.tables.inspection import show_inspection

    show_inspection(found, output)
    output.document({**found.document(), "vehicle": None if known is None else known.name})


def _write_skeleton(log: Path, file: Path | None, unused: list[str], *, json: bool) -> None:
    """Write or print a mapping to fill in. Raises InputError."""
    if unused:
        raise InputError(
            f"--map-skeleton and {unused[0]}: found both; a skeleton is of one whole file, leave the other out"
        )
    output_place("--output", file, (".toml",))
    from towtank.app.terminal.output import Output
    from towtank.outputs import write_text
    from towtank.readers import recognised

    output = Output(json=json)
    with output.progress("reading"):
        recognised(log)  # a file that is none is refused before anything slow is imported
        from towtank.readers.common.skeleton import mapping_skeleton

        found = mapping_skeleton(log)
        if file is not None:
            write_text(file, found.text)
    if file is None:
        output.verbatim(found.text.rstrip())
    else:
        suggested = ", ".join((*found.suggested, *(["thrusters"] if found.thrusters else []))) or "nothing"
        output.line(f"mapping written to {file}: {len(found.columns)} columns, filled in: {suggested}")
        output.line(f"Next: check it, then towtank inspect {log} --map {file}", "dim")
    output.document(
        {
            "log": log,
            "file": file,
            "mapping": found.text,
            "suggested": found.suggested,
            "thrusters": found.thrusters,
            "columns": found.columns,
        }
    )
