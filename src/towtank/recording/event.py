"""Something that happened, worth a line: a sensor lost sight, a payload changed, somebody set a mark."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

__all__ = ["EVENT_ENCODING", "EVENT_KINDS", "EVENT_SCHEMA", "EVENT_TOPIC", "Event", "event_json"]

EVENT_TOPIC, EVENT_ENCODING = "/towtank/events", "json"
EVENT_KINDS = (
    *(
        "change",
        "thruster",
        "configuration",
        "water",
        "mended",
        "link",
        "occlusion",
        "overload",
        "clock",
        "mark",
        "resume",
        "plan",
        "drive",
    ),
)
_NOTHING: Mapping[str, float | str] = MappingProxyType({})
_FORM = {
    "type": "object",
    "properties": {
        "t": {"type": "number", "description": "s, on the clock of the recording"},
        "kind": {"type": "string", "enum": list(EVENT_KINDS)},
        "text": {"type": "string"},
        "details": {"type": "object"},
    },
}
EVENT_SCHEMA = ("towtank.Event", "jsonschema", json.dumps(_FORM).encode())  # name, encoding, text


@dataclass(frozen=True, slots=True)
class Event:
    """What happened, and when.

    Attributes:
        t: when it happened [s], on the samples' clock; for a change, when it is thought to have begun.
        kind: one of `EVENT_KINDS`. "change": of the vehicle (payload, drag, ballast); "thruster": one pushes less or
            more than it did; "configuration": a known one was recognised, or given up; "water": it moves as it did
            not before; "mended": an estimator that had lost itself; "link": one is lost, or back; the others are
            what they say.
        text: one line for a person.
        details: numbers and names for programs, as "noticed" [s] and, by coefficient, the step and its deviation.
    """

    t: float
    kind: str
    text: str
    details: Mapping[str, float | str] = field(default_factory=lambda: _NOTHING)


def event_json(event: Event) -> str:
    """Return an event as one JSON object; numbers that are not finite become null."""
    details = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in event.details.items()
    }
    return json.dumps({"t": event.t, "kind": event.kind, "text": event.text, "details": details}, allow_nan=False)
