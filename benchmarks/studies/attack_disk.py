"""Recordings under attack: disks that fill, files that are taken away, ends of every kind.

    python benchmarks/studies/attack_disk.py [--only CASE,...] [--workers 3] [--output FILE]

A simulated vehicle sends JSON over UDP at 100 Hz to `towtank live --record`. A disk that is full, fills, and gets room
again; a folder that cannot be written, a folder that is removed, a file that is cut; two sessions on one file; SIGINT,
SIGTERM, SIGHUP, and a reader of the output that goes away. Of each: no byte that was recorded is lost but by whoever
cut it off, the session says it within two seconds, learns on, and ends with the exit code that docs/live.md states. The
disks are small file systems in memory, which only root may mount; without the right those cases are not run, and that
is said. The exit code is 1 where a bound is broken. Sessions that are killed are in `attack_kills.py`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from rich.console import Console
from rich.table import Table

from towtank import load_vehicle
from towtank.live.pipeline.instants import rows_of
from towtank.outputs import write_text
from towtank.simulation import Mocap, manoeuvre, simulate

VEHICLE, RATE, FREE = "vlbv300", 100.0, "X_udot,X_uu"  # the cases learn little: they are about files
SAID = 2.0  # s
_FULL = 1 << 20  # bytes of a small disk
_RAW = "/raw/"
_TORN = (McapError, EOFError, struct.error)  # by the reader of the package mcap, where a file ends within a record
_TOLD = 4.0  # s that a case goes on before and after its blow
Feed = Sequence[tuple[float, bytes]]


started: list[subprocess.Popen[str]] = []  # every process, so that none outlives the study


def _hang_up_counts() -> None:
    """Let SIGHUP end the process, as it does where nobody ignores it: a study run by nohup would wait for ever."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class Live:
    """A process of `towtank live` whose lines are read as they come."""

    def __init__(self, port: int, target: Path, *options: str) -> None:
        command = [sys.executable, "-m", "towtank", "live", f"json:127.0.0.1:{port}", "--vehicle", VEHICLE]
        self.process = subprocess.Popen(
            [*command, "--record", str(target), "--json-lines", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=_hang_up_counts,
        )
        self.lines: list[tuple[float, dict[str, Any]]] = []
        self.said: list[str] = []
        self.listens = threading.Event()
        self._gone = False
        started.append(self.process)
        self._threads = [threading.Thread(target=each, daemon=True) for each in (self._read, self._hear)]
        for thread in self._threads:
            thread.start()

    def _read(self) -> None:
        for line in self.process.stdout or ():
            self.lines.append((time.monotonic(), json.loads(line)))
            if self._gone and self.process.stdout is not None:
                self.process.stdout.close()
                return

    def stop_reading(self) -> None:
        """Close the pipe of the output after the next line."""
        self._gone = True

    def _hear(self) -> None:
        for line in self.process.stderr or ():
            self.said.append(line)
            if line.startswith("listening"):
                self.listens.set()
        self.listens.set()

    def ready(self) -> Live:
        """Wait until it listens."""
        self.listens.wait(600.0)
        if self.process.poll() is not None:
            raise SystemExit("".join(self.said))
        return self

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal; return the exit code."""
        self.process.send_signal(number)
        return self.ended()

    def ended(self) -> int:
        """Return the exit code, once it has ended."""
        code = self.process.wait(600.0)
        for thread in self._threads:
            thread.join(10.0)
        for pipe in (self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()
        return code

    def told(self, words: str, since: float, within: float = 60.0) -> float:
        """Return how long after a moment the words were first in a warning or an event [s]; infinity where never."""
        while time.monotonic() < since + within:
            for moment, line in list(self.lines):
                texts = [*line["warnings"], *(event["text"] for event in line["events"])]
                if moment >= since and any(words in text for text in texts):
                    return moment - since
            time.sleep(0.02)
        return float("inf")

    def instants(self) -> int:
        """Return how many samples were learned from, by the latest line."""
        return int(self.lines[-1][1]["samples"]) if self.lines else 0


def messages(seconds: float) -> Feed:
    """Return times and datagrams of a session of all axes at once."""
    vehicle = load_vehicle(VEHICLE)
    plan = manoeuvre("all-multisine", vehicle, duration=seconds, dt=1.0 / RATE, seed=1)
    run = simulate(vehicle, commands=plan.commands, dt=1.0 / RATE, sensors=Mocap(rate=RATE), seed=1)
    return [
        (t, json.dumps({"t": t, **dict(zip(names, values, strict=True))}).encode()) for t, names, values in rows_of(run)
    ]


def send(feed: Feed, port: int) -> None:
    """Send datagrams at the pace of their times."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        began = time.monotonic()
        for t, data in feed:
            wait = began + t - feed[0][0] - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            link.sendto(data, ("127.0.0.1", port))


def free_port() -> int:
    """Return a UDP port that nobody holds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


def opened(target: Path) -> tuple[int, int]:
    """Return samples and packets that the reader of the package mcap finds, up to a record that was torn."""
    topics: dict[int, str] = {}
    found = [0, 0]
    with target.open("rb") as stream, contextlib.suppress(*_TORN):
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                topic = topics[record.channel_id]
                found[topic.startswith(_RAW)] += topic.startswith((_RAW, "/json/"))
    return found[0], found[1]


@dataclass
class Blow:
    """What a case met with.

    Attributes:
        code: of exit, and the one that is documented. said: after how long it was said [s]. learned: whether learning
            went on. gone: bytes that had been recorded and are not there any more, but by whoever cut them off.
        missing: samples sent and not recorded, and of them those that the session counts. wrong: what else is wrong.
    """

    code: int
    expected: int
    said: float = 0.0
    learned: bool = True
    gone: int = 0
    missing: tuple[int, int] = (0, 0)
    wrong: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether every bound holds."""
        whole = self.missing[0] <= max(self.missing[1], 0)
        return self.code == self.expected and self.said <= SAID and self.learned and not self.gone and whole


class Session:
    """A session under way, fed by a thread."""

    def __init__(self, feed: Feed, target: Path) -> None:
        self.feed, self.target, self.port = feed, target, free_port()
        self.live = Live(self.port, target, "--free", FREE, "--no-changes").ready()
        self._sender = threading.Thread(target=send, args=(feed, self.port))
        self._sender.start()
        time.sleep(_TOLD)

    def end(self, number: int = signal.SIGTERM) -> int:
        """Wait until everything is sent, and end it; return the exit code."""
        self._sender.join()
        time.sleep(1.0)
        return self.live.end(number)

    def blow(self, code: int, expected: int, said: float, learned: bool, before: bytes, target: Path) -> Blow:
        """Return what came of it; `before`: what stood in the file at the blow and must still stand there."""
        found = target.read_bytes() if target.exists() else b""
        same = next((k for k in range(min(len(before), len(found))) if before[k] != found[k]), len(before))
        gone = len(before) - min(same, len(found))
        recorded, packets = opened(target) if target.exists() else (0, 0)
        lost = int(self.live.lines[-1][1]["lost"] or 0) if self.live.lines else 0
        missing = max(len(self.feed) - recorded, 0) + max(len(self.feed) - packets, 0)
        return Blow(code, expected, said, learned, gone, (missing, lost))


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """Yield a disk of a megabyte in memory. Raises OSError where the right to mount it is wanting."""
    place = folder / "disk"
    place.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={_FULL}", "tmpfs", str(place)], capture_output=True, text=True
    )
    if done.returncode:
        raise OSError(done.stderr.strip() or "mount failed")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], capture_output=True)


