"""Several models on the same logs: which predicts best, and whether that is more than chance."""

from __future__ import annotations

from html import escape

from towtank.digits import percent, short
from towtank.recording.standard import STANDARD
from towtank.report.elements import Cell, cell, number, paragraph, section, table, unit_text
from towtank.report.verdict import NAMES
from towtank.validation import ChannelComparison, Comparison

__all__ = ["comparison_section"]


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
                    cell(escape(name), "name"),
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
