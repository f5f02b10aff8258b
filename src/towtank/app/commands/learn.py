"""`towtank learn`: a model from logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from towtank.app.commands.arguments import (
    LOG_KINDS,
    Json,
    KeepAll,
    Map,
    Merge,
    Merged,
    MergeMap,
    Report,
    WindowTexts,
    command_text,
    log_places,
    output_place,
    positive_option,
    report_place,
)
from towtank.app.terminal.completion import methods, vehicles
from towtank.errors import InputError, nearest
from towtank.methods import METHODS

__all__ = ["learn", "names_of"]


def learn(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG", help=f"Log files ({LOG_KINDS}). LOG@START,END uses a part of one.")
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
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="METHOD",
            autocompletion=methods,
            help='"joint": one Kalman filter estimates motion, disturbance and all unknowns together, starting from '
            "the "
            'prior; free-running simulations replace it where they predict better. "output-error": always free-running '
            'simulations. "paper": least squares on filtered regressors, one axis after the other.',
        ),
    ] = "joint",
    free: Annotated[
        str | None,
        typer.Option(
            "--free",
            metavar="NAME,...",
            help="Learn only these coefficients, for example X_udot,X_uu, and the delay. All others stay at their "
            "prior values.",
        ),
    ] = None,
    window: WindowTexts = None,
    keep_all: KeepAll = False,
    mapping: Map = None,
    merge: Merge = None,
    merge_map: MergeMap = None,
    model_file: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="MODEL.toml", help="Vehicle file to write.")
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option(
            "--delay", metavar="S", help="Delay from command to thruster, in seconds; default: estimated from the logs."
        ),
    ] = None,
    report: Report = None,
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
    current: Annotated[
        bool,
        typer.Option(
            "--current",
            help="Has no effect any more: the water current is always estimated where heading and either position or "
            "speed over ground are measured.",
        ),
    ] = False,
    allow_empty: Annotated[
        bool,
        typer.Option(
            "--allow-empty",
            help="Write the model even if nothing was learned; without this option the exit code is then 1.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Learn a model from one or several logs.

    Every plausible coefficient is learned, starting from a prior (see towtank vehicle prior). The result gives each
    coefficient with its standard deviation and 95 % interval. Where the logs say little about one, it gives the reason.
    Stretches in which the vehicle is disarmed, on deck, at the surface or without commands are left out and listed.

    \b
    Examples:
      towtank learn surge.csv --vehicle vlbv300 --report learned.html
      towtank learn surge.csv --vehicle mine.toml -o both.toml
      towtank learn surge.csv@2,12@15,28 --vehicle vlbv300
    """
    _known_method(method, prior)
    if current and method != "joint":
        raise InputError(f"--current: method {method} knows none; use joint, or leave it out")
    named, places = logs, log_places(logs, window)
    logs = [place.path for place in places]
    merged = Merged.parse(merge, merge_map, logs)
    output_place("--output", model_file, (".toml",))
    report_place(report)
    positive_option("--delay", delay, zero=True)
    wanted = names_of(free)

    from towtank.app.files import counted, naming_logs, parts_of, read_logs, read_prior, read_vehicle
    from towtank.app.results import LearnedModel
    from towtank.app.tables.free_motion import rate_warnings, show_left_out
    from towtank.app.tables.learning import show_learning
    from towtank.app.tables.repairs import learning_warnings
    from towtank.app.terminal.output import Output
    from towtank.identification.logs import learn_recordings

    output = Output(json=json)
    with output.progress("learning") as progress:
        known = read_vehicle(vehicle, output)
        beforehand = None if prior is None else read_prior(prior, output)
        parts = parts_of(places, read_logs(logs, mapping, progress, merged), known, keep_all=keep_all)
        recordings = counted(parts)
        with output.telling_compilation(), naming_logs(parts):
            learning = learn_recordings(
                known,
                recordings,
                method=method,
                free=wanted,
                delay=delay,
                prior=beforehand,
                progress=lambda text, share: progress(text, 0.9 * share),
            )
        warnings = [*output.warnings, *rate_warnings(parts), *learning_warnings(learning, recordings)]
        if report is None:
            recordings = []  # room for the prediction
        progress("predicting", 0.9)
        learned = LearnedModel.of(learning, parts, recordings, warnings, prior)
        empty = not any(learning.estimate.identified)
        if model_file is not None and (allow_empty or not empty):
            learned.save(model_file)
        judge = f"towtank validate {model_file or 'MODEL.toml'} ANOTHER_LOG" + (f" --map {mapping}" if mapping else "")
        if report is not None:
            progress("report", 0.95)
            again = {
                "--vehicle": vehicle,
                "--method": None if method == "joint" else method,
                "--free": free,
                "--window": window,
                "--keep-all": keep_all,
                "--map": mapping,
                "--merge": merge,
                "--merge-map": merge_map,
                "--delay": delay,
                "--prior": prior,
                "--current": current,
                "--allow-empty": allow_empty,
                "-o": model_file,
            }
            learned.report(report, [command_text("learn", named, again), judge])
    show_learning(
        *(learning, learned.fit, learned.use, logs, learned.warnings, output),
        asked=method,
        prior=prior,
        known=learned.known_by,
    )
    show_left_out(parts, output)
    output.line()
    if model_file is not None and empty and not allow_empty:
        output.warn(f"{model_file} is not written: nothing was learned (--allow-empty writes it all the same)")
    elif model_file is not None:
        output.line(f"model written to {model_file}")
    if report is not None:
        output.line(f"report written to {report}")
    if allow_empty or not empty:
        output.line(f"Next: {judge}" if model_file else f"Next: the same with -o MODEL.toml, then {judge}", "dim")
    output.document(learned.document())
    if model_file is not None and empty and not allow_empty:
        raise typer.Exit(1)


def _known_method(method: str, prior: str | None) -> None:
    """Raise InputError for a method that is not there, or one that takes no prior."""
    if method not in METHODS:
        expected = ", ".join(f'"{name}"' for name in METHODS)
        raise InputError(f'--method: found "{method}", expected one of {expected}{nearest(method, METHODS)}')
    if method == "paper" and prior is not None:
        raise InputError(f"--prior {prior}: the method paper takes none; use joint or output-error, or leave it out")


def names_of(text: str | None, option: str = "--free") -> tuple[str, ...] | None:
    """Return the names in the text of an option. Raises InputError where it holds none."""
    if text is None:
        return None
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise InputError(f'{option}: found "{text}", expected names of coefficients, as X_udot,X_uu')
    return names
