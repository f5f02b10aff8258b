"""Motion capture servers that speak just enough of the makers' protocols for their own libraries to read."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pose", "natnet_server", "qtm_server"]

Pose = tuple[Sequence[float], NDArray[np.float64], bool]  # position [m], rotation (3, 3), seen


@contextlib.contextmanager
def qtm_server(
    bodies: Sequence[str], frames: Sequence[Sequence[Pose]], period: float = 0.01, answers_after: float = 0.0
) -> Iterator[int]:
    """Yield the port of a QTM that has these bodies and streams these frames, once, to whoever asks."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.1)
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            with contextlib.suppress(OSError):
                link, _ = listener.accept()
                with link:
                    link.settimeout(5.0)
                    time.sleep(answers_after)
                    _talk(link, bodies, frames, period, stop)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield int(listener.getsockname()[1])
    finally:
        stop.set()
        thread.join(5.0)
        listener.close()


def _talk(
    link: socket.socket,
    bodies: Sequence[str],
    frames: Sequence[Sequence[Pose]],
    period: float,
    stop: threading.Event,
) -> None:
    link.sendall(_packet(1, b"QTM RT Interface connected\0"))
    while not stop.is_set():
        head = link.recv(8)
        if len(head) < 8:
            return
        text = link.recv(struct.unpack("<I", head[:4])[0] - 8).rstrip(b"\0").decode()
        if text.startswith("version"):
            link.sendall(_packet(1, b"Version set to 1.25\0"))
        elif text.startswith("getparameters"):
            named = "".join(f"<Body><Name>{name}</Name></Body>" for name in bodies)
            link.sendall(
                _packet(
                    2, f"<QTM_Parameters_Ver_1.25><The_6D>{named}</The_6D></QTM_Parameters_Ver_1.25>".encode() + b"\0"
                )
            )
        elif text.startswith("streamframes allframes"):
            for k, poses in enumerate(frames):
                link.sendall(_packet(3, _qtm_frame(k, round(1e6 * period * k), poses)))
                time.sleep(period)
            return


def _packet(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", 8 + len(body), kind) + body


def _qtm_frame(number: int, stamp: int, poses: Sequence[Pose]) -> bytes:
    """Return a data packet with one component of 6-DOF bodies: mm, matrices column by column, NaN where not seen."""
    component = struct.pack("<ihh", len(poses), 0, 0)
    for position, rotation, seen in poses:
        numbers = [1e3 * x for x in position] + rotation.T.ravel().tolist()
        component += struct.pack("<12f", *(numbers if seen else [float("nan")] * 12))
    return struct.pack("<qII", stamp, number, 1) + struct.pack("<II", 8 + len(component), 5) + component


@contextlib.contextmanager
def natnet_server(
    bodies: dict[str, int], frames: Sequence[dict[int, Pose]], damaged: Callable[[int], bool] = lambda k: False
) -> Iterator[int]:
    """Yield the port of a Motive that has these bodies, and streams these frames once a client keeps alive."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))
    link.settimeout(0.05)
    stop = threading.Event()

    def serve() -> None:
        sent = 0
        client: tuple[str, int] | None = None
        while not stop.is_set():
            with contextlib.suppress(TimeoutError):
                data, sender = link.recvfrom(1000)
                kind = struct.unpack_from("<H", data)[0]
                if kind == 0:
                    info = b"Motive".ljust(256, b"\0") + bytes((3, 1, 0, 0)) + bytes((4, 1, 0, 0))
                    link.sendto(struct.pack("<HH", 1, len(info)) + info, sender)
                elif kind == 4:
                    model = _natnet_model(bodies)
                    link.sendto(struct.pack("<HH", 5, len(model)) + model, sender)
                elif kind == 10:
                    client = sender
            while client is not None and sent < len(frames):
                body = _natnet_frame(sent, 0.01 * sent, frames[sent])
                data = struct.pack("<HH", 7, len(body)) + body
                link.sendto(data[: len(data) // 2] if damaged(sent) else data, client)
                sent += 1

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield int(link.getsockname()[1])
    finally:
        stop.set()
        thread.join(5.0)
        link.close()


def _natnet_model(bodies: dict[str, int]) -> bytes:
    out = struct.pack("<I", len(bodies))
    for name, number in bodies.items():
        body = name.encode() + b"\0" + struct.pack("<II3f", number, 0, 0.0, 0.0, 0.0) + struct.pack("<I", 0)
        out += struct.pack("<II", 1, len(body)) + body
    return out


def _natnet_frame(number: int, stamp: float, poses: dict[int, Pose]) -> bytes:
    """Return a frame of version 4.1: of all kinds of things none but rigid bodies."""
    none = struct.pack("<II", 0, 0)
    bodies = b""
    for identity, (position, rotation, seen) in poses.items():
        w = 0.5 * np.sqrt(max(1.0 + np.trace(rotation), 1e-12))
        x, y, z = (rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1])
        turn = (x / (4 * w), y / (4 * w), z / (4 * w), w)
        bodies += struct.pack("<I3f4ffH", identity, *position, *turn, 1e-4, int(seen))
    kinds = none + none + struct.pack("<II", len(poses), len(bodies)) + bodies + none * 5
    return struct.pack("<I", number) + kinds + struct.pack("<IIdQQQH", 0, 0, stamp, 0, 0, 0, 0) + b"\0" * 4