def fill(place: Path, leave: int = 0) -> Path:
    """Fill a disk but for some bytes; return the file that does."""
    ballast = place / "ballast"
    with ballast.open("ab", buffering=0) as stream, contextlib.suppress(OSError):
        while True:
            stream.write(bytes(4096))
    if leave:
        os.truncate(ballast, max(ballast.stat().st_size - leave, 0))
    return ballast


def starts_full(feed: Feed, folder: Path) -> Blow:
    """A disk that is full from the beginning: refused in one line."""
    with small_disk(folder) as disk:
        fill(disk)
        return _refused(disk / "a.mcap")


def starts_read_only(feed: Feed, folder: Path) -> Blow:
    """A folder that cannot be written: refused in one line."""
    with small_disk(folder) as disk:
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        return _refused(disk / "a.mcap")


def _refused(target: Path, *options: str) -> Blow:
    live = Live(free_port(), target, *options)
    code = live.ended()
    lines = [line for line in live.said if line.startswith("towtank: ") and str(target) in line]
    return Blow(code, 2, wrong=[] if len(lines) == 1 else [f"{len(lines)} lines"])


def fills(feed: Feed, folder: Path) -> Blow:
    """A disk that fills, and gets room again: everything is recorded in the end."""
    with small_disk(folder) as disk:
        session = Session(feed, disk / "a.mcap")
        before = _filled(session, disk)
        said = session.live.told("No space left", time.monotonic())
        at = session.live.instants()
        time.sleep(_TOLD)
        learned = session.live.instants() > at
        (disk / "ballast").unlink()
        said = max(said, session.live.told("goes on after", time.monotonic()))
        return session.blow(session.end(), 0, said, learned, before, session.target)


