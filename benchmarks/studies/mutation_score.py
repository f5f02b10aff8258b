"""What tests notice: the share of small faults, put into the source one by one, at which some test fails.

    python benchmarks/studies/mutation_score.py [--mutants 300] [--seed 1] [--packages readers,recording,live]
                                                [--workers 2] [--tests FILE] [--kept FILE] [--output mutation.json]

Each mutant is one replacement (`mutants.py`), drawn at random among all places of the packages. It is put into a copy
of the tree, and the tests that run its line are run there, quick ones first, until one fails, each time in a fork of a
process that has the libraries (`forked_tests.py`). A mutant that no test runs survives, as does one that all tests
pass; one at which they hang is killed. In the end the tests that killed are run again without a mutant, those that fail
then are not believed, and their mutants are run again without them.

Nothing is written to the tree itself, so that nothing stays behind whenever the study is ended. `--tests FILE` keeps
which test runs which line (minutes to find out) for further runs on the same tree, `--kept FILE` what became of each
mutant, so that a study that was ended goes on where it was. Exits with 1 where fewer than 80 %
are killed. Needs cosmic-ray and pytest-cov.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from types import FrameType

from covering_tests import CoveringTests, collect
from mutants import Mutant, draw
from report import show
from rich.table import Table
from runner import write_json

KILLED = 0.80  # of the mutants, at least
ROOT = Path(__file__).resolve().parents[2]
_COPIED = ("src", "tests", "benchmarks", "examples", "pyproject.toml", "README.md", "CHANGELOG.md")
_APP = ("bad_input", "convert", "inspect_bags", "inspect_real_logs", "map_skeleton", "merge", "small_parts")
_OF_RECORDINGS = (
    *("identification/test_noise", "identification/test_before_the_first_pass", "simulation/test_sensors"),
    *("studies/test_attack_files", "studies/test_merge_offset", "app/test_free_motion"),
)
_OF_LIVE = (
    *("studies/test_drive", "dashboard/test_parts", "identification/test_water_velocity", "app/test_inspect"),
    *("app/test_live_judge", "reports/test_live_report"),
)
_GROUPS = (  # tests that run side by side while coverage is collected
    (
        *("tests/readers", "tests/recording"),
        *(f"tests/app/test_{each}.py" for each in _APP),
        *(f"tests/{each}.py" for each in _OF_RECORDINGS),
    ),
    ("tests/live", *(f"tests/{each}.py" for each in _OF_LIVE)),
)
_MOST = 20.0  # s of tests for one mutant, as they take with coverage, quick ones first
_PATIENCE = 6.0  # times the seconds that the tests take without a mutant, after which they hang
_START = 30.0  # s beside, for the tree to be loaded


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant.

    Attributes:
        mutant: what was replaced. outcome: "killed", "hung", "survived" or "no test". by: the first test that failed.
        tests: how many run its line. seconds: that they took.
    """

    mutant: Mutant
    outcome: str
    by: str
    tests: int
    seconds: float

    @property
    def killed(self) -> bool:
        """Whether a test noticed it."""
        return self.outcome in ("killed", "hung")

    @property
    def package(self) -> str:
        """The package of towtank that it stands in."""
        return Path(self.mutant.place.file).parts[2]


