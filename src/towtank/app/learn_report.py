"""What was learned, as tables and as a document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from towtank.app.digits import measured, short
from towtank.app.fits_table import show_fits
from towtank.app.output import Output
from towtank.identification.logs import LogLearning

__all__ = ["learn_document", "show_learning"]

_VELOCITIES = ("u", "v", "w", "p", "q", "r")


def show_learning(
    learning: LogLearning,
    fit: Mapping[str, float | None],
    logs: Sequence[Path],
    warnings: Sequence[str],
    output: Output,
) -> None:
    """Print what was learned."""
    estimate = learning.estimate
    names = ", ".join(log.name for log in logs)
    output.line(f"{learning.vehicle.name} from {names}", "bold")
    output.line(f"{short(estimate.duration)} s, {estimate.samples} samples, method paper")
    _show_coefficients(learning, output)
    if estimate.sums:
        output.heading("Inertias as they move the vehicle (body and water together)")
        table = output.table("Sum", ">Value", ">± std", "Unit")
        for total in estimate.sums:
            table.add_row(total.name, *measured(total.value, total.std), total.unit)
        output.show(table)
    output.heading("Delay from command to thruster")
    scan = learning.delay_scan
    spread = "" if scan is None or scan.std != scan.std else f" ± {1e3 * scan.std:.1f}"
    output.line(f"{1e3 * learning.delay:.1f}{spread} ms ({'given' if scan is None else 'found by scanning'})")
    output.heading("Fit of the free-running prediction on these very logs")
    speeds = {name: fit.get(name) for name in _VELOCITIES}
    show_fits(speeds if any(value is not None for value in speeds.values()) else fit, None, output)
    if warnings:
        output.heading("Warnings")
        for text in warnings:
            output.item(text)


def _show_coefficients(learning: LogLearning, output: Output) -> None:
    learned = [each for each in learning.estimate.coefficients if each.identified]
    if learned:
        output.line()
        table = output.table("Coefficient", ">Value", ">± std", ">Before", "Unit")
        for each in learned:
            before = _before(learning, each.name)
            table.add_row(each.name, *measured(each.value, each.std), short(before), each.unit)
        output.show(table)
    reasons: dict[str, list[str]] = {}
    for each in learning.estimate.coefficients:
        if not each.identified:
            reasons.setdefault(each.reason or "no reason given", []).append(each.name)
    if reasons:
        output.heading("Not identified")
        for reason, names in reasons.items():
            output.item(f"{' '.join(names)}: {reason}")


def _before(learning: LogLearning, name: str) -> float | None:
    try:
        return learning.vehicle.coefficient(name)
    except ValueError:
        return None


def learn_document(learning: LogLearning, fit: Mapping[str, float | None], warnings: Sequence[str]) -> dict[str, Any]:
    """Return the part of the JSON document that learning fills."""
    estimate = learning.estimate
    return {
        "duration_s": estimate.duration,
        "samples": estimate.samples,
        "delay_s": learning.delay,
        "delay_std_s": None if learning.delay_scan is None else learning.delay_scan.std,
        "coefficients": {
            each.name: {
                "value": each.value,
                "std": each.std,
                "unit": each.unit,
                "identified": each.identified,
                "reason": each.reason,
            }
            for each in estimate.coefficients
        },
        "sums": {total.name: {"value": total.value, "std": total.std, "unit": total.unit} for total in estimate.sums},
        "fit": {**{name: fit.get(name) for name in _VELOCITIES}, **fit},
        "warnings": list(warnings),
    }
