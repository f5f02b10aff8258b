"""Reading and writing recordings: 100 MB of our MCAP beside the same samples in Parquet and beside mcap's own loop.

    python benchmarks/bench_recordings.py [--json]

First all must hold the same samples to the last bit, read by us, from Parquet, and message by message through the mcap
library. Then: reading the whole file, what the library alone takes for a stretch of it (scaled to the whole), and what
one sample costs the log of a live session. One core.
"""

from __future__ import annotations

import struct
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from figures import Figure, interleaved, report
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from towtank.readers import read
from towtank.recording import Recording
from towtank.recording.channel import standard_channel
from towtank.recording.mcap.format import Quantity
from towtank.recording.mcap.log import McapLog

LIMIT = 5.0  # s for 100 MB
ROWS = 800_000  # of the fastest source: 2 h 13 min at 100 Hz
STRETCH = 100_000  # messages that the library reads
SAMPLES = 100_000  # written to a log
PER_SAMPLE = 20.0  # us


def session(rows: int = ROWS) -> Recording:
    """Pose and rates at 100 Hz, DVL at 8 Hz, eight thrusters at 50 Hz, noise in every bit."""
    rng = np.random.default_rng(5)
    fast = 0.01 * np.arange(rows)
    channels = {}
    for t, names in (
        (fast, ("x", "y", "z", "phi", "theta", "psi", "p", "q", "r")),
        (fast[::12] + 0.003, ("u", "v", "w")),
        (fast[::2] + 0.001, tuple(f"cmd_{k}" for k in range(1, 9))),
    ):
        channels |= {name: standard_channel(name, t, rng.normal(size=t.size)) for name in names}
    return Recording(channels, source="bench")


def library_loop(path: Path, most: int | None = None) -> tuple[int, list[tuple[float, ...]]]:
    """Read messages through the mcap library, unpacking those of the pose; return how many, and the pose."""
    unpack = struct.Struct("<4x10d").unpack
    count, wanted, pose = 0, 0, []
    with path.open("rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Channel) and record.topic.startswith("/x_y_z"):
                wanted = record.id
            elif isinstance(record, Message):
                count += 1
                if record.channel_id == wanted:
                    pose.append(unpack(record.data))
                if most is not None and count >= most:
                    break
    return count, pose


def proved(folder: Path) -> None:
    """Raise where one of the ways does not give the samples to the bit."""
    run = session(20_000)
    run.write(folder / "small.mcap")
    run.write(folder / "small.parquet")
    ours, parquet = read(folder / "small.mcap"), read(folder / "small.parquet")
    _, pose = library_loop(folder / "small.mcap")
    columns = np.array(pose).T
    same = all(run[name] == ours[name] == parquet[name] for name in run)
    if not same or not all(np.array_equal(columns[k], run[name].values) for k, name in enumerate(run.names[:9], 1)):
        raise SystemExit("the ways of reading do not agree")


def write_log(path: Path) -> float:
    """Return microseconds per sample of six numbers, flushed and synchronised as in a session."""
    path.unlink(missing_ok=True)
    with McapLog.open(path) as log:
        log.source("pose", [Quantity(name) for name in "abcdef"])
        start = time.perf_counter()
        for k in range(SAMPLES):
            log.write("pose", 1e-3 * k, 1.0, 2.0, 3.0, 4.0, 5.0, float(k))
        log.flush()
        return 1e6 * (time.perf_counter() - start) / SAMPLES


def measured() -> Sequence[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        proved(folder)
        run = session()
        ours, parquet = folder / "a.mcap", folder / "a.parquet"
        run.write(ours)
        run.write(parquet)
        megabytes = ours.stat().st_size / 1e6
        messages = sum(len(run[name]) for name in ("x", "u", "cmd_1"))
        took = interleaved(
            {
                "ours": lambda: read(ours),
                "parquet": lambda: read(parquet),
                "library": lambda: library_loop(ours, STRETCH),
                "write": lambda: run.write(folder / "b.mcap"),
            },
            repeats=3,
        )
        library = took["library"] * messages / STRETCH
        scale = 100.0 / megabytes
        size = f"{megabytes:.0f} MB, {messages / 1e6:.1f} million samples of {len(run)} channels"
        return (
            Figure("mcap_read_100mb_seconds", scale * took["ours"], "s", LIMIT, note=size),
            Figure("mcap_write_100mb_seconds", scale * took["write"], "s", note="whole or not at all"),
            Figure("parquet_read_same_seconds", scale * took["parquet"], "s", note="the same samples"),
            Figure("mcap_ratio_to_parquet", took["ours"] / took["parquet"], "", note="times the time of Parquet"),
            Figure(
                "mcap_library_same_seconds", scale * library, "s", note="mcap's quickest loop, scaled from a stretch"
            ),
            Figure("mcap_ratio_to_library", library / took["ours"], "", 3.0, at_least=True, note="times faster"),
            Figure("mcap_log_us_per_sample", write_log(folder / "c.mcap"), "us", PER_SAMPLE, note="6 numbers, live"),
        )


def test_figures_are_met() -> None:
    assert main([]) == 0


def main(argv: Sequence[str] | None = None) -> int:
    return report("recordings", measured, sys.argv[1:] if argv is None else argv)


if __name__ == "__main__":
    sys.exit(main())
