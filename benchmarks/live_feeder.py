"""A vehicle that sends JSON: a recording over UDP on this machine, at the pace of its times.

    python benchmarks/live_feeder.py FILE PORT [--times FROM,TO] [--pace 1]

One datagram a sample, encoded before the first is sent. A process of its own, as a vehicle is.
"""

from __future__ import annotations

import argparse
import json
import socket
import time
from pathlib import Path

from towtank.live.pipeline.instants import rows_of
from towtank.readers import read


def datagrams(path: Path, start: float, end: float) -> list[tuple[float, bytes]]:
    """Return time and bytes of each sample with start <= t < end; commands as a list in the order recorded."""
    out = []
    for t, names, values in rows_of(read(path)):
        if start <= t < end:
            message: dict[str, object] = {"t": round(t, 6)}
            message |= {name: x for name, x in zip(names, values, strict=True) if not name.startswith("cmd_")}
            commands = {
                name.removeprefix("cmd_"): x for name, x in zip(names, values, strict=True) if name.startswith("cmd_")
            }
            out.append((t, json.dumps(message | ({"cmd": commands} if commands else {})).encode()))
    return out


def send(messages: list[tuple[float, bytes]], port: int, pace: float = 1.0) -> None:
    """Send them at `pace` times the speed of their times."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    began = time.monotonic()
    for t, data in messages:
        wait = began + (t - messages[0][0]) / pace - time.monotonic()
        if wait > 0.0:
            time.sleep(wait)
        link.sendto(data, ("127.0.0.1", port))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("port", type=int)
    parser.add_argument("--times", default="-1e9,1e9")
    parser.add_argument("--pace", type=float, default=1.0)
    requested = parser.parse_args()
    start, end = (float(text) for text in requested.times.split(","))
    messages = datagrams(requested.file, start, end)
    print(len(messages), flush=True)
    send(messages, requested.port, requested.pace)


if __name__ == "__main__":
    main()
