"""Links under attack: hostile datagrams, two vehicles of one number, stalls, clocks that are set, floods, hours on end.

    python benchmarks/studies/attack_links.py [--runs 1000000] [--seed 1] [--hours 2] [--speed 10]
                                              [--only PART,...] [--output FILE]

A simulated vehicle drives for half a minute and is heard over JSON, MAVLink and DDS, by the links of `towtank live`
with a session and a learner behind them; what comes over the wire, and when, is played from a tape, so that two runs
of the same tape learn the same to the last digit.

Hostile: `--runs` datagrams, shared by the three links, come between those of the vehicle: cut, flipped, spliced,
random bytes, absurd JSON, wrong checksums, numbers and stamps that cannot be, another vehicle under the same number.
Nothing may be raised, and the estimate must be that of the tape without them, to the last digit.

Cases: the link stalls for a minute and delivers all of it at once; the vehicle starts anew; its clock is set by hours
or seconds; its counter of milliseconds begins anew after 50 days; this computer's clock is set by hours. Each must be
counted or said, and no coefficient may end farther than half a deviation from the tape that nothing befell.

Flood: for some seconds a socket gets what it can hold. What is dropped must be said, and noise must not fill the
disk.

Hours: `towtank live replay:LOG@SPEED` runs `--hours` of a log; memory may grow by 5 MB once it is warm, and the
number of open files not at all. Size: what an hour of 50 signals at 100 Hz takes on the disk. The exit code is 1
where a bound is broken.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from link_tapes import (
    EPOCH,
    FREE,
    LINKS,
    ODOMETRY,
    OTHER,
    OWN,
    SECONDS,
    Heard,
    Outcome,
    Tape,
    drive,
    json_of,
    odometry,
    played,
    tape_of,
    usual,
)
from pymavlink.dialects.v20 import ardupilotmega as dialect
from rich.console import Console
from rich.table import Table

from towtank import load_vehicle
from towtank.live.links.json import JsonSource
from towtank.live.pipeline import clock as host
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.outputs import write_text
from towtank.readers import read
from towtank.recording import Recording
from towtank.recording.mcap.log import McapLog, Quantity
from towtank.simulation import Mocap, manoeuvre, simulate

CHANGED, GROWTH, NOISE = 0.5, 5.0, 2.0  # deviations, MB, MB of a flood of noise that may be recorded
LONGEST = 2.0  # s of work on what came at once
_BEFORE = 4.0  # s of the vehicle alone
_FORGED = 10  # datagrams between two of the vehicle may bear its address and stamps that cannot be: docs/live.md
_ABSURD = (
    b"\n",
    b"null",
    b"[1, 2]",
    b"{}",
    b'{"t": null}',
    b'{"t": 1e308, "x": 1}',
    b'{"t": -1e308, "x": 1}',
    b'{"t": "now", "x": 1}',
    b'{"t": true, "x": false}',
    b'{"t": 1e999, "psi": NaN}',
    b'{"x": Infinity, "y": -Infinity}',
    b'{"x": 1' + b"0" * 400 + b"}",
    b'{"cmd": [1]}',
    b'{"cmd": {"nobody": 1, "": 2}}',
    b'{"cmd": {"aft_port": {"a": 1}}}',
    b'{"frame": 3}',
    b'{"frame": {"body": [], "world": {}}}',
    b'{"qw": 0, "qx": 0, "qy": 0, "qz": 0}',
    b'{"qw": 1e200, "qx": 1e200, "qy": 0, "qz": 0}',
    b"[" * 60_000,
    b'{"a":' * 10_000,
    b'{"\xff\xfe": 1}',
    b'"\\ud800"',
    b'{"cmd_\\ud800": 1, "x\\u0000": 2}',
)


# Hostile


def hostile_json(chance: random.Random, good: bytes, t: float, *, forged: bool) -> Heard:
    """Return a datagram that holds nothing to be learned from."""
    way = chance.randrange(6 if forged else 5)
    if way == 0:
        return Heard(t, good[: chance.randrange(1, len(good))], OWN)  # no object without its last brace
    if way == 1:
        return Heard(t, chance.randbytes(chance.randint(1, 300)), OWN)
    if way == 2:
        return Heard(t, good[:-1] + good[: chance.randrange(1, len(good))], OWN)
    if way == 3:
        return Heard(t, json.dumps({f"k{chance.randrange(10**6)}": chance.random()}).encode(), OWN)
    if way == 4:
        return Heard(t, good.replace(b'"x": ', b'"x": 4'), OTHER)  # another vehicle on the same port
    return Heard(t, chance.choice(_ABSURD), OWN)


def _signed(kind: Any, payload: bytes, sender: tuple[int, int], wrong: int = 0) -> bytes:
    from pymavlink.generator.mavcrc import x25crc

    head = bytes((len(payload), 0, 0, 7, *sender)) + kind.id.to_bytes(3, "little")
    crc = x25crc(head + payload + bytes((kind.crc_extra,))).crc ^ wrong
    return b"\xfd" + head + payload + int(crc).to_bytes(2, "little")


_KINDS = list(dialect.mavlink_map.values())
_ATTITUDE = dialect.mavlink_map[dialect.MAVLINK_MSG_ID_ATTITUDE]


def hostile_mavlink(chance: random.Random, good: bytes, t: float, *, forged: bool) -> Heard:
    """Return a datagram that holds nothing to be learned from."""
    way = chance.randrange(6 if forged else 5)
    if way == 0:
        return Heard(t, good[: chance.randrange(1, len(good))], OWN)
    if way == 1:
        return Heard(t, chance.randbytes(chance.randint(1, 280)), OWN)
    if way == 2:
        return Heard(t, _signed(chance.choice(_KINDS), chance.randbytes(20), (1, 1), wrong=1), OWN)
    if way == 3:  # another vehicle under the same number
        return Heard(t, _signed(chance.choice(_KINDS), chance.randbytes(20), (1, 1)), OTHER)
    if way == 4:  # another autopilot, as itself
        return Heard(t, _signed(_ATTITUDE, chance.randbytes(28), (2, 1)), OTHER)
    stamp = chance.randrange(10**8, 2**31).to_bytes(4, "little")  # days ahead
    return Heard(t, _signed(_ATTITUDE, stamp + chance.randbytes(24), (1, 1)), OWN)


def hostile_ros2(chance: random.Random, good: bytes, t: float, *, forged: bool) -> Heard:
    """Return a message that holds nothing to be learned from."""
    topic = ("/odom", ODOMETRY)
    way = chance.randrange(4 if forged else 3)
    if way == 0:
        return Heard(t, good[: chance.randrange(len(good) - 8)], topic)
    if way == 1:
        return Heard(t, chance.randbytes(chance.randint(0, 60)), topic)
    if way == 2:
        return Heard(t, chance.randbytes(chance.randint(0, 300)), ("/noise", "std_msgs/msg/Float32"))
    return Heard(t, odometry(EPOCH + 1e6 * chance.random(), 5.0, 9.0), topic)  # days ahead


_HOSTILE = {"JSON": hostile_json, "MAVLink": hostile_mavlink, "DDS": hostile_ros2}


def among(kind: str, tape: Tape, count: int, seed: int) -> Iterator[list[Heard]]:
    """Yield the batches of a tape with hostile datagrams before them; stamps are forged in the first of them alone."""
    chance = random.Random(seed)
    start = next(k for k, batch in enumerate(tape) if batch[0].received > EPOCH + _BEFORE)
    each = count / (len(tape) - start)
    make, owed = _HOSTILE[kind], 0.0
    for k, batch in enumerate(tape):
        before: list[Heard] = []
        owed += each if k >= start else 0.0
        while owed >= 1.0:
            owed -= 1.0
            before.append(make(chance, batch[0].data, batch[0].received - 1e-4, forged=len(before) < _FORGED))
        yield [*before, *batch]


@cache
def undisturbed(kind: str, seed: int) -> Outcome:
    """Play the tape of a link that nothing befalls."""
    return played(kind, usual(kind, seed))


@dataclass(frozen=True)
class Row:
    """A line of the table: what was done, what was found, the bound, and whether it holds."""

    what: str
    found: str
    bound: str
    good: bool


def hostile(kind: str, count: int, seed: int) -> Row:
    """Play a tape with and without hostile datagrams."""
    tape, calm = usual(kind, seed), undisturbed(kind, seed)
    storm = played(kind, among(kind, tape, count, seed))
    same = np.array_equal(calm.values, storm.values) and np.array_equal(calm.std, storm.std)
    state = storm.status.sources[0].state
    counted = storm.status.bad + state.foreign
    change = float(np.max(np.abs(calm.values - storm.values) / calm.std))
    learned = bool(calm.status.learnt.instants) and bool(np.any(calm.std > 0.0))
    found = (
        f"{counted} counted, at most {storm.slowest:.2f} s of work at once, "
        f"estimate {'the same' if same else f'off by {change:.3g} std'}"
    )
    good = same and learned and counted > 0 and storm.slowest <= LONGEST
    return Row(f"{count} hostile datagrams, {kind}", found, "no escape, the same", good)


# Cases


def stalls(kind: str, seed: int) -> tuple[Tape, Tape, str]:
    """The link stalls for a minute and then delivers everything at once."""
    calm = usual(kind, seed, SECONDS + 60.0)
    held: Tape = []
    for batch in calm:
        late = EPOCH + 75.0 + 1e-5 * len(held)
        inside = EPOCH + 15.0 < batch[0].received < late
        held.append([each._replace(received=late) for each in batch] if inside else batch)
    return calm, held, ""


def clock_set(seconds: float) -> Callable[[str, int], tuple[Tape, Tape, str]]:
    """The vehicle's clock is set by so many seconds after half of the run."""

    def case(kind: str, seed: int) -> tuple[Tape, Tape, str]:
        link = LINKS[kind]
        run = drive(link.vehicle, SECONDS, seed)
        boot = link.boot + max(-seconds, 0.0)
        calm = tape_of(link.says(run, lambda t: boot + t), seed=seed)
        told = link.says(run, lambda t: boot + t + (seconds if t > SECONDS / 2 else 0.0))
        return calm, tape_of(told, seed=seed), "its clock was set anew"

    return case


