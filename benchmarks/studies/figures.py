"""Draws the figures of "How far to trust it" from what the studies wrote.

    python benchmarks/studies/figures.py surge.json delay.json coupled.json --output docs/images/trust

From any of the files, those that are given: RMSE beside the bound over time (surge.png, delay.png), the times to 5 %
beside those of an estimator at the bound (settling.png), coverage of the 95 % intervals over time (coverage.png), all
coefficients of the coupled runs (coupled.png).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from towtank.core.arrays import Array
from towtank.outputs import write_atomically

INK, FAINT, BAND, GRID = "#1b2733", "#8a97a3", "#e9eef2", "#dfe5ea"
MASS, DRAG, OTHER = "#0b6fa4", "#c4461a", "#3d8b37"
DASHED = (0, (5, 3))
DPI = 120
COVERAGE = (0.90, 0.98)
REST = 0.5  # s
TITLES = {
    "s1-1mm-stairs": "S1, 1 mm, stairs", "s1-1mm-square": "S1, 1 mm, square wave", "s1-5mm-stairs": "S1, 5 mm, stairs",
    "s1-5mm-square": "S1, 5 mm, square wave", "s2-stairs": "S2, random force, stairs",
    "s2-square": "S2, random force, square wave", "delay-s1-stairs": "delay and lag unknown, stairs",
    "delay-s1-square": "delay and lag unknown, square wave", "delay-s2-stairs": "and a random force, stairs",
    "delay-s2-square": "and a random force, square wave", "coupled-pose": "pose",
    "coupled-dvl": "DVL, gyro, depth", "coupled-gyro": "gyro, depth",
}  # fmt: skip


def rmse_figure(parts: Sequence[dict[str, Any]], title: str) -> Figure:
    """Draw RMSE and bound of mass and drag over time, one panel for each experiment."""
    figure, panels = _panels(len(parts), title)
    for axes, part in zip(panels, parts, strict=False):
        stream = part["stream"]
        t = _array(stream["t"])
        rmse, bound = (100.0 * _array(stream[name]) for name in ("rmse", "bound"))
        for i, colour in enumerate((MASS, DRAG)):
            axes.semilogy(t, bound[:, i], color=colour, linewidth=1.1, linestyle=DASHED)
            axes.semilogy(t, rmse[:, i], color=colour, linewidth=1.5)
        axes.set_xlim(0.0, float(t[-1]))
        low = float(np.nanmin(bound[-1])) if np.isfinite(bound[-1]).any() else 0.01
        axes.set_ylim(0.5 * low, 100.0)
        _dress(axes, TITLES[part["experiment"]], "%")
        _ticks(axes, "%g")
    names = parts[0]["stream"]["names"]
    handles = [
        Line2D([], [], color=MASS, label=names[0]), Line2D([], [], color=DRAG, label=names[1]),
        Line2D([], [], color=INK, label=f"RMSE of {parts[0]['stream']['runs']} runs, streamed"),
        Line2D([], [], color=INK, linestyle=DASHED, label="Cramér-Rao bound"),
    ]  # fmt: skip
    return _finished(figure, panels, len(parts), handles)


def settling_figure(parts: Sequence[dict[str, Any]]) -> Figure:
    """Draw the share of runs that are within 5 % for good, over time, beside an estimator at the bound."""
    figure, panels = _panels(len(parts), "Time until mass and drag stay within 5 %")
    for axes, part in zip(panels, parts, strict=False):
        ideal, found = (np.sort(_array(part[name], never=np.inf)) for name in ("t5_at_bound", "t5"))
        end = float(_array(part["stream"]["t"])[-1]) - REST
        for times, style, colour in ((ideal, DASHED, INK), (found, "-", MASS)):
            share = np.arange(times.size + 1) / times.size
            sure = float(np.isfinite(times).mean())
            axes.step(
                np.concatenate([[0.0], times, [end]]),
                np.append(share, sure),
                where="post",
                color=colour,
                linewidth=1.5,
                linestyle=style,
            )
        shown = np.concatenate([each[np.isfinite(each)] for each in (found, ideal)])
        axes.set_xlim(0.0, min(end, 1.2 * float(np.quantile(shown, 0.95))) if shown.size else end)
        axes.set_ylim(0.0, 1.02)
        _dress(axes, TITLES[part["experiment"]], "share of the runs")
    handles = [
        Line2D([], [], color=MASS, label="streamed"),
        Line2D([], [], color=INK, linestyle=DASHED, label="an estimator at the bound"),
    ]
    return _finished(figure, panels, len(parts), handles)


def coverage_figure(parts: Sequence[dict[str, Any]]) -> Figure:
    """Draw how many of the 95 % intervals hold the truth, over time."""
    figure, panels = _panels(len(parts), "Share of the 95 % intervals that hold the truth")
    for axes, part in zip(panels, parts, strict=False):
        stream = part["stream"]
        t, held = _array(stream["t"]), _array(stream["coverage"])
        axes.axhspan(*COVERAGE, color=BAND, linewidth=0)
        axes.axhline(0.95, color=FAINT, linewidth=0.8)
        for i, colour in enumerate((MASS, DRAG)):
            axes.plot(t, held[:, i], color=colour, linewidth=1.2)
            batch = [each for each in part["batch"] if each["name"] == stream["names"][i]]
            axes.plot([b["t"] for b in batch], [b["coverage"] for b in batch], "o", color=colour, markersize=5)
        axes.set_xlim(0.0, float(t[-1]))
        axes.set_ylim(0.5, 1.02)
        _dress(axes, TITLES[part["experiment"]], "")
    names = parts[0]["stream"]["names"]
    handles = [
        Line2D([], [], color=MASS, label=names[0]), Line2D([], [], color=DRAG, label=names[1]),
        Line2D([], [], color=INK, label="streamed"),
        Line2D([], [], color=INK, marker="o", linestyle="", label="learned from the first seconds as a whole"),
        Line2D([], [], color=BAND, linewidth=9, label="0.90 to 0.98"),
    ]  # fmt: skip
    return _finished(figure, panels, len(parts), handles)


def coupled_figure(parts: Sequence[dict[str, Any]]) -> Figure:
    """Draw RMSE and bound of every coefficient at the end of the coupled runs, and their coverage."""
    figure = _figure(12.0, 6.2, "Thirteen coefficients from one run of 60 s on all axes")
    grid = figure.add_gridspec(2, 1, height_ratios=(2.2, 1.0))
    above, below = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    below.axhspan(0.85, 0.99, color=BAND, linewidth=0)
    handles = []
    end = max(each["t"] for each in parts[0]["batch"])
    names = [each["name"] for each in parts[0]["batch"] if each["t"] == end]
    for k, (part, colour) in enumerate(zip(parts, (MASS, DRAG, OTHER), strict=False)):
        last = [each for each in part["batch"] if each["t"] == end]
        x = np.arange(len(last)) + 0.25 * (k - 0.5 * (len(parts) - 1))
        rmse, bound, held = (_array([each[field] for each in last]) for field in ("rmse", "bound", "coverage"))
        above.bar(x, 100.0 * rmse, width=0.22, color=colour, alpha=0.85)
        above.hlines(100.0 * bound, x - 0.12, x + 0.12, color=INK, linewidth=2.0)
        below.plot(x, held, "o", color=colour, markersize=5)
        handles.append(Line2D([], [], color=colour, linewidth=7, label=TITLES[part["experiment"]]))
    above.set_yscale("log")
    _dress(above, f"RMSE of {parts[0]['batch'][0]['runs']} runs", "%")
    _ticks(above, "%g")
    _dress(below, "share of the 95 % intervals that hold the truth", "")
    below.set_ylim(0.5, 1.03)
    for axes in (above, below):
        axes.set_xticks(np.arange(len(names)), names, fontsize=8)
        axes.set_xlim(-0.6, len(names) - 0.4)
        axes.grid(False, axis="x")
    handles += [
        Line2D([], [], color=INK, linewidth=2.0, label="Cramér-Rao bound"),
        Line2D([], [], color=BAND, linewidth=9, label="0.85 to 0.99"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8.5, frameon=False)
    return figure


def draw(document: dict[str, Any]) -> dict[str, Figure]:
    """Return the figures of one study by file name, of the experiments that some run came through."""
    parts = [part for part in document["parts"] if part.get("stream", {}).get("t")]
    if not parts:
        return {}
    if document["study"] == "surge":
        return {
            "surge.png": rmse_figure(parts, "Error of surge mass and drag beside the bound"),
            "settling.png": settling_figure(parts),
            "coverage.png": coverage_figure(parts),
        }
    if document["study"] == "delay":
        return {"delay.png": rmse_figure(parts, "A delay of 0.15 s and a lag of 0.10 s that nobody told")}
    return {"coupled.png": coupled_figure(parts)} if document["study"] == "coupled" else {}


def _figure(width: float, height: float, title: str) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    figure.suptitle(title, color=INK, fontsize=12, fontweight="bold", x=0.01, ha="left")
    return figure


def _panels(count: int, title: str) -> tuple[Figure, list[Axes]]:
    """Return a figure with two columns, stairs and square wave, as the experiments come in pairs."""
    columns = 2 if count > 1 else 1
    rows = -(-count // columns)
    figure = _figure(5.0 * columns + 1.0, 2.4 * rows + 0.8, title)
    grid = figure.add_gridspec(rows, columns)
    return figure, [figure.add_subplot(grid[k // columns, k % columns]) for k in range(count)]


def _finished(figure: Figure, panels: Sequence[Axes], count: int, handles: list[Line2D]) -> Figure:
    for axes in panels[max(count - 2, 0) :]:
        axes.set_xlabel("time s", fontsize=8.5, color=INK)
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 5), fontsize=8.5, frameon=False)
    return figure


def _dress(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, loc="left", fontsize=9.5, color=INK, fontweight="bold")
    if unit:
        axes.set_title(unit, loc="right", fontsize=8.5, color=FAINT)
    axes.tick_params(labelsize=8, colors=INK, length=3)
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)


def _ticks(axes: Axes, form: str) -> None:
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    axes.yaxis.set_major_formatter(FormatStrFormatter(form))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _array(values: Any, never: float = np.nan) -> Array:
    """Return numbers that JSON has as lists; null, what is not finite, becomes `never`."""
    out = np.array(values, dtype=np.float64)
    return np.where(np.isnan(out), never, out)


def main(argv: Sequence[str] | None = None) -> int:
    """Draw what can be drawn from the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="+", type=Path, help="JSON files that the studies wrote")
    parser.add_argument("--output", type=Path, required=True, help="folder of the figures")
    options = parser.parse_args(argv)
    options.output.mkdir(parents=True, exist_ok=True)
    for path in options.studies:
        for name, figure in draw(json.loads(path.read_text())).items():
            write_atomically(options.output / name, partial(figure.savefig, format="png", dpi=DPI))
            sys.stdout.write(f"{options.output / name}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
