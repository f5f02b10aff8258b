"""Malformed MAVLink datagrams: whatever comes over UDP, the link counts what is bad and goes on.

    python benchmarks/studies/fuzz_mavlink.py [--runs 100000] [--seed 1]

Messages of a simulated autopilot are cut, flipped, spliced and mixed with random bytes; others bear a right checksum
over random content, of every message of the dialect and of hundreds of senders. They go through a socket to the link.
Nothing may be raised, no read may take longer than 2 s, memory stays bounded, and an autopilot that speaks sense
afterwards is understood again.
"""

from __future__ import annotations

import argparse
import random
import resource
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.generator.mavcrc import x25crc

from towtank import load_vehicle
from towtank.live.links.mavlink.source import MavlinkSource
from towtank.live.links.source import Sample
from towtank.readers.mavlink.format import layouts

LONGEST, MOST_MEMORY = 2.0, 128.0  # s, MiB
_KINDS = list(dialect.mavlink_map.values())
_USUAL = [
    *("HEARTBEAT", "ATTITUDE", "SERVO_OUTPUT_RAW", "LOCAL_POSITION_NED", "COMMAND_ACK", "PARAM_VALUE", "RAW_IMU"),
    *("EKF_STATUS_REPORT", "VISION_POSITION_DELTA", "ODOMETRY", "SCALED_PRESSURE2", "BATTERY_STATUS", "GPS_RAW_INT"),
]
_LOOKED_INTO = [kind for kind in _KINDS if kind.msgname in _USUAL]


@dataclass(frozen=True)
class Outcome:
    """How it went: datagrams, bad ones counted, seconds of the slowest read, growth of memory [MiB], samples after."""

    datagrams: int
    bad: int
    slowest_s: float
    growth: float
    samples_after: int


def framed(kind: Any, payload: bytes, rng: random.Random, sender: tuple[int, int]) -> bytes:
    """Return a message with any content and a right checksum."""
    head = bytes((len(payload), 0, 0, rng.randrange(256), *sender)) + kind.id.to_bytes(3, "little")
    crc = x25crc(head + payload + bytes((kind.crc_extra,))).crc
    return b"\xfd" + head + payload + int(crc).to_bytes(2, "little")


def broken(rng: random.Random) -> bytes:
    """Return a datagram of any kind."""
    kind = rng.choice(_LOOKED_INTO if rng.random() < 0.7 else _KINDS)
    sender = (1, 1) if rng.random() < 0.8 else (rng.randrange(256), rng.randrange(256))
    size = layouts()[kind.id].dtype.itemsize
    good = framed(kind, rng.randbytes(rng.randrange(1, min(size, 255) + 1)), rng, sender)
    how = rng.randrange(6)
    if how == 0:
        return good[: rng.randrange(len(good))]
    if how == 1:
        data = bytearray(good)
        for _ in range(rng.randrange(1, 6)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(data)
    if how == 2:
        return good[rng.randrange(len(good)) :] + good
    if how == 3:
        return rng.randbytes(rng.randrange(600))
    return good


def sense(boot: float, k: int) -> list[bytes]:
    """Return what an autopilot says."""
    encoder = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    said = [dialect.MAVLink_attitude_message(round(1e3 * boot), 0.1, 0.0, 0.01 * k, 0.0, 0.0, 0.1)]
    said += [dialect.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3)] if k % 20 == 0 else []
    return [bytes(message.pack(encoder)) for message in said]


def perform(runs: int, seed: int) -> Outcome:
    """Send `runs` datagrams, then sense for three seconds."""
    rng = random.Random(seed)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    source = MavlinkSource(f"udpin:127.0.0.1:{port}", load_vehicle("bluerov2_heavy"))
    source.open()
    slowest, before = 0.0, 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for k in range(runs):
            link.sendto(broken(rng), ("127.0.0.1", port))
            if k % 20 == 19:
                began = time.perf_counter()
                source.read(0.0)
                slowest = max(slowest, time.perf_counter() - began)
            if k == runs // 10:
                before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        growth = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
        found, began = 0, time.time()
        while (passed := time.time() - began) < 10.0 and not (passed > 3.0 and found):
            for data in sense(500.0 + passed, round(50.0 * passed)):
                link.sendto(data, ("127.0.0.1", port))
            time.sleep(0.02)
            found += sum(isinstance(each, Sample) and "psi" in each.names for each in source.read(0.0))
    source.close()
    return Outcome(runs, source.state().bad, slowest, growth, found)


def main() -> int:
    """Run and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    began = time.perf_counter()
    found = perform(options.runs, options.seed)
    print(f"{found} in {time.perf_counter() - began:.0f} s")
    good = found.slowest_s < LONGEST and found.growth < MOST_MEMORY and found.samples_after > 0 and found.bad > 0
    print("ok" if good else "FAILED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
