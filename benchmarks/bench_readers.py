"""Reading ArduPilot logs beside pymavlink's own loops.

    python benchmarks/bench_readers.py [--json]

First every number of every message must be pymavlink's. Then: a .BIN of 16 MB and a .tlog of 8 MB into columns of
numbers, by these readers and by the loop that one writes with pymavlink (a message at a time, its fields appended to
lists); and the whole way from the .BIN to a Recording.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from figures import Figure, report
from pymavlink import DFReader
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from towtank.readers import read
from towtank.readers.dataflash.reader import tables_of as decode_dataflash
from towtank.readers.mavlink.tlog import decode as decode_tlog

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "readers"))

from encoders import dive_bin, dive_tlog

Columns = dict[str, dict[str, list[float]]]
PARAMETERS = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 7)}
BIN_BYTES, TLOG_BYTES = 16_000_000, 8_000_000
MINUTE = 60.0
REPEATS = 3


def pymavlink_bin(path: Path) -> Columns:
    """Return kind -> field -> values, as a script with pymavlink reads them."""
    reader = DFReader.DFReader_binary(str(path))
    found: Columns = {}
    while (message := reader.recv_msg()) is not None:
        fields = found.setdefault(message.get_type(), {})
        for name, value in message.to_dict().items():
            fields.setdefault(name, []).append(value)
    reader.close()
    return found


def pymavlink_tlog(path: Path) -> Columns:
    link = mavlink.MAVLink(None)
    link.robust_parsing = True
    data, at = path.read_bytes(), 0
    found: Columns = {}
    while at < len(data):
        size = data[at + 9] + (20 if data[at + 8] == 0xFD else 16)
        for message in link.parse_buffer(data[at + 8 : at + size]) or ():
            fields = found.setdefault(message.get_type(), {})
            for name, value in message.to_dict().items():
                fields.setdefault(name, []).append(value)
        at += size
    return found


def ours_bin(path: Path) -> dict[str, dict[str, np.ndarray]]:
    return {name: dict(table.columns) for name, table in decode_dataflash(path).tables.items()}


def ours_tlog(path: Path) -> dict[str, dict[str, np.ndarray]]:
    tables, _ = decode_tlog(path.read_bytes(), str(path))
    return {name: dict(table.columns) for name, table in tables.tables.items()}


def prove_parity(folder: Path) -> None:
    """Both must say the same of a short log; tables of one kind together hold its messages."""
    path = folder / "short.BIN"
    path.write_bytes(dive_bin(5.0, parameters=PARAMETERS).data)
    _agree(pymavlink_bin(path), ours_bin(path), skip=("FMT", "FMTU"))
    path = folder / "short.tlog"
    path.write_bytes(dive_tlog(5.0, parameters=PARAMETERS).data)
    _agree(pymavlink_tlog(path), ours_tlog(path), skip=())


def _agree(theirs: Columns, ours: dict[str, dict[str, np.ndarray]], skip: Sequence[str]) -> None:
    for kind, fields in theirs.items():
        tables = [table for name, table in ours.items() if name.partition("@")[0].partition("[")[0] == kind]
        if kind in skip:
            continue
        for column in tables[0]:
            name, _, element = column.rstrip("]").partition("[")
            values = [value[int(element)] for value in fields[name]] if element else fields[name]
            mine = np.concatenate([table[column] for table in tables])
            np.testing.assert_array_equal(np.sort(mine), np.sort(np.array(values, dtype=float)), f"{kind}.{column}")


def _long(size: int, minute: Callable[[float], bytearray]) -> bytes:
    """Return minutes one after the other, on one clock, until there are enough bytes."""
    found = bytearray()
    t = 0.0
    while len(found) < size:
        found += minute(t)
        t += MINUTE
    return bytes(found)


def seconds(task: Callable[[], object]) -> float:
    """Return the least of a few times: what the machine's other work did not slow down."""
    best = float("inf")
    for _ in range(REPEATS):
        began = time.perf_counter()
        task()
        best = min(best, time.perf_counter() - began)
    return best


def measure() -> list[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prove_parity(folder)
        log, link = folder / "long.BIN", folder / "long.tlog"
        log.write_bytes(_long(BIN_BYTES, lambda t: dive_bin(MINUTE, parameters=PARAMETERS, start=100.0 + t).data))
        link.write_bytes(
            _long(TLOG_BYTES, lambda t: dive_tlog(MINUTE, parameters=PARAMETERS, boot=50.0 + t, epoch=1.7e9 + t).data)
        )
        read(log)
        ours, theirs = seconds(lambda: ours_bin(log)), seconds(lambda: pymavlink_bin(log))
        whole = seconds(lambda: read(log))
        ours_link, theirs_link = seconds(lambda: ours_tlog(link)), seconds(lambda: pymavlink_tlog(link))
        megabytes = log.stat().st_size / 1e6
    return [
        Figure("readers-bin-recording", whole * 16.0 / megabytes, "s", 5.0, note="16 MB .BIN to a Recording"),
        Figure("readers-bin-columns", ours * 16.0 / megabytes, "s", note="16 MB .BIN to columns"),
        Figure("readers-bin-pymavlink", theirs / ours, "times", 5.0, at_least=True, note="pymavlink's loop, same .BIN"),
        Figure("readers-tlog-columns", ours_link, "s", note="8 MB .tlog to columns"),
        Figure(
            "readers-tlog-pymavlink",
            theirs_link / ours_link,
            "times",
            2.0,
            at_least=True,
            note="pymavlink's loop, same .tlog",
        ),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    return report("readers of ArduPilot logs", measure, argv)


def test_figures_are_met() -> None:
    assert main([]) == 0


if __name__ == "__main__":
    sys.exit(main())
