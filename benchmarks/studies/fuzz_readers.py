"""Broken files: whatever a reader is given, it reads what it can or says in one line why it cannot.

    python benchmarks/studies/fuzz_readers.py [--runs 10000] [--seed 1] [--only mcap,tlog] [--output fuzz.json]

A small log of each kind is cut, flipped, spliced with the other kinds, overwritten, repeated, `--runs` times a kind,
and read. Nothing but InputError may escape, its message is one line, nothing takes longer than 2 s, and memory stays
bounded. "caught" are the errors of libraries that the way in turned into a line: allowed, but better said by the
reader itself. Every kind runs in a process of its own; seeded, so that a finding can be repeated.
"""

from __future__ import annotations

import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from mutations import mutated
from report import show
from rich.table import Table
from runner import arguments, write_json
from small_logs import small_logs

from towtank.errors import InputError

LONGEST = 2.0  # s
MOST_MEMORY = 256.0  # MiB that reading may add
_HANG = 20  # s


class Hang(BaseException):
    """Raised by the alarm, so that nothing catches it."""


@dataclass
class Outcome:
    """What came of one kind of log."""

    kind: str
    size: int
    read: int = 0
    rejected: int = 0
    caught: Counter[str] = field(default_factory=Counter)
    escaped: list[str] = field(default_factory=list)
    many_lines: int = 0
    slowest_s: float = 0.0
    slowest: str = ""
    memory_mib: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether nothing escaped, hung or swelled."""
        return not self.escaped and not self.many_lines and self.slowest_s <= LONGEST and self.memory_mib <= MOST_MEMORY


def fuzz(kind: str, logs: dict[str, tuple[str, bytes]], runs: int, seed: int) -> Outcome:
    """Break the log of one kind `runs` times and read it each time."""
    from towtank.readers import read

    warnings.simplefilter("error")
    signal.signal(signal.SIGALRM, _hang)
    suffix, whole = logs[kind]
    others = [data for name, (_, data) in logs.items() if name != kind]
    found = Outcome(kind, len(whole))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"broken{suffix}"
        path.write_bytes(whole)
        read(path)  # imports and compiles what there is
        before = _peak()
        for k in range(runs):
            name, data = mutated(whole, others, random.Random(f"{kind} {seed + k}"))
            path.write_bytes(data)
            began = time.perf_counter()
            signal.alarm(_HANG)
            try:
                read(path)
                found.read += 1
            except InputError as error:
                found.rejected += 1
                found.many_lines += "\n" in str(error)
                if "damaged, cannot be read as" in str(error):
                    found.caught[str(error).partition("cannot be read as")[2][:100]] += 1
            except BaseException as error:
                found.escaped.append(
                    f"seed {seed + k}, {name}: {traceback.format_exception_only(error)[-1].strip()[:200]}"
                )
            signal.alarm(0)
            took = time.perf_counter() - began
            if took > found.slowest_s:
                found.slowest_s, found.slowest = took, f"seed {seed + k}, {name}"
        found.memory_mib = _peak() - before
    return found


def _hang(signum: int, frame: Any) -> None:
    raise Hang(f"{_HANG} s")


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _table(found: Sequence[Outcome], runs: int) -> Table:
    table = Table(title=f"{runs} broken files of each kind")
    for name in ("kind", "bytes", "read", "refused", "caught", "escaped", "slowest s", "memory +MiB", ""):
        table.add_column(name, justify="left" if name == "kind" else "right", no_wrap=True)
    for each in found:
        table.add_row(
            each.kind, f"{each.size}", f"{each.read}", f"{each.rejected}", f"{each.caught.total()}",
            f"{len(each.escaped)}", f"{each.slowest_s:.3f}", f"{each.memory_mib:.0f}", "pass" if each.holds else "FAIL",
        )  # fmt: skip
    return table


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 10_000, argv)
    logs = small_logs()
    wanted = [part.strip() for part in options.only.split(",")] if options.only else [""]
    kinds = [kind for kind in logs if any(part in kind for part in wanted)]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        waiting = [pool.submit(fuzz, kind, logs, options.runs, options.seed) for kind in kinds]
        found = [each.result() for each in waiting]
    show(_table(found, options.runs))
    for each in found:
        for text, count in each.caught.most_common(5):
            show(f"{each.kind}: {count} times the library's own words: {text}")
        for text in each.escaped[:10]:
            show(f"{each.kind}: escaped: {text}")
    document = [{**asdict(each), "holds": each.holds} for each in found]
    write_json(options.output, {"study": "fuzz", "runs": options.runs, "seed": options.seed, "kinds": document})
    return 0 if all(each.holds for each in found) else 1


if __name__ == "__main__":
    sys.exit(main())
