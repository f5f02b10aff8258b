"""A campaign on a dask scheduler and two workers of this machine, while they are killed.

    make peers PEERS=dask      (or: .peers/dask/bin/python benchmarks/peers/fleet/dask_peer.py [--kills 20 3 5] ...)

    equal     learned by one process, one worker and two workers: the same table, bit for bit after sorting
    poison    a task that aborts its process ends in failed, the rest completes, no worker is lost
    refused   no scheduler, a worker of another version: one line that names it
    many      10,000 trivial tasks in 90 s; client and scheduler within 300 MB; 10,000 parts listed in 5 s
    workers   kill -9 of a random worker, 20 times    } nothing that is done is done more than once again,
    scheduler kill -9 of the scheduler, 3 times       } and the table is the undisturbed one
    client    kill -9 of the client, 5 times          }

Everything listens on loopback alone.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import pieces

from towtank.campaigns import Store, read_campaign, run_campaign, tasks_of
from towtank.campaigns.engines.cluster import Cluster
from towtank.campaigns.engines.local import Local
from towtank.errors import InputError

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[3]
WORKERS = 2
MANY, MANY_SECONDS, MOST_MEMORY, LIST_SECONDS = 10_000, 90.0, 300.0, 5.0
LASTING = 120  # tasks of a third of a second, for each time that something is killed at least one
STUDY = """kind = "simulate-learn"
vehicle = "vlbv300"
method = "{method}"
[study]
manoeuvre = "surge-square"
duration = 8.0
rate = 20.0
sensors = "ins"
vehicles = 2
runs = {runs}
[study.between]
"X_*" = 0.1
[study.within]
"X_*" = 0.03
"""
PRELOAD = "import towtank\ntowtank.__version__ = '0.0.9'\n"


class Fleet:
    """A scheduler and its workers, each a process that can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.folder, self.address = folder, f"tcp://127.0.0.1:{self.port}"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, *words: str, name: str) -> subprocess.Popen[bytes]:
        log = (self.folder / f"{name}.log").open("ab")
        paths = os.pathsep.join([str(ROOT / "src"), str(HERE), os.environ.get("PYTHONPATH", "")])
        environment = os.environ | {"PYTHONPATH": paths, "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error"}
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:], "--no-dashboard"]
        return subprocess.Popen(command, env=environment, stdout=log, stderr=log, cwd=self.folder)

    def start_scheduler(self) -> None:
        self.scheduler = self.start("scheduler", "--host", "127.0.0.1", "--port", str(self.port), name="scheduler")

    def start_worker(self, name: str, *more: str) -> None:
        words = ("worker", self.address, "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", "--name", name)
        self.workers[name] = self.start(*words, *more, name=name)

    def mend(self, workers: int) -> None:
        """Start what is not running."""
        if self.scheduler is None or self.scheduler.poll() is not None:
            self.start_scheduler()
        for k in range(workers):
            each = self.workers.get(f"w{k}")
            if each is None or each.poll() is not None:
                self.start_worker(f"w{k}")

    def end(self) -> None:
        for each in (*self.workers.values(), *([self.scheduler] if self.scheduler else [])):
            each.kill()
            each.wait()
        self.workers, self.scheduler = {}, None


def said(text: str) -> None:
    print(f"  {text}", flush=True)


