"""Several models on the same logs: which predicts best, and whether that is more than chance; cross-validation.

In cross-validation every window is predicted by a model that has not seen it, with coefficients over the folds.
"""

from __future__ import annotations

import math

from towtank.digits import measured, percent, short
from towtank.printable import escaped
from towtank.recording.standard import STANDARD
from towtank.report.elements import Cell, bullets, cell, number, paragraph, section, table, unit_text
from towtank.report.verdict import NAMES
from towtank.validation import ChannelComparison, Comparison, CrossValidation

__all__ = ["comparison_section", "fold_section"]


def comparison_section(found: Comparison | None) -> str:
    """Return fit and error of every model on every channel; nothing where there is one model only."""
    if found is None:
        return ""
    rows: list[list[Cell]] = []
    for channel, one in found.channels.items():
        rows.append([cell(f"<b>{channel}</b> {NAMES[channel]}, {unit_text(STANDARD[channel].unit)}")])
        for name, judged in found.validations.items():
            place = name.replace("~", "~0").replace("/", "~1")  # as in a JSON pointer
            fit, error = judged.fit[channel], judged.rmse[channel]
            rows.append(
                [
                    cell(escaped(name), "name"),
                    cell(number(fit, percent(fit), key=f"comparison/fit/{place}/{channel}"), "n"),
                    cell(number(error, short(error, 3), key=f"comparison/rmse/{place}/{channel}"), "n"),
                    cell(_words(one, name)),
                ]
            )
    note = (
        "Two models are told apart by their errors at the same instants, summed over blocks longer than the errors "
        "remember; p is the probability that chance alone made such a difference."
    )
    return section(
        "comparison",
        "Models on the same logs",
        paragraph(note, "note"),
        table(["Model", ">Fit %", ">RMS error", ""], rows),
    )


def _words(one: ChannelComparison, name: str) -> str:
    if name == one.best:
        tag = "best" if one.decided else "smallest error"
        return f'<span class="tag {"good" if one.decided else ""}">{tag}</span>'
    contest = one.against[name]
    if contest.p is None:
        return "log too short to tell"
    if contest.p == 1.0 and contest.behind == 0.0:
        return "the same"
    p = "&lt; 0.001" if contest.p < 1e-3 else f"{contest.p:.2g}"
    return f"{'worse' if contest.real else 'no real difference'} (p {p})"


def fold_section(found: CrossValidation | None) -> str:
    """Return fits of the windows and spread of the coefficients; nothing where there was no cross-validation."""
    if found is None:
        return ""
    channels = [name for name, fit in found.scores.fit.items() if fit is not None]
    several = len({k for fold in found.folds for k, _, _ in fold.windows}) > 1
    rows: list[list[Cell]] = []
    for k, fold in enumerate(found.folds):
        where = ", ".join(
            (f"log {log + 1}: " if several else "") + f"{short(start)} to {short(end)} s"
            for log, start, end in fold.windows
        )
        key = f"cross_validation/folds/{k}/fit"
        rows.append([cell(escaped(where)), *(_fit(fold.fit[name], f"{key}/{name}") for name in channels)])
    rows.append([cell("<b>all windows</b>"), *(_fit(found.scores.fit[name], f"fit/{name}") for name in channels)])
    key = "cross_validation/fit_seen"
    rows.append([cell("seen while learning"), *(_fit(found.seen.fit[name], f"{key}/{name}") for name in channels)])
    note = "Fit in percent of each window, by a model learned on all the others."
    return section(
        "folds",
        "Cross-validation",
        paragraph(note, "note"),
        table(["Window", *(f">{name}" for name in channels)], rows),
        bullets(fold.note for fold in found.folds if fold.note),
        _coefficients(found),
    )


def _fit(value: float | None, key: str) -> Cell:
    return cell(number(value, percent(value), key=key), "n")


def _coefficients(found: CrossValidation) -> str:
    rows: list[list[Cell]] = []
    for one in found.coefficients:
        value, claimed = measured(one.value, one.claimed)
        known = sum(math.isfinite(each) for each in one.values)
        word = (
            "too few folds" if not math.isfinite(one.spread) else "spreads more" if one.overconfident else "as claimed"
        )
        key = f"cross_validation/coefficients/{one.name}"
        rows.append(
            [
                cell(escaped(one.name), "name"),
                cell(number(one.value, value, key=f"{key}/value"), "n"),
                cell(number(one.claimed, claimed, key=f"{key}/std"), "n"),
                cell(number(one.spread, short(one.spread, 2), key=f"{key}/folds_std"), "n"),
                cell(unit_text(one.unit), "u"),
                cell(f"{known} of {one.values.size}", "n"),
                cell(f'<span class="tag {"fair" if one.overconfident else ""}">{word}</span>'),
            ]
        )
    if not rows:
        return ""
    heads = ["Coefficient", ">Value", ">Claimed ±", ">Over folds ±", "Unit", ">Known in", ""]
    return "<h3>Coefficients over the folds</h3>" + table(heads, rows)
