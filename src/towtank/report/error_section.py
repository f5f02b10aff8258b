"""The error of a prediction over time, and how it grows after each restart."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import PurePath

import numpy as np

from towtank.core.arrays import Array
from towtank.report.chart import Chart, Line, chart_svg
from towtank.report.elements import figure, grid, paragraph, section, unit_text
from towtank.report.prediction_section import scale_and_unit
from towtank.report.verdict import NAMES
from towtank.validation import CHANNELS, Prediction

__all__ = ["error_section", "growth"]

_MOST = 4  # logs that are drawn
_COLUMNS = 180
_SLOTS = 40  # of the time since a restart


def error_section(predictions: Sequence[Prediction], horizon: float | None) -> str:
    """Return the error of every channel over time and, where the prediction was restarted, over the horizon."""
    parts = []
    if horizon is not None and sum(len(each.restarts) for each in predictions) > 1:
        grown = [_growth_figure(predictions, name) for name in CHANNELS]
        said = "Root-mean-square error as a function of the time since the last restart, over all restarts."
        parts += ["<h3>How the error grows over the horizon</h3>", paragraph(said, "note"), grid(grown, "small")]
        parts.append("<h3>Error over time</h3>")
    for prediction in predictions[:_MOST]:
        if len(predictions) > 1:
            parts.append(f"<h3>{escape(PurePath(prediction.source).name or 'recording')}</h3>")
        parts.append(grid((_error_figure(prediction, name) for name in CHANNELS), "small"))
    note = "Measured less predicted. A drift: attitude or a constant force; steps with the commands: thrust or drag."
    return section("errors", "The errors over time", paragraph(note, "note"), *parts)


def growth(predictions: Sequence[Prediction], name: str) -> tuple[Array, Array]:
    """Return the time since the last restart (k,) [s] and the root-mean-square error then (k,), NaN where none is."""
    since, square = [], []
    for prediction in predictions:
        if name not in prediction.channels:
            continue
        measured, predicted = prediction.channels[name]
        restarts = np.array(prediction.restarts)
        last = np.searchsorted(restarts, prediction.t - 1e-9, side="right") - 1
        # the row of a restart ends the stretch before it
        known = np.isfinite(measured) & np.isfinite(predicted) & (last >= 0)
        rows = np.where((last > 0) & (prediction.t - restarts[np.maximum(last, 0)] < 1e-9), last - 1, last)
        since.append((prediction.t - restarts[np.maximum(rows, 0)])[known])
        square.append((measured - predicted)[known] ** 2)
    if not since:
        return np.empty(0), np.empty(0)
    time, errors = np.concatenate(since), np.concatenate(square)
    if not time.size or not time.max() > 0.0:
        return np.empty(0), np.empty(0)
    edges = np.linspace(0.0, float(time.max()), _SLOTS + 1)
    slot = np.clip(np.searchsorted(edges, time, side="left") - 1, 0, _SLOTS - 1)
    counts = np.bincount(slot, minlength=_SLOTS)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(np.bincount(slot, weights=errors, minlength=_SLOTS) / counts)
    return 0.5 * (edges[1:] + edges[:-1]), np.asarray(rms)


def _growth_figure(predictions: Sequence[Prediction], name: str) -> str:
    t, rms = growth(predictions, name)
    known = np.isfinite(rms)
    if known.sum() < 2:
        return ""
    scale, unit = scale_and_unit(name)
    top = float((scale * rms)[known].max()) or 1.0
    chart = Chart(
        label=f"Error of {NAMES[name]} over the time since a restart",
        parts=[Line(t[known], scale * rms[known], "rms")],
        x_name="s",
        x_range=(0.0, float(t[-1])),
        y_range=(0.0, 1.12 * top),
        width=330,
        height=150,
    )
    return figure(chart_svg(chart), f"{name} <small>{NAMES[name]}, {unit_text(unit)}</small>")


def _error_figure(prediction: Prediction, name: str) -> str:
    if name not in prediction.channels:
        return ""
    measured, predicted = prediction.channels[name]
    scale, unit = scale_and_unit(name)
    with np.errstate(invalid="ignore", over="ignore"):
        error = scale * (measured - predicted)
    error = np.where(np.isfinite(error) & (prediction.t >= prediction.restarts[0]), error, np.nan)
    if not np.isfinite(error).any():
        return ""
    chart = Chart(
        label=f"Error of {NAMES[name]} over time",
        parts=[Line(prediction.t, error, "error")],
        x_name="s",
        x_range=(float(prediction.t[0]), float(prediction.t[-1])),
        levels=[(0.0, "zero")],
        width=330,
        height=150,
        columns=_COLUMNS,
    )
    return figure(chart_svg(chart), f"{name} <small>{NAMES[name]}, {unit_text(unit)}</small>")