def until(ready: Callable[[], bool], seconds: float, fleet: Fleet | None = None, workers: int = WORKERS) -> bool:
    """Wait, and mend the fleet meanwhile; return whether it came to be."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if ready():
            return True
        if fleet is not None:
            fleet.mend(workers)
        time.sleep(0.1)
    return False


# -- campaigns


def learned(folder: Path, name: str, engine: object, method: str, runs: int) -> Store:
    """Return the store of a small study."""
    path = folder / "campaign.toml"
    path.write_text(STUDY.format(method=method, runs=runs))
    asked = read_campaign(path)
    tasks, store = tasks_of(asked), Store.at(str(folder / name))
    store.begin(asked, tasks)
    from towtank.app.campaign.work import perform

    done = run_campaign(tasks, store, engine, perform)  # type: ignore[arg-type]
    for each in done.failures:
        said(each.line)
    return store


def of_nothing(folder: Path, name: str, count: int) -> tuple[Store, list[object]]:
    """Return a store whose plan has tasks of nothing, and these."""
    path = folder / "nothing.toml"
    path.write_text(STUDY.format(method="paper", runs=1))
    store, tasks = Store.at(str(folder / name)), pieces.tasks(count, "aaaa")
    store.begin(read_campaign(path), tasks)
    return store, list(tasks)


def equal(fleet: Fleet, folder: Path, options: argparse.Namespace) -> bool:
    learned(folder, "compiled", Local(1), options.method, 1)  # a kernel that is compiled may differ from one loaded
    tables = [learned(folder, "local", Local(2), options.method, options.runs).table().drop(["seconds"])]
    for workers in (1, 2):
        fleet.mend(workers)
        engine = Cluster.at(fleet.address, said)
        tables.append(
            learned(folder, f"fleet{workers}", engine, options.method, options.runs).table().drop(["seconds"])
        )
    good = tables[0].num_rows > 0 and all(each.equals(tables[0]) for each in tables)
    rows, runs = tables[0].num_rows, 2 * options.runs
    said(f"{rows} rows of {runs} runs, method {options.method}: two processes, one worker, two workers")
    return good


def poison(fleet: Fleet, folder: Path, options: argparse.Namespace) -> bool:
    fleet.mend(WORKERS)
    pids = {each.pid for each in fleet.workers.values()}
    store, tasks = of_nothing(folder, "poison", 20)
    done = run_campaign(tasks, store, Cluster.at(fleet.address, said), pieces.abrupt)  # type: ignore[arg-type]
    for each in done.failures:
        said(each.line)
    alive = {each.pid for each in fleet.workers.values() if each.poll() is None}
    return len(done.failures) == 2 and len(store.done()) == 18 and alive == pids


def refused(fleet: Fleet, folder: Path, options: argparse.Namespace) -> bool:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        lines = [_refusal(f"tcp://127.0.0.1:{nobody.getsockname()[1]}")]
    fleet.mend(WORKERS)
    (folder / "preload.py").write_text(PRELOAD)
    fleet.start_worker("old", "--preload", str(folder / "preload.py"))
    until(lambda: bool(_refusal(fleet.address)), 60.0)
    lines.append(_refusal(fleet.address))
    fleet.workers.pop("old").kill()
    for line in lines:
        said(line)
    return "no scheduler answers there" in lines[0] and "worker old at" in lines[1] and "has towtank 0.0.9" in lines[1]


def _refusal(address: str) -> str:
    try:
        Cluster.at(address, said)
    except InputError as error:
        return str(error)
    return ""


def many(fleet: Fleet, folder: Path, options: argparse.Namespace) -> bool:
    fleet.mend(WORKERS)
    store, tasks = of_nothing(folder, "many", MANY)
    until(lambda: not _refusal(fleet.address), 60.0)
    began = time.monotonic()
    run_campaign(tasks, store, Cluster.at(fleet.address, said), pieces.quick)  # type: ignore[arg-type]
    seconds, began = time.monotonic() - began, time.monotonic()
    listed, looked = len(store.done()), time.monotonic() - began
    client = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    scheduler = _memory(fleet.scheduler.pid if fleet.scheduler else 0)
    store, tasks = of_nothing(folder, "many-here", MANY)
    began = time.monotonic()
    run_campaign(tasks, store, Local(2), pieces.quick)  # type: ignore[arg-type]
    here = time.monotonic() - began
    began = time.monotonic()
    rows = store.table().num_rows
    read, began = time.monotonic() - began, time.monotonic()
    store.compact()
    compacted = time.monotonic() - began
    said(f"{MANY} tasks in {seconds:.0f} s by two workers, {here:.0f} s by two processes")
    said(f"client {client:.0f} MB, scheduler {scheduler:.0f} MB; {listed} parts listed in {looked:.2f} s")
    said(f"{rows} rows read into a table in {read:.1f} s, compacted in {compacted:.1f} s")
    quick = max(seconds, here) <= MANY_SECONDS and looked <= LIST_SECONDS
    return quick and listed == MANY and max(client, scheduler) <= MOST_MEMORY


def _memory(pid: int) -> float:
    """Return the most memory that a process has had [MB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return float(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))) / 1024.0


# -- killing


def client_main(uri: str, address: str, count: int) -> int:
    """Run a campaign of tasks that last; this process is the one that is killed."""
    store = Store.opened(uri)
    done = run_campaign(pieces.tasks(count, "aaaa"), store, Cluster.at(address, said), pieces.counted)
    return 1 if done.failures else 0


