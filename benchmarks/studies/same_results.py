"""Do two trees of the source give the same results? Documents of eight logs, compared to the last digit.

    python benchmarks/studies/same_results.py run BEFORE [--tree ../other-clone] [--only pool]
    python benchmarks/studies/same_results.py run AFTER
    python benchmarks/studies/same_results.py compare BEFORE AFTER [--within 1e-9]

`run` simulates four logs, maps four real ones (from `$TOWTANK_DATA`, else `shared/data` beside the repository; left out
where absent), and keeps what `learn --json` (three methods, with the model file), `validate --json`, `inspect --json`
and `live replay:LOG@0 --json` say of each, and the bytes of the simulated logs. `compare` names what differs, place by
place: byte by byte, or, with --within, numbers that are further apart than so much of their own size. What a clock on
the wall decides (seconds of work, rates of a link) is left out. It ends with 1 where anything differs.

It guards every rebuilding of the source: moves and names change nothing, a new form of the same sum changes the last
digits.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from real_cases import BOAT_MAP, POOL_MAP, data_folder
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

__all__ = ["CASES", "Case", "differences", "main"]

_ROOT = Path(__file__).resolve().parents[2]
_METHODS = ("joint", "output-error", "paper")
_WALL_CLOCK = ("elapsed_s", "rates_hz", "latency_ms")  # keys that a clock decides
_ONE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # orders of sums

_SEA = """
thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6", "pwm7", "pwm8"]
columns = { u = "dvl_u", v = "dvl_v", w = "dvl_w", p = "p", q = "q", r = "r", phi = "phi", theta = "theta", psi = "psi", z = "depth_m" }
"""  # noqa: E501


@dataclass(frozen=True)
class Case:
    """A log: its vehicle, and either how it is simulated or where it lies and how its columns are read."""

    name: str
    vehicle: str
    simulated: tuple[str, ...] = ()
    real: str = ""
    mapping: str = ""
    window: str | None = None


CASES = (
    Case("surge", "vlbv300", ("surge-square", "--duration", "20", "--sensors", "mocap", "--seed", "1")),
    Case("tank", "vlbv300", ("tank-session", "--duration", "60", "--sensors", "mocap", "--seed", "2")),
    Case("coupled", "seamor", ("all-multisine", "--duration", "30", "--sensors", "ins", "--seed", "3")),
    Case("heavy", "bluerov2_heavy", ("all-telegraph", "--duration", "30", "--sensors", "mocap", "--seed", "4")),
    Case("pool-yaw", "bluerov_2016", real="bluerov_pool_2016/yaw_3_*.csv", mapping=POOL_MAP),
    Case("pool-all", "bluerov_2016", real="bluerov_pool_2016/all_3_*.csv", mapping=POOL_MAP),
    Case("sea", "bluerov2_heavy_as_published", real="bluerov2_dvl_sea_2026/run_20hz.csv", mapping=_SEA, window="0,100"),
    Case("boat", "blueboat_2024", real="blueboat_2024/log_222.csv", mapping=BOAT_MAP),
)


def run(out: Path, tree: Path, only: str, workers: int) -> None:
    """Keep in `out` what the commands of the source in `tree` say of every log."""
    out.mkdir(parents=True, exist_ok=True)
    cases = [case for case in CASES if only in case.name and _prepared(case, out, tree)]
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=Console(stderr=True), transient=True,
    ) as progress:  # fmt: skip
        task = progress.add_task("commands", total=len(cases))

        def one(case: Case) -> None:
            for name, arguments in _commands(case):
                _keep(out, tree, case.name, name, arguments)
            progress.update(task, advance=1)

        with ThreadPoolExecutor(workers) as pool:
            for _ in pool.map(one, cases):
                pass


def _prepared(case: Case, out: Path, tree: Path) -> bool:
    """Put the log and its mapping into `out`; False where the recording is not here."""
    log = out / f"{case.name}.csv"
    if case.simulated:
        _keep(out, tree, case.name, "simulate", ("simulate", case.vehicle, *case.simulated, "-o", log.name))
        (out / f"{case.name}.sha256").write_text(hashlib.sha256(log.read_bytes()).hexdigest() + "\n")
        return True
    data = data_folder()
    found = [] if data is None else sorted(data.glob(case.real))
    if found:
        log.write_bytes(found[0].read_bytes())
        (out / f"{case.name}.map.toml").write_text(case.mapping)
    return bool(found)


def _commands(case: Case) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the name and the arguments of each command for a log."""
    log, vehicle = f"{case.name}.csv", ("--vehicle", case.vehicle)
    mapped = ("--map", f"{case.name}.map.toml") if case.mapping else ()
    window = () if case.window is None else ("--window", case.window)
    yield "inspect", ("inspect", log, *vehicle, *mapped, "--json")
    for method in _METHODS:
        model = f"{case.name}.{method}.toml"
        learn = ("learn", log, *vehicle, *mapped, *window, "--method", method, "-o", model, "--json")
        yield f"learn-{method}", learn
        yield f"validate-{method}", ("validate", model, log, *mapped, "--json")
    for method in ("joint", "paper"):
        yield f"live-{method}", ("live", f"replay:{log}@0", *vehicle, *mapped, "--method", method, "--json")


