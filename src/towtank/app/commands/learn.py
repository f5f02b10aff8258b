"""`towtank learn`: a model from logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from towtank.app.commands.arguments import (
    LOG_KINDS,
    Json,
    Map,
    Report,
    Window,
    WindowText,
    command_text,
    output_place,
    positive_option,
    report_place,
)
from towtank.errors import InputError, nearest
from towtank.methods import METHODS

if TYPE_CHECKING:
    from towtank.identification import LogLearning
    from towtank.recording import Grid
    from towtank.validation import Validation
    from towtank.vehicle import Vehicle

__all__ = ["learn", "names_of"]


def learn(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG", help=f"Log files ({LOG_KINDS}).")],
    vehicle: Annotated[
        str,
        typer.Option(
            "--vehicle",
            metavar="VEHICLE",
            help="Catalog name or file: body, thrusters, and what is supposed of coefficients. From a file that was "
            "learned, learning goes on.",
        ),
    ],
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="METHOD",
            help='"joint": one Kalman filter over motion, disturbance and all that is unknown, from what is supposed '
            'before; free runs speak where they predict better. "output-error": free runs in any case. "paper": least '
            "squares on filtered regressors, one axis after the other.",
        ),
    ] = "joint",
    free: Annotated[
        str | None,
        typer.Option(
            "--free",
            metavar="NAME,...",
            help="Learn only these, as X_udot,X_uu, and the delay; all others are fixed at what is supposed of them.",
        ),
    ] = None,
    window: WindowText = None,
    mapping: Map = None,
    model_file: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="MODEL.toml", help="Vehicle file to write.")
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option(
            "--delay", metavar="S", help="From command to thruster, in seconds; default: found from the logs."
        ),
    ] = None,
    report: Report = None,
    prior: Annotated[
        str | None,
        typer.Option(
            "--prior",
            metavar="VEHICLE",
            help="What is known beforehand: a vehicle that was learned, with a std on coefficients, or with [prior].",
        ),
    ] = None,
    current: Annotated[
        bool,
        typer.Option(
            "--current",
            help="Without effect: the current of the water is estimated wherever heading and position or speed over "
            "ground are measured.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Learn a model from one or several logs.

    Every plausible coefficient is learned, from what is supposed of it (towtank vehicle prior). Each comes with its
    standard deviation and the interval that holds it in 95 of 100 cases; what these logs hardly tell, with the reason.

    \b
    Examples:
      towtank learn surge.csv --vehicle vlbv300 --report learned.html
      towtank learn surge.csv --vehicle mine.toml -o both.toml
    """
    _known_method(method, prior)
    if current and method != "joint":
        raise InputError(f"--current: method {method} knows none; use joint, or leave it out")
    stretch = Window.parse(window)
    output_place("--output", model_file, (".toml",))
    report_place(report)
    positive_option("--delay", delay, zero=True)
    wanted = names_of(free)

    from towtank.app.files import cut, read_logs, read_prior, read_vehicle
    from towtank.app.reports import learn_facts, write_learn_report
    from towtank.app.tables.learning import learn_document, show_learning
    from towtank.app.tables.repairs import learning_warnings
    from towtank.app.terminal.output import Output
    from towtank.identification.logs import learn_recordings
    from towtank.vehicle import save_vehicle

    output = Output(json=json)
    with output.progress("learning") as progress:
        known = read_vehicle(vehicle, output)
        beforehand = None if prior is None else read_prior(prior, output)
        recordings = cut(read_logs(logs, mapping, progress), stretch)
        with output.telling_compilation():
            learning = learn_recordings(
                known,
                recordings,
                method=method,
                free=wanted,
                delay=delay,
                prior=beforehand,
                current=current,
                progress=lambda text, share: progress(text, 0.9 * share),
            )
        model = _with_provenance(learning, logs, prior)
        warnings = [*output.warnings, *learning_warnings(learning, recordings)]
        if report is None:
            recordings = []  # room for the prediction
        progress("predicting", 0.9)
        scores, unfit = _fit(model, learning.grids)
        fit, rmse = ({}, {}) if scores is None else (scores.fit, scores.rmse)
        warnings += unfit
        if model_file is not None:
            save_vehicle(model, model_file)
        judge = f"towtank validate {model_file or 'MODEL.toml'} ANOTHER_LOG" + (f" --map {mapping}" if mapping else "")
        if report is not None:
            progress("report", 0.95)
            again = {
                "--vehicle": vehicle,
                "--method": None if method == "joint" else method,
                "--free": free,
                "--window": window,
                "--map": mapping,
                "--delay": delay,
                "--prior": prior,
                "--current": current,
                "-o": model_file,
            }
            commands = [command_text("learn", logs, again), judge]
            facts = learn_facts(learning, model, scores, recordings, warnings=warnings, prior=prior)
            write_learn_report(report, facts, logs, commands)
    show_learning(learning, fit, logs, warnings, output, asked=method, prior=prior)
    output.line()
    if model_file is not None:
        output.line(f"model written to {model_file}")
    if report is not None:
        output.line(f"report written to {report}")
    output.line(f"Next: {judge}" if model_file else f"Next: the same with -o MODEL.toml, then {judge}", "dim")
    output.document(
        {"vehicle": known.name, "logs": logs, "prior": prior, **learn_document(learning, fit, warnings, rmse)}
    )


def _fit(model: Vehicle, grids: Sequence[Grid]) -> tuple[Validation | None, list[str]]:
    """Return how the model predicts the logs; where they do not allow a prediction, a warning instead."""
    from towtank.validation import predict, score

    try:
        return score([predict(model, grid) for grid in grids]), []
    except InputError as error:
        return None, [f"no fit: {error}"]


def _known_method(method: str, prior: str | None) -> None:
    """Raise InputError for a method that is not there, or one that takes no prior."""
    if method not in METHODS:
        expected = ", ".join(f'"{name}"' for name in METHODS)
        raise InputError(f'--method: found "{method}", expected one of {expected}{nearest(method, METHODS)}')
    if method == "paper" and prior is not None:
        raise InputError(f"--prior {prior}: the method paper takes none; use joint or output-error, or leave it out")


def names_of(text: str | None) -> tuple[str, ...] | None:
    """Return the names in the text of --free. Raises InputError where it holds none."""
    if text is None:
        return None
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise InputError(f'--free: found "{text}", expected names of coefficients, as X_udot,X_uu')
    return names


def _with_provenance(learning: LogLearning, logs: list[Path], prior: str | None) -> Vehicle:
    """Return the model with the names of the logs it was learned from."""
    from towtank.vehicle import Provenance

    names = ", ".join(log.name for log in logs)
    how = f"method {learning.method}, delay {1e3 * learning.delay:.3g} ms"
    beside = "" if prior is None else f", prior {Path(prior).name}"
    note = f"learned from {names} ({learning.estimate.duration:.5g} s), {how}{beside}"
    kept = learning.model.provenance
    return learning.model.model_copy(update={"provenance": Provenance(source=kept.source, notes=(*kept.notes, note))})
