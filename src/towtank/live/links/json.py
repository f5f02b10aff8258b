"""JSON lines over UDP or standard input: the bridge for whatever has no link of its own.

A line is a sample: `{"t": 12.34, "x": 0.1, "psi": 1.2, "cmd": [1500, 1620]}`; described in docs/live.md.
"""

from __future__ import annotations

import json
import math
import os
import re
import select
import socket
import stat
import sys
from collections.abc import Sequence
from typing import Any

from towtank.errors import InputError
from towtank.live.links.datagrams import Allowance, Datagrams, received_from
from towtank.live.links.source import Rates, Raw, Sample, SourceState
from towtank.live.pipeline.clock import steady_time
from towtank.live.pipeline.frames import MarkerArm, to_ned_frd
from towtank.recording.mapping import Column, ColumnMapping
from towtank.recording.standard import COMMAND_PREFIX, STANDARD, STATES, is_command
from towtank.vehicle import Vehicle

__all__ = ["JsonMessages", "JsonSource"]

_MOST_UNKNOWN = 100  # keys that are told apart
_LONGEST_KEY = 60
_LARGEST = 1e9  # no quantity of a vehicle is larger, in SI
_STEP = re.compile(r"\[(\d+)\]")
_FRAMES = {"body": ("FRD", "FLU"), "world": ("NED", "ENU")}
Decoded = tuple[float, tuple[str, ...], tuple[float, ...]]
_LONGEST = 65536  # bytes of a datagram, or of a line
_KEPT = 4096  # bytes of a bad message that are recorded
_SILENT = 1.0  # s after which another sender may tell a channel
_MOST_OWNED = 1000  # channels whose sender is remembered


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
            elif key in STATES:
                self._put(found, key, float(value) if isinstance(value, bool) else value)
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
        given = frame if isinstance(frame, dict) else {}
        body, world = given.get("body", self._body), given.get("world", self._world)
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


def host_and_port(text: str, prefix: str) -> tuple[str, int]:
    """Return host and port of "PREFIXHOST:PORT"; the host may be in brackets, or absent: this machine alone.

    Raises:
        InputError: there is no port, or it is none.
    """
    host, colon, port = text.removeprefix(prefix).rpartition(":")
    if not colon or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f'source "{text}": expected {prefix}HOST:PORT with a port of 1 to 65535')
    return host.strip("[]") or "127.0.0.1", int(port)


