"""An attack on everything that reads files: whatever a file holds, it is read or refused in one line.

    python benchmarks/studies/attack_files.py [--runs 20000] [--seed 1] [--only tlog,csv] [--workers 2]

Files of every kind that can be read are made here and broken: bytes flipped, cut, spliced and lengths overwritten
(`mutations`), values, times, names and lengths that no vehicle yields (`hostile_logs`), and storms of tiny records.
Each is read, inspected (`inspect --json`), and one in ten is learned from (`learn --json -o`). Counted are tracebacks,
warnings of libraries, more than 60 s, more than 2 GB, outputs that are half written, and refusals that are no line
that names the file and what was expected. None of them is allowed: the exit code is 1 where there is one. Seeded by
the number of the file, so that a finding can be repeated: `--seed N --runs 1`.
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from hostile_logs import STORMS, WRITERS, hostile, storm
from mutations import mutated
from report import show
from rich.table import Table
from runner import arguments, over, write_json
from small_logs import SMALL_LOGS, small_logs

from towtank.errors import InputError

LONGEST = 60.0  # s
MOST_MEMORY = 2.0e9  # bytes
_HANG = 90  # s
_ADDRESSES = 12 << 30  # bytes, so that a file that wants all memory takes none of the others'
_BLOCK = 25  # files of one task
_VEHICLE = "bluerov2"
_STORM, _STORM_SIZE = 0.01, 4_000_000  # share of the files; bytes of a large one
_HOSTILE = 0.4  # share of the files
_SHOWN = 12
# what Python and its libraries say, which is no word for a user
_FOREIGN = re.compile(
    r"cannot be read as .*\(|out of range|cannot convert|codec can't|object has no|NoneType|not supported between|"
    r"has no attribute|must be |invalid literal|list index|KeyError|ValueError|unpack requires|broadcast|Errno"
)
_SAYS = re.compile(
    r"expected|cannot|--map|--window|--keep-all|no such|no message|no sample|not a readable|damaged|hold|"
    r"measured|counts|vehicle has"
)
FAULTS = ("traceback", "library warning", "over 60 s", "over 2 GB", "half written", "refusal not said")


class Hang(BaseException):
    """Raised by the alarm, so that nothing catches it."""


class Fault(NamedTuple):
    """One broken bound: which, at what file, and what was seen."""

    kind: str
    name: str
    detail: str


@dataclass
class Outcome:
    """What came of some files."""

    files: Counter[str] = field(default_factory=Counter)
    read: Counter[str] = field(default_factory=Counter)
    learned: Counter[str] = field(default_factory=Counter)
    refusals: Counter[str] = field(default_factory=Counter)
    faults: list[Fault] = field(default_factory=list)
    slowest_s: float = 0.0
    slowest: str = ""
    memory: int = 0

    def add(self, other: Outcome) -> None:
        """Add what came of others."""
        for mine, theirs in ((self.files, other.files), (self.read, other.read), (self.learned, other.learned)):
            mine.update(theirs)
        self.refusals.update(other.refusals)
        self.faults += other.faults
        self.memory = max(self.memory, other.memory)
        if other.slowest_s > self.slowest_s:
            self.slowest_s, self.slowest = other.slowest_s, other.slowest


def attacked(seeds: Sequence[int], kinds: Sequence[str]) -> Outcome:
    """Make the files of some seeds, read, inspect and learn from them."""
    limit_process()
    found = Outcome()
    for seed in seeds:
        kind = kinds[seed % len(kinds)]
        name, suffix, data = _file(kind, random.Random(f"attack {seed}"))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"log{suffix}"
            path.write_bytes(data)
            _attack(found, path, f"seed {seed}, {kind}, {name}", kind, learns=seed // len(kinds) % 10 == 0)
    return found


def limit_process() -> None:
    """Bound the memory of this process, and let an alarm end what hangs."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    signal.signal(signal.SIGALRM, _hang)