def stays_full(feed: Feed, folder: Path) -> Blow:
    """A disk that fills and stays so: what was recorded before stays, the rest is counted, the exit code is 1."""
    with small_disk(folder) as disk:
        session = Session(feed, disk / "a.mcap")
        before = _filled(session, disk)
        said = session.live.told("No space left", time.monotonic())
        at = session.live.instants()
        time.sleep(_TOLD)
        learned = session.live.instants() > at
        return session.blow(session.end(), 1, said, learned, before, session.target)


def _filled(session: Session, disk: Path) -> bytes:
    """Fill the disk; return what is recorded by then: a record that it cuts short at this moment is not, yet."""
    fill(disk)
    data, end = session.target.read_bytes(), 0
    with io.BytesIO(data) as stream, contextlib.suppress(*_TORN):
        for _ in StreamReader(stream, validate_crcs=True).records:
            end = stream.tell()
    return data[:end]


def folder_removed(feed: Feed, folder: Path) -> Blow:
    """A folder that is removed: the file is made anew from what the system holds of it."""
    place = folder / "dives"
    place.mkdir()
    session = Session(feed, place / "a.mcap")
    before = session.target.read_bytes()
    moment = time.monotonic()
    shutil.rmtree(place)
    said = session.live.told("was removed from outside", moment)
    at = session.live.instants()
    time.sleep(2.0)
    learned = session.live.instants() > at
    return session.blow(session.end(), 0, said, learned, before, session.target)


def file_cut(feed: Feed, folder: Path) -> Blow:
    """A file that is cut to a third: what is left stays, what follows is recorded, what was cut off is counted."""
    return _cut(feed, folder, 3)


def file_emptied(feed: Feed, folder: Path) -> Blow:
    """A file that is cut to nothing: a new beginning is written, what was cut off is counted."""
    return _cut(feed, folder, 0)


def _cut(feed: Feed, folder: Path, share: int) -> Blow:
    session = Session(feed, folder / "a.mcap")
    size = session.target.stat().st_size // share if share else 0
    moment = time.monotonic()
    os.truncate(session.target, size)
    said = session.live.told("were cut off", moment)
    before = session.target.read_bytes()[: max(size - (1 << 16), 0)]  # less a record that was cut through
    at = session.live.instants()
    time.sleep(2.0)
    learned = session.live.instants() > at
    return session.blow(session.end(), 1, said, learned, before, session.target)


