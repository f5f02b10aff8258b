"""What can be asked of the page's server: a fixed table of files, a few numbers, and a few controls.

Each viewer has a socket that is written to and never read from.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from pathlib import Path
from typing import BinaryIO

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from towtank.dashboard.access import Access, Refusals
from towtank.dashboard.assets import INDEX, Asset
from towtank.dashboard.feed import Feed
from towtank.dashboard.pump import VIEWERS, Mailbox, Pump
from towtank.vehicle import vehicle_text

__all__ = ["Reports", "application"]

_POLICY, _LATER = 1008, 1013  # codes of closing
_IN_ORDER = (1000, 1001, 1005, 1006, 1011, 1012)  # of a peer that left, or that we gave up
Reports = Callable[[], bytes]
_ASKED = ("begin", "hold", "on", "drive-on", "drive-off", "drive-key", "drive-let-go")  # of the pilot's guide
_CONTROLS = ("pause", "resume", "mark", *_ASKED)
_LONGEST = 2048  # bytes of a body
_MARK = 200  # characters of a mark
_PIECE = 1 << 18  # bytes of the recording that are read at once
_SAFE = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-embedder-policy": "require-corp",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_WORDS = {401: "token needed: open the address that was printed at the start", 403: "refused", 404: "not found"}


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


def application(
    feed: Feed, pump: Pump, access: Access, refusals: Refusals, assets: Mapping[str, Asset], reports: Reports | None
) -> ASGIApp:
    """Return the application of one page."""
    pages = _Pages(feed, pump, access, refusals, reports)

    async def viewer(socket: WebSocket) -> None:
        await look(socket, pump, access, refusals)

    routes = [
        *(Route(path, pages.asset(path, asset), methods=["GET"]) for path, asset in assets.items()),
        Route("/api/state", pages.state, methods=["GET"]),
        Route("/api/model.toml", pages.model, methods=["GET"]),
        Route("/api/recording", pages.recording, methods=["GET"]),
        *([Route("/api/report", pages.report, methods=["GET"])] if reports is not None else []),
        *(Route(f"/api/{name}", pages.control(name), methods=["POST"]) for name in _CONTROLS),
        WebSocketRoute("/api/stream", viewer),
    ]
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    return _Gate(app, access, refusals)


class _Gate:
    """Stands before every request: hosts, token and size; adds headers that keep browsers from doing harm."""

    def __init__(self, app: ASGIApp, access: Access, refusals: Refusals) -> None:
        self._app, self._access, self._refusals = app, access, refusals

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        refused = self._refused(request)

        async def answer(message: dict[str, object]) -> None:
            if message["type"] == "http.response.start":
                given = message.get("headers")
                headers = [*given] if isinstance(given, list | tuple) else []
                headers += [(name.encode(), value.encode()) for name, value in _SAFE.items()]
                if request.method != "GET" or refused is not None:
                    headers.append((b"connection", b"close"))  # whatever is still being sent is not read
                message["headers"] = headers
            await send(message)

        await (self._app if refused is None else refused)(scope, receive, answer)  # type: ignore[arg-type]

    def _refused(self, request: Request) -> Response | None:
        access, headers, cookies = self._access, request.headers, request.cookies
        peer = request.client.host if request.client else "?"
        token = request.query_params.get("token")
        if not access.host(headers):
            return self._no(peer, 403, "a request for another host")
        if request.method == "POST" and not access.may_steer(headers, cookies):
            return self._no(peer, 403, "a control without the token, or from a foreign page")
        if token is not None and not access.right(token):
            return self._no(peer, 403, "a wrong token")
        if token is None and not access.may_look(headers, cookies):
            return self._no(peer, 401, "a request without the token")
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > _LONGEST:
            return self._no(peer, 413, "a body that is too long")
        return None

    def _no(self, peer: str, code: int, reason: str) -> Response:
        self._refusals.add(peer, reason)
        return PlainTextResponse(_WORDS.get(code, reason), code)


class _Pages:
    """The answers."""

    def __init__(self, feed: Feed, pump: Pump, access: Access, refusals: Refusals, reports: Reports | None) -> None:
        self._feed, self._pump, self._access = feed, pump, access
        self._refusals, self._reports = refusals, reports

    def asset(self, path: str, asset: Asset) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            headers = {"etag": asset.tag}
            response = Response(asset.body, media_type=asset.media_type, headers=headers)
            if path == INDEX and request.query_params.get("token"):
                key, token = self._access.cookie, self._access.token
                response.set_cookie(key, token, httponly=True, samesite="strict", max_age=7 * 86400)
            return response

        return answer

    async def state(self, request: Request) -> Response:
        return Response(self._pump.state, media_type="application/json")

    async def model(self, request: Request) -> Response:
        try:
            vehicle = await asyncio.to_thread(self._feed.model)
        except TimeoutError:
            return PlainTextResponse("the learner is busy; try again", 503)
        name = f"{re.sub(r'[^A-Za-z0-9_-]+', '_', vehicle.name) or 'model'}_learned.toml"
        return Response(vehicle_text(vehicle), media_type="application/toml", headers=_saved_as(name))

    async def recording(self, request: Request) -> Response:
        recording = self._pump.recording
        if recording is None:
            return PlainTextResponse("nothing is recorded in this session", 404)
        return _Growing(recording.path, recording.size)

    async def report(self, request: Request) -> Response:
        if self._reports is None:
            return PlainTextResponse(_WORDS[404], 404)
        try:
            text = await asyncio.to_thread(self._reports)
        except TimeoutError:
            return PlainTextResponse("the learner is busy; try again", 503)
        return Response(text, media_type="text/html; charset=utf-8", headers=_saved_as("report.html"))

    def control(self, name: str) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            try:
                body = await _body(request)
            except ValueError as error:
                self._refusals.add(request.client.host if request.client else "?", str(error))
                return PlainTextResponse(str(error), 413)
            except ClientDisconnect:
                return PlainTextResponse("", 400)
            if name == "mark":
                text = _mark(body)
                if text is None:
                    return PlainTextResponse('expected {"text": "..."}', 400)
                self._feed.mark(text)
            elif name in _ASKED:
                if not self._feed.ask(name):
                    return PlainTextResponse("nothing is to be driven now", 409)
            else:
                self._feed.pause(name == "pause")
            return Response(status_code=204)

        return answer


async def _body(request: Request) -> bytes:
    """Return the body; ValueError as soon as it is too long, whatever it declared."""
    body = b""
    async for piece in request.stream():
        body += piece
        if len(body) > _LONGEST:
            raise ValueError("a body that is too long")
    return body


def _mark(body: bytes) -> str | None:
    try:
        text = json.loads(body or b"{}").get("text", "")
    except (ValueError, AttributeError, RecursionError):
        return None
    if not isinstance(text, str):
        return None
    return "".join(letter for letter in " ".join(text.split()) if letter.isprintable())[:_MARK] or "mark"


def _saved_as(name: str) -> dict[str, str]:
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name)
    return {"content-disposition": f'attachment; filename="{plain}"'}


class _Growing(StreamingResponse):
    """The first `size` bytes of a file that is still being written; closed when the answer ends or is broken off."""

    def __init__(self, path: Path, size: int) -> None:
        headers = {**_saved_as(path.name), "content-length": str(size)}
        super().__init__((), media_type="application/octet-stream", headers=headers)
        self._path, self._size = path, size

    async def stream_response(self, send: Send) -> None:
        with self._path.open("rb") as stream:  # at once: a thread would open it for nobody, were this cancelled
            self.body_iterator = _pieces(stream, self._size)
            await super().stream_response(send)


async def _pieces(stream: BinaryIO, size: int) -> AsyncIterator[bytes]:
    while size > 0 and (piece := await asyncio.to_thread(stream.read, min(_PIECE, size))):
        size -= len(piece)
        yield piece