def _file(kind: str, rng: random.Random) -> tuple[str, str, bytes]:
    """Return what is wrong with it, suffix and bytes of a broken file."""
    way = rng.random()
    base = kind.removesuffix("-bz2").removesuffix("-lz4").removesuffix("-cut")
    base = "mcap-live" if base == "mcap" else base
    if way < _STORM and base in STORMS:
        size = rng.choice((20_000, 20_000, 200_000, _STORM_SIZE))
        return f"storm {size}", *storm(base, rng, size)
    if way < _HOSTILE and base in WRITERS:
        return hostile(base, rng)
    logs = _logs()
    suffix, whole = logs[kind]
    name, data = mutated(whole, [other for each, (_, other) in logs.items() if each != kind], rng)
    return name, suffix, data


@cache
def _logs() -> dict[str, tuple[str, bytes]]:
    return small_logs()


def _attack(found: Outcome, path: Path, name: str, kind: str, *, learns: bool) -> None:
    """Do all that reads a file, and note what goes wrong."""
    from towtank.readers import read

    found.files[kind] += 1
    content = path.read_bytes()
    _reset_peak()
    with _watched(found, path, f"{name}, read"):
        read(path)
        found.read[kind] += 1
    _command(found, path, f"{name}, inspect", ["inspect", str(path), "--json"])
    if learns:
        model = path.with_name("model.toml")
        words = ["learn", str(path), "--vehicle", _VEHICLE, "--json", "-o", str(model)]
        code = _command(found, path, f"{name}, learn", words)
        found.learned[kind] += code == 0
        _check_outputs(found, path, name, model, code)
    if path.read_bytes() != content:
        found.faults.append(Fault("half written", name, "the log itself was changed"))
    peak = _peak()
    found.memory = max(found.memory, peak)
    if peak > MOST_MEMORY:
        found.faults.append(Fault("over 2 GB", name, f"{peak / 1e9:.2f} GB"))


def _command(found: Outcome, path: Path, name: str, words: list[str]) -> int | None:
    """Run a command as the shell does; return its exit code, None where it ended otherwise."""
    from towtank.app.cli import app

    said, told = io.StringIO(), io.StringIO()
    code: int | None = None
    with _watched(found, path, name), contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        code = app(words, standalone_mode=False) or 0
    if code is None:
        if said.getvalue():
            found.faults.append(Fault("half written", name, "a refusal beside output"))
        return None
    try:
        json.loads(said.getvalue(), parse_constant=_no_number)
    except ValueError as error:
        found.faults.append(Fault("half written", name, f"standard output is no JSON document: {error}"))
    if code and "nothing was learned" not in told.getvalue():
        found.faults.append(Fault("refusal not said", name, f"exit code {code}: {told.getvalue()[-200:]}"))
    return code


def _check_outputs(found: Outcome, path: Path, name: str, model: Path, code: int | None) -> None:
    """Whether there is a whole model where one was promised, and nothing else."""
    from towtank.vehicle import load_vehicle

    left = sorted(each.name for each in path.parent.iterdir() if each not in (path, model))
    if left:
        found.faults.append(Fault("half written", name, f"left behind: {left}"))
    if model.exists() != (code == 0):
        found.faults.append(
            Fault("half written", name, f"exit code {code}, model {'' if model.exists() else 'not '}there")
        )
    if model.exists():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                load_vehicle(model)
            except Exception as error:
                found.faults.append(Fault("half written", name, f"the model cannot be read: {error}"))


@contextlib.contextmanager
def _watched(found: Outcome, path: Path, name: str) -> Iterator[None]:
    """Note what escapes, what warns, how long it takes, and how it is refused."""
    from towtank.vehicle import VehicleWarning

    began = time.perf_counter()
    signal.alarm(_HANG)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", VehicleWarning)
        warnings.simplefilter("ignore", ResourceWarning)
        try:
            yield
        except InputError as error:
            found.refusals[_shape(str(error), path)] += 1
            wrong = _what_is_wrong(str(error), path)
            if wrong:
                found.faults.append(Fault("refusal not said", name, f"{wrong}: {error}"[:400]))
        except Hang:
            found.faults.append(Fault("over 60 s", name, f"ended after {_HANG} s"))
        except Exception as error:
            found.faults.append(Fault("traceback", name, _where(error)))
        finally:
            signal.alarm(0)
    took = time.perf_counter() - began
    if LONGEST < took < _HANG:
        found.faults.append(Fault("over 60 s", name, f"{took:.1f} s"))
    if took > found.slowest_s:
        found.slowest_s, found.slowest = took, name
    for each in caught:
        place = f"{Path(each.filename).name}:{each.lineno}"
        found.faults.append(Fault("library warning", name, f"{each.category.__name__}: {each.message} ({place})"))


