"""The figure of a thruster fit: what the bench measured and the curve through it, one colour per supply voltage.

matplotlib is imported on first use and draws without a display.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from towtank.digits import short
from towtank.outputs import write_atomically
from towtank.vehicle import ThrusterFit, curve_force

__all__ = ["thruster_figure"]

_CURVE_POINTS = 401


def thruster_figure(fit: ThrusterFit, path: Path) -> None:
    """Write the figure (.png, .svg or .pdf, by the suffix), whole or not at all. Raises InputError."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), layout="constrained", facecolor="white")
    axes = figure.subplots()
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, len(fit.voltages)))
    for each, colour in zip(fit.voltages, colours, strict=True):
        command = np.linspace(each.command.min(), each.command.max(), _CURVE_POINTS)
        label = "measured" if each.voltage is None else f"{short(each.voltage)} V"
        axes.plot(each.command, each.force, "o", color=colour, markersize=3.0, alpha=0.6, label=label)
        axes.plot(command, curve_force(fit.curve, command, each.voltage), "-", color=colour, linewidth=1.5)
    axes.axhline(0.0, color="#8a97a3", linewidth=0.8)
    axes.set_xlabel(fit.command_name)
    axes.set_ylabel("force [N]")
    axes.set_title(f"{fit.source}: measured (dots) and fitted (lines)", loc="left", fontsize=10)
    axes.legend(frameon=False)
    axes.grid(True, color="#dfe5ea", linewidth=0.6)
    kind = path.suffix.lower().removeprefix(".")
    write_atomically(path, lambda stream: figure.savefig(stream, format=kind, dpi=120))
