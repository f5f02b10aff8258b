"""Several models on the same logs, as a table and a part of the document."""

from __future__ import annotations

from typing import Any

from towtank.app.output import Output
from towtank.digits import percent, short
from towtank.recording import STANDARD
from towtank.validation.comparison import ChannelComparison, Comparison, Contest

__all__ = ["comparison_document", "show_comparison"]


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
