"""One viewer: a socket that is written to and never read from."""

from __future__ import annotations

import asyncio
import contextlib

from starlette.websockets import WebSocket, WebSocketDisconnect

from towtank.dashboard.access import Access
from towtank.dashboard.mailbox import Mailbox
from towtank.dashboard.pump import VIEWERS, Pump
from towtank.dashboard.refusals import Refusals

__all__ = ["look"]

_POLICY, _LATER = 1008, 1013  # codes of closing
_IN_ORDER = (1000, 1001, 1005, 1006, 1011, 1012)  # of a peer that left, or that we gave up


async def look(socket: WebSocket, pump: Pump, access: Access, refusals: Refusals) -> None:
    """Serve one viewer until one side leaves."""
    peer = socket.client.host if socket.client else "?"
    if not access.host(socket.headers) or not access.origin(socket.headers):
        refusals.add(peer, "a socket from a foreign page")
        await socket.close(_POLICY)
        return
    if not access.may_look(socket.headers, socket.cookies):
        refusals.add(peer, "a socket without the token")
        await socket.close(_POLICY)
        return
    if pump.viewers >= VIEWERS:
        await socket.close(_LATER)
        return
    await socket.accept()
    box = Mailbox()
    box.replace("you", _you(access.known(socket.headers, socket.cookies)))
    pump.join(box)
    sending = asyncio.create_task(_send(socket, box))
    try:
        message = await socket.receive()
        if message["type"] == "websocket.receive" or message.get("code") not in _IN_ORDER:
            refusals.add(peer, "a frame that no page of ours sends")
            with contextlib.suppress(Exception):
                await asyncio.wait_for(socket.close(_POLICY), 1.0)
    finally:
        pump.leave(box)
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await sending


async def _send(socket: WebSocket, box: Mailbox) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            frame = await box.next()
            if isinstance(frame, str):
                await socket.send_text(frame)
            else:
                await socket.send_bytes(frame)


def _you(steers: bool) -> str:
    """Say whether this viewer may steer."""
    return f'{{"type": "you", "steers": {"true" if steers else "false"}}}'
