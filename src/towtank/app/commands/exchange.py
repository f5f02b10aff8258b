"""Files of others: `towtank export` and `import`, models; `towtank convert`, logs."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from towtank.app.commands.arguments import LOG_KINDS, Json, Map, Merge, Merged, MergeMap, output_place
from towtank.app.terminal.completion import vehicles
from towtank.errors import InputError

__all__ = ["convert", "export", "import_"]


@contextmanager
def _uncollected() -> Iterator[None]:
    """Search for no cycles meanwhile: what is loaded stays, and searching it over and over is a tenth of an export."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


@_uncollected()
def export(
    model: Annotated[
        str | None,
        typer.Argument(metavar="MODEL", autocompletion=vehicles, help="Learned model, vehicle file or catalog name."),
    ] = None,
    to: Annotated[
        str | None, typer.Option("--to", metavar="TARGET", help="What to write it for; --list shows the targets.")
    ] = None,
    output_file: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="File to write, or folder for targets that write several; default: the vehicle's name in the working "
            "directory.",
        ),
    ] = None,
    target_version: Annotated[
        str | None, typer.Option("--target-version", metavar="V", help="Version of the target's format.")
    ] = None,
    at_speed: Annotated[
        float | None,
        typer.Option(
            "--at-speed",
            metavar="M/S",
            help="Speed ahead at which terms are taken that the target knows only as constant numbers.",
        ),
    ] = None,
    allow_unidentified: Annotated[
        bool,
        typer.Option(
            "--allow-unidentified",
            help="Export coefficients that the data did not narrow, too: with what was supposed before the data.",
        ),
    ] = False,
    engine: Annotated[
        str | None,
        typer.Option("--engine", metavar="NAME", help="gz-sim: the physics engine, dart (default), bullet or mujoco."),
    ] = None,
    with_ardupilot: Annotated[
        bool, typer.Option("--with-ardupilot", help="gz-sim: control channels for ArduPilot's SITL.")
    ] = False,
    in_float: Annotated[bool, typer.Option("--float", help="c: single precision.")] = False,
    list_targets: Annotated[bool, typer.Option("--list", help="Show the targets and what they write.")] = False,
    json: Json = False,
) -> None:
    """Write a model for a simulator, a controller or a program.

    Every file opens with a comment: where the model comes from, each coefficient with its deviation, what the target
    cannot say, and how large an error that makes.

    \b
    Example:
      towtank export bluerov2_heavy --to gz-sim -o my_rov
    """
    from towtank.app.tables.exports import export_document, show_export, show_targets, targets_document
    from towtank.app.terminal.output import Output

    output = Output(json=json)
    if list_targets:
        show_targets(output)
        output.document(targets_document())
        return
    if model is None or to is None:
        missing = "MODEL: missing; give a learned model or a vehicle" if model is None else "--to: missing"
        raise InputError(f"{missing}; towtank export --list shows the targets")
    import warnings

    from towtank.exporters import export as write
    from towtank.vehicle import VehicleWarning, faults

    options: dict[str, str | bool] = {"with-ardupilot": with_ardupilot, "float": in_float}
    if engine is not None:
        options["engine"] = engine
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VehicleWarning)  # said below
        done = write(
            model,
            to,
            output_file,
            target_version=target_version,
            at_speed=at_speed,
            allow_unidentified=allow_unidentified,
            options=options,
        )
    for fault in faults(done.vehicle):
        output.warn(f"{model}: {fault}")
    show_export(done, output)
    output.document(export_document(done))


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="SDF, URDF or xacro of a simulator.")],
    kind: Annotated[
        str, typer.Option("--from", metavar="KIND", help="gz-sim, uuv-simulator, urdf-hydrodynamics, or auto.")
    ] = "auto",
    output_file: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="Vehicle file to write; default: named after the vehicle."),
    ] = None,
    json: Json = False,
) -> None:
    """Make a vehicle file of a simulator's model: signs and frames undone, what is doubtful said.

    \b
    Example:
      towtank import model.sdf -o theirs.toml
    """
    from towtank.app.tables.exports import import_document, show_import
    from towtank.app.terminal.output import Output
    from towtank.exporters import import_vehicle
    from towtank.exporters.request import stem_of
    from towtank.vehicle import save_vehicle

    output = Output(json=json)
    found = import_vehicle(file, kind)
    place = Path(f"{stem_of(found.vehicle)}.toml") if output_file is None else output_file
    if place.suffix.lower() != ".toml":
        raise InputError(f'--output: found "{place}", expected a name that ends in .toml')
    if output_file is None and place.exists():
        raise InputError(f"{place}: is there already; name the file with --output, which is written over")
    save_vehicle(found.vehicle, place)
    show_import(found, place, output)
    output.document(import_document(found, place))


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
