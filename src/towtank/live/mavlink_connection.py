"""The connections that MAVLink comes over: UDP that listens or speaks first, TCP, serial lines."""

from __future__ import annotations

import contextlib
import re
import select
import socket
import time
from dataclasses import dataclass
from typing import Protocol

from towtank.errors import InputError
from towtank.live.mavlink_streams import Address, Serial, Tcp, resolved

__all__ = ["Connection", "UdpIn", "UdpOut", "connection_of"]

_LARGEST = 65536
_MOST = 256  # datagrams taken at once
_BUFFER = 1 << 21
_EXPECTED = "expected udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or /dev/NAME,BAUD"


class Connection(Protocol):
    """A way to a vehicle.

    Attributes:
        stream: whether messages come in pieces. speaks_first: whether nothing comes until we have spoken.
        bandwidth: bytes per second that it carries, where that is little; 0 where it is plenty.
        broken: why nothing comes at present, "" where it may.
    """

    stream: bool
    speaks_first: bool
    bandwidth: float
    broken: str

    def open(self) -> None:
        """Begin. Raises InputError in one line where that cannot be."""

    def receive(self, timeout: float) -> list[tuple[bytes, float, Address]]:
        """Return what has come, when [s] and where from; wait for it at most so long [s]."""
        ...

    def send(self, data: bytes, to: Address) -> None:
        """Send, as far as it can be."""

    def close(self) -> None:
        """End; may be called twice."""


def connection_of(text: str) -> Connection:
    """Return the connection that a text means. Raises InputError where it means none."""
    if text.startswith("/dev/") or re.match(r"COM\d|serial:", text, re.IGNORECASE):
        return Serial(text)
    match = re.fullmatch(r"(udp|udpin|udpout|tcp):(?://)?(\[[^\]]+\]|[^:\[\]]*):(\d+)", text, re.IGNORECASE)
    if match is None:
        raise InputError(f'source "{text}": {_EXPECTED}')
    kind, host, port = match[1].lower(), match[2].strip("[]"), int(match[3])
    if not 0 < port < 65536:
        raise InputError(f'source "{text}": port {port}, expected 1 to 65535')
    if kind in ("udp", "udpin"):
        return UdpIn(text, host or "0.0.0.0", port)
    if not host:
        raise InputError(f'source "{text}": no host; {_EXPECTED}')
    return UdpOut(text, host, port) if kind == "udpout" else Tcp(text, host, port)


@dataclass
class UdpIn:
    """Waits for whoever sends to a port, and answers to where it came from."""

    text: str
    host: str
    port: int
    stream = False
    speaks_first = False
    bandwidth = 0.0
    broken = ""
    _socket: socket.socket | None = None

    def open(self) -> None:
        """Bind the port."""
        family, address = resolved(self.text, self.host, self.port, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind(address)
        except OSError as error:
            self.close()
            raise InputError(
                f'source "{self.text}": cannot listen there ({error.strerror or error}); '
                "does a ground station hold the port? Let it forward to another one"
            ) from error
        self._ready(self._socket)

    def _ready(self, link: socket.socket) -> None:
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        link.setblocking(False)

    def receive(self, timeout: float) -> list[tuple[bytes, float, Address]]:
        """Return the datagrams that wait, each with its time of receipt [s] and where it came from."""
        found: list[tuple[bytes, float, Address]] = []
        link = self._socket
        if link is None or not select.select([link], [], [], timeout)[0]:
            return found
        while len(found) < _MOST:
            try:
                data, address = link.recvfrom(_LARGEST)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # nobody listens at the other end, yet
                continue
            found.append((data, time.time(), address))
        return found

    def send(self, data: bytes, to: Address) -> None:
        """Send to where something came from; an unreachable one is no error of ours."""
        if self._socket is not None and to is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, to)

    def close(self) -> None:
        """Free the port."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class UdpOut(UdpIn):
    """Speaks first to a port, whose owner then answers."""

    speaks_first = True

    def open(self) -> None:
        """Find the host; UDP knows no more of whether somebody listens."""
        family, address = resolved(self.text, self.host, self.port, socket.SOCK_DGRAM)
        self._to: Address = address
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._ready(self._socket)

    def send(self, data: bytes, to: Address) -> None:
        """Send to the host, or to where it answered from."""
        super().send(data, to or self._to)
