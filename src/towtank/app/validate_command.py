"""`towtank validate`: a model against logs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from towtank.app.arguments import LOG_KINDS, Json, Map, Report, Window, WindowText, no_report, positive
from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.app.output import Output, Teller
    from towtank.recording import Recording
    from towtank.validation import Validation
    from towtank.validation.cross_validation import Learn
    from towtank.vehicle import Vehicle

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
    no_report(report)
    positive("--horizon", horizon)
    positive("--delay", delay, zero=True)
    stretch = Window.parse(window)
    models = _models(model, against or [])
    _folds_alone(folds, method, against)

    from towtank.app.digits import short
    from towtank.app.output import Output
    from towtank.app.relearning import learn_by
    from towtank.app.sources import read_logs, read_vehicle

    output = Output(json=json)
    with output.progress("predicting") as tell:
        recordings, common = _windowed(read_logs(logs, mapping, tell), stretch)
        vehicles = {name: read_vehicle(name, output) for name in models}
        options = {"horizon": horizon, "delay": delay}
        if folds is not None:
            recordings = recordings if common is None else [recording.window(*common) for recording in recordings]
            judged = _by_folds(vehicles[model], recordings, folds, learn_by(method, delay), logs, options, tell)
        elif len(vehicles) > 1:
            judged = _against(vehicles, recordings, {"window": common, **options}, tell)
        else:
            judged = _alone(vehicles[model], recordings, {"window": common, **options}, tell)
        found = judged.found
    output.line(f"{model} on {', '.join(log.name for log in logs)}", "bold")
    restart = "" if horizon is None else f", set back to the measured state every {short(horizon)} s"
    late = "" if delay is None else f", delay {1e3 * delay:.4g} ms"
    output.line(f"{short(found.window[0])} to {short(found.window[1])} s{restart}{late}")
    judged.show(output)
    output.document(
        {
            "model": model,
            "logs": logs,
            "fit": found.fit,
            "rmse": found.rmse,
            "window": found.window,
            "horizon_s": horizon,
            "delay_s": delay,
            **judged.document,
            "warnings": output.warnings,
        }
    )


@dataclass(frozen=True)
class _Judged:
    """What was found: scores, how to print it, and its part of the document."""

    found: Validation
    show: Callable[[Output], None]
    document: dict[str, Any]


def _alone(vehicle: Vehicle, recordings: Sequence[Recording], options: dict[str, Any], tell: Teller) -> _Judged:
    from towtank.app.fits_table import show_fits
    from towtank.app.residual_tables import residual_document, show_residuals
    from towtank.validation import residuals
    from towtank.validation import validate as judge

    found = judge(vehicle, recordings, progress=tell, **options)
    errors = residuals(found.predictions, progress=tell)

    def show(output: Output) -> None:
        output.line()
        show_fits(found.fit, found.rmse, output)
        show_residuals(errors, output)

    return _Judged(found, show, {"residuals": residual_document(errors)})


def _against(
    vehicles: Mapping[str, Vehicle], recordings: Sequence[Recording], options: dict[str, Any], tell: Teller
) -> _Judged:
    from towtank.app.comparison_tables import comparison_document, show_comparison
    from towtank.app.residual_tables import residual_document
    from towtank.validation import compare, residuals

    found = compare(vehicles, recordings, progress=tell, **options)
    first = next(iter(found.validations.values()))
    document = {
        "residuals": residual_document(residuals(first.predictions, progress=tell)),
        "comparison": comparison_document(found),
    }
    return _Judged(first, lambda output: show_comparison(found, output), document)


def _by_folds(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    folds: int,
    learn: Learn,
    logs: Sequence[Path],
    options: dict[str, Any],
    tell: Teller,
) -> _Judged:
    from towtank.app.fold_tables import fold_document, show_folds
    from towtank.validation import cross_validate

    found = cross_validate(vehicle, recordings, windows=folds, learn=learn, progress=tell, **options)
    document = {"cross_validation": fold_document(found, logs)}
    return _Judged(found.scores, lambda output: show_folds(found, logs, output), document)


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