class JsonSource:
    """`json:HOST:PORT` listens for datagrams of one or more lines; `-` reads standard input.

    A regular file as standard input is read as fast as it is learned from, its times being what they are.
    """

    name = "json"

    def __init__(self, text: str, vehicle: Vehicle, mapping: ColumnMapping | None = None) -> None:
        self._text = text
        self._address = None if text == "-" else host_and_port(text, "json:")
        self._topic = "stdin" if self._address is None else f"port_{self._address[1]}"
        self._messages = JsonMessages([each.name for each in vehicle.thrusters], mapping)
        self._rates = Rates()
        self._senders: dict[str, None] = {}
        self._owners: dict[str, tuple[Any, float]] = {}  # channel -> its sender, and when that sent it last [s]
        self._foreign, self._rival = 0, ""
        self._noise = Allowance()
        self._link: Datagrams | None = None
        self._input = -1
        self._rest = b""
        self._ended = False
        self._shift = math.nan
        self.keeps_time = self.patient = self._address is None and _is_file()

    def open(self) -> None:
        """Begin to listen. Raises InputError."""
        if self._address is None:
            try:
                self._input = sys.stdin.fileno()
            except (OSError, ValueError, AttributeError) as error:
                raise InputError(f'source "-": there is no standard input ({error})') from None
            return
        family = socket.AF_INET6 if ":" in self._address[0] else socket.AF_INET
        link = socket.socket(family, socket.SOCK_DGRAM)
        try:
            link.bind(self._address)
        except OSError as error:
            link.close()
            raise InputError(f'source "{self._text}": cannot listen there ({error.strerror or error})') from None
        self._link = Datagrams(link)

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return what has come; waits at most `timeout` [s]."""
        if self._link is not None:
            return self._datagrams(self._link, timeout)
        if self._ended or self._input < 0 or not select.select([self._input], [], [], timeout)[0]:
            return []
        return self._lines_of_input()

    def state(self) -> SourceState:
        """Return how it fares."""
        messages = self._messages
        said = []
        if messages.bad:
            said.append(f"{messages.bad} bad, last: {messages.wrong}")
        if messages.unknown:
            keys = ", ".join(list(messages.unknown)[:5])
            said.append(f"unknown keys passed over: {keys} ({sum(messages.unknown.values())} times)")
        if self._foreign:
            said.append(
                f"{self._rival} sends channels that come from another sender already: "
                f"{self._foreign} values passed over"
            )
        said += self._noise.said
        if self._link is not None:
            said += self._link.said
        if not self._rates.counts:
            said.append("nothing has come yet")
        return SourceState(
            said=tuple(said),
            rates=self._rates.now(),
            bad=messages.bad,
            dropped=0 if self._link is None else self._link.dropped,
            foreign=self._foreign,
            senders=tuple(self._senders),
            ended=self._ended,
        )

    def close(self) -> None:
        """Stop listening."""
        if self._link is not None:
            self._link.close()
        self._input = -1

    def _datagrams(self, link: Datagrams, timeout: float) -> list[Sample | Raw]:
        out: list[Sample | Raw] = []
        for data, received, sender in link.receive(timeout):
            if len(self._senders) < 8:
                self._senders.setdefault(received_from(sender))
            self._take(data, received, out, sender)
        return out

    def _lines_of_input(self) -> list[Sample | Raw]:
        data = os.read(self._input, _LONGEST)
        out: list[Sample | Raw] = []
        now = steady_time()
        if not data:
            self._ended = True
            self._take(self._rest, now, out)
            return out
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._take(line, now, out)
        if len(self._rest) > _LONGEST:
            self._messages.bad += 1
            self._messages.wrong = f"a line of more than {_LONGEST} bytes"
            self._rest = b""
        return out

    def _take(self, data: bytes, received: float, out: list[Sample | Raw], sender: Any = None) -> None:
        """Append what a datagram holds, as it came and decoded."""
        bad, meant = self._messages.bad, False
        for line in data.splitlines():
            if line.strip():
                decoded = self._messages.decode(line)
                meant = meant or decoded is not None
                if decoded is not None and (own := self._own(decoded, received, sender))[1]:
                    self._rates.add(self._topic)
                    t = self._from_now(own[0], received) if self.keeps_time else own[0]
                    out.append(Sample(self.name, self._topic, t, received, own[1], own[2]))
        if data:
            kept = data if self._messages.bad == bad else data[:_KEPT]
            if meant or self._noise.takes(kept):
                out.append(Raw(self.name, self._topic, received, kept))

    def _own(self, decoded: Decoded, received: float, sender: Any) -> Decoded:
        """Return a message without the channels that another sender is telling: two vehicles are never mixed."""
        kept: list[int] = []
        for k, name in enumerate(decoded[1]):
            owner, last = self._owners.get(name, (sender, received))
            if owner != sender and received - last <= _SILENT:
                continue
            if name in self._owners or len(self._owners) < _MOST_OWNED:
                self._owners[name] = sender, received
            kept.append(k)
        if len(kept) == len(decoded[1]):
            return decoded
        self._foreign += len(decoded[1]) - len(kept)
        self._rival = received_from(sender)
        return decoded[0], tuple(decoded[1][k] for k in kept), tuple(decoded[2][k] for k in kept)

    def _from_now(self, t: float, received: float) -> float:
        """Return a time of a file as if its first sample were of now."""
        if math.isnan(self._shift):
            self._shift = received - t
        return t + self._shift


def _is_file() -> bool:
    """Whether standard input is a file, which can wait, and not a pipe or a terminal."""
    try:
        return stat.S_ISREG(os.fstat(sys.stdin.fileno()).st_mode)
    except (OSError, ValueError, AttributeError):
        return False
