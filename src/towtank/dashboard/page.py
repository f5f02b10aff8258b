"""The live page of a session: a server in a thread of its own, for which the session never waits."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from towtank.dashboard.access import Access, Address, Refusals
from towtank.dashboard.assets import page_assets
from towtank.dashboard.feed import Feed
from towtank.dashboard.pump import Pump
from towtank.dashboard.routes import Reports, application
from towtank.errors import InputError

__all__ = ["Page"]

_FRAME = 256  # bytes of a message from a viewer; none is expected
_CONNECTIONS = 100
_ON_THE_WAY = 1 << 17  # bytes that the system holds for a viewer: more would be old by the time it is seen
_PATIENCE = 5.0  # s for the server to start or to end


class Page:
    """Serves one session; a context manager.

    Args:
        feed: the session. address: where to serve. say: takes a line of what was refused.
        reports: makes the report, where there is one. token: to be known by; a new one where omitted.

    Raises:
        InputError: the libraries or the files of the page are missing, or the address is taken.
    """

    def __init__(
        self,
        feed: Feed,
        address: Address,
        *,
        say: Callable[[str], None] = lambda line: None,
        reports: Reports | None = None,
        token: str | None = None,
    ) -> None:
        try:
            import starlette  # noqa: F401
            import uvicorn  # noqa: F401
            import websockets  # noqa: F401
        except ImportError as error:
            raise InputError(f'--page: {error.name} is missing; pip install "towtank[page]"') from None
        assets = page_assets()
        self._socket = _bound(address)
        self.address = Address(address.host, self._socket.getsockname()[1])
        self.access = Access(self.address, token or secrets.token_urlsafe(24))
        self.refusals = Refusals(say)
        self.pump = Pump(feed, secrets.token_hex(8), report=reports is not None, page=self._status)
        self._app = application(feed, self.pump, self.access, self.refusals, assets, reports)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._server: Any = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._cpu = 0

    @property
    def url(self) -> str:
        """Where the page is, with the token that its controls need."""
        host = self.address.host
        shown = Address(socket.gethostname() if host in ("0.0.0.0", "::") else host, self.address.port)
        return f"http://{shown.text}/?token={self.access.token}"

    def start(self) -> Self:
        """Begin to serve."""
        self._thread.start()
        deadline = time.monotonic() + _PATIENCE
        while not getattr(self._server, "started", False) and time.monotonic() < deadline and self._thread.is_alive():
            time.sleep(0.01)
        return self

    def close(self) -> None:
        """Tell the viewers that the session has ended, and stop."""
        loop, server = self._loop, self._server
        if loop is not None and server is not None and self._thread.is_alive():
            with contextlib.suppress(TimeoutError, RuntimeError):
                asyncio.run_coroutine_threadsafe(self.pump.end(), loop).result(_PATIENCE)
            server.should_exit = True
            self._thread.join(_PATIENCE)
        self._socket.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        import uvicorn

        config = uvicorn.Config(
            self._app,
            loop="asyncio",
            http="h11",
            ws="websockets-sansio",
            ws_max_size=_FRAME,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            log_level=logging.CRITICAL + 1,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            limit_concurrency=_CONNECTIONS,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=16_384,
        )
        self._server = uvicorn.Server(config)
        asyncio.run(self._serve(self._server))

    async def _serve(self, server: Any) -> None:
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(lambda loop, context: self.refusals.add("?", "a connection that broke rules"))
        pumping = asyncio.create_task(self.pump.run())
        try:
            await server.serve([self._socket])
        finally:
            pumping.cancel()

    def _status(self) -> dict[str, Any]:
        document = {"refused": self.refusals.total, "trouble": self.pump.trouble}
        with contextlib.suppress(AttributeError, OSError):  # not on every system
            document["cpu_s"] = time.clock_gettime(time.pthread_getcpuclockid(self._thread.ident or 0))
        return document


def _bound(address: Address) -> socket.socket:
    """Return a socket that listens. Raises InputError."""
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)
        family, kind, protocol, _, place = found[0]
        link = socket.socket(family, kind, protocol)
        try:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _ON_THE_WAY)
            link.bind(place)
            link.listen(64)
        except OSError:
            link.close()
            raise
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"--page {address.text}: cannot be served there ({why}); choose another HOST:PORT") from error
    return link
