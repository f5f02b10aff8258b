"""One line of JSON as a sample: `{"t": 12.34, "x": 0.1, "psi": 1.2, "cmd": [1500, 1620]}`; told in docs/live.md."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any

from towtank.live.frames import MarkerArm, to_ned_frd
from towtank.recording.mapping import Column, ColumnMapping
from towtank.recording.standard import COMMAND_PREFIX, STANDARD, is_command

__all__ = ["JsonMessages"]

_MOST_UNKNOWN = 100  # keys that are told apart
_LONGEST_KEY = 60
_LARGEST = 1e9  # no quantity of a vehicle is larger, in SI
_STEP = re.compile(r"\[(\d+)\]")
_FRAMES = {"body": ("FRD", "FLU"), "world": ("NED", "ENU")}

Decoded = tuple[float, tuple[str, ...], tuple[float, ...]]


class JsonMessages:
    """Decodes messages one by one, and counts what is wrong with them.

    Attributes:
        bad: messages, or values in them, that could not be used.
        unknown: key -> how often it came, of keys that mean nothing.
        wrong: what was wrong last, for a person.
    """

    def __init__(self, thrusters: Sequence[str], mapping: ColumnMapping | None = None) -> None:
        self.bad, self.unknown, self.wrong = 0, dict[str, int](), ""
        self._thrusters = tuple(thrusters)
        self._body, self._world = (mapping.body, mapping.world) if mapping else ("FRD", "NED")
        self._arm = MarkerArm(mapping.marker) if mapping and mapping.marker else None
        self._columns = mapping.channels() if mapping else {}
        self._time: Column | None = mapping.columns.get("t") if mapping else None

    def decode(self, line: bytes) -> Decoded | None:
        """Return time (NaN where there is none), names and values of a message; None where nothing is in it."""
        try:
            message = json.loads(line)
        except (ValueError, RecursionError):
            self._refuse("not JSON")
            return None
        if not isinstance(message, dict):
            self._refuse("not a JSON object")
            return None
        body, world = self._frames(message.pop("frame", None))
        t, found = self._mapped(message) if self._columns else self._plain(message)
        if math.isinf(t):
            self._refuse('"t" is not a time')
            return None
        sample = to_ned_frd(found, body, world)
        if self._arm is not None:
            sample = self._arm.to_origin(sample)
        return (t, tuple(sample), tuple(sample.values())) if sample else None

    def _plain(self, message: dict[str, Any]) -> tuple[float, dict[str, float]]:
        t, found = math.nan, dict[str, float]()
        for key, value in message.items():
            if key == "t":
                t = self._time_of(value)
            elif key == "cmd":
                self._commands(value, found)
            elif key in STANDARD or is_command(key):
                self._put(found, key, value)
            else:
                self._unknown(key)
        return t, found

    def _mapped(self, message: dict[str, Any]) -> tuple[float, dict[str, float]]:
        found: dict[str, float] = {}
        for name, column in self._columns.items():
            value = _at(message, column.source)
            if value is not None:
                self._put(found, name, value)
                if name in found:
                    found[name] = column.scale * found[name] + column.offset
        t = self._time_of(_at(message, self._time.source if self._time else "t"))
        return (self._time.scale * t + self._time.offset if self._time else t), found

    def _commands(self, value: Any, found: dict[str, float]) -> None:
        if isinstance(value, dict):
            for name, number in value.items():
                self._put(found, COMMAND_PREFIX + name, number)
        elif isinstance(value, list) and len(value) == len(self._thrusters):
            for name, number in zip(self._thrusters, value, strict=True):
                self._put(found, COMMAND_PREFIX + name, number)
        else:
            size = f"{len(value)} numbers" if isinstance(value, list) else type(value).__name__
            self._refuse(f'"cmd" holds {size}, expected {len(self._thrusters)} numbers or an object')

    def _put(self, found: dict[str, float], name: str, value: Any) -> None:
        """Take a value; null is "not measured"."""
        number = _number(value)
        if value is not None and not abs(number) <= _LARGEST:
            self._refuse(f'"{ascii(name[:_LONGEST_KEY])[1:-1]}" is not a number that can be')
        elif value is not None:
            found[name] = number

    def _time_of(self, value: Any) -> float:
        """Return a time [s], NaN where there is none, infinity where it is none."""
        if value is None:
            return math.nan
        number = _number(value)
        return number if math.isfinite(number) else math.inf

    def _frames(self, frame: Any) -> tuple[str, str]:
        if frame is None:
            return self._body, self._world
        told = frame if isinstance(frame, dict) else {}
        body, world = told.get("body", self._body), told.get("world", self._world)
        if not isinstance(frame, dict) or body not in _FRAMES["body"] or world not in _FRAMES["world"]:
            self._refuse('"frame" is not {"body": "FRD" or "FLU", "world": "NED" or "ENU"}; the usual frames are taken')
            return self._body, self._world
        return body, world

    def _unknown(self, key: str) -> None:
        key = ascii(key[:_LONGEST_KEY])[1:-1]  # it will stand on a terminal
        if key not in self.unknown and len(self.unknown) >= _MOST_UNKNOWN:
            key = "..."
        self.unknown[key] = self.unknown.get(key, 0) + 1

    def _refuse(self, why: str) -> None:
        self.bad += 1
        self.wrong = why


def _number(value: Any) -> float:
    """Return a number; NaN for whatever is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.nan


def _at(message: Any, path: str) -> Any:
    """Return what stands at "pose.position.x" or "channels[3]"; None where nothing does."""
    if isinstance(message, dict) and path in message:
        return message[path]
    for part in path.split("."):
        name, *places = _STEP.split(part)
        message = message.get(name) if isinstance(message, dict) else None
        for place in (int(each) for each in places if each):
            message = message[place] if isinstance(message, list) and place < len(message) else None
    return message
