"""`towtank plan`: what to drive so that the wanted coefficients become known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from towtank.app.commands.arguments import Json, output_place, positive_option
from towtank.app.terminal.completion import vehicles
from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.app.terminal.output import Output
    from towtank.planning import Plan

__all__ = ["plan"]

_LONGEST = 60.0  # minutes


def plan(
    vehicle: Annotated[
        str, typer.Argument(metavar="VEHICLE", autocompletion=vehicles, help="Catalog name, vehicle file or model.")
    ],
    space: Annotated[
        str | None,
        typer.Option("--space", metavar="LxWxH", help="Tank in metres, as 5x5x2.5; without it, open water."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--start", metavar="X,Y,Z", help="Where segments begin, from the middle of the surface, z down."),
    ] = None,
    sensors: Annotated[
        str, typer.Option("--sensors", metavar="NAME", help="What is measured: pose, dvl or gyro-depth.")
    ] = "pose",
    accuracy: Annotated[
        str, typer.Option("--accuracy", metavar="SHARE", help="Deviation that is asked for, as 5% or 0.05.")
    ] = "5%",
    want: Annotated[
        str | None,
        typer.Option("--want", metavar="NAME,...", help="Coefficients; default: the twelve on the diagonal."),
    ] = None,
    minutes: Annotated[
        float, typer.Option("--minutes", metavar="N", help="Most time of manoeuvring, pauses left out.")
    ] = 3.0,
    force: Annotated[
        float | None,
        typer.Option("--force", metavar="N", help="Random force that the water makes; default: as it usually is."),
    ] = None,
    by_hand: Annotated[
        bool, typer.Option("--by-hand", help="Segments that a pilot can drive: two axes at a time, not too quick.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="The same seed gives the same plan.")] = 0,
    output_file: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Plan to write, .toml.")
    ] = None,
    json: Json = False,
) -> None:
    """Plan what to drive: segments of some seconds, and how well each coefficient will be known after them.

    \b
    Example:
      towtank plan bluerov2_heavy --space 5x5x2.5 -o plan.toml
    """
    from towtank.app.files import read_vehicle
    from towtank.app.terminal.output import Output
    from towtank.planning import Space, write_plan
    from towtank.planning import plan as planned

    positive_option("--minutes", minutes)
    positive_option("--force", force, zero=True)
    if minutes > _LONGEST:
        raise InputError(f"--minutes: found {minutes:g}, expected at most {_LONGEST:g}")
    if seed < 0:
        raise InputError(f"--seed: found {seed}, expected 0 or more")
    if start is not None and space is None:
        raise InputError("--start: needs --space, whose middle it is counted from")
    if output_file is not None:
        output_place("--output", output_file, (".toml",))
    share = _share(accuracy)
    output = Output(json=json)
    found = read_vehicle(vehicle, output)
    tank = None if space is None else Space.from_text(space, start=start)
    with output.progress("planning") as progress:
        made = planned(
            found,
            space=tank,
            sensors=sensors,
            accuracy=share,
            want=[each.strip() for each in want.split(",")] if want else (),
            minutes=minutes,
            force=force,
            seed=seed,
            by_hand=by_hand,
            progress=progress,
        )
    if output_file is not None:
        write_plan(made, output_file)
    _show(made, vehicle, output_file, output)
    output.document(_document(made))


def _share(text: str) -> float:
    """Return a share of 5% or 0.05. Raises InputError."""
    try:
        value = float(text.strip().removesuffix("%")) / (100.0 if text.strip().endswith("%") else 1.0)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise InputError(f'--accuracy: found "{text}", expected a share such as 5% or 0.05')
    return value


def _show(made: Plan, vehicle: str, place: Path | None, output: Output) -> None:
    from towtank.planning import INSTRUMENTS

    where = "in open water"
    if made.space is not None:
        where = "in " + " x ".join(f"{each:g}" for each in made.space.size) + " m"
    output.line(f"{made.vehicle}, {INSTRUMENTS[made.sensors].summary}, {where}", "bold")
    many = len(made.segments)
    verdict = "all that is wanted will be known to" if made.met else "not all that is wanted will be known to"
    output.line(
        f"{many} segment{'' if many == 1 else 's'}, {made.manoeuvring:g} s of manoeuvring: {verdict}"
        f" {100.0 * made.accuracy:g} %"
    )
    segments = output.table("Segment", ">s", "Axes", "Moves off its start, m", ">Leaves", wrap="Axes")
    for k, each in enumerate(made.segments, 1):
        reached = " ".join(f"{value:.1f}" for value in each.reached)
        leaves = "-" if made.space is None else f"{100.0 * each.leaves:.0f} %"
        segments.add_row(f"{k} {each.segment.form}", f"{each.segment.duration:g}", each.segment.axes, reached, leaves)
    output.show(segments)
    table = output.table("Coefficient", ">Now", ">Then", ">Of nine vehicles in ten", "", wrap="")
    for known in made.expected:
        band = f"{100.0 * known.low:.1f} .. {100.0 * known.high:.1f} %"
        table.add_row(known.name, f"{100.0 * known.before:.0f} %", f"{100.0 * known.after:.1f} %", band, known.reason)
    output.show(table)
    output.line("Deviations; of an added mass that of the total inertia. Nobody can do better with these segments.")
    if made.space is not None and max(each.leaves for each in made.segments) > 0.0:
        output.line(
            "Leaves: how likely a segment ends at a wall if nobody steers. Bring the vehicle back between segments."
        )
    if place is not None:
        output.line(f"written to {place}")
        output.line()
        output.line(f"Next: towtank simulate {vehicle} {place} -o run.csv --sensors mocap", "dim")


def _document(made: Plan) -> dict[str, Any]:
    return {
        "vehicle": made.vehicle,
        "sensors": made.sensors,
        "space": None if made.space is None else list(made.space.size),
        "accuracy": made.accuracy,
        "met": made.met,
        "manoeuvring_s": made.manoeuvring,
        "segments": [
            {
                "form": each.segment.form,
                "duration_s": each.segment.duration,
                "axes": each.segment.axes,
                "reached_m": list(each.reached),
                "leaves": each.leaves,
            }
            for each in made.segments
        ],
        "expected": {
            each.name: {key: getattr(each, key) for key in ("before", "after", "low", "high", "reason")}
            for each in made.expected
        },
    }
