"""Sessions that are killed: what is missing, and what learning has lost by it.

    python benchmarks/studies/attack_kills.py [--kills 100] [--each 1] [--seconds 30] [--seed 1] [--workers 3]
                                              [--output FILE]

A simulated vehicle sends JSON over UDP at 100 Hz to `towtank live --record`. At random moments the process is killed
with SIGKILL, started anew with `--resume`, and the vehicle goes on from where it stood; `--each` kills a session. After
every kill the file is opened with the reader of the package `mcap`, which must find every sample, and at most a second
of what was sent may be missing. In the end every coefficient must be within half a deviation of the median of sessions
that nobody interrupted: the filter's re-estimations run beside the stream, so that these differ among themselves; how
far, is shown beside. What was lost is gone for good, and what it told with it: how much that alone may change, as wider
deviations say, is shown, too. The exit code is 1 where a bound is broken.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from attack_disk import RATE, Feed, Live, free_port, messages, no_survivors, opened, send
from rich.console import Console
from rich.table import Table

from towtank.outputs import write_text
from towtank.readers import read

MISSING, CHANGED = 1.0, 0.5  # s, deviations
_MARGIN = 2.0  # s of the session at both ends in which nothing is killed


@dataclass(frozen=True)
class Killed:
    """One session.

    Attributes:
        kills: moments in the session [s]. missing: most that had been sent and is not recorded after a kill [s].
        unread: samples that the independent reader does not find. sent, recorded: samples.
        coefficients: name -> value, std.
    """

    kills: tuple[float, ...]
    missing: float
    unread: int
    sent: int
    recorded: int
    coefficients: dict[str, tuple[float, float]]


def killed(feed: Feed, target: Path, kills: Sequence[float]) -> Killed:
    """Send everything to a session that is killed at moments [s]."""
    port, before, done, missing, unread = free_port(), 0, 0, 0.0, 0
    live = Live(port, target).ready()
    for moment in kills:
        part = [each for each in feed[done:] if each[0] < moment]
        send(part, port)
        live.end(signal.SIGKILL)
        done += len(part)
        found = len(read(target)["x"])
        unread += max(found - opened(target)[0], 0)
        missing = max(missing, (len(part) - (found - before)) / RATE)
        before = found
        live = Live(port, target, "--resume").ready()
    send(feed[done:], port)
    time.sleep(0.5)
    if live.end():
        raise SystemExit("".join(live.said))
    known = {
        name: (each["value"], each["std"])
        for name, each in live.lines[-1][1]["coefficients"].items()
        if each["identified"]
    }
    unread += max(len(read(target)["x"]) - opened(target)[0], 0)
    return Killed(tuple(kills), missing, unread, len(feed), len(read(target)["x"]), known)


def changes(run: Killed, reference: dict[str, tuple[float, float]]) -> dict[str, float]:
    """Return how far each coefficient is from the reference, in deviations; infinity where only one knows it."""
    names = run.coefficients.keys() | reference.keys()
    return {
        name: abs(run.coefficients[name][0] - reference[name][0]) / max(reference[name][1], 1e-12)
        if name in run.coefficients and name in reference
        else float("inf")
        for name in sorted(names)
    }


def widening(run: Killed, reference: dict[str, tuple[float, float]]) -> list[float]:
    """Return by how much each coefficient may change since less is known of it, in deviations.

    An estimate from a part of the data differs from that of all by the difference of both variances.
    """
    both = [(run.coefficients[name][1], reference[name][1]) for name in run.coefficients.keys() & reference.keys()]
    return [float(np.sqrt(max(wide**2 - std**2, 0.0)) / max(std, 1e-12)) for wide, std in both]


def median_of(runs: Sequence[Killed]) -> dict[str, tuple[float, float]]:
    """Return value and deviation of each coefficient that most runs know: medians of both."""
    names = [name for run in runs for name in run.coefficients]
    found = {}
    for name in sorted(set(names)):
        if 2 * names.count(name) > len(runs):
            pairs = [run.coefficients[name] for run in runs if name in run.coefficients]
            found[name] = float(np.median([value for value, _ in pairs])), float(np.median([std for _, std in pairs]))
    return found


def show_killed(through: Sequence[Killed], runs: Sequence[Killed]) -> bool:
    """Print sessions that were killed beside those that were not; return whether the bounds hold."""
    reference = median_of(through)
    table = Table(title=f"{sum(len(run.kills) for run in runs)} kills in {len(runs)} sessions")
    for column in ("", "bound", "found", "where"):
        table.add_column(column, justify="left" if column in ("", "where") else "right")
    worst = max(runs, key=lambda run: max(changes(run, reference).values()))
    change = changes(worst, reference)
    name = max(change, key=lambda each: change[each])
    late = max(runs, key=lambda run: run.missing)
    unread = sum(run.unread for run in runs)
    own = max(max(changes(run, reference).values()) for run in through)
    every = [x for run in runs for x in changes(run, reference).values()]
    alone = [x for run in through for x in changes(run, reference).values()]
    table.add_row("missing after a kill [s]", f"{MISSING}", f"{late.missing:.2f}", _moments(late))
    table.add_row("samples that the package mcap does not find", "0", f"{unread}", "")
    table.add_row(
        "largest change of a coefficient [std]", f"{CHANGED}", f"{change[name]:.2f}", f"{name}, {_moments(worst)}"
    )
    beyond = sum(max(changes(run, reference).values()) > CHANGED for run in runs)
    table.add_row("sessions with a larger one", "", f"{beyond}", f"of {len(runs)}")
    table.add_row("median change [std]", "", f"{np.median(every):.3f}", f"of {len(reference)} coefficients")
    explained = f"{np.sqrt(np.mean([x**2 for run in runs for x in widening(run, reference)])):.3f} by wider deviations"
    finite = [x for x in every if np.isfinite(x)]
    table.add_row("root mean square of the changes [std]", "", f"{np.sqrt(np.mean(np.square(finite))):.3f}", explained)
    table.add_row("among sessions that nobody interrupted [std]", "", f"{own:.2f}", f"median {np.median(alone):.3f}")
    Console(width=120, markup=False).print(table)
    return late.missing <= MISSING and unread == 0 and change[name] <= CHANGED


def _moments(run: Killed) -> str:
    return f"killed at {', '.join(f'{each:.2f}' for each in run.kills)} s"


def main() -> int:
    """Run and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--each", type=int, default=1, help="kills in one session")
    parser.add_argument("--seconds", type=float, default=30.0, help="of a session")
    parser.add_argument("--through", type=int, default=5, help="sessions that nobody interrupts")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    feed, chance = messages(asked.seconds), random.Random(asked.seed)
    plans = [
        sorted(chance.uniform(_MARGIN, asked.seconds - _MARGIN) for _ in range(min(asked.each, asked.kills - k)))
        for k in range(0, asked.kills, asked.each)
    ]
    with tempfile.TemporaryDirectory() as folder, no_survivors(), ThreadPoolExecutor(asked.workers) as pool:
        every = [*([()] * asked.through), *plans]
        tasks = [pool.submit(killed, feed, Path(folder, f"{k}.mcap"), plan) for k, plan in enumerate(every)]
        done = [each.result() for each in tasks]
    through, runs = done[: asked.through], done[asked.through :]
    good = show_killed(through, runs)
    if asked.output:
        document = {"through": [asdict(each) for each in through], "killed": [asdict(each) for each in runs]}
        write_text(asked.output, json.dumps(document, indent=2))
    print("every bound holds" if good else "A BOUND IS BROKEN")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
