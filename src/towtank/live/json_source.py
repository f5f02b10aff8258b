"""JSON lines over UDP or standard input: the bridge for whatever has no link of its own."""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import stat
import sys
import time
from collections.abc import Sequence

from towtank.errors import InputError
from towtank.live.addresses import host_and_port
from towtank.live.json_message import JsonMessages
from towtank.live.rates import Rates
from towtank.live.source import Raw, Sample, SourceState
from towtank.recording.mapping import ColumnMapping
from towtank.vehicle import Vehicle

__all__ = ["JsonSource"]

_LONGEST = 65536  # bytes of a datagram, or of a line
_BUFFER = 1 << 23  # bytes that the system is asked to hold for us
_BATCH = 256  # datagrams taken at once
_KEPT = 4096  # bytes of a bad message that are recorded


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
        self._socket: socket.socket | None = None
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
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        try:
            link.bind(self._address)
        except OSError as error:
            link.close()
            raise InputError(f'source "{self._text}": cannot listen there ({error.strerror or error})') from None
        link.setblocking(False)
        self._socket = link

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return what has come; waits at most `timeout` [s]."""
        handle = self._input if self._socket is None else self._socket.fileno()
        if self._ended or handle < 0:
            return []
        if not select.select([handle], [], [], timeout)[0]:
            return []
        return self._lines_of_input() if self._socket is None else self._datagrams(self._socket)

    def state(self) -> SourceState:
        """Return how it fares."""
        messages = self._messages
        said = []
        if messages.bad:
            said.append(f"{messages.bad} bad, last: {messages.wrong}")
        if messages.unknown:
            keys = ", ".join(list(messages.unknown)[:5])
            said.append(f"unknown keys passed over: {keys} ({sum(messages.unknown.values())} times)")
        if not self._rates.counts:
            said.append("nothing has come yet")
        return SourceState(
            said=tuple(said),
            rates=self._rates.now(),
            bad=messages.bad,
            senders=tuple(self._senders),
            ended=self._ended,
        )

    def close(self) -> None:
        """Stop listening."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        self._input = -1

    def _datagrams(self, link: socket.socket) -> list[Sample | Raw]:
        out: list[Sample | Raw] = []
        for _ in range(_BATCH):
            try:
                data, sender = link.recvfrom(_LONGEST)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                self._messages.bad += 1
                break
            if len(self._senders) < 8:
                self._senders.setdefault(f"{sender[0]}:{sender[1]}")
            self._take(data, time.time(), out)
        return out

    def _lines_of_input(self) -> list[Sample | Raw]:
        data = os.read(self._input, _LONGEST)
        out: list[Sample | Raw] = []
        now = time.time()
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

    def _take(self, data: bytes, received: float, out: list[Sample | Raw]) -> None:
        """Append what a datagram holds, as it came and decoded."""
        before = self._messages.bad
        for line in data.splitlines():
            if line.strip():
                decoded = self._messages.decode(line)
                if decoded is not None:
                    self._rates.add(self._topic)
                    t = self._from_now(decoded[0], received) if self.keeps_time else decoded[0]
                    out.append(Sample(self.name, self._topic, t, received, decoded[1], decoded[2]))
        if data:
            kept = data if self._messages.bad == before else data[:_KEPT]
            out.append(Raw(self.name, self._topic, received, kept))

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
