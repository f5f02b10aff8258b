"""MAVLink over connections of bytes, TCP and serial lines, which are made again where they break."""

from __future__ import annotations

import contextlib
import re
import select
import socket
import time
from dataclasses import dataclass
from typing import Any

from towtank.errors import InputError

__all__ = ["Address", "Serial", "Tcp", "resolved"]

Address = tuple[str, int] | None
_LARGEST = 65536
_PATIENCE = 5.0  # s for TCP to connect
_AGAIN = 1.0  # s between attempts at a connection that broke
_BAUD = 115200
_TURN = 0.05  # s that a serial line is waited for, or takes to send


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
        return [(data, time.time(), None)]

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
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.send(data)

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
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.write(data)

    def close(self) -> None:
        """Close the line."""
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None
