"""The fit of a thruster curve as tables, a plot of characters, a document, and a figure of the bench's points.

matplotlib is imported on first use and draws without a display.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from towtank.app.terminal.output import Output
from towtank.core.arrays import Array
from towtank.digits import short
from towtank.outputs import write_atomically
from towtank.vehicle import ThrusterFit, curve_force, curve_text

__all__ = ["fit_document", "show_fit", "text_plot", "thruster_figure"]

_WIDTH, _HEIGHT = 60, 15
_MARGIN = 9
_CURVE_POINTS = 401


def text_plot(points: tuple[Array, Array], curve: tuple[Array, Array], *, x_name: str, y_name: str) -> list[str]:
    """Return the lines of a plot, 70 characters wide.

    Args:
        points: x (n,) and y (n,), drawn as `o`. curve: x (m,) and y (m,), drawn as `.` beneath the points.
    """
    x = np.concatenate([points[0], curve[0]])
    y = np.concatenate([points[1], curve[1]])
    left, right = float(x.min()), float(x.max())
    low, high = float(min(y.min(), 0.0)), float(max(y.max(), 0.0))
    if not (right > left and high > low):
        return []
    canvas = [[" "] * _WIDTH for _ in range(_HEIGHT)]
    zero = _place(0.0, low, high, _HEIGHT)
    canvas[zero] = ["-"] * _WIDTH
    for (xs, ys), sign in ((curve, "."), (points, "o")):
        for px, py in zip(xs, ys, strict=True):
            canvas[_place(py, low, high, _HEIGHT)][_place(px, left, right, _WIDTH)] = sign
    labels = {_HEIGHT - 1: high, 0: low, zero: 0.0}
    lines = [f"{y_name:>{_MARGIN}}"]
    for row in reversed(range(_HEIGHT)):
        label = f"{labels[row]:.4g}" if row in labels else ""
        lines.append(f"{label:>{_MARGIN}} |{''.join(canvas[row])}".rstrip())
    ends = f"{left:.5g}", f"{right:.5g}"
    room = _WIDTH - len(ends[0]) - len(ends[1])
    lines.append(f"{'':>{_MARGIN}}  {ends[0]}{x_name:^{room}}{ends[1]}")
    return lines


def _place(value: float, low: float, high: float, cells: int) -> int:
    return int(np.clip(round((value - low) / (high - low) * (cells - 1)), 0, cells - 1))


def show_fit(fit: ThrusterFit, output: Output) -> None:
    """Print the fit."""
    at = "" if fit.nominal_voltage is None else f" at {short(fit.nominal_voltage)} V"
    output.line(f"Thruster curve fitted to {fit.source}{at}", "bold")
    table = output.table("Direction", ">Samples", ">R²", ">RMS error N", ">Largest N")
    for name, direction in (("forward", fit.forward), ("reverse", fit.reverse)):
        if direction is not None:
            row = (direction.samples, f"{direction.r_squared:.4f}", short(direction.rmse, 3))
            table.add_row(name, *map(str, row), short(direction.largest_force))
    output.show(table)
    if fit.dead_band is not None:
        output.line(f"no force for {fit.command_name} {short(fit.dead_band[0])} to {short(fit.dead_band[1])}")
    if fit.asymmetry is not None:
        output.line(f"forward pushes {short(fit.asymmetry, 3)} times as hard as reverse")
    _show_voltages(fit, output)
    _show_plot(fit, output)
    output.heading("In a vehicle file, under [[thrusters]]:")
    output.verbatim(curve_text(fit.curve))


def _show_voltages(fit: ThrusterFit, output: Output) -> None:
    if len(fit.voltages) < 2:
        return
    law = fit.curve.voltage
    if law is not None:
        back = "" if law.reverse_exponent is None else f", reverse {short(law.reverse_exponent, 3)}"
        output.line(f"force grows with the supply voltage to the power of {short(law.exponent, 3)}{back}")
    table = output.table(">Supply V", "No force", ">Forward N", ">Reverse N", ">RMS error N")
    for each in fit.voltages:
        band = "-" if each.dead_band is None else f"{short(each.dead_band[0])} .. {short(each.dead_band[1])}"
        table.add_row(
            short(each.voltage), band, short(each.largest_forward), short(each.largest_reverse), short(each.rmse, 3)
        )
    output.show(table)


def _show_plot(fit: ThrusterFit, output: Output) -> None:
    nominal = min(fit.voltages, key=lambda each: abs((each.voltage or 0.0) - (fit.nominal_voltage or 0.0)))
    x = np.linspace(nominal.command.min(), nominal.command.max(), 241)
    curve = x, curve_force(fit.curve, x, nominal.voltage)
    lines = text_plot((nominal.command, nominal.force), curve, x_name=fit.command_name, y_name="force N")
    if lines:
        output.heading("o measured, . fitted")
        output.verbatim("\n".join(lines))


def fit_document(fit: ThrusterFit) -> dict[str, Any]:
    """Return the JSON document of a fit."""
    return {
        "bench": fit.source,
        "command": fit.command_name,
        "curve": fit.curve.model_dump(exclude_none=True),
        "toml": curve_text(fit.curve),
        "nominal_voltage": fit.nominal_voltage,
        "dead_band": fit.dead_band,
        "asymmetry": fit.asymmetry,
        "rmse": fit.rmse,
        "forward": None if fit.forward is None else asdict(fit.forward),
        "reverse": None if fit.reverse is None else asdict(fit.reverse),
        "voltages": [
            {
                "voltage": each.voltage,
                "samples": each.command.size,
                "dead_band": each.dead_band,
                "largest_forward": each.largest_forward,
                "largest_reverse": each.largest_reverse,
                "rmse": each.rmse,
            }
            for each in fit.voltages
        ],
    }


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
