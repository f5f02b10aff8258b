"""What the demo leaves behind: model, recordings, page, and figures of its convergence and its prediction as PNG.

matplotlib is imported on first use, draws with Agg and never opens a window.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from towtank import __version__
from towtank.app.demo.progress import LearningCurve, convergence_of, quantities
from towtank.app.demo.words import LOG, MODEL, UNSEEN, commands, setting, verdict
from towtank.core.arrays import Array
from towtank.digits import percent
from towtank.outputs import write_atomically, write_text
from towtank.report import LearnFacts, Origin
from towtank.report.learn_page import report_html
from towtank.simulation.tank import Session
from towtank.validation import Prediction, Validation, residuals
from towtank.vehicle import save_vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Trace", "convergence_figure", "png", "prediction_figure", "write_demo"]

_INK, _FAINT, _ACCENT, _TRUTH, _TURN = "#1b2733", "#8a97a3", "#0b6fa4", "#c4461a", "#e9eef2"
_AXIS_COLOURS = {
    "surge": "#0b6fa4", "sway": "#c4461a", "heave": "#3d8b37", "roll": "#7b4fa3", "pitch": "#b08900", "yaw": "#4d5a66"
}  # fmt: skip
_PANELS = (("x", "y", "z"), ("phi", "theta", "psi"))
_TITLES = {"x": "north x", "y": "east y", "z": "depth z", "phi": "roll φ", "theta": "pitch θ", "psi": "heading ψ"}
_NEAR = 0.3  # of the truth, half the height of a convergence panel
_DPI = 120
_CONVERGENCE, _PREDICTION, _PAGE = "convergence.png", "prediction.png", "demo.html"


@dataclass(frozen=True, eq=False)
class Trace:
    """One estimate over time.

    Attributes:
        name, unit: of the quantity. axes: of surge .. yaw, those that it belongs to. values, std: (n,), NaN while
            it is not identified. truth: the value to be found, None where nobody knows; before: until when [s] it was
            another one, and which.
    """

    name: str
    unit: str
    axes: tuple[str, ...]
    values: Array
    std: Array
    truth: float | None = None
    before: tuple[float, float] | None = None

    def truth_at(self, t: Array) -> Array:
        """Return the value to be found at times (n,) [s], NaN where nobody knows."""
        truth = np.full(t.shape, np.nan if self.truth is None else self.truth)
        return truth if self.before is None else np.where(t < self.before[0], self.before[1], truth)


def png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def convergence_figure(
    t: Array, traces: Sequence[Trace], turns: Sequence[tuple[str, float, float]] = (), title: str = ""
) -> Figure:
    """Draw each estimate with twice its deviation and its truth, and the error of all in the last panel.

    Args:
        t: times (n,) [s]. turns: name, start, end [s] of the time in which an axis was excited; shaded.
    """
    columns = 4
    rows = -(-(len(traces) + 2) // columns)
    figure = _figure(12.0, 2.25 * rows + 0.5, title)
    grid = figure.add_gridspec(rows, columns)
    for k, trace in enumerate(traces):
        axes = figure.add_subplot(grid[k // columns, k % columns])
        _convergence_panel(axes, t, trace, [turn for turn in turns if turn[0] in trace.axes])
        axes.set_xlim(0.0, float(t[-1]))
    start = len(traces) % columns or columns
    overview = figure.add_subplot(grid[rows - 1, start % columns :])
    _error_panel(overview, t, traces)
    _legend(figure, [axis for axis in _AXIS_COLOURS if any(axis in trace.axes for trace in traces)])
    return figure


def _figure(width: float, height: float, title: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    if title:
        figure.suptitle(title, color=_INK, fontsize=12, fontweight="bold", x=0.01, ha="left")
    return figure


def _dress(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, loc="left", fontsize=9.5, color=_INK, fontweight="bold")
    if unit:
        axes.set_title(unit, loc="right", fontsize=8.5, color=_FAINT)
    axes.tick_params(labelsize=8, colors=_INK, length=3)
    axes.grid(True, color="#dfe5ea", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(_FAINT)


def _convergence_panel(axes: Axes, t: Array, trace: Trace, turns: Sequence[tuple[str, float, float]]) -> None:
    for _, start, end in turns:
        axes.axvspan(start, end, color=_TURN, linewidth=0)
    low, high = trace.values - 2.0 * trace.std, trace.values + 2.0 * trace.std
    axes.fill_between(t, low, high, color=_ACCENT, alpha=0.2, linewidth=0)
    axes.plot(t, trace.values, color=_ACCENT, linewidth=1.4)
    known = np.flatnonzero(np.isfinite(trace.values))
    middle = trace.truth if trace.truth is not None else trace.values[known[-1]] if known.size else None
    if trace.truth is not None:
        steps = np.append(0.0, t)
        axes.step(steps, trace.truth_at(steps), where="post", color=_TRUTH, linewidth=1.1, linestyle=(0, (5, 3)))
    if middle:
        other = middle if trace.before is None else trace.before[1]
        room = _NEAR * abs(middle)
        axes.set_ylim(min(middle, other) - room, max(middle, other) + room)
    if not known.size:
        axes.text(0.5, 0.75, "not identified", transform=axes.transAxes, ha="center", fontsize=9, color=_FAINT)
    _dress(axes, trace.name, trace.unit)


def _error_panel(axes: Axes, t: Array, traces: Sequence[Trace]) -> None:
    """Draw the size of all errors [%] (relative deviations where no truth is known) on a logarithmic scale."""
    for trace in traces:
        with np.errstate(divide="ignore", invalid="ignore"):
            away = trace.std / trace.values if trace.truth is None else trace.values / trace.truth_at(t) - 1.0
        away = np.where(np.isfinite(away), away, np.nan)
        error = np.maximum(100.0 * np.abs(away), 1e-3)
        inertia = " - " in trace.name
        colour = _AXIS_COLOURS.get(trace.axes[0], _INK)
        axes.semilogy(t, error, color=colour, linewidth=1.3 if inertia else 1.0, linestyle="-" if inertia else "--")
    axes.set_ylim(0.03, 100.0)
    axes.set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    axes.set_xlim(0.0, float(t[-1]))
    _dress(axes, "all: error (solid: inertia, dashed: drag and righting moment)", "%")
    axes.set_xlabel("time s", fontsize=8.5, color=_INK)


def _legend(figure: Figure, names: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=_ACCENT, linewidth=6, alpha=0.4, label="estimate ± 2 std"),
        Line2D([], [], color=_TRUTH, linestyle=(0, (5, 3)), label="truth"),
        Line2D([], [], color=_TURN, linewidth=9, label="its own turn"),
        *(Line2D([], [], color=_AXIS_COLOURS[name], label=name) for name in names),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8.5, frameon=False)


def prediction_figure(prediction: Prediction, fit: Mapping[str, float | None], title: str = "") -> Figure:
    """Draw the measured and the predicted pose, with the fit of each."""
    names = [name for row in _PANELS for name in row if name in prediction.channels]
    figure = _figure(12.0, 6.0, title)
    if not names:
        return figure
    columns = min(3, len(names))
    grid = figure.add_gridspec(-(-len(names) // columns), columns)
    for k, name in enumerate(names):
        axes = figure.add_subplot(grid[k // columns, k % columns])
        measured, predicted = prediction.channels[name]
        scale, unit = (180.0 / np.pi, "°") if name in _PANELS[1] else (1.0, "m")
        axes.plot(prediction.t, scale * measured, color=_FAINT, linewidth=3.0, alpha=0.6, label="measured")
        axes.plot(prediction.t, scale * predicted, color=_ACCENT, linewidth=1.2, label="predicted")
        low, high = scale * np.nanmin(measured), scale * np.nanmax(measured)
        room = 0.35 * (high - low) + 1e-3
        axes.set_ylim(low - room, high + room)
        axes.set_xlim(float(prediction.t[0]), float(prediction.t[-1]))
        _dress(axes, _TITLES[name], unit)
        value = fit.get(name)
        label = f"fit {percent(value)} %" if value is not None and value > -100.0 else "no fit"
        axes.text(0.98, 0.95, label, transform=axes.transAxes, ha="right", va="top", fontsize=9, color=_INK)
        if k // columns == (len(names) - 1) // columns:
            axes.set_xlabel("time s", fontsize=8.5, color=_INK)
        if k == 0:
            axes.legend(fontsize=8, frameon=False, loc="lower left")
    return figure


def write_demo(
    output: Path, session: Session, unseen: Session, facts: LearnFacts, judged: Validation, curve: LearningCurve
) -> list[Path]:
    """Write everything into the folder and return the files, the page first. facts: of what was learned."""
    save_vehicle(facts.model, output / MODEL)
    session.recording.write(output / LOG)
    unseen.recording.write(output / UNSEEN)
    t, values, std = np.array(curve.t), np.array(curve.values), np.array(curve.std)
    first = quantities(session.truth, weight=session.later is not None)
    traces = [
        Trace(q.name, q.unit, q.axes, values[:, i], std[:, i], q.truth, _until(session, first[i].truth))
        for i, q in enumerate(curve.learned)
    ]
    convergence = png(convergence_figure(t, traces, session.turns, "Estimates as the session goes on"))
    prediction = png(prediction_figure(judged.predictions[0], judged.fit, "Prediction of a session never seen"))
    for name, image in ((_CONVERGENCE, convergence), (_PREDICTION, prediction)):
        write_atomically(output / name, partial(_put, image))
    write_text(output / _PAGE, report_html(_facts(session, facts, judged, curve)))
    return [output / name for name in (_PAGE, MODEL, LOG, UNSEEN, _CONVERGENCE, _PREDICTION)]


def _until(session: Session, value: float) -> tuple[float, float] | None:
    """Return until when [s] the truth was another one, and which; None where it was the same all along."""
    return None if session.later is None else (session.changed, value)


def _facts(session: Session, facts: LearnFacts, judged: Validation, curve: LearningCurve) -> LearnFacts:
    """Return what the page says: what was learned, beside the truth, with the curve of the first pass."""
    next_ = [f"# {purpose}\n{command}" for purpose, command in commands(Path())]
    return replace(
        facts,
        title="A vehicle learned in a simulated tank",
        verdict=f"{verdict(curve)}.",
        remarks=[setting(session), *facts.remarks],
        fit=judged.fit,
        rmse=judged.rmse,
        predictions=judged.predictions,
        residuals=residuals(judged.predictions),
        predicted="a session never seen, with other noise and other random forces",
        convergence=convergence_of(curve, session.known),
        truth=session.final,
        truth_before=None if session.later is None else (session.changed, session.truth),
        events=curve.events,
        origin=Origin(commands=next_, versions={"towtank": __version__}),
    )


def _put(data: bytes, stream: BinaryIO) -> None:
    stream.write(data)