def starts_anew(kind: str, seed: int) -> tuple[Tape, Tape, str]:
    """The vehicle starts anew, so that its clock begins again."""
    link = LINKS[kind]
    run = drive(link.vehicle, SECONDS, seed)
    told = link.says(run, lambda t: link.boot + t if t < SECONDS / 2 else 1.0 + t - SECONDS / 2)
    return usual(kind, seed), tape_of(told, seed=seed), "its clock was set anew"


def counter_begins_anew(kind: str, seed: int) -> tuple[Tape, Tape, str]:
    """The counter of milliseconds has 32 bits, and begins anew after 50 days."""
    link = LINKS[kind]
    run = drive(link.vehicle, SECONDS, seed)
    boot = 2.0**32 * 1e-3 - SECONDS / 2
    return usual(kind, seed), tape_of(link.says(run, lambda t: boot + t), seed=seed), ""


def same_number(kind: str, seed: int) -> tuple[Tape, Tape, str]:
    """Another vehicle speaks under the same number, on another course, as often, and with a clock of its own."""
    link = LINKS[kind]
    calm = usual(kind, seed)
    other = link.says(drive(link.vehicle, SECONDS, seed + 1), lambda t: 7000.0 + t, OTHER)
    rival = tape_of([(t, said) for t, said in other if t > _BEFORE], seed=seed + 1)
    both = sorted([*calm, *rival], key=lambda batch: batch[0].received)
    return calm, both, "passed over"


