"""`towtank live`: a model from what a vehicle is sending."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from towtank.app.commands.arguments import Json, KeepAll, Map, Report, output_place, positive_option, report_place
from towtank.app.terminal.completion import streaming_methods, vehicles
from towtank.app.terminal.keys import can_read_keys
from towtank.app.terminal.page_option import FoxgloveOption, PageOption, page_address
from towtank.errors import InputError, nearest
from towtank.methods import STREAMING_METHODS

__all__ = ["live"]


def live(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, /dev/NAME,BAUD (MAVLink); ros2:[DOMAIN], "
            "dds:[DOMAIN] (ROS 2); qtm:HOST[/BODY], natnet:HOST[/BODY] (motion capture); json:HOST:PORT, - (JSON lines "
            "over UDP, or on standard input); replay:FILE[@SPEED] (a log; @0: as fast as possible). "
            "Where several sources measure the same quantity, the one named first is used.",
        ),
    ],
    vehicle: Annotated[
        str,
        typer.Option(
            "--vehicle",
            metavar="VEHICLE",
            autocompletion=vehicles,
            help="Catalog name or vehicle file: the body, the thrusters, and what is assumed about the coefficients "
            "before any data. Given a file that learn wrote, learning continues from it.",
        ),
    ],
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="FILE.mcap",
            help="Record everything that is received. What was learned is saved beside it, in FILE.mcap.state.",
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Continue FILE.mcap and what was learned from it; if there is no such file, start it."
        ),
    ] = False,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="METHOD",
            autocompletion=streaming_methods,
            help='"joint": one Kalman filter estimates motion, disturbance and all coefficients together. "paper": '
            "least "
            "squares on filtered regressors, one axis after the other.",
        ),
    ] = "joint",
    seconds: Annotated[
        float | None, typer.Option("--for", metavar="S", help="Stop after this many seconds; default: at Ctrl-C.")
    ] = None,
    window: Annotated[
        float,
        typer.Option(
            "--window",
            metavar="S",
            help="Hold samples back for this time, so that late ones can be sorted in. Samples that are later still "
            "are recorded but not learned from.",
        ),
    ] = 0.1,
    free: Annotated[
        str | None,
        typer.Option(
            "--free",
            metavar="NAME,...",
            help="Learn only these coefficients, for example X_udot,X_uu, and the delay. All others stay at their "
            "prior values.",
        ),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            "--prior",
            metavar="VEHICLE",
            autocompletion=vehicles,
            help="Further prior knowledge: a vehicle file that learn wrote, that gives a std for coefficients, or "
            "that has a table [prior].",
        ),
    ] = None,
    no_changes: Annotated[
        bool, typer.Option("--no-changes", help="Do not watch for changes of the vehicle, such as a payload taken up.")
    ] = False,
    configurations: Annotated[
        Path | None,
        typer.Option(
            "--configurations",
            metavar="DIR",
            help="Folder of configurations (see towtank config): when the vehicle changes into one of them, it is "
            "recognised.",
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            "--plan",
            metavar="PLAN.toml",
            help="Lead the pilot through a plan that towtank plan wrote: what to drive now and next, with a "
            "count-down; after each segment the next is designed from what was really driven.",
        ),
    ] = None,
    drive: Annotated[
        bool,
        typer.Option(
            "--drive",
            help="Drive the plan, by the pilot's sticks over MAVLink (ArduSub in MANUAL mode): only while an operator "
            "has switched on and holds a key, on the page or (space) in the terminal. Tested against simulated "
            "vehicles only; read docs/driving.md first.",
        ),
    ] = False,
    drive_by: Annotated[
        str,
        typer.Option(
            "--drive-by",
            metavar="WAY",
            help='How sticks are sent: "manual" (MANUAL_CONTROL) or "rc" (RC_CHANNELS_OVERRIDE).',
        ),
    ] = "manual",
    drive_limit: Annotated[
        float,
        typer.Option("--drive-limit", metavar="PCT", help="Drive by at most this much of what the plan wants [%]."),
    ] = 100.0,
    mapping: Map = None,
    model_file: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="MODEL.toml",
            help="Vehicle file to write at the end; default: beside the recording, if there is one.",
        ),
    ] = None,
    report: Report = None,
    page: PageOption = None,
    foxglove: FoxgloveOption = None,
    keep_all: KeepAll = False,
    json: Json = False,
    json_lines: Annotated[
        bool,
        typer.Option(
            "--json-lines", help="Print one line of JSON per second, and the whole document as the last line."
        ),
    ] = False,
) -> None:
    """Learn from what a vehicle is sending, while it drives.

    The coefficients and their deviations are shown as they settle, with the state of each link. Only free motion in
    water is learned from; disarmed, at the surface, upside down or before the first command is recorded and reported.
    A payload taken up, lost ballast or a fouled thruster is detected, reported and learned. Ctrl-C stops the session,
    closes the recording and writes the model. The vehicle is never commanded, unless --drive asks for it.

    \b
    Examples:
      towtank live udpin:0.0.0.0:14550 --vehicle bluerov2_heavy --record dive.mcap -o mine.toml
      towtank live json:127.0.0.1:5005 udpin:0.0.0.0:14550 --vehicle mine.toml --map mocap.toml
      towtank live udpin:0.0.0.0:14550 --vehicle bluerov2_heavy --page
      towtank live udpin:0.0.0.0:14550 --vehicle bluerov2_heavy --plan plan.toml --page
      towtank live udpin:0.0.0.0:14550 --vehicle bluerov2_heavy --plan plan.toml --page --drive
      towtank live replay:dive.mcap@0 --vehicle bluerov2_heavy --json
    """
    if method not in STREAMING_METHODS:
        expected = ", ".join(f'"{name}"' for name in STREAMING_METHODS)
        raise InputError(f'--method: found "{method}", expected one of {expected}{nearest(method, STREAMING_METHODS)}')
    if json and json_lines:
        raise InputError("--json and --json-lines: found both, expected one of them")
    if resume and record is None:
        raise InputError("--resume: expected --record FILE.mcap, the recording to go on with")
    if no_changes and configurations is not None:
        raise InputError("--no-changes and --configurations: found both; configurations are recognised by changes")
    if len(set(sources)) < len(sources):
        raise InputError(f"SOURCE: found one of {', '.join(sources)} twice")
    if drive_by not in ("manual", "rc"):
        raise InputError(f'--drive-by: found "{drive_by}", expected "manual" or "rc"')
    if not 0.0 < drive_limit <= 100.0:
        raise InputError(f"--drive-limit: found {drive_limit:g}, expected more than 0 and at most 100")
    if drive and page is None and (json or json_lines or not can_read_keys()):
        raise InputError("--drive: expected --page, or a terminal: somebody must hold a key while it drives")
    positive_option("--for", seconds)
    positive_option("--window", window, zero=True)
    output_place("--output", model_file, (".toml",))
    output_place("--record", record, (".mcap",))
    report_place(report)
    page_address(page)

    from towtank.app.commands.learn import names_of
    from towtank.app.live.session import LiveOptions, run_live
    from towtank.app.terminal.output import Output

    options = LiveOptions(
        sources=tuple(sources),
        vehicle=vehicle,
        record=record,
        resume=resume,
        method=method,
        seconds=seconds,
        window=window,
        free=names_of(free),
        prior=prior,
        changes=not no_changes,
        configurations=configurations,
        plan=plan,
        drive=drive,
        drive_by=drive_by,
        drive_limit=drive_limit / 100.0,
        mapping=mapping,
        model_file=model_file,
        report=report,
        json_lines=json_lines,
        page=page,
        foxglove=foxglove,
        keep_all=keep_all,
    )
    run_live(options, Output(json=json or json_lines))
