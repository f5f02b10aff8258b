"""Malformed datagrams: whatever comes over UDP, the links count what is bad and go on.

    python benchmarks/studies/fuzz_datagrams.py [--runs 100000] [--seed 1] [--output fuzz.json]

Datagrams of a simulated vehicle are cut, flipped, spliced, repeated, mixed with random bytes and with JSON that is
valid but absurd, and sent through a socket to the JSON link, nine of ten of them broken. What still decodes goes the
whole way: clock, sorting, the instants of a real learner. Nothing may be raised, no read may take longer than 2 s,
memory stays bounded, and every datagram is either taken or counted.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import resource
import socket
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from towtank import load_vehicle
from towtank.live.links.json import JsonSource
from towtank.live.links.source import Raw, Sample, SourceState
from towtank.live.pipeline.instants import rows_of
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.outputs import write_text
from towtank.simulation import Mocap, manoeuvre, simulate

VEHICLE = "vlbv300"
LONGEST, MOST_MEMORY = 2.0, 128.0  # s, MiB
_BURST = 50
_ABSURD = (
    b"",
    b"\n",
    b"null",
    b"[1, 2]",
    b"{}",
    b'{"t": null}',
    b'{"t": 1e308, "x": 1}',
    b'{"t": -1e308, "x": 1}',
    b'{"t": "now", "x": 1}',
    b'{"t": true, "x": false}',
    b'{"t": 1e999, "psi": NaN}',
    b'{"x": Infinity, "y": -Infinity}',
    b'{"x": 1' + b"0" * 400 + b"}",
    b'{"cmd": [1]}',
    b'{"cmd": {"nobody": 1, "": 2}}',
    b'{"cmd": {"aft_port": {"a": 1}}}',
    b'{"frame": 3, "x": 1}',
    b'{"frame": {"body": [], "world": {}}, "x": 1}',
    b'{"qw": 0, "qx": 0, "qy": 0, "qz": 0}',
    b'{"qw": 1e200, "qx": 1e200, "qy": 0, "qz": 0}',
    b"[" * 60_000,
    b'{"a":' * 10_000,
    b'{"\xff\xfe": 1}',
    b'"\\ud800"',
    b'{"cmd_\\ud800": 1, "x\\u0000": 2}',
)


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    datagrams: int
    samples: int
    bad: int
    slowest_s: float
    memory_mib: float
    learned: int
    warnings: tuple[str, ...]


class Fed:
    """The JSON link, fed with datagrams by its own reader, so that none is lost to a full buffer."""

    name, keeps_time, patient = "json", False, False

    def __init__(self, datagrams: Iterator[bytes], link: JsonSource, address: tuple[str, int]) -> None:
        self._datagrams, self._link, self._address = datagrams, link, address
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sent, self.slowest, self.raw, self._ended = 0, 0.0, 0, False

    def open(self) -> None:
        self._link.open()

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        burst = list(itertools.islice(self._datagrams, _BURST))
        for data in burst:
            self._socket.sendto(data, self._address)
        self.sent += len(burst)
        self._ended = not burst
        began = time.monotonic()
        items = list(self._link.read(timeout)) if burst else []
        self.slowest = max(self.slowest, time.monotonic() - began)
        self.raw += sum(isinstance(item, Raw) for item in items)
        return items

    def state(self) -> SourceState:
        state = self._link.state()
        return SourceState(state.said, state.asked, state.rates, state.bad, state.late, state.senders, self._ended)

    def close(self) -> None:
        self._link.close()
        self._socket.close()


def broken(data: bytes, other: bytes, chance: random.Random) -> bytes:
    """Return a datagram as a bad link or a bad program might send it."""
    way = chance.randrange(7)
    if way == 0:
        return data[: chance.randrange(len(data))]
    if way == 1:
        flipped = bytearray(data)
        for _ in range(chance.randint(1, 8)):
            flipped[chance.randrange(len(flipped))] ^= 1 << chance.randrange(8)
        return bytes(flipped)
    if way == 2:
        return data[: chance.randrange(len(data))] + other[chance.randrange(len(other)) :]
    if way == 3:
        return chance.randbytes(chance.randint(0, 1400))
    if way == 4:
        return data + data[: chance.randrange(len(data))]
    if way == 5:
        digits = [k for k, byte in enumerate(data) if byte in b"0123456789.-"]
        changed = bytearray(data)
        for k in chance.sample(digits, min(4, len(digits))):
            changed[k] = chance.choice(b"0123456789.-e")
        return bytes(changed)
    return chance.choice(_ABSURD)


def datagrams(count: int, seed: int) -> Iterator[bytes]:
    """Yield datagrams, one of ten of them whole."""
    chance = random.Random(seed)
    vehicle = load_vehicle(VEHICLE)
    seconds = 10.0
    plan = manoeuvre("all-multisine", vehicle, duration=seconds, dt=0.01, seed=seed)
    run = simulate(vehicle, commands=plan.commands, dt=0.01, sensors=Mocap(rate=100.0), seed=seed)
    whole = [
        json.dumps(({} if k % 100 else {"t": t}) | dict(zip(names, values, strict=True))).encode()
        for k, (t, names, values) in enumerate(rows_of(run))  # most without a stamp: they are learned from at any pace
    ]
    for k in range(count):
        data = whole[k // 10 % len(whole)]
        yield data if k % 10 == 0 else broken(data, chance.choice(whole), chance)


def perform(count: int, seed: int) -> Outcome:
    """Send everything; raises what a link or the learner raises."""
    warnings.simplefilter("error")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        address = ("127.0.0.1", int(probe.getsockname()[1]))
    vehicle = load_vehicle(VEHICLE)
    source = Fed(datagrams(count, seed), JsonSource(f"json:{address[0]}:{address[1]}", vehicle), address)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    session = Session([("json", source)], vehicle, new_learner(vehicle, "joint"), epoch=time.time(), window=0.02)
    session.open()
    status: Status = session.run(threading.Event())
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
    assert source.raw + datagrams_without_bytes(count, seed) == source.sent == count, "a datagram was lost"
    return Outcome(
        source.sent, status.samples, status.bad, source.slowest, memory, status.learnt.instants, status.warnings
    )


def datagrams_without_bytes(count: int, seed: int) -> int:
    """Return how many datagrams are empty: there is nothing to record of them."""
    return sum(not data for data in datagrams(count, seed))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path)
    requested = parser.parse_args()
    found = perform(requested.runs, requested.seed)
    for name, value in asdict(found).items():
        print(f"{name:12} {value}")
    if requested.output:
        write_text(requested.output, json.dumps(asdict(found), indent=2))
    failed = [text for text in found.warnings if "stopped" in text or "failed" in text]
    return 1 if failed or found.slowest_s > LONGEST or found.memory_mib > MOST_MEMORY else 0


if __name__ == "__main__":
    sys.exit(main())