def _client(fleet: Fleet, store: Store, count: int) -> subprocess.Popen[bytes]:
    paths = os.pathsep.join([str(ROOT / "src"), str(HERE), os.environ.get("PYTHONPATH", "")])
    words = [sys.executable, __file__, "--client", store.place.uri, fleet.address, str(count)]
    return subprocess.Popen(words, env=os.environ | {"PYTHONPATH": paths})


def killed(fleet: Fleet, folder: Path, what: str, times: int, seed: int) -> bool:
    """Kill one of the three kinds so many times while a campaign runs, each time after something more is done."""
    rng, count = random.Random(seed), max(LASTING, 6 * times)
    undisturbed, tasks = of_nothing(folder, f"undisturbed-{count}", count)
    if not undisturbed.done():
        run_campaign(tasks, undisturbed, Local(2), pieces.quick)  # type: ignore[arg-type]
    store, _ = of_nothing(folder, what, count)
    fleet.mend(WORKERS)
    client = _client(fleet, store, count)
    for k in range(times):
        so_far = len(store.done())
        if not until(lambda so_far=so_far: len(store.done()) > so_far, 120.0, fleet):
            said(f"nothing more was done within 120 s after {k} kills")
            return False
        time.sleep(rng.uniform(0.0, 0.5))
        if what == "workers":
            fleet.workers[rng.choice(sorted(fleet.workers))].send_signal(signal.SIGKILL)
        elif what == "scheduler" and fleet.scheduler is not None:
            fleet.scheduler.kill()
            fleet.scheduler.wait()
        else:
            client.kill()
            client.wait()
            client = _client(fleet, store, count)
    if not until(lambda: client.poll() is not None, 300.0, fleet):
        said("it does not come to an end")
        client.kill()
        return False
    fleet.end()
    same = store.table().drop(["seconds"]).equals(undisturbed.table().drop(["seconds"]))
    marks = Counter(path.name.partition(".")[0] for path in Path(store.place.root, "marks").iterdir())
    twice = sum(each - 1 for each in marks.values())
    said(
        f"{times} kills in {count} tasks: exit code {client.returncode}, {twice} done again, none more than "
        f"{max(marks.values()) - 1} times"
    )
    return same and client.returncode == 0 and max(marks.values()) <= 2 and len(store.done()) == count


def main(argv: Sequence[str] | None = None) -> int:
    """Do what is named, everything by default; 0 where all of it holds."""
    parser = argparse.ArgumentParser(description="A campaign on dask, while workers, scheduler and client are killed.")
    parser.add_argument("only", nargs="*", help="equal, poison, refused, many, workers, scheduler, client")
    parser.add_argument("--kills", type=int, nargs=3, default=(20, 3, 5), metavar=("WORKERS", "SCHEDULERS", "CLIENTS"))
    parser.add_argument("--method", default="paper", help="of the runs that must be equal (default paper)")
    parser.add_argument("--runs", type=int, default=6, help="of each of two vehicles that must be equal (default 6)")
    parser.add_argument("--seed", type=int, default=1, help="of whom is killed when")
    parser.add_argument("--client", nargs=3, metavar=("STORE", "ADDRESS", "COUNT"), help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.client:
        return client_main(options.client[0], options.client[1], int(options.client[2]))
    parts: dict[str, Callable[[Fleet, Path], bool]] = {
        each.__name__: lambda fleet, folder, each=each: each(fleet, folder, options)  # type: ignore[misc]
        for each in (equal, poison, refused, many)
    }
    for what, times in zip(("workers", "scheduler", "client"), options.kills, strict=True):
        parts[what] = lambda fleet, folder, what=what, times=times: killed(  # type: ignore[misc]
            fleet, folder, what, times, options.seed
        )
    results = {}
    for name in options.only or parts:
        print(f"\n{name}", flush=True)
        with tempfile.TemporaryDirectory() as place:
            fleet = Fleet(Path(place))
            try:
                began = time.monotonic()
                results[name] = parts[name](fleet, Path(place))
                said(f"{time.monotonic() - began:.0f} s")
            finally:
                fleet.end()
    print()
    for name, good in results.items():
        print(f"{name:10} {'ok' if good else 'FAILED'}")
    return 0 if all(results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
