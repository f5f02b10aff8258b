"""What happened while it was learned: payloads, thrusters, lost sight, marks, one below the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime

from towtank.digits import short
from towtank.printable import escaped
from towtank.recording.event import Event
from towtank.report.elements import Cell, cell, number, section, sentence, table

__all__ = ["event_section"]

_WORDS = {
    "change": "the vehicle changed",
    "thruster": "a thruster",
    "configuration": "configuration",
    "water": "the water",
    "mended": "the filter",
    "link": "link",
    "occlusion": "lost sight",
    "overload": "too many samples",
    "clock": "clock",
    "mark": "mark",
    "resume": "resumed",
}


def event_section(events: Sequence[Event], epoch: float) -> str:
    """Return the events in order of their time; nothing where there are none.

    Args:
        epoch: Unix time [s] at which their time is 0, NaN where it is not known.
    """
    if not events:
        return ""
    dated = math.isfinite(epoch)
    head = [">Time s", *([">UTC"] if dated else []), "What", "In words"]
    rows = [_row(event, epoch) for event in sorted(events, key=lambda event: event.t)]
    return section("events", "What happened", table(head, rows))


def _row(event: Event, epoch: float) -> list[Cell]:
    when = [cell(number(event.t, f"{event.t:.1f}"), "n")]
    if math.isfinite(epoch):
        when.append(cell(datetime.fromtimestamp(epoch + event.t, UTC).strftime("%H:%M:%S"), "n"))
    noticed = event.details.get("noticed")
    late = noticed - event.t if isinstance(noticed, float) else math.nan
    said = f"<small>noticed {short(late, 2)} s later</small>" if late > 0.0 else ""
    word = _WORDS.get(event.kind, event.kind)
    return [*when, cell(escaped(word)), cell(sentence(event.text) + said)]
