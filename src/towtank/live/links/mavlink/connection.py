"""The connections that MAVLink comes over: UDP that listens or speaks first, TCP, serial lines.

TCP and serial lines are made again where they break.
"""

from __future__ import annotations

import contextlib
import re
import select
import socket
import time
from dataclasses import dataclass
from typing import Any, Protocol

from towtank.errors import InputError
from towtank.live.links.datagrams import Datagrams
from towtank.live.pipeline.clock import steady_time

__all__ = ["Address", "Connection", "UdpIn", "UdpOut", "connection_of"]

Address = tuple[str, int] | None
_LARGEST = 65536
_PATIENCE = 5.0  # s for TCP to connect
_AGAIN = 1.0  # s between attempts at a connection that broke
_BAUD = 115200
_TURN = 0.05  # s that a serial line is waited for, or takes to send
_EXPECTED = "expected udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or /dev/NAME,BAUD"


def resolved(text: str, host: str, port: int, kind: socket.SocketKind) -> tuple[int, Any]:
    """Return family and address of a host. Raises InputError where it is not known."""
    try:
        found = socket.getaddrinfo(host, port, type=kind)
    except (OSError, UnicodeError) as error:
        raise InputError(f'source "{text}": host "{host}" is not known ({error})') from error
    chosen = next((each for each in found if each[0] == socket.AF_INET), found[0])
    return chosen[0], chosen[4]


@dataclass
class _Stream:
    """A connection of bytes that is made again where it breaks."""

    text: str
    stream = True
    speaks_first = False
    bandwidth = 0.0
    broken = ""
    dropped = 0
    _tried = 0.0

    def _connect(self, patience: float) -> None:
        raise NotImplementedError

    def _file(self) -> Any:
        raise NotImplementedError

    def _wait(self, timeout: float) -> bool:
        raise NotImplementedError

    def _take(self) -> bytes:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError

    def receive(self, timeout: float) -> list[tuple[bytes, float, Address]]:
        """Return the bytes that wait, with their time of receipt [s]."""
        if self._file() is None and not self._reconnected(timeout):
            return []
        try:
            if not self._wait(timeout):
                return []
            data = self._take()
        except (BlockingIOError, InterruptedError):
            return []
        except (OSError, ValueError) as error:
            self._break(str(error))
            return []
        if not data:
            self._break("the other end has closed")
            return []
        return [(data, steady_time(), None)]

    def _reconnected(self, timeout: float) -> bool:
        if time.monotonic() - self._tried < _AGAIN:
            time.sleep(min(timeout, 0.1))
            return False
        self._tried = time.monotonic()
        try:
            self._connect(min(max(timeout, 0.05), 1.0))
        except (OSError, InputError):
            return False
        self.broken = ""
        return True

    def _break(self, why: str) -> None:
        self.close()
        self.broken = f"{self.text}: {why}; trying again"
        self._tried = time.monotonic()


