"""`towtank validate`: a model against logs."""

from __future__ import annotations

from collections.abc import Sequence
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
    positive_option,
    reachable_fit,
    report_place,
)
from towtank.app.terminal.completion import methods, vehicles
from towtank.errors import InputError

__all__ = ["validate"]


def validate(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL", autocompletion=vehicles, help="Vehicle file, as learn writes it, or catalog name."
        ),
    ],
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG", help=f"Log files that the model was not learned from ({LOG_KINDS}).")
    ],
    window: WindowTexts = None,
    keep_all: KeepAll = False,
    horizon: Annotated[
        float | None,
        typer.Option(
            "--horizon",
            metavar="S",
            help="Restart the prediction from the measured state every S seconds; default: never.",
        ),
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option(
            "--delay", metavar="S", help="Delay from command to thruster, in seconds; default: the model's own."
        ),
    ] = None,
    against: Annotated[
        list[str] | None,
        typer.Option(
            "--against",
            metavar="MODEL2",
            autocompletion=vehicles,
            help="Another model to compare with; may be repeated.",
        ),
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(
            "--folds",
            metavar="K",
            help="Cross-validate: cut the logs into K windows; for each window, learn MODEL's coefficients anew from "
            "the others and predict it.",
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="METHOD",
            autocompletion=methods,
            help="With --folds: the method to learn with, as for learn.",
        ),
    ] = None,
    mapping: Map = None,
    merge: Merge = None,
    merge_map: MergeMap = None,
    report: Report = None,
    require: Annotated[
        float | None,
        typer.Option(
            "--require",
            metavar="PCT",
            help="Exit with code 1 unless every axis that was driven and measured is predicted with at least this fit.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Predict logs from their commands alone and compare with what was measured.

    A fit of 100 % is perfect; 0 % is no better than the mean of the measurement. The result also says what the errors
    are: sensor noise, slow disturbances, or something that the model lacks.

    \b
    Examples:
      towtank validate learned.toml surge.csv --horizon 10
      towtank validate learned.toml surge.csv --against vlbv300
      towtank validate learned.toml surge.csv --folds 5
      towtank validate learned.toml surge.csv --require 30
    """
    positive_option("--horizon", horizon)
    positive_option("--delay", delay, zero=True)
    named, places = logs, log_places(logs, window)
    logs = [place.path for place in places]
    merged = Merged.parse(merge, merge_map, logs)
    reachable_fit("--require", require)
    models = _models(model, against or [])
    _folds_alone(folds, method, against)
    report_place(report)

    from towtank.app.files import counted, parts_of, read_logs, read_vehicle
    from towtank.app.judging import against_others, alone, by_folds, learn_by, with_wiring
    from towtank.app.results import Judgement
    from towtank.app.tables.free_motion import rate_warnings, show_left_out
    from towtank.app.terminal.output import Output
    from towtank.digits import short

    output = Output(json=json)
    with output.progress("predicting") as progress:
        read = read_logs(logs, mapping, progress, merged)
        vehicles = {name: read_vehicle(name, output) for name in models}
        parts = parts_of(places, read, vehicles[model], keep_all=keep_all)
        recordings = counted(parts)
        for text in rate_warnings(parts):
            output.warn(text)
        options = {"horizon": horizon, "delay": delay}
        if folds is not None:
            of_parts = [each.log for each in parts for _ in each.parts]
            judged = by_folds(vehicles[model], recordings, folds, learn_by(method, delay), of_parts, options, progress)
        elif len(vehicles) > 1:
            judged = against_others(vehicles, recordings, options, progress)
        else:
            judged = alone(vehicles[model], recordings, options, progress)
        judged = with_wiring(judged, vehicles[model], recordings)
        warnings = tuple(output.warnings)
        judgement = Judgement(model, vehicles[model], judged, tuple(parts), horizon, delay, warnings, require)
        if report is not None:
            progress("report", 0.95)
            again = {
                "--window": window,
                "--keep-all": keep_all,
                "--horizon": horizon,
                "--delay": delay,
                "--against": against,
                "--folds": folds,
                "--method": method,
                "--map": mapping,
                "--merge": merge,
                "--merge-map": merge_map,
                "--require": require,
            }
            judgement.report(report, [command_text("validate", [model, *named], again)])
    output.line(judgement.verdict, "bold")
    output.line()
    output.line(f"{model} on {', '.join(log.name for log in logs)}", "bold")
    restart = "" if horizon is None else f", restarted from the measured state every {short(horizon)} s"
    late = "" if delay is None else f", delay {1e3 * delay:.4g} ms"
    output.line(f"{short(judgement.window[0])} to {short(judgement.window[1])} s{restart}{late}")
    for each in judgement.merged:
        output.line(str(each["text"]))
    judged.show(output)
    show_left_out(parts, output)
    if report is not None:
        output.line()
        output.line(f"report written to {report}")
    output.document(judgement.document())
    if require is not None and judgement.lacking:
        output.warn(f"--require {short(require)}: {'; '.join(judgement.lacking)}")
        raise typer.Exit(1)


def _models(model: str, against: Sequence[str]) -> list[str]:
    """Return all models. Raises InputError where one is named twice."""
    models = [model, *against]
    for k, name in enumerate(models):
        if name in models[:k]:
            raise InputError(f'--against: found "{name}" twice, expected another model than those already named')
    return models


def _folds_alone(folds: int | None, method: str | None, against: Sequence[str] | None) -> None:
    """Raise InputError for options that do not go together."""
    if folds is None:
        if method is not None:
            raise InputError(f"--method {method}: only --folds learns anew; give --folds K too, or leave --method out")
        return
    if folds < 2:
        raise InputError(f"--folds: found {folds}, expected 2 windows or more")
    if against:
        raise InputError("--folds: cannot be combined with --against; run validate once for each model")
