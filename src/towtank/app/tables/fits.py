"""Fits of a free-running prediction as a table with bars."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from towtank.app.terminal.output import Output
from towtank.digits import percent, short
from towtank.recording import STANDARD
from towtank.recording.axes import judged_by
from towtank.report.verdict import usable_text
from towtank.validation import Usability

__all__ = ["show_fits", "show_own_fits", "usable_document"]

_POSITIONS = ("x", "y", "z")
_BAR = 20  # characters
WORSE = "worse than the mean"


def show_fits(
    fit: Mapping[str, float | None],
    rmse: Mapping[str, float | None] | None,
    output: Output,
    errors: Mapping[str, str] | None = None,
) -> None:
    """Print the fit [%] of every channel that was measured, and its error where `rmse` is given.

    Args:
        errors: spark lines of the errors over time.
    """
    measured = {name: value for name, value in fit.items() if value is not None}
    if not measured:
        output.line("nothing to compare with: no motion was measured")
        return
    columns = ("Channel", ">Fit %", "") if rmse is None else ("Channel", ">Fit %", "", ">RMS error", "Unit")
    table = output.table(*columns, *(() if errors is None else ("Error over time",)))
    for name, value in measured.items():
        row = [name, percent(value), output.bar(value / 100.0).ljust(_BAR) if value >= 0.0 else WORSE]
        if rmse is not None:
            row += [short(rmse.get(name), 3), STANDARD[name].unit]
        if errors is not None:
            row.append(errors.get(name, ""))
        table.add_row(*row)
    output.show(table)


def show_own_fits(fit: Mapping[str, float | None], output: Output) -> None:
    """Print the fit [%] to what was learned from: of each axis its speed, or its pose where no speed is measured."""
    shown = {name: fit[name] for name in judged_by([name for name, value in fit.items() if value is not None])}
    show_fits(shown, None, output)
    if any((shown.get(name) or 0.0) < 0.0 for name in _POSITIONS):
        output.line("Errors of position add up every push of the water, whatever the model:", "dim")
        output.line("towtank validate --horizon 10 restarts the prediction from the measurement every 10 s.", "dim")


def usable_document(use: Usability | None) -> dict[str, Any] | None:
    """Return for how long a model predicts, for a JSON document; `seconds` is null for whole recordings."""
    if use is None:
        return None
    return {
        "grade": usable_text(use).grade,
        "text": usable_text(use).text,
        "axes": {
            each.axis: {
                "channel": each.channel,
                "usable": each.seconds > 0.0,
                "seconds": None if math.isinf(each.seconds) else each.seconds,
                "fit": each.fit,
            }
            for each in use.axes
        },
        "undriven": use.undriven,
        "unmeasured": use.unmeasured,
    }
