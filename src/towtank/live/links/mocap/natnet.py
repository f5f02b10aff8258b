"""OptiTrack Motive: rigid bodies by NatNet. Packets are read by the `natnet` library, sockets are our own.

The library's client prints, and dies of a packet that is damaged; its parsers do neither.
"""

from __future__ import annotations

import contextlib
import importlib.util
import select
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any

from towtank.errors import InputError
from towtank.live.links.mocap.tracked_body import TrackedBody, body_named, capture_address
from towtank.live.links.source import Rates, Raw, Sample, SourceState
from towtank.live.pipeline.clock import steady_time
from towtank.recording.mapping import ColumnMapping

__all__ = ["NatnetSource"]

_PORT, _DATA_PORT, _GROUP = 1510, 1511, "239.255.42.99"
_CONNECT, _SERVER, _ASK_MODEL, _MODEL, _FRAME, _ALIVE = 0, 1, 4, 5, 7, 10
_ANSWER = 3.0  # s that Motive may take
_ASK_AGAIN = 0.5
_STAY = 1.0  # s between two signs of life, without which Motive ends a unicast
_BUFFER = 1 << 22  # bytes that the system is asked to hold for us
_LONGEST = 65_536
_BATCH = 256
_TOPIC = "rigid_bodies"


class NatnetSource:
    """`natnet:HOST[:PORT][/BODY][?up=z][&multicast=GROUP]`: one rigid body of Motive, unicast or multicast alike."""

    name = "natnet"
    keeps_time = patient = False

    def __init__(self, text: str, mapping: ColumnMapping | None = None) -> None:
        self._text = text
        self._host, self._port, self._wanted, options = capture_address(text, "natnet:", _PORT)
        if set(options) - {"up", "multicast"} or options.get("up", "y") not in ("y", "z"):
            raise InputError(f'source "{text}": expected no options but ?up=y, ?up=z and multicast=GROUP')
        self._group = options.get("multicast", _GROUP)
        self._body = TrackedBody(mapping, options.get("up", "y"))
        self._sockets: list[socket.socket] = []
        self._server = ""
        self._version: Any = None
        self._title = self._named = ""
        self._number = -1
        self._names: dict[int, str] = {}
        self._kept_alive = 0.0
        self._bad = 0
        self._rates = Rates()

    def open(self) -> None:
        """Ask the server who it is and which bodies it has. Raises InputError."""
        if importlib.util.find_spec("natnet") is None:
            raise InputError(f'source "{self._text}": natnet is not installed; pip install "towtank[mocap]"')
        try:
            self._server = socket.gethostbyname(self._host)
            self._sockets = [_bound("", 0)]
        except OSError as error:
            raise InputError(f'source "{self._text}": {self._host}: {error.strerror or error}') from None
        with contextlib.suppress(OSError):  # a network without multicast: Motive has to send unicast then
            self._sockets.append(self._joined())
        try:
            if not self._asked(_CONNECT, b"Ping\0", lambda: self._version is not None):
                raise InputError(f'source "{self._text}": no NatNet server at {self._host}:{self._port} answers')
            self._asked(_ASK_MODEL, b"\0", lambda: bool(self._names))
            place = body_named(self._text, self._wanted, list(self._names.values()))
        except BaseException:
            self.close()
            raise
        self._number, self._named = list(self._names.items())[place]

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return the frames that have come; waits at most `timeout` [s]."""
        out: list[Sample | Raw] = []
        if not self._sockets:
            return out
        if time.monotonic() - self._kept_alive >= _STAY:
            self._tell(_ALIVE, b"\0")
        for link in select.select(self._sockets, [], [], timeout)[0]:
            for _ in range(_BATCH):
                try:
                    data, sender = link.recvfrom(_LONGEST)
                except (BlockingIOError, InterruptedError):
                    break
                except OSError:
                    self._bad += 1
                    break
                if sender[0] == self._server:
                    self._take(data, steady_time(), out)
        return out

    def state(self) -> SourceState:
        """Return how it fares."""
        silent = [] if self._rates.counts else ["no frame yet: is streaming on, and its local interface right?"]
        return SourceState(
            said=(f'body "{self._named}"', *silent, *self._body.said),
            rates=self._rates.now(),
            bad=self._bad,
            senders=(f"{self._title} {self._host}".strip(),),
        )

    def close(self) -> None:
        """Stop listening."""
        for link in self._sockets:
            link.close()
        self._sockets = []

    def _joined(self) -> socket.socket:
        """Return a socket that hears the group on the interface that leads to the server."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((self._server, self._port))
            own = probe.getsockname()[0]
        link = _bound(self._group, _DATA_PORT)
        try:
            member = socket.inet_aton(self._group) + socket.inet_aton(own)
            link.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError:
            link.close()
            raise
        return link

    def _asked(self, question: int, body: bytes, answered: Any) -> bool:
        """Ask until it is answered; return whether it was."""
        end = time.monotonic() + _ANSWER
        while not answered() and (now := time.monotonic()) < end:
            self._tell(question, body)
            again = min(now + _ASK_AGAIN, end)
            while not answered() and time.monotonic() < again:
                self.read(again - time.monotonic())
        return bool(answered())

    def _tell(self, message: int, body: bytes) -> None:
        self._kept_alive = time.monotonic()
        with contextlib.suppress(OSError):
            self._sockets[0].sendto(struct.pack("<HH", message, len(body)) + body, (self._server, self._port))

    def _take(self, data: bytes, received: float, out: list[Sample | Raw]) -> None:
        """Read a packet: of a frame the body, as it came and in standard channels."""
        from natnet import DataDescriptions, DataFrame, ServerInfo
        from natnet.packet_buffer import PacketBuffer

        buffer = PacketBuffer(data)
        try:
            kind = buffer.read_uint16()
            buffer.read_uint16()
            if kind == _SERVER:
                found = ServerInfo.read_from_buffer(buffer, None)
                self._version, self._title = found.nat_net_protocol_version, found.application_name[:60]
            elif kind == _MODEL and self._number < 0 and self._version is not None:
                bodies = DataDescriptions.read_from_buffer(buffer, self._version).rigid_bodies
                self._names = {each.id_num: each.name or str(each.id_num) for each in bodies}
            elif kind == _FRAME and self._version is not None:
                frame = DataFrame.read_from_buffer(buffer, self._version)
                self._rates.add(_TOPIC)
                out.append(Raw(self.name, _TOPIC, received, data))
                self._sample(frame, received, out)
        except Exception:  # the library raises whatever a damaged packet leads it to
            self._bad += 1

    def _sample(self, frame: Any, received: float, out: list[Sample | Raw]) -> None:
        body = next((each for each in frame.rigid_bodies if each.id_num == self._number), None)
        if body is None or body.tracking_valid is False:
            self._body.hidden += 1
            return
        x, y, z, w = body.rot
        channels = self._body.channels(body.pos, (w, x, y, z))
        if channels:
            t = float(frame.suffix.timestamp)
            out.append(Sample(self.name, _TOPIC, t, received, tuple(channels), tuple(channels.values())))


def _bound(address: str, port: int) -> socket.socket:
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        link.bind((address, port))
        link.setblocking(False)
    except OSError:
        link.close()
        raise
    return link