CASES: dict[str, tuple[Callable[[str, int], tuple[Tape, Tape, str]], tuple[str, ...]]] = {
    "stalls for a minute": (stalls, ("JSON", "MAVLink")),
    "starts anew": (starts_anew, ("JSON", "MAVLink")),
    "clock set by +3 h": (clock_set(10_800.0), ("JSON", "MAVLink", "DDS")),
    "clock set by -3 h": (clock_set(-10_800.0), ("JSON", "MAVLink", "DDS")),
    "clock set by -5 s": (clock_set(-5.0), ("JSON",)),
    "counter of ms begins anew": (counter_begins_anew, ("MAVLink",)),
    "another vehicle, same number": (same_number, ("JSON", "MAVLink")),
}


def case(name: str, kind: str, seed: int) -> Row:
    """Play a tape that something befell, and the one that nothing did."""
    calm_tape, tape, words = CASES[name][0](kind, seed)
    calm = undisturbed(kind, seed) if calm_tape == usual(kind, seed) else played(kind, calm_tape)
    found = played(kind, tape)
    change = float(np.max(np.abs(found.values - calm.values) / calm.std))
    said = not words or words in found.told
    text = f"off by {change:.3f} std" + ("" if said else f", not said: {words}")
    good = said and change <= CHANGED and bool(found.status.learnt.instants)
    return Row(f"{kind}: {name}", text, f"{CHANGED} std, said", good)


