"""`towtank validate`: a model against logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from towtank.app.commands.arguments import (
    LOG_KINDS,
    Json,
    Map,
    Merge,
    Merged,
    MergeMap,
    Report,
    Window,
    WindowText,
    command_text,
    positive_option,
    report_place,
)
from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.recording import Recording

__all__ = ["validate"]


def validate(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Vehicle file, as learn writes it, or catalog name.")],
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG", help=f"Log files that the model was not learned from ({LOG_KINDS}).")
    ],
    window: WindowText = None,
    horizon: Annotated[
        float | None,
        typer.Option("--horizon", metavar="S", help="Restart the prediction from the measured state every S seconds."),
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option("--delay", metavar="S", help="From command to thruster, in seconds; default: the model's own."),
    ] = None,
    against: Annotated[
        list[str] | None,
        typer.Option("--against", metavar="MODEL2", help="Another model to compare with; may be repeated."),
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(
            "--folds",
            metavar="K",
            help="Cross-validate: cut the logs into K windows, learn MODEL's coefficients anew on all but one and "
            "predict that one, for each in turn.",
        ),
    ] = None,
    method: Annotated[
        str | None, typer.Option("--method", metavar="METHOD", help="With --folds: how to learn, as in learn.")
    ] = None,
    mapping: Map = None,
    merge: Merge = None,
    merge_map: MergeMap = None,
    report: Report = None,
    json: Json = False,
) -> None:
    """Predict logs from their commands alone and compare with what was measured.

    A fit of 100 % is perfect, 0 no better than the mean of the measurement. Then: what the errors are, slow
    disturbances, noise, or the trace of something that the model lacks.

    \b
    Examples:
      towtank validate learned.toml surge.csv --horizon 10
      towtank validate learned.toml surge.csv --against vlbv300
      towtank validate learned.toml surge.csv --folds 5
    """
    positive_option("--horizon", horizon)
    positive_option("--delay", delay, zero=True)
    stretch, merged = Window.parse(window), Merged.parse(merge, merge_map, logs)
    models = _models(model, against or [])
    _folds_alone(folds, method, against)
    report_place(report)

    from towtank.app.files import read_logs, read_vehicle
    from towtank.app.judging import against_others, alone, by_folds, learn_by, write_validate_report
    from towtank.app.terminal.output import Output
    from towtank.digits import short
    from towtank.recording.merging.merge import merges_of

    output = Output(json=json)
    with output.progress("predicting") as progress:
        recordings, common = _windowed(read_logs(logs, mapping, progress, merged), stretch)
        merges = [each for run in recordings for each in merges_of(run)]
        vehicles = {name: read_vehicle(name, output) for name in models}
        options = {"horizon": horizon, "delay": delay}
        if folds is not None:
            recordings = recordings if common is None else [recording.window(*common) for recording in recordings]
            judged = by_folds(vehicles[model], recordings, folds, learn_by(method, delay), logs, options, progress)
        elif len(vehicles) > 1:
            judged = against_others(vehicles, recordings, {"window": common, **options}, progress)
        else:
            judged = alone(vehicles[model], recordings, {"window": common, **options}, progress)
        found = judged.found
        if report is not None:
            progress("report", 0.95)
            again = {
                "--window": window,
                "--horizon": horizon,
                "--delay": delay,
                "--against": against,
                "--folds": folds,
                "--method": method,
                "--map": mapping,
                "--merge": merge,
                "--merge-map": merge_map,
            }
            facts = {"horizon": horizon, "delay": delay, "warnings": tuple(output.warnings), "recordings": recordings}
            write_validate_report(
                report, model, vehicles[model], judged, logs, [command_text("validate", [model, *logs], again)], facts
            )
    output.line(f"{model} on {', '.join(log.name for log in logs)}", "bold")
    restart = "" if horizon is None else f", set back to the measured state every {short(horizon)} s"
    late = "" if delay is None else f", delay {1e3 * delay:.4g} ms"
    output.line(f"{short(found.window[0])} to {short(found.window[1])} s{restart}{late}")
    for each in merges:
        output.line(str(each["text"]))
    judged.show(output)
    if report is not None:
        output.line()
        output.line(f"report written to {report}")
    output.document(
        {
            "model": model,
            "logs": logs,
            "merged": merges,
            "fit": found.fit,
            "rmse": found.rmse,
            "window": found.window,
            "horizon_s": horizon,
            "delay_s": delay,
            **judged.document,
            "warnings": output.warnings,
        }
    )


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


def _windowed(
    recordings: Sequence[Recording], window: Window | None
) -> tuple[Sequence[Recording], tuple[float, float] | None]:
    """Return the recordings and the window common to all; cut already where each has its own."""
    if window is None:
        return recordings, None
    stretches = [window.within(recording) for recording in recordings]
    if len(set(stretches)) == 1:
        return recordings, stretches[0]
    return [recording.window(*stretch) for recording, stretch in zip(recordings, stretches, strict=True)], None
