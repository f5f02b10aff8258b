"""Sessions that are killed: what is missing from the recording, and what the resumed session still knows.

    python benchmarks/studies/live_kill_study.py [--runs 20] [--seed 1] [--workers 2] [--seconds 40] [--output FILE]

A simulated vehicle sends JSON over UDP at 100 Hz to `towtank live --record`. At a random moment the process is killed
with SIGKILL, started anew with `--resume`, and the vehicle goes on from where it stood. Asked of every run: at most a
second of what had been sent is missing from the recording, the recording is one and is read, and the coefficients end
within half a deviation of those of sessions that nobody interrupted.

The filter's second looks run beside the stream and take effect when they are done, so that sessions which nobody
interrupts differ among themselves. Several are run (--through); their median is the reference, and how far each of them
is from it is shown beside.
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
from towtank.live.pipeline.instants import rows_of
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
        resumed: seconds that the new start took. checkpoint: whether it went on from one.
        coefficients: name -> value, std.
    """

    killed: float | None
    missing: float
    sent: int
    recorded: int
    resumed: float
    checkpoint: bool
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
        self.said: list[str] = []
        for line in self.process.stderr:
            self.said.append(line)
            if line.startswith("listening"):
                return
        raise SystemExit("".join(self.said))

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
    live, rest, missing, took, checkpoint = Live(port, target), feed, 0.0, 0.0, False
    if killed is not None:
        first = [each for each in feed if each[0] < killed]
        send(first, port)
        live.kill()
        missing = (len(first) - samples(target)) / RATE
        before = time.monotonic()
        live, rest = Live(port, target, "--resume"), feed[len(first) :]
        took = time.monotonic() - before
        checkpoint = any("after its checkpoint" in line for line in live.said)
    send(rest, port)
    time.sleep(0.5)
    found = live.end()["coefficients"]
    known = {name: (each["value"], each["std"]) for name, each in found.items() if each["identified"]}
    return Run(killed, missing, len(feed), samples(target), took, checkpoint, known)


def samples(target: Path) -> int:
    """Return how many samples a recording holds."""
    return len(read(target)["x"])


def changes(run: Run, reference: dict[str, tuple[float, float]]) -> dict[str, float]:
    """Return how far each coefficient is from the reference, in deviations; infinity where only one knows it."""
    names = run.coefficients.keys() | reference.keys()
    return {
        name: abs(run.coefficients[name][0] - reference[name][0]) / max(reference[name][1], 1e-12)
        if name in run.coefficients and name in reference
        else float("inf")
        for name in sorted(names)
    }


def median_of(runs: Sequence[Run]) -> dict[str, tuple[float, float]]:
    """Return value and deviation of each coefficient that most runs know: medians of both."""
    names = [name for run in runs for name in run.coefficients]
    found = {}
    for name in sorted(set(names)):
        if 2 * names.count(name) > len(runs):
            pairs = [run.coefficients[name] for run in runs if name in run.coefficients]
            found[name] = float(np.median([value for value, _ in pairs])), float(np.median([std for _, std in pairs]))
    return found


def show(title: str, runs: Sequence[Run], reference: dict[str, tuple[float, float]]) -> float:
    """Print how runs ended; return the largest change of a coefficient, in deviations."""
    table = Table(title=title)
    for column in ("killed at [s]", "missing [s]", "recorded", "new start [s]", "from", "largest change [std]", "of"):
        table.add_column(column, justify="right")
    worst = 0.0
    for run in sorted(runs, key=lambda each: each.killed or 0.0):
        change = changes(run, reference)
        name = max(change, key=lambda each: change[each])
        worst = max(worst, change[name])
        cells = ("-", "-", f"{run.recorded} of {run.sent}", "-", "-")
        if run.killed is not None:
            whence = "checkpoint" if run.checkpoint else "recording"
            cells = (f"{run.killed:.2f}", f"{run.missing:.2f}", cells[2], f"{run.resumed:.1f}", whence)
        table.add_row(*cells, f"{change[name]:.2f}", name)
    Console(width=110).print(table)
    return worst


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--through", type=int, default=5, help="sessions that nobody interrupts")
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--output", type=Path)
    requested = parser.parse_args()
    chance = random.Random(requested.seed)
    moments = [chance.uniform(_MARGIN, requested.seconds - _MARGIN) for _ in range(requested.runs)]
    feed = messages(requested.seconds)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(requested.workers) as pool:
        whole = [pool.submit(session, feed, Path(folder) / f"through{k}.mcap", None) for k in range(requested.through)]
        killed = [
            pool.submit(session, feed, Path(folder) / f"killed{k}.mcap", moment) for k, moment in enumerate(moments)
        ]
        through, runs = [each.result() for each in whole], [each.result() for each in killed]
    reference = median_of(through)
    spread = show(f"{len(through)} sessions that nobody interrupted, {len(reference)} coefficients", through, reference)
    worst = show(f"{len(runs)} sessions, killed", runs, reference)
    if requested.output:
        changed = [changes(run, reference) for run in runs]
        document = {
            "reference": reference,
            "through": [asdict(run) for run in through],
            "runs": [asdict(run) for run in runs],
            "changes": changed,
        }
        write_text(requested.output, json.dumps(document, indent=2))
    every = [x for run in runs for x in changes(run, reference).values()]
    alone = [x for run in through for x in changes(run, reference).values()]
    missing = max(run.missing for run in runs)
    print(f"missing at most {missing:.2f} s (limit {MISSING})")
    print(f"changed at most {worst:.2f} std (limit {CHANGED}), median {np.median(every):.3f}")
    print(f"uninterrupted sessions among themselves: at most {spread:.2f} std, median {np.median(alone):.3f}")
    return 0 if missing <= MISSING and worst <= CHANGED else 1


if __name__ == "__main__":
    sys.exit(main())