def computer_clock(seed: int) -> Row:
    """This computer's clock is set by three hours, forward and back, while a socket is read."""
    vehicle = load_vehicle("seamor")
    run = drive("seamor", 6.0, seed)
    set_by = 0.0
    honest = time.time
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.bind(("127.0.0.1", 0))
        port = out.getsockname()[1] + 1
        source = JsonSource(f"json:127.0.0.1:{port}", vehicle)
        log = McapLog.open(Path(folder, "a.mcap"))
        learner = new_learner(vehicle, "joint", FREE, changes=False)
        session = Session([("JSON", source)], vehicle, learner, epoch=host.steady_time(), log=log)
        session.open()
        stop = threading.Event()
        done: list[Status] = []
        thread = threading.Thread(target=lambda: done.append(session.run(stop)))
        thread.start()
        time.time = lambda: honest() + set_by  # type: ignore[assignment]
        try:
            began = time.monotonic()
            for t, said in json_of(run, lambda t: t):
                time.sleep(max(began + t - time.monotonic(), 0.0))
                set_by = 0.0 if t < 2.0 else 10_800.0 if t < 4.0 else -10_800.0
                out.sendto(said[0][0], ("127.0.0.1", port))
            time.sleep(1.0)
        finally:
            time.time = honest
        stop.set()
        thread.join()
        times = read(Path(folder, "a.mcap"))["x"].t
    said = sum("computer's clock was set" in event.text for event in done[0].events)
    gap = float(np.max(np.diff(times)))
    kept = len(times) / len(run["x"])
    length = float(times[-1] - times[0])
    good = said == 2 and gap < 2.0 and kept == 1.0 and 5.0 < length < 8.0
    found = f"said {said} times, {100 * kept:.0f} % recorded over {length:.1f} s"
    return Row("this computer's clock set by +3 h, -6 h", found, "said, times go on", good)


def flood(seconds: float, seed: int) -> Row:
    """A socket gets as much noise as it can hold, with a vehicle's samples in it."""
    vehicle = load_vehicle("seamor")
    chance = random.Random(seed)
    good = json_of(drive("seamor", 2.0, seed), lambda t: t)
    noise = [chance.randbytes(1400).translate(None, b"\r\n") for _ in range(100)]  # one line each
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.bind(("127.0.0.1", 0))
        port = out.getsockname()[1] + 1
        log = McapLog.open(Path(folder, "a.mcap"))
        learner = new_learner(vehicle, "joint", FREE, changes=False)
        source = JsonSource(f"json:127.0.0.1:{port}", vehicle)
        session = Session([("JSON", source)], vehicle, learner, epoch=host.steady_time(), log=log)
        session.open()
        stop = threading.Event()
        done: list[Status] = []
        thread = threading.Thread(target=lambda: done.append(session.run(stop)))
        thread.start()
        sent, end = 0, time.monotonic() + seconds
        while time.monotonic() < end:
            for data in (*noise, good[sent % len(good)][1][0][0]):
                out.sendto(data, ("127.0.0.1", port))
                sent += 1
        for _ in range(3):  # the system tells with the next one what it has dropped
            time.sleep(2.0)
            out.sendto(good[-1][1][0][0], ("127.0.0.1", port))
            sent += 1
        time.sleep(1.0)
        stop.set()
        thread.join()
        size = Path(folder, "a.mcap").stat().st_size / 1e6
    state = done[0].sources[0].state
    counted = state.bad + done[0].samples + state.dropped + done[0].sources[0].strange
    found = f"{sent} sent, {state.bad} bad, {state.dropped} dropped by the system, {size:.1f} MB recorded"
    bound = NOISE + 0.1 * seconds
    told = not state.dropped or any("dropped by the system" in text for text in state.said)
    good_one = told and size <= bound and counted >= 0.99 * sent and state.bad > 0
    return Row(f"flood of noise, {seconds:.0f} s", found, f"counted, {bound:.1f} MB", good_one)


# Hours


