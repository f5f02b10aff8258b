"""A live session in words and rows, for the view, the lines of a pipe and the end."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

from towtank.digits import measured, short
from towtank.live.learning import Learnt
from towtank.live.status import SourceStatus, Status
from towtank.recording.event import Event

__all__ = ["clock", "coefficient_rows", "estimate_text", "event_line", "likely_line", "link_lines", "measures"]

_SURE = 1e-9
_MOST_RATES = 6
_MOST_LIKELY, _HARDLY = 3, 0.005
_ASCII = str.maketrans({"±": "+-", "−": "-", "²": "^2"})


def clock(seconds: float) -> str:
    """Return a duration as 1:02:03."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def estimate_text(value: float, std: float, *, ascii_only: bool = False) -> str:
    """Return `40.42 ± 0.21`."""
    number, spread = measured(value, std)
    return f"{number} {'+-' if ascii_only else '±'} {spread}" if spread else number


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
        epoch: Unix time [s] of the session's time 0; where it is NaN the session's own time is told.
    """
    when = clock(event.t) if math.isnan(epoch) else time.strftime("%H:%M:%S", time.localtime(epoch + event.t))
    text = f"{when}  {event.text}"
    return text.translate(_ASCII).encode("ascii", "replace").decode() if ascii_only else text


def likely_line(likely: Mapping[str, float]) -> str:
    """Return how probable each known configuration is, the most probable first."""
    told = sorted(likely.items(), key=lambda pair: -pair[1])[:_MOST_LIKELY]
    shares = [f"{name} {100.0 * share:.0f} %" for name, share in told if share >= _HARDLY]
    return f"configuration: {', '.join(shares)}" if shares else "configuration: none of those known"


def link_lines(status: Status) -> list[str]:
    """Return a line or several for each link: rates got of those asked for, clock, what it says."""
    lines = []
    for each in status.sources:
        state = each.state
        rates = sorted(state.rates.items(), key=lambda pair: -pair[1])[:_MOST_RATES]
        told = ", ".join(_rate(topic, rate, state.asked.get(topic)) for topic, rate in rates) or "nothing yet"
        lines.append(f"{each.text}: {each.samples} samples, {told}{_clock(each)}")
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
