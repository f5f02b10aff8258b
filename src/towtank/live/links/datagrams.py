"""What comes over UDP: whole datagrams, counted where more came than was read; and how much of noise is recorded."""

from __future__ import annotations

import contextlib
import select
import socket
import sys
import time
from typing import Any

from towtank.live.pipeline.clock import steady_time

__all__ = ["Allowance", "Datagrams", "received_from"]

_LARGEST = 65536
_MOST = 256  # datagrams taken at once
_BUFFER = 1 << 23  # bytes that the system is asked to hold for us
_OVERFLOW = 40  # SO_RXQ_OVFL of Linux: the count of dropped datagrams comes with those behind them
_ROOM = socket.CMSG_SPACE(4) if hasattr(socket, "CMSG_SPACE") else 0
_NOISE, _BURST = 1 << 16, 1 << 20  # bytes a second, and at once, of what means nothing


class Datagrams:
    """Receives from one UDP socket, which it owns.

    Attributes:
        dropped: datagrams that the system had no room for, where it says so (Linux).
    """

    def __init__(self, link: socket.socket) -> None:
        self.socket, self.dropped = link, 0
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        self._counts = False
        if sys.platform == "linux":
            with contextlib.suppress(OSError):
                link.setsockopt(socket.SOL_SOCKET, _OVERFLOW, 1)
                self._counts = True
        link.setblocking(False)

    def receive(self, timeout: float) -> list[tuple[bytes, float, Any]]:
        """Return the datagrams that wait, each with its time of receipt [s] and where it came from.

        Args:
            timeout: for which the first one is waited for [s].
        """
        found: list[tuple[bytes, float, Any]] = []
        if self.socket.fileno() < 0 or not select.select([self.socket], [], [], timeout)[0]:
            return found
        for _ in range(_MOST):  # errors count, lest an unreachable peer keep us here
            try:
                data, address = self._one()
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # nobody listens at the other end, yet
                continue
            found.append((data, steady_time(), address))
        return found

    def _one(self) -> tuple[bytes, Any]:
        if not self._counts:
            return self.socket.recvfrom(_LARGEST)
        data, more, _, address = self.socket.recvmsg(_LARGEST, _ROOM)
        for level, kind, content in more:
            if level == socket.SOL_SOCKET and kind == _OVERFLOW:
                self.dropped = int.from_bytes(content[:4], sys.byteorder)
        return data, address

    def close(self) -> None:
        """Free the port; the count stays."""
        self.socket.close()

    @property
    def said(self) -> list[str]:
        """What a person had better know."""
        return [f"{self.dropped} datagrams dropped by the system: more came than can be read"] * bool(self.dropped)


class Allowance:
    """How much of what means nothing is recorded: 64 kB a second, a megabyte at once; so no flood of it fills a disk.

    Attributes:
        passed_over: datagrams that were not recorded.
    """

    def __init__(self) -> None:
        self.passed_over = 0
        self._left, self._at = float(_BURST), time.monotonic()

    def takes(self, data: bytes) -> bool:
        """Return whether there is room for bytes, and take it."""
        now = time.monotonic()
        self._left, self._at = min(self._left + _NOISE * (now - self._at), _BURST), now
        if len(data) > self._left:
            self.passed_over += 1
            return False
        self._left -= len(data)
        return True

    @property
    def said(self) -> list[str]:
        """What a person had better know."""
        text = f"{self.passed_over} datagrams without any message in them are counted and not recorded: too many come"
        return [text] * bool(self.passed_over)


def received_from(address: Any) -> str:
    """Return an address as HOST:PORT.

    >>> received_from(("192.168.2.2", 14550))
    '192.168.2.2:14550'
    """
    return f"{address[0]}:{address[1]}"