def hours(length: float, speed: float, seed: int) -> Row:
    """Run `towtank live` over hours of a log, so many times as fast; look at memory and open files once a second."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder, "log.parquet")
        vehicle = load_vehicle("vlbv300")
        part = 600.0
        plan = manoeuvre("all-multisine", vehicle, duration=part, dt=0.01, seed=seed)
        run = simulate(vehicle, commands=plan.commands, dt=0.01, sensors=Mocap(rate=100.0), seed=seed)
        many = max(math.ceil(3600.0 * length / part), 1)
        t = np.concatenate([run["x"].t + k * (part + 0.01) for k in range(many)])
        names = [*run.names]
        table = {name: np.tile(np.interp(run["x"].t, run[name].t, run[name].values), many) for name in names}
        Recording.from_table(t, table, source="hours").window(0.0, 3600.0 * length).write(log)
        command = [sys.executable, "-m", "towtank", "live", f"replay:{log}@{speed:g}", "--vehicle", "vlbv300"]
        process = subprocess.Popen(
            [*command, "--record", str(Path(folder, "a.mcap")), "--json-lines"], stdout=subprocess.PIPE, text=True
        )
        memory, handles, last = [], [], ""
        for line in process.stdout or ():
            last = line
            if process.poll() is None and (usage := _usage(process.pid)) is not None:
                memory.append(usage[0])
                handles.append(usage[1])
        process.wait()
        document = json.loads(last)
    warm = len(memory) // 4
    tenth = max(len(memory) // 10, 1)
    early, late = float(np.median(memory[warm : warm + tenth])), float(np.median(memory[-tenth:]))
    held = int(np.median(handles[warm : warm + tenth])), int(np.median(handles[-tenth:]))
    dropped = document["live"]["dropped"]
    found = f"{early:.1f} MB, then {late:.1f} MB; {held[0]} open files, then {held[1]}; {dropped} dropped in learning"
    good = late - early <= GROWTH and held[1] <= held[0] and process.returncode == 0
    return Row(f"{length:g} h at {speed:g} times the pace", found, f"+{GROWTH:g} MB, +0 files", good)


def _usage(process: int) -> tuple[float, int] | None:
    """Return resident memory [MB] and open files of a process."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
        resident = next(line for line in status.splitlines() if line.startswith("VmRSS"))
        return float(resident.split()[1]) * 1.024e-3, len(list(Path(f"/proc/{process}/fd").iterdir()))
    except (OSError, StopIteration):
        return None


def size_of_an_hour(minutes: float, seed: int) -> Row:
    """Record 50 signals at 100 Hz as a session does, bytes and samples; return what an hour takes."""
    rng = np.random.default_rng(seed)
    names = [f"cmd_{k}" for k in range(50)]
    count = round(6000 * minutes)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        with McapLog.open(path, interval=1e9) as log:
            log.source("json/port", [Quantity(name) for name in names])
            for k in range(count):
                values = np.round(rng.normal(size=50), 4).tolist()
                data = json.dumps({"t": round(0.01 * k, 3), **dict(zip(names, values, strict=True))}).encode()
                log.write_raw("json/port", 0.01 * k, data)
                log.write("json/port", 0.01 * k, *values)
                if k % 10 == 9:
                    log.flush()
        size = path.stat().st_size / 1e6 * 60.0 / minutes
    return Row("an hour of 50 signals at 100 Hz, JSON and samples", f"{size:.0f} MB", "-", True)


PARTS = ("hostile", "cases", "computer", "flood", "size", "hours")


def perform(runs: int, seed: int, parts: Sequence[str], length: float, speed: float) -> list[Row]:
    """Return the rows of the table."""
    rows: list[Row] = []
    steps: list[tuple[str, Callable[[], Row]]] = []
    if "hostile" in parts:
        share = {"JSON": 0.4, "MAVLink": 0.4, "DDS": 0.2}
        steps += [(kind, lambda kind=kind: hostile(kind, round(share[kind] * runs), seed)) for kind in LINKS]  # type: ignore[misc]
    if "cases" in parts:
        for name, (_, kinds) in CASES.items():
            steps += [(name, lambda name=name, kind=kind: case(name, kind, seed)) for kind in kinds]  # type: ignore[misc]
    if "computer" in parts:
        steps.append(("computer", lambda: computer_clock(seed)))
    if "flood" in parts:
        steps.append(("flood", lambda: flood(10.0, seed)))
    if "size" in parts:
        steps.append(("size", lambda: size_of_an_hour(6.0, seed)))
    if "hours" in parts:
        steps.append(("hours", lambda: hours(length, speed, seed)))
    for name, step in steps:
        print(f"{name} ...", file=sys.stderr, flush=True)
        rows.append(step())
    return rows


def main() -> int:
    """Run and judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1_000_000, help="hostile datagrams")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--only", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    rows = perform(asked.runs, asked.seed, asked.only.split(","), asked.hours, asked.speed)
    table = Table(title="Links")
    for column in ("attack", "found", "bound", ""):
        table.add_column(column)
    for row in rows:
        table.add_row(row.what, row.found, row.bound, "ok" if row.good else "BROKEN")
    Console(width=150).print(table)
    if asked.output:
        write_text(asked.output, json.dumps([asdict(row) for row in rows]))
    good = all(row.good for row in rows)
    print("every bound holds" if good else "A BOUND IS BROKEN")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
