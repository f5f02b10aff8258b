"""What waits for one viewer: bounded, so that one who is slow sees newer frames and misses older ones."""

from __future__ import annotations

import asyncio
from collections import deque

__all__ = ["Mailbox"]

_ROOM = 40  # frames of a stream: two seconds of signals


class Mailbox:
    """Frames for one viewer; used within one event loop.

    A frame put in a *place* replaces the one that waits there; others queue, and the oldest is given up when there is
    no room.

    Attributes:
        skipped: frames given up.
    """

    def __init__(self, room: int = _ROOM) -> None:
        self.skipped = 0
        self._places: dict[str, str | bytes] = {}
        self._queue: deque[bytes] = deque()
        self._room = room
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._places) + len(self._queue)

    def put(self, frame: bytes) -> None:
        """Queue a frame."""
        if len(self._queue) >= self._room:
            self._queue.popleft()
            self.skipped += 1
        self._queue.append(frame)
        self._filled.set()

    def replace(self, place: str, frame: str | bytes) -> None:
        """Put a frame where only the newest counts."""
        if place in self._places:
            self.skipped += 1
        self._places[place] = frame
        self._filled.set()

    async def next(self) -> str | bytes:
        """Return what is to be sent next, once there is something."""
        while not self._places and not self._queue:
            self._filled.clear()
            await self._filled.wait()
        if self._places:
            return self._places.pop(next(iter(self._places)))
        return self._queue.popleft()
