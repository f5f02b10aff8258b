"""A live session on the terminal: coefficients as they settle; plain lines every few seconds where it is piped."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping

from rich.console import Group
from rich.live import Live
from rich.text import Text

from towtank.app.terminal.output import Output
from towtank.app.terminal.spark import spark
from towtank.digits import estimate_text, short
from towtank.live.learning import Learnt
from towtank.live.status import SourceStatus, Status
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["LiveView", "coefficient_rows", "event_line", "likely_line", "link_lines", "measures"]

_SURE = 1e-9
_MOST_RATES = 6
_MOST_LIKELY, _HARDLY = 3, 0.005
_ASCII = str.maketrans({"±": "+-", "−": "-", "²": "^2"})
_EVENTS = 3  # that are shown
_LINE = 5.0  # s between two plain lines
_SPARK, _LONGEST = 12, 480  # characters; values kept of a coefficient
_SURE_OF_TABLE, _FAIR = 0.05, 0.2  # relative deviations that are shown in green, in yellow


def clock(seconds: float) -> str:
    """Return a duration as 1:02:03."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def coefficient_rows(
    learnt: Learnt, *, ascii_only: bool = False
) -> tuple[list[tuple[str, str, str, str]], dict[str, list[str]]]:
    """Return name, estimate, relative deviation and unit of what is identified; and reason -> names of what is not."""
    rows, rest = [], dict[str, list[str]]()
    for each in learnt.estimate.coefficients:
        if not each.identified:
            rest.setdefault(each.reason or "not known yet", []).append(each.name)
            continue
        relative = 100.0 * each.std / abs(each.value) if abs(each.value) > _SURE else math.inf
        share = f"{short(relative, 2)} %" if relative < 1000.0 else "-"
        rows.append((each.name, estimate_text(each.value, each.std, ascii_only=ascii_only), share, each.unit))
    return rows, rest


def measures(status: Status) -> list[str]:
    """Return lines on delay, excitation, latency, losses and the recording."""
    learnt, recording = status.learnt, status.recording
    delay = "delay not known yet" if math.isnan(learnt.delay) else f"delay {1e3 * learnt.delay:.1f} ms"
    lag = "" if math.isnan(learnt.lag) else f", lag {1e3 * learnt.lag:.0f} ms"
    lines = [f"{status.samples} samples, {delay}{lag}"]
    if learnt.excitation:
        force = " ".join(f"{name} {short(x, 2)}" for name, x in zip("XYZ", learnt.excitation[:3], strict=True))
        moment = " ".join(f"{name} {short(x, 2)}" for name, x in zip("KMN", learnt.excitation[3:], strict=True))
        lines.append(f"asked for (rms, 10 s): {force} N, {moment} N m")
    total, own = learnt.latency, learnt.processing
    if not math.isnan(total["median"]):
        lines.append(
            f"latency {short(total['median'], 3)} ms (99 %: {short(total['p99'], 3)}), "
            f"of it computing {short(own['median'], 2)} ms (99 %: {short(own['p99'], 2)})"
        )
    lines.append(f"dropped {status.dropped}, late {status.late}, bad {status.bad}, waiting {status.waiting}")
    if recording is not None:
        state = f"lost {recording.lost}" if recording.lost else "nothing lost"
        lines.append(f"recording {recording.path.name}: {_size(recording.size)}, {state}")
    return lines


def event_line(event: Event, epoch: float, *, ascii_only: bool = False) -> str:
    """Return what happened, after the time of day.

    Args:
        epoch: Unix time [s] of the session's time 0; where it is NaN the session's own time is shown.
    """
    when = clock(event.t) if math.isnan(epoch) else time.strftime("%H:%M:%S", time.localtime(epoch + event.t))
    text = f"{when}  {event.text}"
    return text.translate(_ASCII).encode("ascii", "replace").decode() if ascii_only else text


def likely_line(likely: Mapping[str, float]) -> str:
    """Return how probable each known configuration is, the most probable first."""
    ranked = sorted(likely.items(), key=lambda pair: -pair[1])[:_MOST_LIKELY]
    shares = [f"{name} {100.0 * share:.0f} %" for name, share in ranked if share >= _HARDLY]
    return f"configuration: {', '.join(shares)}" if shares else "configuration: none of those known"


def link_lines(status: Status) -> list[str]:
    """Return a line or several for each link: rates got of those asked for, clock, what it says."""
    lines = []
    for each in status.sources:
        state = each.state
        rates = sorted(state.rates.items(), key=lambda pair: -pair[1])[:_MOST_RATES]
        counted = ", ".join(_rate(topic, rate, state.asked.get(topic)) for topic, rate in rates) or "nothing yet"
        lines.append(f"{each.text}: {each.samples} samples, {counted}{_clock(each)}")
        silent = [topic for topic in state.asked if topic not in state.rates]
        if silent:
            lines.append(f"  asked for and not got: {', '.join(silent[:_MOST_RATES])}")
        lines += [f"  {text}" for text in state.said]
    return lines


def _rate(topic: str, rate: float, asked: float | None) -> str:
    wanted = "" if asked is None else f" of {asked:.0f}"
    return f"{topic} {short(rate, 3)}{wanted} Hz"


def _clock(each: SourceStatus) -> str:
    if math.isnan(each.offset) or abs(each.offset) < 1e-3:
        return ""
    return f"; its clock is {abs(each.offset):.3f} s {'behind' if each.offset > 0.0 else 'ahead'}"


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 100_000 else f"{count / 1e3:.1f} kB"


class LiveView:
    """Shows a session on a console."""

    def __init__(self, output: Output, vehicle: Vehicle, method: str) -> None:
        self._output, self._console = output, output.console
        self._title = f"{vehicle.name}, method {method}"
        self._printed = time.monotonic()
        self._histories: dict[str, list[float]] = {}

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
        histories = self._history(status)
        relative = [
            each.std / abs(each.value) for each in learnt.estimate.coefficients if each.identified and each.value
        ]
        styles = ["green" if x <= _SURE_OF_TABLE else "yellow" if x <= _FAIR else "dim" for x in relative]
        for k, row in enumerate(rows):
            history = spark(histories[row[0]], _SPARK, ascii_only=self._output.ascii)
            table.add_row(*row, history, style=styles[k] if len(styles) == len(rows) else "")
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

    def _history(self, status: Status) -> dict[str, list[float]]:
        """Return the history of every coefficient that is identified, thinned where it becomes long."""
        for each in status.learnt.estimate.coefficients:
            if each.identified:
                history = self._histories.setdefault(each.name, [])
                history.append(each.value)
                if len(history) > _LONGEST:
                    del history[::2]
        return self._histories

    def _line(self, status: Status) -> None:
        now = time.monotonic()
        if now - self._printed < _LINE:
            return
        self._printed = now
        rows, _ = coefficient_rows(status.learnt, ascii_only=self._output.ascii)
        known = ", ".join(f"{name} {estimate}" for name, estimate, _, _ in rows) or "no coefficient known yet"
        rates = sum(sum(each.state.rates.values()) for each in status.sources)
        lost = f"; dropped {status.dropped}, late {status.late}, bad {status.bad}"
        self._output.verbatim(f"{clock(status.elapsed)}  {rates:.0f} Hz{lost}; {known}")
        for text in status.warnings:
            self._output.verbatim(f"  ! {text}")
