"""What the figures of the studies have in common: colours, panels, ticks, legends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from towtank.core.arrays import Array

__all__ = [
    "BAND",
    "DASHED",
    "DPI",
    "DRAG",
    "INK",
    "MASS",
    "OTHER",
    "array",
    "band",
    "dot",
    "dress",
    "figure_of",
    "finished",
    "legend",
    "line",
    "log_ticks",
    "panels_of",
]

INK, FAINT, BAND, GRID = "#1b2733", "#6d7a86", "#dde5eb", "#dfe5ea"
MASS, DRAG, OTHER = "#0b6fa4", "#c4461a", "#3d8b37"
DASHED: Any = (0, (5, 3))
DPI = 120
_IN_A_ROW = 4  # entries of a legend
_MOST_DECADES = 2.3  # that bear ticks at 2 and 5 as well


def figure_of(width: float, height: float, title: str) -> Figure:
    """Return an empty figure [inch] on white, with its title."""
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.06)
    figure = Figure(figsize=(width, height), layout=layout, facecolor="white")
    figure.suptitle(title, color=INK, fontsize=12, fontweight="bold", x=0.015, ha="left")
    return figure


def panels_of(count: int, title: str) -> tuple[Figure, list[Axes]]:
    """Return a figure with two columns, stairs and square wave, as the experiments come in pairs."""
    columns = 2 if count > 1 else 1
    rows = -(-count // columns)
    figure = figure_of(4.2 * columns + 0.6, 2.1 * rows + 0.9, title)
    grid = figure.add_gridspec(rows, columns)
    return figure, [figure.add_subplot(grid[k // columns, k % columns]) for k in range(count)]


def finished(figure: Figure, panels: Sequence[Axes], handles: Sequence[Line2D], below: str = "s") -> Figure:
    """Return the figure with the unit of time below its last row of panels, and a legend."""
    for axes in panels[max(len(panels) - 2, 0) :]:
        axes.set_xlabel(below, fontsize=8.5, color=INK)
    legend(figure, handles)
    return figure


def legend(figure: Figure, handles: Sequence[Line2D]) -> None:
    """Put a legend below all panels."""
    columns = 3 if len(handles) > _IN_A_ROW else len(handles)
    figure.legend(handles=list(handles), loc="outside lower center", ncols=columns, fontsize=8.5, frameon=False)


def dress(axes: Axes, title: str, unit: str) -> None:
    """Give a panel its title, the unit of its ordinate, a grid and quiet spines."""
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


def log_ticks(axes: Axes) -> None:
    """Write plain numbers beside a logarithmic ordinate, at 1, 2 and 5 where it is short."""
    low, high = axes.get_ylim()
    short = np.log10(high / low) < _MOST_DECADES
    axes.yaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0) if short else (1.0,), numticks=20))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))


def line(colour: str, label: str, style: Any = "-", width: float = 1.5) -> Line2D:
    """Return a line for a legend."""
    return Line2D([], [], color=colour, label=label, linestyle=style, linewidth=width)


def dot(colour: str, label: str) -> Line2D:
    """Return a dot for a legend."""
    return Line2D([], [], color=colour, label=label, marker="o", linestyle="", markersize=5)


def band(label: str) -> Line2D:
    """Return a shaded band for a legend."""
    return Line2D([], [], color=BAND, label=label, linewidth=9)


def array(values: Any, never: float = np.nan) -> Array:
    """Return numbers that JSON has as lists; null, what is not finite, becomes `never`."""
    out = np.array(values, dtype=np.float64)
    return np.where(np.isnan(out), never, out)
