"""What the demo shows while it learns: a table on a terminal, plain lines anywhere else."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from towtank.app.demo.progress import SETTLED, SETTLING, WAITING, LearningCurve
from towtank.app.demo.stream import Moment
from towtank.app.live.view import event_line
from towtank.app.terminal.spark import spark
from towtank.digits import estimate_text, short
from towtank.simulation.tank import ALL, Session

__all__ = ["Screen", "coefficient_table"]

_STYLES = {WAITING: "dim", SETTLING: "yellow", SETTLED: "green"}
_BAR = 30
_SPARK, _EVENTS = 8, 3  # characters; events that are shown


def coefficient_table(curve: LearningCurve, axis: str = "", *, ascii_only: bool = False, final: bool = False) -> Table:
    """Return the table of coefficients; the rows of `axis` are marked as being excited.

    Args:
        final: errors in deviations in place of states.
    """
    box = None if ascii_only else SIMPLE_HEAD
    table = Table(box=box, pad_edge=False, padding=(0, int(ascii_only), 0, 0), show_edge=False, header_style="bold")
    table.add_column("", width=1)
    table.add_column("Coefficient", no_wrap=True, min_width=12)
    table.add_column("Unit", no_wrap=True)
    table.add_column("Truth", justify="right", no_wrap=True, min_width=7)
    table.add_column("Estimate +- std" if ascii_only else "Estimate ± std", justify="right", no_wrap=True, min_width=15)
    table.add_column("Error %", justify="right", no_wrap=True, min_width=7)
    if final:
        table.add_column("in std", justify="right", no_wrap=True, min_width=6)
    table.add_column("Course", no_wrap=True, min_width=_SPARK)
    if not final:
        table.add_column("State", no_wrap=True, min_width=8)
    for i, ((quantity, value, std), state) in enumerate(zip(curve.latest(), curve.states, strict=True)):
        known = value == value
        style = _STYLES[state]
        excited = axis in quantity.axes
        table.add_row(
            (">" if ascii_only else "▸") if excited else "",
            Text(quantity.name, style="bold" if excited else ""),
            Text(quantity.unit, style="dim"),
            short(quantity.truth, 5),
            Text(estimate_text(value, std, ascii_only=ascii_only), style=style if known else "dim"),
            f"{100.0 * (value / quantity.truth - 1.0):+.2f}" if known and quantity.truth else "",
            *([f"{abs(value - quantity.truth) / std:.1f}" if known else ""] if final else []),
            spark([row[i] for row in curve.values], _SPARK, ascii_only=ascii_only),
            *([] if final else [Text(state, style=style)]),
        )
    return table


class Screen:
    """Shows the stream on a console: live where it is a terminal, else a line at the end of every axis' turn."""

    def __init__(self, console: Console, session: Session) -> None:
        self.console = console
        self.session = session
        self.ascii_only = not console.encoding.lower().startswith("utf")
        self._printed = 0

    @contextlib.contextmanager
    def showing(self) -> Iterator[Callable[[Moment], None]]:
        """Yield a function that shows a moment."""
        if not self.console.is_terminal:
            yield self._line
            return
        with Live(console=self.console, auto_refresh=False, vertical_overflow="crop") as live:
            yield lambda moment: live.update(self._picture(moment), refresh=True)

    def _picture(self, moment: Moment) -> Group:
        axis = self.session.axis_at(moment.t)
        table = coefficient_table(moment.curve, axis, ascii_only=self.ascii_only)
        return Group(table, Text(), *self._events(moment), self._where(moment, axis), self._speed(moment))

    def _events(self, moment: Moment) -> list[Text]:
        """Return what the learner noticed last."""
        events = moment.curve.events[-_EVENTS:]
        return [Text(event_line(event, math.nan, ascii_only=self.ascii_only), style="bold") for event in events]

    def _where(self, moment: Moment, axis: str) -> Text:
        full = round(_BAR * moment.t / moment.end)
        done, rest = ("#", ".") if self.ascii_only else ("━", "─")
        doing = "finished" if moment.t >= moment.end else f"exciting {axis}" if axis else "back to the middle"
        left = f"{moment.t:.0f} of {moment.end:.0f} s, {moment.end - moment.t:.0f} s to go"
        return Text.assemble((done * full, "green"), (rest * (_BAR - full), "dim"), f" {left}: ", (doing, "bold"))

    def _speed(self, moment: Moment) -> Text:
        latency = moment.latency_ms
        return Text(
            f"{moment.samples} samples, {moment.rate:.0f} a second; one update takes {short(latency['median'], 2)} ms "
            f"(99 %: {short(latency['p99'], 2)} ms)",
            style="dim",
        )

    def _line(self, moment: Moment) -> None:
        """Print what the turns that have ended since the last call have shown."""
        latest = {quantity.name: (quantity, value, std) for quantity, value, std in moment.curve.latest()}
        while self._printed < len(self.session.turns) and moment.t >= self.session.turns[self._printed][2] - 1e-9:
            axis, _, end = self.session.turns[self._printed]
            self._printed += 1
            parts = [
                f"{name} {estimate_text(value, std, ascii_only=self.ascii_only)}"
                for name, (quantity, value, std) in latest.items()
                if axis in quantity.axes or axis == ALL
            ]
            self.console.print(Text(f"{end:5.0f} s  {axis:<6} {', '.join(parts)}"), soft_wrap=True)
        if moment.t >= moment.end:
            for line in self._events(moment):
                self.console.print(line)
            self.console.print()
            self.console.print(coefficient_table(moment.curve, ascii_only=self.ascii_only))
            self.console.print()
            self.console.print(self._speed(moment))
