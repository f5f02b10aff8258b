"""`towtank validate`: a model against logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from towtank.app.arguments import Json, Map, Report, Window, WindowText, no_report, positive

if TYPE_CHECKING:
    from towtank.recording import Recording

__all__ = ["validate"]


def validate(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Vehicle file, as learn writes it, or catalog name.")],
    logs: Annotated[list[Path], typer.Argument(metavar="LOG", help="Log files that the model was not learned from.")],
    window: WindowText = None,
    horizon: Annotated[
        float | None,
        typer.Option("--horizon", metavar="S", help="Restart the prediction from the measured state every S seconds."),
    ] = None,
    mapping: Map = None,
    report: Report = None,
    json: Json = False,
) -> None:
    """Predict logs from their commands alone and compare with what was measured.

    A fit of 100 % is perfect, 0 no better than the mean of the measurement.

    \b
    Example:
      towtank validate learned.toml surge.csv --horizon 10
    """
    no_report(report)
    positive("--horizon", horizon)
    stretch = Window.parse(window)

    from towtank.app.digits import short
    from towtank.app.fits_table import show_fits
    from towtank.app.output import Output
    from towtank.app.sources import read_logs, read_vehicle
    from towtank.validation import validate as judge

    output = Output(json=json)
    with output.progress("predicting") as tell:
        vehicle = read_vehicle(model, output)
        recordings, common = _windowed(read_logs(logs, mapping, tell), stretch)
        found = judge(vehicle, recordings, window=common, horizon=horizon, progress=tell)
    output.line(f"{vehicle.name} ({model}) on {', '.join(log.name for log in logs)}", "bold")
    restart = "" if horizon is None else f", set back to the measured state every {short(horizon)} s"
    output.line(f"{short(found.window[0])} to {short(found.window[1])} s{restart}")
    output.line()
    show_fits(found.fit, found.rmse, output)
    output.document(
        {
            "model": model,
            "logs": logs,
            "fit": found.fit,
            "rmse": found.rmse,
            "window": found.window,
            "horizon_s": horizon,
            "warnings": output.warnings,
        }
    )


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
