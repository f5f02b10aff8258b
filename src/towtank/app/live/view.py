"""A live session on the terminal: coefficients as they settle; plain lines every few seconds where it is piped."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from towtank.app.live.coaching import plan_lines
from towtank.app.live.readings import Reading, Readings
from towtank.app.terminal.output import Output
from towtank.app.terminal.spark import spark
from towtank.app.terminal.wrap import wrapped
from towtank.dashboard.prediction import SECONDS
from towtank.dashboard.verdict import COUNTED
from towtank.digits import estimate_text, short
from towtank.live.learning import Learnt
from towtank.live.pipeline.hearing import no_data
from towtank.live.status import SourceStatus, Status
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

Row = tuple[str, str, str, str]

__all__ = ["LiveView", "coefficient_rows", "event_line", "likely_line", "link_lines", "measures"]

_SURE = 1e-9
_MOST_RATES = 6
_MOST_LIKELY, _HARDLY = 3, 0.005
_ASCII = str.maketrans({"±": "+-", "−": "-", "²": "^2", "°": "deg"})
_EVENTS = 3  # that are shown
_OWN = 1e7  # s: a clock that is farther off does not mean the time of day
_HEADING, _FEWEST = 2, 6  # lines of a table's head; rows that notes leave to it
_WIDE = 500  # characters in which nothing would be broken
_LINE = 5.0  # s between two plain lines
_SPARK, _LONGEST = 12, 480  # characters; values kept of a coefficient
_SURE_OF_TABLE, _FAIR = 0.05, 0.2  # relative deviations that are shown in green, in yellow


def clock(seconds: float) -> str:
    """Return a duration as 1:02:03."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def coefficient_rows(learnt: Learnt, *, ascii_only: bool = False) -> tuple[list[Row], dict[str, list[str]]]:
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
    lost = f"dropped {status.dropped}, late {status.late}, bad {status.bad}, waiting {status.waiting}"
    lines = [f"{status.samples} samples, {delay}{lag}; {lost}"]
    if learnt.excitation and status.silent is None:
        force = " ".join(f"{name} {short(x, 2)}" for name, x in zip("XYZ", learnt.excitation[:3], strict=True))
        moment = " ".join(f"{name} {short(x, 2)}" for name, x in zip("KMN", learnt.excitation[3:], strict=True))
        lines.append(f"asked for (rms, 10 s): {force} N, {moment} N m")
    total, own = learnt.latency, learnt.processing
    if not math.isnan(total["median"]):
        lines.append(
            f"latency {short(total['median'], 3)} ms (99 %: {short(total['p99'], 3)}), "
            f"of it computing {short(own['median'], 2)} ms (99 %: {short(own['p99'], 2)})"
        )
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


def rate_lines(status: Status) -> list[str]:
    """Return a line or two for each link: rates got of those asked for, and its clock."""
    lines = []
    for each in status.sources:
        state = each.state
        rates = sorted(state.rates.items(), key=lambda pair: -pair[1])[:_MOST_RATES]
        counted = ", ".join(_rate(topic, rate, state.asked.get(topic)) for topic, rate in rates) or "nothing yet"
        if each.silent is not None:
            counted = no_data(each.silent)
        lines.append(f"{each.text}: {each.samples} samples, {counted}{_clock(each)}")
        silent = [topic for topic in state.asked if topic not in state.rates]
        if silent:
            lines.append(f"  asked for and not got: {', '.join(silent[:_MOST_RATES])}")
    return lines


def link_lines(status: Status) -> list[str]:
    """Return what `rate_lines` does, and what each link says."""
    return [*rate_lines(status), *(f"  {text}" for each in status.sources for text in each.state.said)]


def _styles(status: Status) -> list[str]:
    """Return the colours of the coefficients that are identified."""
    relative = [
        each.std / abs(each.value) for each in status.learnt.estimate.coefficients if each.identified and each.value
    ]
    return ["green" if x <= _SURE_OF_TABLE else "yellow" if x <= _FAIR else "dim" for x in relative]


def _rate(topic: str, rate: float, asked: float | None) -> str:
    wanted = "" if asked is None else f" of {asked:.0f}"
    return f"{topic} {short(rate, 3)}{wanted} Hz"


