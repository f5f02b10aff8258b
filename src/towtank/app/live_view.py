"""A live session on the terminal: coefficients as they settle; plain lines every few seconds where it is piped."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

from rich.console import Group
from rich.live import Live
from rich.text import Text

from towtank.app.live_table import clock, coefficient_rows, event_line, likely_line, link_lines, measures
from towtank.app.output import Output
from towtank.app.spark import spark
from towtank.live.status import Status
from towtank.vehicle import Vehicle

__all__ = ["LiveView"]

_EVENTS = 3  # that are shown
_LINE = 5.0  # s between two plain lines
_SPARK, _LONGEST = 12, 480  # characters; values kept of a course
_SURE, _FAIR = 0.05, 0.2  # relative deviations that are shown in green, in yellow


class LiveView:
    """Shows a session on a console."""

    def __init__(self, output: Output, vehicle: Vehicle, method: str) -> None:
        self._output, self._console = output, output.console
        self._title = f"{vehicle.name}, method {method}"
        self._told = time.monotonic()
        self._courses: dict[str, list[float]] = {}

    @contextlib.contextmanager
    def showing(self) -> Iterator[Callable[[Status], None] | None]:
        """Yield a function that shows a status."""
        if self._output.json:
            yield None
        elif not self._console.is_terminal:
            yield self._line
        else:
            with Live(console=self._console, auto_refresh=False, vertical_overflow="crop", transient=True) as live:
                yield lambda status: live.update(self.picture(status), refresh=True)

    def picture(self, status: Status) -> Group:
        """Return the whole view: how things stand, and the coefficients."""
        learnt = status.learnt
        parts: list[object] = [
            Text.assemble((self._title, "bold"), f"  {clock(status.elapsed)}", ("   Ctrl-C ends", "dim"))
        ]
        parts += [Text(f"! {text}", style="yellow") for text in status.warnings]
        parts += [Text(line, overflow="ellipsis", no_wrap=True) for line in measures(status)]
        parts += [Text(line, style="dim", overflow="ellipsis", no_wrap=True) for line in link_lines(status)]
        rows, rest = coefficient_rows(learnt, ascii_only=self._output.ascii)
        parts.append(Text())
        header = ">Estimate +- std" if self._output.ascii else ">Estimate ± std"
        table = self._output.table("Coefficient", header, ">Rel. std", "Unit", "Course")
        courses = self._followed(status)
        relative = [
            each.std / abs(each.value) for each in learnt.estimate.coefficients if each.identified and each.value
        ]
        styles = ["green" if x <= _SURE else "yellow" if x <= _FAIR else "dim" for x in relative]
        for k, row in enumerate(rows):
            course = spark(courses[row[0]], _SPARK, ascii_only=self._output.ascii)
            table.add_row(*row, course, style=styles[k] if len(styles) == len(rows) else "")
        parts.append(table if rows else Text("no coefficient is known yet", style="dim"))
        if rest:
            names = ", ".join(name for group in rest.values() for name in group)
            parts.append(Text(f"not known: {names}", style="dim"))
        if status.events:
            parts.append(Text())
        for event in status.events[-_EVENTS:]:
            line = event_line(event, status.epoch, ascii_only=self._output.ascii)
            parts.append(Text(line, style="bold"))
        if learnt.likely:
            parts.append(Text(likely_line(learnt.likely)))
        return Group(*parts)  # type: ignore[arg-type]

    def _followed(self, status: Status) -> dict[str, list[float]]:
        """Return the course of every coefficient that is identified, thinned where it becomes long."""
        for each in status.learnt.estimate.coefficients:
            if each.identified:
                course = self._courses.setdefault(each.name, [])
                course.append(each.value)
                if len(course) > _LONGEST:
                    del course[::2]
        return self._courses

    def _line(self, status: Status) -> None:
        now = time.monotonic()
        if now - self._told < _LINE:
            return
        self._told = now
        rows, _ = coefficient_rows(status.learnt, ascii_only=self._output.ascii)
        known = ", ".join(f"{name} {estimate}" for name, estimate, _, _ in rows) or "no coefficient known yet"
        rates = sum(sum(each.state.rates.values()) for each in status.sources)
        lost = f"; dropped {status.dropped}, late {status.late}, bad {status.bad}"
        self._output.verbatim(f"{clock(status.elapsed)}  {rates:.0f} Hz{lost}; {known}")
        for text in status.warnings:
            self._output.verbatim(f"  ! {text}")
