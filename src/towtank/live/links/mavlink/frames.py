"""Cuts what comes over a MAVLink link into messages: version 1 and 2, whole datagrams or a stream of bytes.

A message counts where its checksum is right. What is no message is skipped up to the next one and counted; nothing
that comes can raise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from towtank.readers.mavlink.format import MessageLayout, checksum
from towtank.readers.mavlink.senders import Sender

__all__ = ["Frame", "Framer"]

_MAVLINK_1, _MAVLINK_2 = 0xFE, 0xFD
_HEAD = {_MAVLINK_1: 6, _MAVLINK_2: 10}
_SIGNED = 1
_SIGNATURE = 13
_CRC = 2


class Frame(NamedTuple):
    """One message: its number, its sender, its payload as it came, and the version of MAVLink."""

    number: int
    sender: Sender
    payload: bytes
    version: int


class Framer:
    """Cuts the bytes of one connection.

    Args:
        layouts: of the messages that are known, by number.
        stream: whether a message may come in several pieces, as over TCP and serial lines; a datagram is whole.

    Attributes:
        bad: stretches that are no message, and messages with a wrong checksum.
        unknown: messages of numbers that are not known, which cannot be checked.
    """

    def __init__(self, layouts: Mapping[int, MessageLayout], *, stream: bool) -> None:
        self._layouts, self._stream = layouts, stream
        self._rest = b""
        self._lost = False
        self.bad = self.unknown = 0

    def feed(self, data: bytes) -> list[Frame]:
        """Return the messages that are whole now."""
        data = self._rest + data
        found: list[Frame] = []
        at, size = 0, len(data)
        while at < size:
            magic = data[at]
            head = _HEAD.get(magic)
            if head is None:
                self._lose()
                at = _next_magic(data, at + 1)
                continue
            end = at + head + data[at + 1] if at + 1 < size else size + 1
            after = end + _CRC
            if magic == _MAVLINK_2 and at + 2 < size and data[at + 2] & _SIGNED:
                after += _SIGNATURE
            if after > size or at + head > size:
                if self._stream:
                    break
                self._lose()
                at = _next_magic(data, at + 1)
                continue
            at = self._message(data, at, head, end, after, found)
        self._rest = data[at:]
        if not self._stream:
            self._rest, self._lost = b"", False
        return found

    def _message(self, data: bytes, at: int, head: int, end: int, after: int, found: list[Frame]) -> int:
        """Judge what stands from `at`; return where to go on."""
        if data[at] == _MAVLINK_2:
            number = int.from_bytes(data[at + 7 : at + 10], "little")
            sender, version = Sender(data[at + 5], data[at + 6]), 2
        else:
            number, sender, version = data[at + 5], Sender(data[at + 3], data[at + 4]), 1
        layout = self._layouts.get(number)
        if layout is not None:
            sent = data[end] | data[end + 1] << 8
            right = checksum(data[at + 1 : end] + layout.crc_extra) == sent
            if right and (version == 1 or data[at + 2] <= _SIGNED):
                found.append(Frame(number, sender, data[at + head : end], version))
                self._lost = False
                return after
        elif not self._lost and (after == len(data) or data[after] in _HEAD):
            self.unknown += 1
            return after
        self._lose()
        return _next_magic(data, at + 1)

    def _lose(self) -> None:
        """Count the stretch once, however long it is."""
        if not self._lost:
            self.bad += 1
            self._lost = True


def _next_magic(data: bytes, at: int) -> int:
    """Return where a message may next begin; the size of the data where none does."""
    places = [place for place in (data.find(b"\xfd", at), data.find(b"\xfe", at)) if place >= 0]
    return min(places, default=len(data))