def _keep(out: Path, tree: Path, case: str, name: str, arguments: Sequence[str]) -> None:
    """Run a command and keep its document, its errors and its exit code in one file."""
    environment = os.environ | dict.fromkeys(_ONE_THREAD, "1") | {"PYTHONPATH": str(tree / "src"), "COLUMNS": "100"}
    done = subprocess.run(
        [sys.executable, "-m", "towtank", *arguments], cwd=out, env=environment, capture_output=True, text=True
    )
    try:
        document = json.loads(done.stdout)
    except ValueError:
        document = done.stdout
    error = [line for line in done.stderr.splitlines() if "Traceback" in line or line.startswith("towtank:")]
    kept = {"exit": done.returncode, "error": error, "document": document}
    (out / f"{case}.{name}.json").write_text(json.dumps(kept, indent=1) + "\n")


def differences(a: Any, b: Any, within: float, place: str = "") -> Iterator[str]:
    """Yield a line for each place where two documents differ by more than `within` of the numbers' size."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in a.keys() | b.keys():
            if key in _WALL_CLOCK:
                continue
            if key not in a or key not in b:
                yield f"{place}.{key}: only {'after' if key in b else 'before'}"
            else:
                yield from differences(a[key], b[key], within, f"{place}.{key}")
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            yield f"{place}: {len(a)} entries before, {len(b)} after"
        for i, (x, y) in enumerate(zip(a, b, strict=False)):
            yield from differences(x, y, within, f"{place}[{i}]")
    elif _is_number(a) and _is_number(b):
        if a != b and not math.isclose(a, b, rel_tol=within, abs_tol=within * 1e-3):
            yield f"{place}: {a!r} before, {b!r} after"
    elif a != b:
        yield f"{place}: {a!r} before, {b!r} after"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def compare(before: Path, after: Path, within: float) -> int:
    """Print what differs between two folders of `run`; return how many files do."""
    names = sorted({path.name for folder in (before, after) for path in folder.iterdir() if _compared(path)})
    console, differing = Console(width=200, highlight=False), 0
    for name in names:
        here, there = before / name, after / name
        if not here.exists() or not there.exists():
            found = [f"only in {after if there.exists() else before}"]
        elif name.endswith(".json"):
            found = list(differences(json.loads(here.read_text()), json.loads(there.read_text()), within))
        elif name.endswith(".toml"):
            found = list(differences(_model(here), _model(there), within))
        else:
            found = [] if here.read_bytes() == there.read_bytes() else ["other bytes"]
        differing += bool(found)
        for line in found[:8]:
            console.print(f"{name} {line}", markup=False)
        if len(found) > 8:
            console.print(f"{name} ... {len(found) - 8} more places")
    console.print(f"{len(names)} documents, {differing} differ (within {within:g})")
    return differing


def _model(path: Path) -> Any:
    import tomllib

    return tomllib.loads(path.read_text())


def _compared(path: Path) -> bool:
    return path.suffix in (".json", ".sha256") or (path.suffix == ".toml" and not path.name.endswith(".map.toml"))


def main(argv: Sequence[str] | None = None) -> int:
    """Run or compare; 1 where anything differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    first = verbs.add_parser("run", help="keep the documents of one tree")
    first.add_argument("folder", type=Path)
    first.add_argument("--tree", type=Path, default=_ROOT, help="clone whose src is run (default: this one)")
    first.add_argument("--only", default="", help="part of the names of the logs")
    first.add_argument("--workers", type=int, default=2, help="logs at a time (default 2)")
    second = verbs.add_parser("compare", help="name what differs between two folders")
    second.add_argument("before", type=Path)
    second.add_argument("after", type=Path)
    second.add_argument("--within", type=float, default=0.0, help="of a number's size (default 0: every byte)")
    options = parser.parse_args(argv)
    if options.verb == "run":
        run(options.folder.resolve(), options.tree.resolve(), options.only, options.workers)
        return 0
    return int(compare(options.before, options.after, options.within) > 0)


if __name__ == "__main__":
    sys.exit(main())
