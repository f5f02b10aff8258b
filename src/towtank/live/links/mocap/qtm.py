"""Qualisys Track Manager: 6-DOF bodies by its real-time protocol, through the maker's own library (qtm-rt)."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import time
from collections import deque
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

from towtank.errors import InputError
from towtank.live.links.mocap.tracked_body import TrackedBody, body_named, capture_address, quaternion_of_matrix
from towtank.live.links.source import Rates, Raw, Sample, SourceState
from towtank.live.pipeline.clock import steady_time
from towtank.recording.mapping import ColumnMapping

__all__ = ["QtmSource"]

_PORT = 22223  # little endian
_ANSWER = 5.0  # s that QTM may take
_AGAIN = 2.0  # s between two attempts, once it was there
_MILLI, _MICRO = 1e-3, 1e-6
_MOST = 10_000  # packets that wait
_TOPIC = "6d"


class QtmSource:
    """`qtm:HOST[:PORT][/BODY]`: one body of QTM, every frame; positions come in mm, attitudes as matrices."""

    name = "qtm"
    keeps_time = patient = False

    def __init__(self, text: str, mapping: ColumnMapping | None = None) -> None:
        self._text = text
        self._host, self._port, self._wanted, options = capture_address(text, "qtm:", _PORT)
        if set(options) - {"up"} or options.get("up", "z") not in ("y", "z"):
            raise InputError(f'source "{text}": expected no option but ?up=y or ?up=z')
        self._body = TrackedBody(mapping, options.get("up", "z"))
        self._place = 0
        self._names: tuple[str, ...] = ()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._link: Any = None
        self._connecting: asyncio.Task[None] | None = None  # once it was there: for as long as an answer may take
        self._came: deque[tuple[float, Any]] = deque(maxlen=_MOST)
        self._arrived = asyncio.Event()
        self._tried = 0.0
        self._bad = 0
        self._rates = Rates()

    def open(self) -> None:
        """Connect, and ask for every frame. Raises InputError."""
        if importlib.util.find_spec("qtm_rt") is None:
            raise InputError(f'source "{self._text}": qtm-rt is not installed; pip install "towtank[mocap]"')
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(self._failed)
        try:
            self._loop.run_until_complete(self._connect(_ANSWER))
        except BaseException:
            self.close()
            raise

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return the frames that have come; waits at most `timeout` [s]."""
        loop = self._loop
        if loop is None:
            return []
        if not (self._connected or self._connecting) and time.monotonic() - self._tried >= _AGAIN:
            self._connecting = loop.create_task(self._connect(_ANSWER))
        if not self._came:
            loop.run_until_complete(self._wait(timeout))
        if self._connecting is not None and self._connecting.done():
            task, self._connecting = self._connecting, None
            with contextlib.suppress(InputError):
                task.result()
        out: list[Sample | Raw] = []
        for _ in range(len(self._came)):
            self._take(*self._came.popleft(), out)
        return out

    def state(self) -> SourceState:
        """Return how it fares."""
        said = [] if self._connected else [f"QTM at {self._host}:{self._port} does not answer; it is tried again"]
        said += [f'body "{name}"' for name in self._names[self._place : self._place + 1]]
        return SourceState(
            said=(*said, *self._body.said),
            rates=self._rates.now(),
            bad=self._bad,
            senders=(f"QTM {self._host}:{self._port}",),
        )

    def close(self) -> None:
        """Disconnect."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        with contextlib.suppress(Exception):
            if self._connecting is not None:
                self._connecting.cancel()
                loop.run_until_complete(asyncio.wait([self._connecting]))
            if self._connected:
                self._link.disconnect()
            loop.run_until_complete(asyncio.sleep(0))
        self._link = self._connecting = None
        loop.close()

    @property
    def _connected(self) -> bool:
        return self._link is not None and bool(self._link.has_transport())

    async def _connect(self, patience: float) -> None:
        import qtm_rt

        self._tried = time.monotonic()
        where = f'source "{self._text}": QTM at {self._host}:{self._port}'
        link: Any = None
        try:
            async with asyncio.timeout(patience):
                link = await qtm_rt.connect(self._host, self._port, timeout=patience, loop=self._loop)
                if link is None:
                    raise InputError(f"{where} does not answer")
                bodies = await link.get_parameters(parameters=["6d"])
                self._names = tuple(_bodies(bodies))
                self._place = body_named(self._text, self._wanted, self._names)
                await link.stream_frames(components=["6d"], on_packet=self._keep)
                self._link, link = link, None
        except (TimeoutError, OSError) as error:
            raise InputError(f"{where} does not answer ({str(error) or 'not in time'})") from None
        except (qtm_rt.QRTCommandException, ElementTree.ParseError) as error:
            raise InputError(f"{where} refuses: {error}") from None
        finally:
            if link is not None:
                link.disconnect()

    def _keep(self, packet: Any) -> None:
        self._came.append((steady_time(), packet))
        self._arrived.set()

    async def _wait(self, timeout: float) -> None:
        self._arrived.clear()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._arrived.wait(), timeout)

    def _failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Count what the library cannot parse; it ends the connection, and `read` makes it anew."""
        self._bad += 1

    def _take(self, received: float, packet: Any, out: list[Sample | Raw]) -> None:
        """Append a frame as it came, and the body in it."""
        self._rates.add(_TOPIC)
        out.append(Raw(self.name, _TOPIC, received, bytes(packet.data)))
        try:
            found = packet.get_6d()
            place, turn = found[1][self._place]
        except Exception:  # a frame without bodies, of fewer bodies, or cut short
            self._bad += 1
            return
        position = [_MILLI * x for x in place]
        channels = self._body.channels(position, quaternion_of_matrix(turn.matrix))
        if channels:
            t = _MICRO * packet.timestamp
            out.append(Sample(self.name, _TOPIC, t, received, tuple(channels), tuple(channels.values())))


def _bodies(parameters: bytes | str) -> list[str]:
    """Return the names of the 6-DOF bodies in QTM's settings."""
    tree = ElementTree.fromstring(parameters)
    return [(name.text or "").strip() for name in tree.findall(".//The_6D/Body/Name")]
