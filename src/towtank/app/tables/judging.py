"""How models predict, as tables and parts of the document: several on the same logs, over folds, and their errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from towtank.app.terminal.output import Output
from towtank.digits import measured, percent, short
from towtank.recording import STANDARD
from towtank.validation.autocorrelation import Autocorrelation, Portmanteau
from towtank.validation.command_trace import CommandTrace
from towtank.validation.comparison import ChannelComparison, Comparison, Contest
from towtank.validation.cross_validation import CrossValidation, FoldedCoefficient
from towtank.validation.residuals import Residual
from towtank.validation.verdicts import CHANCE, follows

__all__ = [
    "comparison_document",
    "fold_document",
    "residual_document",
    "show_comparison",
    "show_folds",
    "show_residuals",
]

_ACROSS = 6  # channels beside each other in 80 columns


def show_comparison(found: Comparison, output: Output) -> None:
    """Print fit and error of every model on every channel, the best marked, and whether it really is the best."""
    letters = dict(zip(found.validations, _letters(len(found.validations)), strict=True))
    output.heading("Models on the same logs")
    for name, letter in letters.items():
        output.item(name, mark=letter)
    output.line()
    if not found.channels:
        output.line("nothing to compare with: no motion was measured")
        return
    table = output.table("Channel", "Model", ">Fit %", ">RMS error", "Unit", "")
    for channel, one in found.channels.items():
        for k, (name, letter) in enumerate(letters.items()):
            judged = found.validations[name]
            table.add_row(
                channel if k == 0 else "",
                letter,
                percent(judged.fit[channel]),
                short(judged.rmse[channel], 3),
                STANDARD[channel].unit,
                _words(one, name),
            )
    output.show(table)
    output.line()
    for name in found.validations:
        won = [channel for channel, one in found.channels.items() if one.best == name and one.decided]
        if won:
            output.item(f"{letters[name]} is really better on {' '.join(won)}")
    open_ = [channel for channel, one in found.channels.items() if not one.decided]
    if open_:
        output.item(f"no model is really better than all others on {' '.join(open_)}")


def _letters(count: int) -> list[str]:
    """Return A, B, .. Z, AA, AB, .."""
    return [(chr(64 + k // 26) if k >= 26 else "") + chr(65 + k % 26) for k in range(count)]


def _words(one: ChannelComparison, name: str) -> str:
    if name == one.best:
        return "best" if one.decided else "smallest error"
    contest = one.against[name]
    if contest.p is None:
        return "log too short to tell"
    if contest.p == 1.0 and contest.behind == 0.0:
        return "the same"
    return f"worse (p {_p(contest)})" if contest.real else f"no real difference (p {_p(contest)})"


def _p(contest: Contest) -> str:
    return "-" if contest.p is None else "< 0.001" if contest.p < 1e-3 else f"{contest.p:.2g}"


def comparison_document(found: Comparison) -> dict[str, Any]:
    """Return the comparison's part of the JSON document."""
    return {
        "models": list(found.validations),
        "fit": {name: judged.fit for name, judged in found.validations.items()},
        "rmse": {name: judged.rmse for name, judged in found.validations.items()},
        "channels": {
            channel: {
                "best": one.best,
                "decided": one.decided,
                "others": {
                    name: {"behind": contest.behind, "p": contest.p, "real": contest.real}
                    for name, contest in one.against.items()
                },
            }
            for channel, one in found.channels.items()
        },
    }


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
            one.name, value, claimed, short(one.spread, 2), one.unit, f"{known}/{one.values.size}", _fold_words(one)
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


def _fold_words(one: FoldedCoefficient) -> str:
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


def show_residuals(found: Mapping[str, Residual], output: Output) -> None:
    """Print what the errors of each channel are."""
    if not found:
        return
    output.heading("What the errors are")
    table = output.table(
        "Channel", ">Lasts s", ">± std", ">Slow", ">Noise", ">Constant", "Unit", ">Command", "One step"
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
