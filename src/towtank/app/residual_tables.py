"""What the errors of a prediction are, as a table, a sentence per channel, and a part of the document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from towtank.app.output import Output
from towtank.digits import measured, short
from towtank.recording import STANDARD
from towtank.validation.autocorrelation import Autocorrelation, Portmanteau
from towtank.validation.command_trace import CommandTrace
from towtank.validation.residuals import Residual
from towtank.validation.verdicts import CHANCE, follows

__all__ = ["residual_document", "show_residuals"]


def show_residuals(found: Mapping[str, Residual], output: Output) -> None:
    """Print what the errors of each channel are."""
    if not found:
        return
    output.heading("What the errors are")
    table = output.table(
        "Channel", ">Last for s", ">± std", ">Slow", ">Noise", ">Constant", "Unit", ">Command", "One step"
    )
    for name, one in found.items():
        lasts = ("-", "") if one.time is None else measured(one.time, one.time_std)
        slow = short(one.memory.slow, 2) if one.memory is not None and one.time is not None else "-"
        noise = "-" if one.memory is None else ("" if one.memory.noise_known else "< ") + short(one.memory.white, 2)
        constant = "-" if one.memory is None else short(one.memory.bias, 2)
        table.add_row(
            name, *lasts, slow, noise, constant, STANDARD[name].unit, _command(one.command), _colour(one.one_step_test)
        )
    output.show(table)
    output.line()
    for one in found.values():
        output.item(one.verdict.text)


def _command(trace: CommandTrace | None) -> str:
    """Return the share of the errors that follows the command, "-" where it was not commanded."""
    if trace is None:
        return "-"
    return f"{100.0 * trace.share:.0f} %" if follows(trace) else "no"


def _colour(test: Portmanteau | None) -> str:
    if test is None:
        return "-"
    return "white" if test.p >= CHANCE else "coloured"


def residual_document(found: Mapping[str, Residual]) -> dict[str, Any]:
    """Return the errors' part of the JSON document."""
    return {name: _document(one) for name, one in found.items()}


def _document(one: Residual) -> dict[str, Any]:
    memory, command = one.memory, one.command
    return {
        "samples": one.samples,
        "verdict": one.verdict.kind,
        "text": one.verdict.text,
        "correlation_time_s": one.time,
        "correlation_time_std_s": one.time_std,
        "slow": None if memory is None or one.time is None else memory.slow,
        "noise": None if memory is None else memory.white,
        "constant": None if memory is None else memory.bias,
        "free_running": _correlation(one.free, one.free_test),
        "one_step": _correlation(one.one_step, one.one_step_test),
        "command": None
        if command is None
        else {
            "p": command.p,
            "share": command.share,
            "lag_s": command.lag,
            "correlation": command.correlation,
            "band_95": command.band,
        },
    }


def _correlation(found: Autocorrelation, test: Portmanteau | None) -> dict[str, Any]:
    return {
        "ljung_box": None if test is None else {"statistic": test.statistic, "lags": test.lags, "p": test.p},
        "lag_s": found.lag,
        "autocorrelation": found.value,
        "band_95": found.band,
    }