def two_on_one_file(feed: Feed, folder: Path) -> Blow:
    """A second session on one file: refused, and the first one is as if nothing had been."""
    session = Session(feed, folder / "a.mcap")
    second = _refused(session.target, "--resume")
    blow = session.blow(session.end(), 0, 0.0, True, b"", session.target)
    blow.wrong += second.wrong
    blow.code = blow.code or (0 if second.good else second.code + 100)
    return blow


def _ended_by(number: int, expected: int) -> Callable[[Feed, Path], Blow]:
    def case(feed: Feed, folder: Path) -> Blow:
        session = Session(feed, folder / "a.mcap")
        return session.blow(session.end(number), expected, 0.0, True, b"", session.target)

    return case


def reader_gone(feed: Feed, folder: Path) -> Blow:
    """The reader of the output goes away: the session goes on to its end, and the exit code tells."""
    session = Session(feed, folder / "a.mcap")
    at = session.target.stat().st_size
    session.live.stop_reading()
    time.sleep(3.0)
    learned = session.target.stat().st_size > at
    return session.blow(session.end(), 1, 0.0, learned, b"", session.target)


CASES: dict[str, Callable[[Feed, Path], Blow]] = {
    "full": starts_full,
    "read-only": starts_read_only,
    "fills": fills,
    "stays-full": stays_full,
    "folder-removed": folder_removed,
    "cut": file_cut,
    "emptied": file_emptied,
    "two-sessions": two_on_one_file,
    "SIGINT": _ended_by(signal.SIGINT, 0),
    "SIGTERM": _ended_by(signal.SIGTERM, 0),
    "SIGHUP": _ended_by(signal.SIGHUP, 0),
    "SIGPIPE": reader_gone,
}


def run_case(name: str, feed: Feed) -> Blow | str:
    """Return what came of a case; why it was not run, where it cannot be."""
    print(f"{name} ...", file=sys.stderr, flush=True)
    with tempfile.TemporaryDirectory() as folder:
        try:
            return CASES[name](feed, Path(folder))
        except OSError as error:
            if "mount" not in str(error) and "permission" not in str(error).lower():
                raise
            return f"not run: {error}"


def show_cases(found: dict[str, Blow | str]) -> bool:
    """Print the cases; return whether all that were run hold."""
    table = Table(title="Disks and processes")
    for column in ("case", "exit code", "said after [s]", "learned on", "bytes gone", "missing (counted)", ""):
        table.add_column(column, justify="left" if column in ("case", "") else "right")
    good = True
    for name, blow in found.items():
        if isinstance(blow, str):
            table.add_row(name, "-", "-", "-", "-", "-", blow)
            continue
        fine = blow.good and not blow.wrong
        good = good and fine
        code = f"{blow.code}" if blow.code == blow.expected else f"{blow.code}, documented {blow.expected}"
        verdict = "ok" if fine else "BROKEN " + "; ".join(blow.wrong)
        missing = f"{blow.missing[0]} ({blow.missing[1]})"
        table.add_row(name, code, f"{blow.said:.2f}", "yes" if blow.learned else "no", str(blow.gone), missing, verdict)
    Console(width=120, markup=False).print(table)
    return good


@contextlib.contextmanager
def no_survivors() -> Iterator[None]:
    """Kill at the end what was started and still runs."""
    try:
        yield
    finally:
        for process in started:
            if process.poll() is None:
                process.kill()


def main() -> int:
    """Run and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--only", default="", help=f"of {', '.join(CASES)}")
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    names = list(CASES) if not asked.only else [name for name in asked.only.split(",") if name in CASES]
    feed = messages(20.0)
    with no_survivors(), ThreadPoolExecutor(asked.workers) as pool:
        cases = {name: pool.submit(run_case, name, feed) for name in names}
        found = {name: each.result() for name, each in cases.items()}
    good = show_cases(found)
    if asked.output:
        document = {name: each if isinstance(each, str) else asdict(each) for name, each in found.items()}
        write_text(asked.output, json.dumps({"cases": document}, indent=2))
    print("every bound holds" if good else "A BOUND IS BROKEN")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
