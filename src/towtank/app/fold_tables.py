"""Cross-validation over windows, as tables and a part of the document."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from towtank.app.output import Output
from towtank.digits import measured, percent, short
from towtank.validation.cross_validation import CrossValidation, FoldedCoefficient

__all__ = ["fold_document", "show_folds"]

_ACROSS = 6  # channels beside each other in 80 columns


def show_folds(found: CrossValidation, logs: Sequence[Path], output: Output) -> None:
    """Print the fit of each window by a model that has not seen it, and the coefficients over the folds."""
    output.heading("Fit % of each window, learned on the others")
    if len(logs) > 1:
        for k, log in enumerate(logs):
            output.item(log.name, mark=f"log {k + 1}:")
        output.line()
    channels = [name for name, fit in found.scores.fit.items() if fit is not None]
    for first in range(0, len(channels), _ACROSS):
        _show_fits(found, len(logs) > 1, channels[first : first + _ACROSS], output)
    for fold in found.folds:
        if fold.note:
            output.item(fold.note)
    if not found.coefficients:
        output.line("no coefficient was identified")
        return
    output.heading("Coefficients")
    table = output.table("Coefficient", ">Value", ">Claimed ±", ">Folds ±", "Unit", ">Known in", "")
    for one in found.coefficients:
        known = sum(math.isfinite(value) for value in one.values)
        value, claimed = measured(one.value, one.claimed)
        table.add_row(
            one.name, value, claimed, short(one.spread, 2), one.unit, f"{known}/{one.values.size}", _words(one)
        )
    output.show(table)


def _show_fits(found: CrossValidation, several: bool, channels: Sequence[str], output: Output) -> None:
    table = output.table("Window s", *(f">{name}" for name in channels), wrap="Window s")
    for fold in found.folds:
        windows = [
            (f"log {k + 1}: " if several else "") + f"{short(start)} to {short(end)}" for k, start, end in fold.windows
        ]
        table.add_row(", ".join(windows), *(percent(fold.fit[name]) for name in channels))
    table.add_section()
    table.add_row("all windows", *(percent(found.scores.fit[name]) for name in channels))
    table.add_row("seen while learning", *(percent(found.seen.fit[name]) for name in channels))
    output.show(table)


def _words(one: FoldedCoefficient) -> str:
    if not math.isfinite(one.spread):
        return "too few folds"
    return "spreads more" if one.overconfident else "as claimed"


def fold_document(found: CrossValidation, logs: Sequence[Path]) -> dict[str, Any]:
    """Return the part of the JSON document that cross-validation fills."""
    return {
        "folds": [
            {
                "windows": [{"log": logs[k], "window": [start, end]} for k, start, end in fold.windows],
                "fit": fold.fit,
                "rmse": fold.rmse,
                "note": fold.note or None,
            }
            for fold in found.folds
        ],
        "fit_seen": found.seen.fit,
        "coefficients": {
            one.name: {
                "value": one.value,
                "std": one.claimed,
                "unit": one.unit,
                "folds": one.values,
                "folds_std": one.spread,
                "p": one.p,
                "overconfident": one.overconfident,
            }
            for one in found.coefficients
        },
    }
