"""Sessions that are killed: what is missing from the recording, and what the resumed session still knows.

    python benchmarks/studies/live_kill_study.py [--runs 20] [--seed 1] [--workers 4] [--seconds 40] [--output FILE]

A simulated vehicle sends JSON over UDP at 100 Hz to `towtank live --record`. At a random moment the process is killed
with SIGKILL, started anew with `--resume`, and the vehicle goes on from where it stood. Asked of every run: at most a
second of what had been sent is missing from the recording, the recording is one and is read, and the coefficients end
within half a deviation of those of a session that nobody interrupted.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from towtank import load_vehicle
from towtank.live.recorded import rows_of
from towtank.outputs import write_text
from towtank.readers import read
from towtank.simulation import Mocap, manoeuvre, simulate

VEHICLE, RATE = "vlbv300", 100.0
MISSING, CHANGED = 1.0, 0.5  # s, deviations
_MARGIN = 2.0  # s of the session at both ends in which nothing is killed


@dataclass(frozen=True)
class Run:
    """One session.

    Attributes:
        killed: moment in the session [s]; None where it went through.
        missing: what had been sent and is not recorded [s]. recorded: samples in the end, of `sent`.
        resumed: seconds that the new start took. coefficients: name -> value, std.
    """

    killed: float | None
    missing: float
    sent: int
    recorded: int
    resumed: float
    coefficients: dict[str, tuple[float, float]]


class Live:
    """A process of `towtank live`."""

    def __init__(self, port: int, target: Path, *options: str) -> None:
        command = [sys.executable, "-m", "towtank", "live", f"json:127.0.0.1:{port}", "--vehicle", VEHICLE]
        self.process = subprocess.Popen(
            [*command, "--record", str(target), "--json-lines", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stderr is not None
        said: list[str] = []
        for line in self.process.stderr:
            said.append(line)
            if line.startswith("listening"):
                return
        raise SystemExit("".join(said))

    def kill(self) -> None:
        """End at once, without a chance to close anything."""
        self.process.send_signal(signal.SIGKILL)
        self.process.communicate()

    def end(self) -> dict[str, dict[str, dict[str, float]]]:
        """End in order; return the document."""
        self.process.terminate()
        lines = self.process.communicate()[0].splitlines()
        if self.process.returncode:
            raise SystemExit(f"towtank live ended with {self.process.returncode}")
        document: dict[str, dict[str, dict[str, float]]] = json.loads(lines[-1])
        return document


def messages(seconds: float) -> list[tuple[float, bytes]]:
    """Return times and datagrams of a session of all axes at once."""
    vehicle = load_vehicle(VEHICLE)
    plan = manoeuvre("all-multisine", vehicle, duration=seconds, dt=1.0 / RATE, seed=1)
    run = simulate(vehicle, commands=plan.commands, dt=1.0 / RATE, sensors=Mocap(rate=RATE), seed=1)
    return [
        (t, json.dumps({"t": t, **dict(zip(names, values, strict=True))}).encode()) for t, names, values in rows_of(run)
    ]


def send(feed: Sequence[tuple[float, bytes]], port: int) -> None:
    """Send datagrams at the pace of their times."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        began = time.monotonic()
        for t, data in feed:
            wait = began + t - feed[0][0] - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            link.sendto(data, ("127.0.0.1", port))


def session(feed: Sequence[tuple[float, bytes]], target: Path, killed: float | None) -> Run:
    """Send everything to a session that is killed at a moment [s], or not."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        port = int(link.getsockname()[1])
    live, rest, missing, took = Live(port, target), feed, 0.0, 0.0
    if killed is not None:
        first = [each for each in feed if each[0] < killed]
        send(first, port)
        live.kill()
        missing = (len(first) - samples(target)) / RATE
        before = time.monotonic()
        live, rest = Live(port, target, "--resume"), feed[len(first) :]
        took = time.monotonic() - before
    send(rest, port)
    time.sleep(0.5)
    found = live.end()["coefficients"]
    known = {name: (each["value"], each["std"]) for name, each in found.items() if each["identified"]}
    return Run(killed, missing, len(feed), samples(target), took, known)


def samples(target: Path) -> int:
    """Return how many samples a recording holds."""
    return len(read(target)["x"])


def changes(run: Run, reference: Run) -> dict[str, float]:
    """Return how far each coefficient is from the reference, in deviations; infinity where only one knows it."""
    names = run.coefficients.keys() | reference.coefficients.keys()
    return {
        name: abs(run.coefficients[name][0] - reference.coefficients[name][0])
        / max(reference.coefficients[name][1], 1e-12)
        if name in run.coefficients and name in reference.coefficients
        else float("inf")
        for name in sorted(names)
    }


def show(runs: Sequence[Run], reference: Run) -> bool:
    """Print what came of it; return whether all holds."""
    table = Table(title=f"{len(runs)} sessions of {len(reference.coefficients)} coefficients, killed")
    for column in ("killed at [s]", "missing [s]", "recorded", "new start [s]", "largest change [std]", "of"):
        table.add_column(column, justify="right")
    worst = 0.0
    for run in sorted(runs, key=lambda each: each.killed or 0.0):
        change = changes(run, reference)
        name = max(change, key=lambda each: change[each])
        worst = max(worst, change[name])
        cells = (f"{run.killed:.2f}", f"{run.missing:.2f}", f"{run.recorded} of {run.sent}", f"{run.resumed:.1f}")
        table.add_row(*cells, f"{change[name]:.2f}", name)
    Console(width=100).print(table)
    missing = max(run.missing for run in runs)
    print(f"missing at most {missing:.2f} s (limit {MISSING}), changed at most {worst:.2f} std (limit {CHANGED})")
    return missing <= MISSING and worst <= CHANGED


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    chance = random.Random(asked.seed)
    moments = [chance.uniform(_MARGIN, asked.seconds - _MARGIN) for _ in range(asked.runs)]
    feed = messages(asked.seconds)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(asked.workers) as pool:
        through = pool.submit(session, feed, Path(folder) / "through.mcap", None)
        killed = [
            pool.submit(session, feed, Path(folder) / f"killed{k}.mcap", moment) for k, moment in enumerate(moments)
        ]
        reference, runs = through.result(), [each.result() for each in killed]
    holds = show(runs, reference)
    if asked.output:
        changed = [changes(run, reference) for run in runs]
        document = {"reference": asdict(reference), "runs": [asdict(run) for run in runs], "changes": changed}
        write_text(asked.output, json.dumps(document, indent=2))
    print("median change", f"{np.median([x for run in runs for x in changes(run, reference).values()]):.3f} std")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
