"""`towtank plan`: what to drive so that the wanted coefficients become known."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from towtank.app.commands.arguments import Json, Report, command_text, output_place, positive_option, report_place
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
    no_pose: Annotated[
        bool,
        typer.Option(
            "--no-pose",
            help="Nobody knows where it is while it is driven: short, gentle segments, pauses to bring it back.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="The same seed gives the same plan.")] = 0,
    output_file: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Plan to write, .toml.")
    ] = None,
    sequence: Annotated[
        Path | None,
        typer.Option(
            "--sequence",
            metavar="FILE",
            help="The commands over time to write: .csv, .parquet or .mcap; a name without a suffix is the folder of a "
            "ROS 2 bag.",
        ),
    ] = None,
    report: Report = None,
    json: Json = False,
) -> None:
    """Plan what to drive: segments of some seconds, and how well each coefficient will be known after them.

    \b
    Example:
      towtank plan bluerov2_heavy --space 5x5x2.5 -o plan.toml --report plan.html
    """
    from towtank.app.files import read_vehicle
    from towtank.app.reports import plan_facts, write_plan_report
    from towtank.app.sequences import sequence_place, write_sequence
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
    if sequence is not None:
        sequence_place(sequence)
    report_place(report)
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
            pose=not no_pose,
            progress=progress,
        )
        if output_file is not None:
            write_plan(made, output_file)
        if sequence is not None:
            write_sequence(made.sequence(found), found, sequence)
        if report is not None:
            progress("report", 0.98)
            again = {
                "--space": space,
                "--start": start,
                "--sensors": sensors,
                "--accuracy": accuracy,
                "--want": want,
                "--minutes": minutes,
                "--force": force,
                "--by-hand": by_hand,
                "--no-pose": no_pose,
                "--seed": seed,
                "-o": output_file,
            }
            write_plan_report(report, plan_facts(made, found, force), [command_text("plan", [vehicle], again)])
    _show(made, output)
    for place in (output_file, sequence, report):
        if place is not None:
            output.line(f"{'report ' if place is report else ''}written to {place}")
    if output_file is not None:
        output.line()
        output.line(f"Next: {_next(made, vehicle, output_file)}", "dim")
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


def _next(made: Plan, vehicle: str, place: Path) -> str:
    if made.by_hand:
        return f"towtank live SOURCE --vehicle {vehicle} --plan {place} --page"
    return f"towtank simulate {vehicle} {place} -o run.csv --sensors mocap"


def _show(made: Plan, output: Output) -> None:
    from towtank.planning import INSTRUMENTS
    from towtank.report.verdict import plan_notes, plan_verdict

    where = "in open water"
    if made.space is not None:
        where = "in " + " x ".join(f"{each:g}" for each in made.space.size) + " m"
    output.line(f"{made.vehicle}, {INSTRUMENTS[made.sensors].summary}, {where}", "bold")
    output.line(plan_verdict(made).text)
    for note in plan_notes(made):
        output.line(f"- {note}")
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
    if made.space is not None and made.leaves > 0.0:
        many = "" if len(made.segments) == 1 else f"; {100.0 * made.leaves:.0f} % that one of them does"
        output.line(f"Leaves: how likely a segment ends at a wall if nobody steers{many}.")
    if len(made.segments) > 1:
        output.line(f"Between segments: {made.pause:g} s to bring the vehicle back, level and at rest.")


def _document(made: Plan) -> dict[str, Any]:
    from towtank.report.verdict import plan_notes

    return {
        "vehicle": made.vehicle,
        "sensors": made.sensors,
        "space": None if made.space is None else list(made.space.size),
        "accuracy": made.accuracy,
        "met": made.met,
        "manoeuvring_s": made.manoeuvring,
        "pose": made.pose,
        "pause_s": made.pause,
        "leaves": made.leaves,
        "room_m": None if made.room is None or not math.isfinite(max(made.room)) else list(made.room),
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
            each.name: {
                **{key: getattr(each, key) for key in ("before", "after", "low", "high", "reason")},
                "needs_s": each.needs if math.isfinite(each.needs) else None,
            }
            for each in made.expected
        },
        "missing": plan_notes(made),
    }
