"""Tables of a study, on the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text
from summary import Check, DelaySpread, Spread

__all__ = ["checks_table", "delays_table", "failures_text", "show", "spreads_table", "times_table"]


_SHOWN = 20  # failures


def show(*parts: RenderableType) -> None:
    """Print tables and lines."""
    console = Console(highlight=False)
    console.width = max(console.width, 130)
    for part in parts:
        console.print(part)


def spreads_table(title: str, found: Sequence[Spread]) -> Group:
    """RMSE beside the bound, bias and coverage, one row for each time and quantity."""
    table = Table()
    for name in ("quantity", "t s", "RMSE %", "bound %", "RMSE/bound", "stated %", "bias %", "in 95 %", "identified"):
        table.add_column(name, justify="left" if name == "quantity" else "right", no_wrap=True)
    for s in found:
        table.add_row(
            s.name, f"{s.t:g}", _percent(s.rmse), _percent(s.bound), _number(s.ratio, 2), _percent(s.stated),
            f"{_percent(s.bias, sign=True)} ± {_percent(s.bias_std)}", _number(s.coverage, 3),
            f"{s.identified}/{s.runs}",
        )  # fmt: skip
    return Group(Text(f"\n{title}", style="bold"), table)


def delays_table(title: str, found: Sequence[DelaySpread]) -> Group:
    """How the delay came out, one row for each time."""
    table = Table()
    for name in ("t s", "RMSE ms", "bound ms", "bias ms", "near enough"):
        table.add_column(name, justify="right", no_wrap=True)
    for d in found:
        rmse, bound, bias = (f"{1e3 * each:.1f}" for each in (d.rmse, d.bound, d.bias))
        table.add_row(f"{d.t:g}", rmse, bound, bias, f"{100.0 * d.within:.0f} %")
    return Group(Text(f"\n{title}", style="bold"), table)


def times_table(title: str, rows: Sequence[tuple[str, float, float, float, float]]) -> Group:
    """Rows of experiment, median and 90th percentile of t5, and those of an estimator that is at the bound."""
    table = Table()
    table.add_column("experiment", no_wrap=True)
    for name in ("median s", "90 % s", "at the bound: median s", "90 % s"):
        table.add_column(name, justify="right", no_wrap=True)
    for name, *times in rows:
        table.add_row(name, *(_seconds(each) for each in times))
    return Group(Text(f"\n{title}", style="bold"), table)


def checks_table(title: str, checks: Sequence[Check]) -> Group:
    """What must hold, and whether it does."""
    table = Table()
    for name in ("figure", "measured", "must hold", "", "compared with"):
        table.add_column(name, justify="right" if name in ("measured", "must hold") else "left", no_wrap=True)
    for check in checks:
        verdict = "[green]pass[/]" if check.met else "[bold red]FAIL[/]"
        table.add_row(check.name, _number(check.value), _limits(check), verdict, check.note)
    return Group(Text(f"\n{title}", style="bold"), table)


def failures_text(failed: Sequence[Mapping[str, Any]], runs: int) -> Text:
    """Say how many runs were not sound, and show the first of them."""
    if not failed:
        return Text(f"{runs} runs, none with an exception, a NaN or a divergence")
    lines = [f"{f['experiment']} seed {f['seed']} {f['mode']}: {f['failure']}" for f in failed[:_SHOWN]]
    return Text("\n".join([*lines, f"{len(failed)} of {runs} runs FAILED"]))


def _limits(check: Check) -> str:
    if math.isinf(check.low):
        return f"<= {check.high:g}"
    return f">= {check.low:g}" if math.isinf(check.high) else f"{check.low:g} .. {check.high:g}"


def _number(value: float, digits: int | None = None) -> str:
    if not math.isfinite(value):
        return "never" if math.isinf(value) else "-"
    return f"{value:.4g}" if digits is None else f"{value:.{digits}f}"


def _percent(share: float, *, sign: bool = False) -> str:
    if not math.isfinite(share):
        return "-"
    return f"{100.0 * share:+.3g}" if sign else f"{100.0 * share:.3g}"


def _seconds(t: float) -> str:
    return "never" if math.isinf(t) else "-" if math.isnan(t) else f"{t:.2f}"
