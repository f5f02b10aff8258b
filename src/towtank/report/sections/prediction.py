"""Free-running prediction beside the measurement, with its fit; its error over time and after each restart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import PurePath

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.printable import escaped
from towtank.recording.standard import STANDARD
from towtank.report.chart import Chart, Line, chart_svg
from towtank.report.elements import Cell, cell, figure, fit_number, grid, number, paragraph, section, table, unit_text
from towtank.report.verdict import NAMES
from towtank.validation import CHANNELS, Prediction, Usability

__all__ = ["error_section", "fit_table", "fit_tiles", "growth", "prediction_figures", "prediction_section"]

_MOST = 6  # logs that are drawn
_LEAVES = 0.4  # of the span of what was measured, that a prediction is shown beyond it
_POINTS = 26_000  # columns of all charts together: what keeps the page small
_LEGEND = (
    '<div class="legend"><span><i class="measured"></i>measured</span>'
    '<span><i class="predicted"></i>predicted from the commands alone</span></div>'
)
_BAR = '<svg viewBox="0 0 100 8" class="bar" preserveAspectRatio="none"><rect width="{share:.0f}" height="8"/></svg>'
_WORSE = '<small class="worse">worse than the mean</small>'
_ANGLES = ("phi", "theta", "psi")
_MOST_RESTARTS = 4  # logs that are drawn
_COLUMNS = 180
_SLOTS = 40  # of the time since a restart


def prediction_section(
    predictions: Sequence[Prediction],
    fit: Mapping[str, float | None],
    rmse: Mapping[str, float | None],
    predicted: str,
) -> str:
    """Return fits and charts; nothing where nothing was predicted."""
    if not any(value is not None for value in fit.values()):
        return ""
    note = (
        f"The model runs freely from one measured state, driven only by the commands of {predicted}. A fit of 100 % is "
        "perfect, 0 % no better than the mean of the measurement."
    )
    return section(
        "prediction",
        "Prediction against measurement",
        paragraph(note, "note"),
        fit_table(fit, rmse),
        prediction_figures(predictions, fit),
    )


def fit_table(fit: Mapping[str, float | None], rmse: Mapping[str, float | None], key: str = "") -> str:
    """Return fit and error of every channel that was measured."""
    rows: list[list[Cell]] = []
    for name in CHANNELS:
        value = fit.get(name)
        if value is None:
            continue
        error = rmse.get(name)
        share = min(max(value, 0.0), 100.0)
        rows.append(
            [
                cell(f"{name}<small>{NAMES[name]}</small>", "name"),
                cell(fit_number(value, f"{key}fit/{name}"), "n"),
                cell(_BAR.format(share=share) if value >= 0.0 else _WORSE, "t"),
                *([cell(number(error, short(error, 3), key=f"{key}rmse/{name}"), "n")] if rmse else []),
                cell(unit_text(STANDARD[name].unit), "u"),
            ]
        )
    heads = ["Channel", ">Fit %", ""] + ([">RMS error"] if rmse else []) + ["Unit"]
    return table(heads, rows, style="tight")


def fit_tiles(fit: Mapping[str, float | None], use: Usability | None) -> list[tuple[str, str]]:
    """Return how long predictions hold, and the best fit never without the worst: of the axes that were driven."""
    fits = {name: value for name, value in fit.items() if value is not None}
    keys = {name: f"fit/{name}" for name in fits}
    out = []
    if use is not None and use.axes:
        fits = {each.channel: each.fit for each in use.axes}
        keys = {each.channel: f"usable/axes/{each.axis}/fit" for each in use.axes}
        seconds = use.seconds if not use.poor else 0.0
        held = (
            "whole runs" if seconds == math.inf else f"{seconds:g} s" if seconds else f"{len(use.good)} of {len(fits)}"
        )
        out.append(("Predicts up to" if seconds else "Axes predicted", held))
    if fits:
        best, worst = max(fits, key=lambda name: fits[name]), min(fits, key=lambda name: fits[name])
        for word, name in (("Best fit", best), ("Least fit", worst))[: 1 + (worst != best)]:
            unit = "" if fits[name] <= -999.0 else " %"
            out.append((f"{word} ({NAMES[name]})", f"{fit_number(fits[name], keys[name])}{unit}"))
    return out


def prediction_figures(predictions: Sequence[Prediction], fit: Mapping[str, float | None], *, most: int = _MOST) -> str:
    """Return a chart for each channel of each log, the first ones where there are many."""
    shown = predictions[:most]
    count = sum(len(prediction.channels) for prediction in shown)
    columns = max(60, min(364, _POINTS // max(2 * count, 1)))
    parts = [_LEGEND] if count else []
    for prediction in shown:
        if len(predictions) > 1:
            parts.append(f"<h3>{escaped(PurePath(prediction.source).name or 'recording')}</h3>")
        parts.append(grid(_figure(prediction, name, fit, columns, alone=len(predictions) == 1) for name in CHANNELS))
    if len(predictions) > most:
        parts.append(paragraph(f"{len(predictions) - most} further logs are not drawn; the fits count them.", "note"))
    return "".join(parts)


def _figure(prediction: Prediction, name: str, fit: Mapping[str, float | None], columns: int, *, alone: bool) -> str:
    if name not in prediction.channels:
        return ""
    measured, predicted = prediction.channels[name]
    if name in _ANGLES:
        measured, predicted = unwrapped(measured, predicted)
    scale, unit = scale_and_unit(name)
    known = scale * measured[np.isfinite(measured)]
    if not known.size:
        return ""
    started = prediction.t >= prediction.restarts[0]
    chart = Chart(
        label=f"{NAMES[name]} measured and predicted over time",
        parts=[
            Line(prediction.t, scale * measured, "measured"),
            Line(prediction.t[started], scale * predicted[started], "predicted"),
        ],
        x_name="s",
        x_range=(float(prediction.t[0]), float(prediction.t[-1])),
        y_range=_range(known, scale * predicted[started]),
        columns=columns,
    )
    value = fit.get(name)
    right = (
        f"fit {fit_number(value, f'fit/{name}')}{'' if value <= -999.0 else ' %'}"
        if alone and value is not None
        else ""
    )
    title = f"{name} <small>{NAMES[name]}, {unit_text(unit)}</small>"
    return figure(chart_svg(chart), title, right=right)


def unwrapped(measured: Array, predicted: Array) -> tuple[Array, Array]:
    """Return two courses of an angle (n,) [rad] without jumps of a turn, beside each other at first."""
    out = []
    for angle in (measured, predicted):
        known = np.isfinite(angle)
        course = angle.copy()
        course[known] = np.unwrap(angle[known])
        out.append(course)
    both = np.flatnonzero(np.isfinite(out[0]) & np.isfinite(out[1]))
    if both.size:
        out[1] -= 2.0 * np.pi * np.round((out[1][both[0]] - out[0][both[0]]) / (2.0 * np.pi))
    return out[0], out[1]


def _range(known: Array, predicted: Array) -> tuple[float, float]:
    """Return what to show: all that was measured, and of the prediction what does not leave it by much."""
    low, high = float(known.min()), float(known.max())
    span = (high - low) or 0.2
    finite = predicted[np.isfinite(predicted)]
    below, above = (float(finite.min()), float(finite.max())) if finite.size else (low, high)
    low, high = min(low, max(below, low - _LEAVES * span)), max(high, min(above, high + _LEAVES * span))
    return low - 0.08 * span, high + 0.08 * span


def scale_and_unit(name: str) -> tuple[float, str]:
    """Return what to multiply a channel by to draw it, and the unit then: degrees for angles."""
    if STANDARD[name].unit.startswith("rad"):
        return 180.0 / math.pi, STANDARD[name].unit.replace("rad", "°")
    return 1.0, STANDARD[name].unit


def error_section(predictions: Sequence[Prediction], horizon: float | None) -> str:
    """Return the error of every channel over time and, where the prediction was restarted, over the horizon."""
    parts = []
    if horizon is not None and sum(len(each.restarts) for each in predictions) > 1:
        grown = [_growth_figure(predictions, name) for name in CHANNELS]
        said = "Root-mean-square error as a function of the time since the last restart, over all restarts."
        parts += ["<h3>How the error grows over the horizon</h3>", paragraph(said, "note"), grid(grown, "small")]
        parts.append("<h3>Error over time</h3>")
    for prediction in predictions[:_MOST_RESTARTS]:
        if len(predictions) > 1:
            parts.append(f"<h3>{escaped(PurePath(prediction.source).name or 'recording')}</h3>")
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
