"""A proxy before an object store that fails: answers of 503, connections reset, stalls, bodies cut in half."""

from __future__ import annotations

import http.client
import random
import socket
import struct
import threading
import time
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar

__all__ = ["FailingProxy"]

FAULTS = ("503", "reset", "stall", "half an answer", "half a request")
_STALL = 30.0  # s, longer than anybody waits


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    target: ClassVar[int]
    share: ClassVar[float]
    rng: ClassVar[random.Random]
    counts: ClassVar[Counter[str]]

    def _pass_on(self) -> None:
        body = self._body()
        fault = self.rng.choice(FAULTS) if self.rng.random() < self.share else ""
        if fault.startswith("half a request") and not body:
            fault = "reset"
        self.counts[fault or "passed on"] += 1
        if fault == "503":
            self._answer(503, [], b"<Error><Code>SlowDown</Code><Message>Reduce your rate</Message></Error>")
        elif fault == "reset":
            self._reset()
        elif fault == "stall":
            time.sleep(_STALL)
            self._reset()
        elif fault == "half a request":
            self._send(body[: len(body) // 2]).close()
            self._reset()
        else:
            self._answer(*self._asked(body), cut=fault == "half an answer")

    def _body(self) -> bytes:
        """Return the body of a request as it comes, frames of chunks included."""
        if self.headers.get("Transfer-Encoding", "") != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length") or 0))
        out = []
        while True:
            line = self.rfile.readline()
            size = int(line.partition(b";")[0], 16)
            out += [line, self.rfile.read(size + 2)]
            if not size:
                return b"".join(out)

    def _send(self, body: bytes) -> socket.socket:
        """Send the head of the request on, and this of its body."""
        heads = [
            f"{name}: {value}" for name, value in self.headers.items() if name.lower() not in ("expect", "connection")
        ]
        head = "\r\n".join([f"{self.command} {self.path} HTTP/1.1", *heads, "Connection: close", "", ""])
        link = socket.create_connection(("127.0.0.1", self.target), timeout=60.0)
        link.sendall(head.encode() + body)
        return link

    def _asked(self, body: bytes) -> tuple[int, list[tuple[str, str]], bytes]:
        with self._send(body) as link:
            answer = http.client.HTTPResponse(link, method=self.command)
            answer.begin()
            return answer.status, answer.getheaders(), answer.read()

    def _answer(self, status: int, headers: list[tuple[str, str]], data: bytes, *, cut: bool = False) -> None:
        self.send_response_only(status)
        for name, value in headers:
            if name.lower() not in ("transfer-encoding", "connection", "content-length"):
                self.send_header(name, value)
        size = next((value for name, value in headers if name.lower() == "content-length"), str(len(data)))
        self.send_header("Content-Length", size if self.command == "HEAD" else str(len(data)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data[: len(data) // 2] if cut else data)
        if cut:
            self._reset()

    def _reset(self) -> None:
        """End the connection so that the other side sees it reset."""
        self.wfile.flush()
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.close_connection = True
        self.connection.close()

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = _pass_on

    def handle(self) -> None:
        try:
            super().handle()
        except (OSError, ValueError):
            self.close_connection = True

    def finish(self) -> None:
        try:
            super().finish()
        except (OSError, ValueError):
            self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class FailingProxy:
    """Passes requests on to a port of this machine, all but a share of them.

    Attributes:
        port: that it listens on. counts: of requests by what became of them.
    """

    def __init__(self, target: int, share: float, seed: int) -> None:
        self.counts: Counter[str] = Counter()
        about = {"target": target, "share": share, "rng": random.Random(seed), "counts": self.counts}
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), about))
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