class Copy:
    """A copy of the tree in which one mutant at a time is tested."""

    def __init__(self, folder: Path) -> None:
        self.root = folder
        self.stopped = False
        self._tested = 0
        self._server: subprocess.Popen[str] | None = None
        for name in _COPIED:
            source = ROOT / name
            if source.is_dir():  # with times and compiled kernels, so that only what is mutated is compiled again
                shutil.copytree(source, folder / name, symlinks=True)
            else:
                shutil.copy2(source, folder / name)
        (folder / "tmp").mkdir()
        data = os.environ.get("TOWTANK_DATA", ROOT.parent / "shared" / "data")
        paths = [folder / "src", folder / "benchmarks" / "studies", *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
        self.environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(str(each) for each in paths if str(each)),
            "OPENBLAS_NUM_THREADS": "1",  # forks have no others
            "PYTHONDONTWRITEBYTECODE": "1",  # of a mutant
            "TMPDIR": str(folder / "tmp"),
            "TOWTANK_DATA": str(Path(data).resolve()),
        }

    def test(self, mutant: Mutant, tests: CoveringTests, without: frozenset[str] = frozenset()) -> Verdict:
        """Put the mutant in, run its tests, and put back what was there."""
        file = self.root / mutant.place.file
        original, stamp = file.read_text(encoding="utf-8"), file.stat()
        covering = tests.of(mutant.place.file, original, mutant.place.begin[0])
        ends = accumulate(tests.seconds.get(each, 0.0) for each in covering)
        names = [name for name, end in zip(covering, ends, strict=True) if end <= _MOST and name not in without]
        if not names:
            return Verdict(mutant, "no test", "", 0, 0.0)
        started = time.monotonic()
        try:
            file.write_text(mutant.source, encoding="utf-8")
            self._tested += 1  # byte code is known by the second in which its source was written, and by its size
            os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns + self._tested * 10**9))
            failed, hung = self.failing(names, _START + _PATIENCE * sum(tests.seconds.get(each, 0.0) for each in names))
        finally:
            file.write_text(original, encoding="utf-8")
            os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
        outcome = "hung" if hung else "killed" if failed else "survived"
        return Verdict(mutant, outcome, failed[0] if failed else "", len(names), time.monotonic() - started)

    def failing(self, names: Sequence[str], limit: float, *, first_only: bool = True) -> tuple[list[str], bool]:
        """Run tests and return those that fail, and whether they hung; a failure of pytest itself counts as one."""
        if self._server is None:
            self._server = subprocess.Popen(
                [sys.executable, self.root / "benchmarks" / "studies" / "forked_tests.py", *sum(_GROUPS, ())],
                cwd=self.root,
                env=self.environment,
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        request = {"tests": list(names), "first_only": first_only, "limit": limit}
        print(json.dumps(request), file=self._server.stdin, flush=True)
        answer = json.loads(self._server.stdout.readline())
        shutil.rmtree(self.root / "tmp", ignore_errors=True)
        (self.root / "tmp").mkdir(exist_ok=True)
        return answer["failed"], answer["hung"]

    def stop(self) -> None:
        """End the tests that run, if any; what came of them tells nothing."""
        self.stopped = True
        if self._server is not None:
            with self._server:
                self._server.terminate()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; return 0 if enough mutants are killed."""
    options = _options(argv)
    packages = options.packages.split(",")
    files = [
        path.relative_to(ROOT).as_posix()
        for package in packages
        for path in sorted((ROOT / "src" / "towtank" / package).rglob("*.py"))
    ]
    signal.signal(signal.SIGTERM, _stop)
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
        copies = [Copy(Path(folder) / f"tree-{i}") for i in range(options.workers)]
        try:
            tests = _covering(copies, packages, options.tests)
            drawn = draw(ROOT, files, options.mutants, options.seed)
            verdicts = _tested(drawn, copies, tests, _Kept(options.kept))
        finally:
            for each in copies:
                each.stop()
    show(*_tables(verdicts, tests, options.seed))
    score = sum(each.killed for each in verdicts) / len(verdicts)
    write_json(options.output, _document(verdicts, tests, options.seed))
    return 0 if score >= KILLED else 1


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").strip(), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mutants", type=int, default=300, help="how many are drawn (default 300)")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default 1)")
    parser.add_argument("--packages", default="readers,recording,live", help="of towtank, separated by commas")
    parser.add_argument(
        "--workers", type=int, default=min(2, os.cpu_count() or 1), help="copies of the tree (default 2)"
    )
    parser.add_argument("--tests", type=Path, help="file that keeps which test runs which line")
    parser.add_argument("--kept", type=Path, help="file that keeps what became of each mutant, to go on with")
    parser.add_argument("--output", type=Path, help="JSON file to write")
    options = parser.parse_args(argv)
    if options.mutants < 1 or options.workers < 1:
        parser.error("--mutants and --workers: expected 1 or more")
    missing = [each for each in options.packages.split(",") if not (ROOT / "src" / "towtank" / each).is_dir()]
    if missing:
        parser.error(f"--packages: there is no package {missing[0]!r} in towtank")
    return options


def _covering(copies: Sequence[Copy], packages: Sequence[str], kept: Path | None) -> CoveringTests:
    """Return which tests run which lines: from the file that keeps it, else by running all."""
    if kept is not None and kept.is_file():
        read = json.loads(kept.read_text())
        lines = {
            file: {int(at): frozenset(read["names"][i] for i in found) for at, found in each.items()}
            for file, each in read["lines"].items()
        }
        return CoveringTests(lines, read["seconds"], frozenset(read["failed"]))
    with ThreadPoolExecutor(len(copies)) as pool:
        jobs = (
            [
                pool.submit(collect, copies[i % len(copies)].root, group, packages, copies[i % len(copies)].environment)
                for i, group in enumerate(_GROUPS)
            ]
            if len(copies) > 1
            else []
        )
        found = [job.result() for job in jobs] or [
            collect(copies[0].root, group, packages, copies[0].environment) for group in _GROUPS
        ]
    total = found[0]
    for each in found[1:]:
        total += each
    if kept is not None:
        names = sorted(total.seconds)
        number = {name: i for i, name in enumerate(names)}
        short = {
            file: {at: [number[each] for each in sorted(found) if each in number] for at, found in lines.items()}
            for file, lines in total.lines.items()
        }
        kept.write_text(
            json.dumps({"names": names, "lines": short, "seconds": total.seconds, "failed": sorted(total.failed)})
        )
    return total


class _Kept:
    """Verdicts in a file, a line each, so that they outlast the study; nothing without a file."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._lock = threading.Lock()
        lines = path.read_text().splitlines() if path is not None and path.is_file() else []
        self._known = {tuple(each.pop("mutant")): each for each in map(json.loads, lines)}

    def of(self, mutant: Mutant) -> Verdict | None:
        """Return what became of a mutant, None where it is not known."""
        known = self._known.get(self._name(mutant))
        return None if known is None else Verdict(mutant, **known)

    def add(self, verdict: Verdict) -> None:
        """Keep one."""
        if self._path is None:
            return
        row = {"outcome": verdict.outcome, "by": verdict.by, "tests": verdict.tests, "seconds": verdict.seconds}
        with self._lock, self._path.open("a") as stream:
            stream.write(json.dumps({"mutant": self._name(verdict.mutant), **row}) + "\n")

    def _name(self, mutant: Mutant) -> tuple[str | int, ...]:
        return (mutant.place.file, *mutant.place.begin, mutant.operator, mutant.after)


def _tested(drawn: Sequence[Mutant], copies: Sequence[Copy], tests: CoveringTests, kept: _Kept) -> list[Verdict]:
    """Test all mutants, a copy of the tree for each worker; again those killed by a test that fails without them."""
    free: queue.SimpleQueue[Copy] = queue.SimpleQueue()
    for each in copies:
        free.put(each)
    done = 0

    def test(mutant: Mutant, without: frozenset[str] = frozenset()) -> Verdict:
        nonlocal done
        known = None if without else kept.of(mutant)
        copy = free.get()
        try:
            verdict = known or copy.test(mutant, tests, without)
        finally:
            free.put(copy)
        if known is None and not copy.stopped:
            kept.add(verdict)
        done += 1
        print(f"{done:4d}/{len(drawn)} {_line(verdict)}", file=sys.stderr, flush=True)
        return verdict

    pool = ThreadPoolExecutor(len(copies))
    try:
        verdicts = list(pool.map(test, drawn))
        killers = sorted({each.by for each in verdicts if each.outcome == "killed" and each.by in tests.seconds})
        unsure = frozenset(copies[0].failing(killers, 3600.0, first_only=False)[0]) if killers else frozenset()
        again = {i: pool.submit(test, v.mutant, unsure) for i, v in enumerate(verdicts) if v.by in unsure}
        return [again[i].result() if i in again else each for i, each in enumerate(verdicts)]
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for each in copies:
            each.stop()  # what is under way ends
        raise
    finally:
        pool.shutdown()


def _tables(verdicts: Sequence[Verdict], tests: CoveringTests, seed: int) -> list[Table]:
    summary = Table(title=f"Mutants, seed {seed}")
    for name in ("", "mutants", "killed", "of them hung", "survived", "no test", "killed %"):
        summary.add_column(name, justify="right" if name else "left")
    kinds = sorted({each.mutant.place.kind for each in verdicts})
    rows = [
        (package, [v for v in verdicts if v.package == package]) for package in sorted({v.package for v in verdicts})
    ]
    rows += [(f"  {kind}", [v for v in verdicts if v.mutant.place.kind == kind]) for kind in kinds]
    for name, some in [*rows, ("all", list(verdicts))]:
        count = {outcome: sum(v.outcome == outcome for v in some) for outcome in ("hung", "survived", "no test")}
        killed = sum(v.killed for v in some)
        numbers = (len(some), killed, count["hung"], count["survived"], count["no test"])
        summary.add_row(name, *map(str, numbers), f"{100.0 * killed / len(some):.1f}")
    left = Table(title="What survived")
    for name in ("place", "was", "is", "tests"):
        left.add_column(name, overflow="fold")
    for each in sorted((v for v in verdicts if not v.killed), key=lambda v: v.mutant.place.file):
        place = f"{each.mutant.place.file.removeprefix('src/towtank/')}:{each.mutant.place.begin[0]}"
        left.add_row(place, each.mutant.before, each.mutant.after, str(each.tests))
    if tests.failed:
        summary.caption = f"{len(tests.failed)} tests fail without a mutant and are left out"
    return [left, summary]


def _document(verdicts: Sequence[Verdict], tests: CoveringTests, seed: int) -> dict[str, object]:
    return {
        "seed": seed,
        "mutants": len(verdicts),
        "killed": sum(each.killed for each in verdicts) / len(verdicts),
        "failing_without_a_mutant": sorted(tests.failed),
        "verdicts": [
            {
                "file": each.mutant.place.file, "line": each.mutant.place.begin[0], "kind": each.mutant.place.kind,
                "operator": each.mutant.operator, "before": each.mutant.before, "after": each.mutant.after,
                "outcome": each.outcome, "by": each.by, "tests": each.tests, "seconds": each.seconds,
            }
            for each in verdicts
        ],
    }  # fmt: skip


def _line(verdict: Verdict) -> str:
    place = verdict.mutant.place
    where = f"{place.file.removeprefix('src/towtank/')}:{place.begin[0]}"
    shown = "" if verdict.killed else f" | {verdict.mutant.before} -> {verdict.mutant.after}"
    return f"{verdict.outcome:8} {verdict.seconds:5.1f} s {verdict.tests:4d} tests {where}{shown}"


def _stop(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