def _what_is_wrong(text: str, path: Path) -> str:
    """Return why a refusal is none that a person can act on, "" where it is."""
    if "\n" in text or "\r" in text or "\x1b" in text:
        return "more than a line"
    if not text.startswith(str(path)):
        return "does not begin with the file"
    rest = text[len(str(path)) :]
    if _FOREIGN.search(rest):
        return "a library's words"
    return "" if _SAYS.search(rest) else "does not say what was expected"


def _shape(text: str, path: Path) -> str:
    """Return a refusal without its numbers and names."""
    text = text.replace(str(path), "FILE")
    return re.sub(r"\d+(\.\d+)?(e[+-]?\d+)?", "#", re.sub(r'"[^"]*"', '""', text))[:300]


def _where(error: BaseException) -> str:
    last = [each for each in traceback.extract_tb(error.__traceback__) if "towtank" in each.filename][-1:]
    place = "".join(f" ({Path(each.filename).name}:{each.lineno})" for each in last)
    return f"{traceback.format_exception_only(error)[-1].strip()[:200]}{place}"


def _no_number(text: str) -> Any:
    raise ValueError(f"found {text}")


def _hang(signum: int, frame: Any) -> None:
    raise Hang


def _reset_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> int:
    """Return the most memory [bytes] since the last reset; where the system has no such figure, of the process."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def run(runs: int, seed: int, only: str | None, workers: int) -> Outcome:
    """Attack with `runs` files, those of the seeds from `seed` on."""
    wanted = only.split(",") if only else [""]
    kinds = [kind for kind in SMALL_LOGS if any(part in kind for part in wanted)]
    seeds = range(seed, seed + runs)
    blocks = [(seeds[k : k + _BLOCK], kinds) for k in range(0, runs, _BLOCK)]
    total = Outcome()
    for each in over("files", attacked, blocks, workers, failed=lambda outcome: bool(outcome.faults)):
        total.add(each)
    return total


def _table(found: Outcome, runs: int) -> Table:
    table = Table(title=f"{runs} broken files")
    for name in ("kind", "files", "read", "learned from", *FAULTS):
        table.add_column(name, justify="left" if name == "kind" else "right", no_wrap=True)
    for kind in found.files:
        own = Counter(fault.kind for fault in found.faults if fault.name.split(", ")[1] == kind)
        counts = (f"{own[fault]}" for fault in FAULTS)
        table.add_row(kind, f"{found.files[kind]}", f"{found.read[kind]}", f"{found.learned[kind]}", *counts)
    totals = Counter(fault.kind for fault in found.faults)
    sums = (found.files.total(), found.read.total(), found.learned.total(), *(totals[fault] for fault in FAULTS))
    table.add_row("all", *map(str, sums), style="bold")
    return table


def main(argv: Sequence[str] | None = None) -> int:
    """Run the attack; 0 where nothing broke."""
    options = arguments(__doc__ or "", 20_000, argv)
    found = run(options.runs, options.seed, options.only, options.workers)
    by_detail: dict[tuple[str, str], list[Fault]] = {}
    for fault in found.faults:
        by_detail.setdefault((fault.kind, re.sub(r"/tmp/\S*?/|\d+", "", fault.detail)), []).append(fault)
    for same in sorted(by_detail.values(), key=len, reverse=True)[: _SHOWN * 4]:
        show(f"{len(same)} x {same[0].kind}: {same[0].name}: {same[0].detail}".replace("[", "\\["))
    show(f"slowest: {found.slowest_s:.1f} s ({found.slowest}); most memory: {found.memory / 1e6:.0f} MB")
    show(_table(found, options.runs))
    write_json(options.output, {"study": "attack_files", "runs": options.runs, "seed": options.seed, **asdict(found)})
    return 1 if found.faults else 0


if __name__ == "__main__":
    sys.exit(main())