class Tcp(_Stream):
    """Connects to a server."""

    def __init__(self, text: str, host: str, port: int) -> None:
        super().__init__(text)
        self._host, self._port = host, port
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect."""
        try:
            self._connect(_PATIENCE)
        except OSError as error:
            raise InputError(f'source "{self.text}": cannot connect ({error.strerror or error})') from error

    def _connect(self, patience: float) -> None:
        _, address = resolved(self.text, self._host, self._port, socket.SOCK_STREAM)
        link = socket.create_connection(address[:2], timeout=patience)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setblocking(False)
        self._socket = link

    def _file(self) -> Any:
        return self._socket

    def _wait(self, timeout: float) -> bool:
        return self._socket is not None and bool(select.select([self._socket], [], [], timeout)[0])

    def _take(self) -> bytes:
        return self._socket.recv(_LARGEST) if self._socket is not None else b""

    def send(self, data: bytes, to: Address) -> None:
        """Send; what does not go out at once is lost."""
        link = self._socket  # another thread may close it meanwhile
        if link is not None:
            with contextlib.suppress(OSError):
                link.send(data)

    def close(self) -> None:
        """Disconnect."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class Serial(_Stream):
    """A serial line: /dev/NAME,BAUD."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        plain = re.sub(r"^serial:(//)?", "", text, flags=re.IGNORECASE)
        device, _, baud = plain.replace(":", ",").partition(",")
        if baud and not baud.isdigit():
            raise InputError(f'source "{text}": baud rate "{baud}", expected a number such as {_BAUD}')
        self._device, self._baud = device, int(baud or _BAUD)
        self.bandwidth = self._baud / 10.0
        self._port: Any = None
        self._first = b""

    def open(self) -> None:
        """Open the line."""
        try:
            self._connect(0.0)
        except (OSError, ValueError) as error:
            raise InputError(f'source "{self.text}": cannot be opened ({error})') from error

    def _connect(self, patience: float) -> None:
        try:
            import serial
        except ImportError:
            raise InputError(
                f'source "{self.text}": serial lines need pyserial; pip install "towtank[serial]"'
            ) from None
        self._port = serial.Serial(self._device, self._baud, timeout=_TURN, write_timeout=_TURN)

    def _file(self) -> Any:
        return self._port

    def _wait(self, timeout: float) -> bool:
        self._first = bytes(self._port.read(1))  # the timeout of the port: to change it is to set it up anew
        return bool(self._first)

    def _take(self) -> bytes:
        return self._first + bytes(self._port.read(min(self._port.in_waiting, _LARGEST)))

    def send(self, data: bytes, to: Address) -> None:
        """Send; what does not go out at once is lost."""
        port = self._port  # another thread may close it meanwhile
        if port is not None:
            with contextlib.suppress(OSError, TypeError, ValueError):
                port.write(data)

    def close(self) -> None:
        """Close the line."""
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None


class Connection(Protocol):
    """A way to a vehicle.

    Attributes:
        stream: whether messages come in pieces. speaks_first: whether nothing comes until we have spoken.
        bandwidth: bytes per second that it carries, where that is little; 0 where it is plenty.
        broken: why nothing comes at present, "" where it may.
        dropped: datagrams for which the system had no room, because more came than was read.
    """

    stream: bool
    speaks_first: bool
    bandwidth: float
    broken: str

    @property
    def dropped(self) -> int:
        """Datagrams for which the system had no room."""
        ...

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
    _link: Datagrams | None = None

    @property
    def dropped(self) -> int:
        """Datagrams for which the system had no room."""
        return 0 if self._link is None else self._link.dropped

    def open(self) -> None:
        """Bind the port."""
        family, address = resolved(self.text, self.host, self.port, socket.SOCK_DGRAM)
        link = socket.socket(family, socket.SOCK_DGRAM)
        try:
            link.bind(address)
        except OSError as error:
            link.close()
            raise InputError(
                f'source "{self.text}": cannot listen there ({error.strerror or error}); '
                "does a ground station hold the port? Let it forward to another one"
            ) from error
        self._link = Datagrams(link)

    def receive(self, timeout: float) -> list[tuple[bytes, float, Address]]:
        """Return the datagrams that wait, each with its time of receipt [s] and where it came from."""
        return [] if self._link is None else self._link.receive(timeout)

    def send(self, data: bytes, to: Address) -> None:
        """Send to where something came from; an unreachable one is no error of ours."""
        if self._link is not None and to is not None:
            with contextlib.suppress(OSError):
                self._link.socket.sendto(data, to)

    def close(self) -> None:
        """Free the port."""
        if self._link is not None:
            self._link.close()


class UdpOut(UdpIn):
    """Speaks first to a port, whose owner then answers."""

    speaks_first = True

    def open(self) -> None:
        """Find the host; UDP knows no more of whether somebody listens."""
        family, address = resolved(self.text, self.host, self.port, socket.SOCK_DGRAM)
        self._to: Address = address
        self._link = Datagrams(socket.socket(family, socket.SOCK_DGRAM))

    def send(self, data: bytes, to: Address) -> None:
        """Send to the host, or to where it answered from."""
        super().send(data, to or self._to)
