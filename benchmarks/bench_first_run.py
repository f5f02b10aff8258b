"""What the first minute costs: kernels that each command compiles on an empty cache, and the start of `towtank --help`.

    python benchmarks/bench_first_run.py [--only learn,live] [--tree ../other-clone] [--seconds 20]

Of every command two runs are made, the first with an empty folder of machine code, the second with what it left. A row
shows the CPU seconds (user and system, of all threads) of both and their difference, the seconds inside the compiler,
how many functions and specialisations were compiled, and the machine code kept on disk. The demo is one of `--seconds`;
logs are simulated and as long. `--tree` runs the source of another clone: a second table, printed first, is before.
CPU seconds grow by half on a machine whose cores share their arithmetic with others: compare runs of the same minute.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]
_STARTS = 7
_WATCHED = """
import atexit, json, os, sys, threading, time
from numba.core import event
rows, own = [], threading.local()
class Listener(event.Listener):
    def on_start(self, each):
        own.__dict__.setdefault("began", []).append(time.thread_time())
    def on_end(self, each):
        seconds = time.thread_time() - own.began.pop()
        function = each.data["dispatcher"].py_func
        rows.append((f"{function.__module__}.{function.__qualname__}", 0.0 if own.began else seconds))
event.register("numba:compile", Listener())
def keep():
    used = os.times()
    with open(os.environ["FIRST_RUN"], "w") as file:
        json.dump({"cpu": used.user + used.system, "rows": rows}, file)
atexit.register(keep)
sys.argv[0] = "towtank"
from towtank.app.cli import main
main()
"""


@dataclass(frozen=True)
class Run:
    """CPU time of a process [s], and what it compiled: (function, seconds where no other compilation called for it)."""

    cpu: float
    rows: list[tuple[str, float]]


def commands(seconds: float) -> dict[str, list[str]]:
    """Return the arguments of each command, run in a folder with `log.csv` and `model.toml`."""
    return {
        "demo": ["demo", "--fast", "--no-browser", "--seconds", f"{seconds:g}", "--output", "demo"],
        "learn": ["learn", "log.csv", "--vehicle", "vlbv300", "-o", "learned.toml"],
        "live": ["live", "replay:log.csv@0", "--vehicle", "vlbv300"],
        "validate": ["validate", "model.toml", "log.csv"],
        "inspect": ["inspect", "log.csv", "--vehicle", "vlbv300"],
        "free runs": ["learn", "log.csv", "--vehicle", "vlbv300", "--method", "output-error", "-o", "free.toml"],
        "waves": ["simulate", "vlbv300", "all-telegraph", "--waves", "0.05,6", "--duration", "2", "-o", "waves.csv"],
        "plan": ["plan", "vlbv300", "--space", "5x5x2.5", "--minutes", "0.1", "-o", "plan.toml"],
    }


def run(tree: Path, folder: Path, cache: Path, arguments: Sequence[str]) -> Run:
    """Run a command of the source in `tree` with its machine code in `cache`.

    Raises:
        SystemExit: the command failed; its messages are printed.
    """
    kept = folder / "first_run.json"
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "NUMBA_CACHE_DIR": str(cache), "FIRST_RUN": str(kept)}
    done = subprocess.run(
        [sys.executable, "-c", _WATCHED, *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"towtank {' '.join(arguments)}: ended with {done.returncode}\n{done.stderr}")
    found = json.loads(kept.read_text())
    return Run(found["cpu"], [(name, seconds) for name, seconds in found["rows"]])


def start_of_help(tree: Path) -> tuple[float, float]:
    """Return the least wall time and the least CPU time of `towtank --help` [s] of a few starts."""
    environment = os.environ | {"PYTHONPATH": str(tree / "src")}
    walls, cpus = [], []
    for _ in range(_STARTS):
        began, used = time.perf_counter(), os.times()
        subprocess.run([sys.executable, "-m", "towtank", "--help"], env=environment, capture_output=True, check=True)
        walls.append(time.perf_counter() - began)
        now = os.times()
        cpus.append(now.children_user + now.children_system - used.children_user - used.children_system)
    return min(walls), min(cpus)


def table(tree: Path, names: Sequence[str], seconds: float) -> None:
    """Print one row for each command of the source in `tree`."""
    write = sys.stdout.write
    write(f"{tree}\n{'':10}{'first':>9}{'again':>9}{'more':>9}{'compiler':>10}")
    write(f"{'functions':>11}{'special.':>10}{'on disk':>10}\n")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        making = folder / "making"
        log = ["simulate", "vlbv300", "tank-session", "--duration", f"{seconds:g}", "--sensors", "mocap", "--seed", "1"]
        run(tree, folder, making, [*log, "-o", "log.csv"])
        if "validate" in names:
            run(tree, folder, making, ["learn", "log.csv", "--vehicle", "vlbv300", "-o", "model.toml"])
        for name in names:
            cache = folder / f"cache-{name}"
            first = run(tree, folder, cache, commands(seconds)[name])
            (folder / "learned.toml").unlink(missing_ok=True)
            again = run(tree, folder, cache, commands(seconds)[name])
            size = sum(path.stat().st_size for path in cache.rglob("*.nbc"))
            functions = len({function for function, _ in first.rows})
            compiler = sum(seconds for _, seconds in first.rows)
            write(f"{name:10}{first.cpu:>7.1f} s{again.cpu:>7.1f} s{first.cpu - again.cpu:>7.1f} s{compiler:>8.1f} s")
            write(f"{functions:>11}{len(first.rows):>10}{size / 1e6:>7.1f} MB\n")
            if again.rows:
                write(f"{'':10}compiled again: {', '.join(sorted({function for function, _ in again.rows}))}\n")
            sys.stdout.flush()
    wall, cpu = start_of_help(tree)
    write(f"towtank --help takes {wall:.2f} s, {cpu:.2f} s of them CPU (least of {_STARTS})\n\n")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="demo,learn,live,validate,inspect", help="commands, with commas between")
    parser.add_argument("--tree", type=Path, help="clone that is measured before this one")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of demo and logs (default 20)")
    chosen = parser.parse_args(arguments)
    names = [name for name in chosen.only.split(",") if name]
    unknown = set(names) - commands(chosen.seconds).keys()
    if unknown:
        parser.error(f"--only: found {', '.join(sorted(unknown))}, expected {', '.join(commands(chosen.seconds))}")
    for tree in [*([chosen.tree.resolve()] if chosen.tree else []), _ROOT]:
        table(tree, names, chosen.seconds)


if __name__ == "__main__":
    main()
