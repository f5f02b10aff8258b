"""The fit of a thruster curve as tables, a plot of characters, and a document."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from towtank.app.output import Output
from towtank.app.text_plot import text_plot
from towtank.digits import short
from towtank.vehicle import ThrusterFit, curve_force, curve_text

__all__ = ["fit_document", "show_fit"]


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