def _clock(each: SourceStatus) -> str:
    if math.isnan(each.offset) or abs(each.offset) < 1e-3:
        return ""
    if abs(each.offset) > _OWN:
        return "; its clock has a zero of its own"
    return f"; its clock is {abs(each.offset):.3f} s {'behind' if each.offset > 0.0 else 'ahead'}"


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 100_000 else f"{count / 1e3:.1f} kB"


class LiveView:
    """Shows a session on a console."""

    def __init__(self, output: Output, vehicle: Vehicle, method: str, readings: Readings | None = None) -> None:
        self._output, self._console = output, output.console
        self._title = f"{vehicle.name}, method {method}"
        self._readings = readings
        self._printed, self._stopped = time.monotonic(), (False, False, False)
        self._histories: dict[str, list[float]] = {}

    @contextlib.contextmanager
    def showing(self) -> Iterator[Callable[[Status], None] | None]:
        """Yield a function that shows a status."""
        if self._output.json:
            yield None
        elif self._readings is None or not self._console.is_terminal:
            yield self._line
        else:
            read = self._readings.read
            with Live(console=self._console, auto_refresh=False, vertical_overflow="crop", transient=True) as live:
                yield lambda status: live.update(self.picture(status, read(status)), refresh=True)

    def picture(self, status: Status, reading: Reading) -> Group:
        """Return the whole view: how things stand, and as many coefficients as the window has room for."""
        height = self._console.height
        head, facts = self._head(status, reading), self._facts(status, reading)
        happened = self._happened(status)
        rows, rest = coefficient_rows(status.learnt, ascii_only=self._output.ascii)
        unknown = self._unknown(rest)
        room = height - len(head) - len(facts) - len(unknown) - len(happened) - _HEADING - 2  # empty lines
        noted = self._noted(reading, max(room - min(len(rows), _FEWEST), 0))
        room -= len(noted)
        parts: list[object] = [*head, *noted, *facts, Text()]
        if not rows:
            parts.append(Text("no coefficient is known yet", style="dim"))
        else:
            whole = (self._table(status, rows, course=c) for c in (True, False) if len(rows) <= room)
            fitting = next(filter(self._fits, whole), None)
            parts += self._columns(status, rows, max(room - 1, 1)) if fitting is None else [fitting]
        return Group(*parts, *unknown, *happened)  # type: ignore[arg-type]

    def _lines(self, text: str, style: str = "", first: str = "") -> list[Text]:
        """Return a text in lines that fit."""
        if self._output.ascii:
            text = text.translate(_ASCII).encode("ascii", "replace").decode()
        return [Text(line, style=style) for line in wrapped(text, self._console.width, first=first)]

    def _head(self, status: Status, reading: Reading) -> list[Text]:
        """Return title, state and verdict, and what a person had better know."""
        learnt = status.learnt
        good = status.silent is None and not learnt.trouble and learnt.left_out is None
        state = (reading.state, "bold green" if good else "bold yellow")
        title = Text.assemble((self._title, "bold"), f"  {clock(status.elapsed)}  ", state, ("   Ctrl-C ends", "dim"))
        lines = [title] if len(title) <= self._console.width else [title[: len(title) - len("   Ctrl-C ends")]]
        if len(lines[0]) > self._console.width:
            lines = [Text.assemble((self._title, "bold"), f"  {clock(status.elapsed)}")]
            lines += self._lines(reading.state, "bold yellow")
        lines += self._lines(reading.verdict, "bold" if good else "bold yellow")
        for k, text in enumerate([] if reading.plan is None else plan_lines(reading.plan)):
            lines += self._lines(text, "bold cyan" if k == 0 else "cyan")
        for text in status.warnings:
            lines += self._lines(text, "yellow", "! ")
        return lines

    def _noted(self, reading: Reading, room: int) -> list[Text]:
        """Return as many notes as there is room for; the last line says how many there are besides."""
        lines: list[Text] = []
        for k, text in enumerate(reading.notes):
            own, left = self._lines(text, "dim", "- "), len(reading.notes) - k
            if len(lines) + len(own) + (left > 1) > room:
                rest = self._lines(
                    f"{left} {'more notes' if k else 'notes'} of the links, told at the end", "dim", "- "
                )
                return [*lines, *rest] if room > len(lines) else lines
            lines += own
        return lines

    def _facts(self, status: Status, reading: Reading) -> list[Text]:
        """Return lines on the prediction, on delay, latency and losses, and on what each link sends."""
        lines = self._lines(f"prediction, {SECONDS:.0f} s: {reading.prediction}")
        for line in measures(status):
            lines += self._lines(line)
        for line in rate_lines(status):
            lines += self._lines(line, "dim")
        return lines

    def _happened(self, status: Status) -> list[Text]:
        """Return the last things that happened to the vehicle, and which configuration it is."""
        lines = []
        for event in [each for each in status.events if each.kind not in COUNTED][-_EVENTS:]:
            lines += self._lines(event_line(event, status.epoch), "bold")
        return [*lines, *(self._lines(likely_line(status.learnt.likely)) if status.learnt.likely else [])]

    def _unknown(self, rest: Mapping[str, list[str]]) -> list[Text]:
        """Return which coefficients are not known yet; how many, where their names are more than a line."""
        names = [name for group in rest.values() for name in group]
        lines = self._lines(f"not known: {', '.join(names)}", "dim") if names else []
        return lines if len(lines) < 2 else self._lines(f"not known yet: {len(names)} coefficients", "dim")

    def _table(self, status: Status, rows: Sequence[Row], *, course: bool) -> Table:
        table = self._output.table("Coefficient", self._estimate, ">Rel. std", "Unit", *(["Course"] if course else []))
        histories, styles = self._history(status), _styles(status)
        for k, row in enumerate(rows):
            history = [spark(histories[row[0]], _SPARK, ascii_only=self._output.ascii)] if course else []
            table.add_row(*row, *history, style=styles[k] if len(styles) == len(rows) else "")
        return table

    def _columns(self, status: Status, rows: Sequence[Row], room: int) -> list[object]:
        """Return as many coefficients as there is room for, without units, and what is left out.

        Two of them in a row where that fits, else one, else without its relative deviation, else line by line.
        """
        self._history(status)
        header = ("Coefficient", self._estimate, ">Rel. std")
        for across, columns in ((2, 3), (1, 3), (1, 2)):
            shown, table = rows[: across * room], self._output.table(*header[:columns] * across)
            half = -(-len(shown) // across)
            for k in range(half):
                cells = [
                    shown[j][:columns] if j < len(shown) else ("",) * columns for j in range(k, across * half, half)
                ]
                table.add_row(*(cell for each in cells for cell in each))
            if self._fits(table):
                return [table, *self._left_out(len(rows) - len(shown))]
        lines = [line for name, estimate, *_ in rows for line in self._lines(f"{name} {estimate}")][: room + _HEADING]
        return [*lines, *self._left_out(len(rows) - sum(" " in line.plain for line in lines))]

    def _left_out(self, count: int) -> list[Text]:
        """Return what a larger window shows: so many coefficients more, and the units."""
        return self._lines(f"{f'{count} more and the' if count else 'the'} units: in a larger window", "dim")

    def _fits(self, table: Table) -> bool:
        """Whether a table fits the window's width without anything broken."""
        return (
            self._console.measure(table, options=self._console.options.update_width(_WIDE)).maximum
            <= self._console.width
        )

    @property
    def _estimate(self) -> str:
        return ">Estimate +- std" if self._output.ascii else ">Estimate ± std"

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
        stopped = (status.silent is not None, status.learnt.left_out is not None, status.in_trouble)
        if now - self._printed < _LINE and stopped == self._stopped:
            return
        self._printed, self._stopped = now, stopped
        rows, _ = coefficient_rows(status.learnt, ascii_only=self._output.ascii)
        known = ", ".join(f"{name} {estimate}" for name, estimate, _, _ in rows) or "no coefficient known yet"
        rates = sum(sum(each.state.rates.values()) for each in status.sources)
        lost = f"; dropped {status.dropped}, late {status.late}, bad {status.bad}"
        self._output.verbatim(f"{clock(status.elapsed)}  {status.state}, {rates:.0f} Hz{lost}; {known}")
        for text in status.warnings:
            self._output.verbatim(f"  ! {text}")
