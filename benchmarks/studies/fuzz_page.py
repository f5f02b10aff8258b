"""Malformed WebSocket frames and requests against the live page: refused, counted, told once, nothing else.

    python benchmarks/studies/fuzz_page.py [--frames 10000] [--requests 2000] [--seed 1]

A session is simulated and served on a free port of this machine; every frame goes through a socket of its own, greeted
as a viewer is. At the end the page must answer, no viewer may be left, and learning must have gone on.
"""

from __future__ import annotations

import argparse
import base64
import os
import socket
import struct
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.dashboard.rig import Rig


def greeted(port: int) -> socket.socket:
    """Return a socket that has been greeted as a viewer."""
    link = socket.create_connection(("127.0.0.1", port), 10)
    key = base64.b64encode(os.urandom(16)).decode()
    link.sendall(
        f"GET /api/stream HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    link.recv(64)
    return link


def frame(random: np.random.Generator) -> bytes:
    """Return what no page of ours sends."""
    kind = int(random.integers(6))
    body = random.bytes(int(random.integers(0, 400)))
    mask = random.bytes(4)
    if kind == 0:
        return random.bytes(int(random.integers(2, 200)))
    if kind == 1:  # not masked
        return bytes([0x80 | int(random.integers(16)), len(body[:100])]) + body[:100]
    if kind == 2:  # longer than it may be
        return b"\x82\xff" + struct.pack(">Q", int(random.integers(2**16, 2**62))) + mask + body
    if kind == 3:  # reserved bits and codes
        return bytes([int(random.integers(256)) | 0x70, 0x80 | len(body[:100])]) + mask + body[:100]
    if kind == 4:  # parts of a message that never began, or never ends
        return bytes([int(random.integers(2)), 0x80 | len(body[:100])]) + mask + body[:100]
    return b"\x81" + bytes([0x80 | len(body[:100])]) + mask + body[:100]  # text, of any bytes


def request(random: np.random.Generator, port: int) -> bytes:
    """Return a request that is none of ours."""
    paths = ("/", "/../..", "/%2e%2e/%00", "/api/state", "/api/mark", "/page.js", "/" + "a" * 3000, "*")
    method = ("GET", "POST", "HEAD", "BREW", "get", "CONNECT")[int(random.integers(6))]
    head = f"{method} {paths[int(random.integers(len(paths)))]} HTTP/1.{int(random.integers(3))}\r\n".encode()
    host = (f"127.0.0.1:{port}", "evil.example", "")[int(random.integers(3))]
    head += f"Host: {host}\r\nContent-Length: {int(random.integers(-5, 10**6))}\r\n\r\n".encode()
    cut = int(random.integers(1, len(head) + 1)) if random.random() < 0.3 else len(head)
    return head[:cut] + random.bytes(int(random.integers(0, 200)))


def closed(link: socket.socket, seconds: float = 0.3) -> bool:
    """Read until the server closes, at most so long."""
    link.settimeout(seconds)
    deadline = time.monotonic() + seconds
    try:
        while time.monotonic() < deadline:
            if not link.recv(1 << 16):
                return True
    except TimeoutError:
        return False
    except ConnectionError:
        return True
    return False


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--requests", type=int, default=2_000)
    parser.add_argument("--seed", type=int, default=1)
    requested = parser.parse_args()
    random = np.random.default_rng(requested.seed)
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(Path(folder))
        rig.start()
        port, began = rig.page.address.port, time.monotonic()
        threads = threading.active_count()
        ended = 0
        for _ in range(requested.frames):
            with greeted(port) as link:
                link.sendall(frame(random) + b"\x88\x80mask")  # and goodbye, where the frame left room for it
                ended += closed(link)
        frames = time.monotonic() - began
        for _ in range(requested.requests):
            with socket.create_connection(("127.0.0.1", port), 10) as link:
                link.sendall(request(random, port))
                closed(link, 0.05)
        instants = rig.session.learning.now.instants
        with urllib.request.urlopen(f"{rig.base}/api/state", timeout=10) as answer:
            alive = answer.status == 200
        time.sleep(1.0)
        status = rig.session.status()
        print(f"{requested.frames} malformed frames in {frames:.0f} s: {ended} sockets closed by the server at once")
        print(f"{requested.requests} malformed requests; refused in all: {dict(rig.page.refusals.counts)}")
        print(f"lines told: {len(rig.told)}; viewers left: {rig.page.pump.viewers}; page alive: {alive}")
        print(f"threads before {threads}, after {threading.active_count()}; dropped {status.dropped}")
        learning = status.learnt.instants > instants or rig.session.learning.now.t >= 199.0
        good = alive and learning and rig.page.pump.viewers == 0 and len(rig.told) <= 10 and not status.dropped
        rig.close()
    print("nothing else happened" if good else "SOMETHING ELSE HAPPENED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
