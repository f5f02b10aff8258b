"""A live session under load: nothing lost, latency, memory.

    python benchmarks/bench_live.py [--seconds 600] [--fast-seconds 60] [--json]

A simulated BlueROV2 Heavy, eight thrusters and pose in six degrees of freedom, sends JSON over UDP on this machine to
`towtank live --record`, from a process of its own: at 100 Hz for ten minutes, samples not held back, and at 1 kHz for
one. Every datagram must stand in the recording; at 100 Hz every sample must be learned from, with 99 of 100 latencies
(receipt of the datagram to updated estimate) within 20 ms, and memory must stay flat over the second half.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from figures import Figure, report

from towtank import load_vehicle
from towtank.readers import read
from towtank.simulation import Mocap, manoeuvre, simulate

VEHICLE = "bluerov2_heavy"
LATENCY = 20.0  # ms
GROWTH = 16.0  # MiB over the second half
FEEDER = Path(__file__).with_name("live_feeder.py")


@dataclass(frozen=True)
class Outcome:
    """How one session went.

    Attributes:
        sent: datagrams. recorded: of them, as bytes and as samples. document: of `--json-lines`, its last line.
        memory: (n,) resident memory [MiB], one a second.
    """

    sent: int
    recorded: tuple[int, int]
    document: dict[str, object]
    memory: list[float]


def recording_at(rate: float, seconds: float, path: Path) -> None:
    """Write a simulated session of all axes at once."""
    vehicle = load_vehicle(VEHICLE)
    plan = manoeuvre("all-multisine", vehicle, duration=seconds, dt=1.0 / rate, seed=1)
    run = simulate(vehicle, commands=plan.commands, dt=1.0 / rate, sensors=Mocap(rate=rate), seed=1)
    run.write(path)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


def resident(process: int) -> float:
    """Return the resident memory of a process [MiB]."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return float(line.split()[1]) / 1024.0
    return float("nan")


def run(rate: float, seconds: float, folder: Path, *options: str) -> Outcome:
    """Send a session to `towtank live`."""
    source, target, port = folder / f"{rate:.0f}.parquet", folder / f"{rate:.0f}.mcap", free_port()
    recording_at(rate, seconds, source)
    command = [sys.executable, "-m", "towtank", "live", f"json:127.0.0.1:{port}", "--vehicle", VEHICLE]
    live = subprocess.Popen(
        [*command, "--record", str(target), "--json-lines", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert live.stderr is not None
    while "listening" not in live.stderr.readline():
        if live.poll() is not None:
            raise SystemExit(f"towtank live has ended with {live.returncode}")
    feeder = subprocess.Popen([sys.executable, str(FEEDER), str(source), str(port)], stdout=subprocess.PIPE, text=True)
    assert feeder.stdout is not None
    assert live.stdout is not None
    sent = int(feeder.stdout.readline())
    memory: list[float] = []
    for _ in live.stdout:
        memory.append(resident(live.pid))
        if feeder.poll() is not None and len(memory) > 3:
            break
    time.sleep(2.0)
    live.terminate()
    last = live.communicate()[0].splitlines()[-1]
    kept = read(target)
    counts = {each.name.split("/")[1]: each.count for each in kept.contents}
    return Outcome(sent, (counts["raw"], counts["json"]), json.loads(last), memory)


def slow(seconds: float, folder: Path) -> list[Figure]:
    """Return the figures at 100 Hz."""
    found = run(100.0, seconds, folder, "--window", "0")
    live = part(found, "live")
    latency = part(live, "latency_ms")
    half = found.memory[len(found.memory) // 2 :]
    growth = float(np.polyfit(np.arange(len(half)), half, 1)[0]) * len(half) if len(half) > 2 else 0.0
    what = f"{seconds:.0f} s at 100 Hz, 8 thrusters, pose"
    return [
        Figure("live_100hz_lost_from_recording", found.sent - min(found.recorded), "samples", 0.0, note=what),
        Figure("live_100hz_not_learned_from", found.sent - float(str(live["instants"])), "samples", 0.0, note=what),
        Figure("live_100hz_latency_median", float(str(latency["median"])), "ms"),
        Figure("live_100hz_latency_p99", float(str(latency["p99"])), "ms", LATENCY, note="datagram to estimate"),
        Figure("live_100hz_latency_longest", float(str(latency["max"])), "ms", note="while the filter looks back"),
        Figure("live_100hz_memory", found.memory[-1], "MiB"),
        Figure("live_100hz_memory_growth", growth, "MiB", GROWTH, note="over the second half, by a line"),
    ]


def fast(seconds: float, folder: Path) -> list[Figure]:
    """Return the figures at 1 kHz."""
    found = run(1000.0, seconds, folder)
    live = part(found, "live")
    what = f"{seconds:.0f} s at 1 kHz"
    return [
        Figure("live_1khz_lost_from_recording", found.sent - min(found.recorded), "samples", 0.0, note=what),
        Figure("live_1khz_not_learned_from", found.sent - float(str(live["instants"])), "samples", note=what),
        Figure("live_1khz_latency_p99", float(str(part(live, "processing_ms")["p99"])), "ms", note="without window"),
        Figure("live_1khz_memory", found.memory[-1], "MiB"),
    ]


def part(found: Outcome | dict[str, object], name: str) -> dict[str, object]:
    """Return a part of a document."""
    value = (found.document if isinstance(found, Outcome) else found)[name]
    assert isinstance(value, dict)
    return value


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="at 100 Hz; 0 leaves it out")
    parser.add_argument("--fast-seconds", type=float, default=60.0, help="at 1 kHz; 0 leaves it out")
    requested, rest = parser.parse_known_args()

    def figures() -> list[Figure]:
        found: list[Figure] = []
        with tempfile.TemporaryDirectory() as name:
            if requested.seconds:
                found += slow(requested.seconds, Path(name))
            if requested.fast_seconds:
                found += fast(requested.fast_seconds, Path(name))
        return found

    return report("live sessions", figures, rest)


if __name__ == "__main__":
    sys.exit(main())
