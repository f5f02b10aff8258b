"""The log of a live session: what it holds after kill -9, with a full disk, with late samples."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from towtank.errors import InputError
from towtank.readers import read
from towtank.recording.mcap.format import Quantity
from towtank.recording.mcap.log import McapLog

POSE = [Quantity("x", "m", "NED"), Quantity("psi", "rad", "NED-FRD")]
GYRO = [Quantity("r", "rad/s", "FRD")]


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    epoch = datetime(2026, 5, 4, 12, 0, tzinfo=UTC)
    with McapLog.open(path, source="udp:14550", epoch=epoch, attributes={"vehicle": "seamor"}) as log:
        log.source("pose", POSE)
        log.source("gyro", GYRO)
        for k in range(1000):
            log.write("gyro", 0.01 * k, 0.1 * k)
            if k % 10 == 0:
                log.write("pose", 0.01 * k, float("nan") if k == 20 else k / 3.0, -0.0)
                log.write_raw("udp:14550", 0.01 * k, bytes([k % 256]) * (k % 7))
        log.close(["learning was skipped for 2 s"])
    run = read(path)
    assert run.names == ("x", "psi", "r")
    assert run.source == "udp:14550"
    assert run.notes == ("learning was skipped for 2 s",)
    assert run.attributes == {"vehicle": "seamor", "epoch": epoch.isoformat()}
    assert np.array_equal(run["r"].t, [0.01 * k for k in range(1000)])
    assert np.array_equal(run["x"].values[:4], [0.0, 10 / 3.0, np.nan, 10.0], equal_nan=True)
    assert np.signbit(run["psi"].values).all()
    assert not run.repairs
    assert [(each.name, each.count) for each in run.contents] == [
        ("/pose", 100),
        ("/gyro", 1000),
        ("/raw/udp:14550", 100),
    ]
    with path.open("rb") as stream:
        messages = list(make_reader(stream, validate_crcs=True).iter_messages(topics=["/raw/udp:14550"]))
    assert [message.data for _, _, message in messages] == [bytes([k % 256]) * (k % 7) for k in range(0, 1000, 10)]
    assert messages[1][2].log_time == round(epoch.timestamp() * 1e9) + 100_000_000


def test_late_and_repeated_samples_are_sorted_and_counted(tmp_path: Path) -> None:
    with McapLog.open(tmp_path / "a.mcap") as log:
        log.source("gyro", GYRO)
        for t in (0.0, 0.1, 0.3, 0.2, 0.4, 0.4, 0.5):
            log.write("gyro", t, 10.0 * t)
        log.write("gyro", 0.6, float("inf"))
    run = read(tmp_path / "a.mcap")
    assert np.array_equal(run["r"].t, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert (run.repairs.disorder, run.repairs.duplicates, run.repairs.infinities) == (1, 1, 1)


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    McapLog.open(tmp_path / "a.mcap").close()
    before = (tmp_path / "a.mcap").read_bytes()
    with pytest.raises(InputError, match="exists already"):
        McapLog.open(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == before
    with pytest.raises(InputError, match=r"cannot be created \(No such file"):
        McapLog.open(tmp_path / "no" / "a.mcap")


def test_sources_are_announced_once_and_samples_fit(tmp_path: Path) -> None:
    with McapLog.open(tmp_path / "a.mcap") as log:
        log.source("gyro", GYRO)
        with pytest.raises(InputError, match="announced twice"):
            log.source("gyro", GYRO)
        with pytest.raises(InputError, match="all different"):
            log.source("two", [*GYRO, *GYRO])
        with pytest.raises(ValueError, match="found 2 values, expected 1"):
            log.write("gyro", 0.0, 1.0, 2.0)


def test_flushed_at_most_a_second_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("towtank.recording.mcap.log.time.monotonic", lambda: now)
    log = McapLog.open(tmp_path / "a.mcap")
    log.source("gyro", GYRO)
    for k in range(10):
        log.write("gyro", 0.01 * k, 0.0)
    empty = (tmp_path / "a.mcap").stat().st_size
    now += 0.9
    log.flush_if_due()
    assert (tmp_path / "a.mcap").stat().st_size == empty
    now += 0.2
    log.flush_if_due()
    assert len(read(tmp_path / "a.mcap")["r"]) == 10
    now += 1.0
    log.write("gyro", 0.5, 0.0)
    assert len(read(tmp_path / "a.mcap")["r"]) == 11
    log.close()
    log.close()


def test_the_system_gets_samples_oftener_than_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the system has outlives a process that is killed; a disk may take longer for a sync than for bytes."""
    now, synced = 100.0, list[float]()
    monkeypatch.setattr("towtank.recording.mcap.log.time.monotonic", lambda: now)
    monkeypatch.setattr("towtank.recording.mcap.log.os.fsync", lambda _: synced.append(now))
    log = McapLog.open(tmp_path / "a.mcap", interval=0.1)
    log.source("gyro", GYRO)
    for k in range(20):
        now += 0.125
        log.write("gyro", 0.1 * k, 0.0)
        assert len(read(tmp_path / "a.mcap")["r"]) == k + 1
        assert log._syncing is None or log._syncing.join() is None
    assert synced == [100.5, 101.0, 101.5, 102.0, 102.5]
    log.close()


WRITER = """
import sys
from towtank.recording.mcap.log import McapLog, Quantity
log = McapLog.open(sys.argv[1], interval=0.05)
log.source("gyro", [Quantity("r", "rad/s", "FRD")])
log.source("depth", [Quantity("z", "m", "NED")])
k = 0
while True:
    log.write("gyro", 1e-3 * k, float(k))
    if k % 4 == 0:
        log.write("depth", 1e-3 * k, float(k))
    k += 1
    if k % 200 == 0:
        log.flush()
        print(k, flush=True)
"""


@pytest.mark.parametrize("seed", range(3))
def test_kill_9_costs_what_was_not_flushed(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        moments = random.Random(seed)
        flushed = 0
        for _ in range(moments.randrange(1, 40)):
            flushed = int(child.stdout.readline())
        time.sleep(moments.uniform(0.0, 0.02))
        os.kill(child.pid, signal.SIGKILL)
        rest = child.stdout.read().split()
    flushed = int(rest[-1]) if rest else flushed
    run = read(path)
    assert len(run["r"]) >= flushed
    assert np.array_equal(run["r"].values, np.arange(len(run["r"])))
    assert np.array_equal(run["z"].values, np.arange(0, 4 * len(run["z"]), 4))
    assert 4 * len(run["z"]) >= flushed
    assert any("has no end" in line for line in run.repairs.lines)


FULL = """
import resource, signal, sys
from towtank.recording.mcap.log import McapLog, Quantity
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
log = McapLog.open(sys.argv[1])
log.source("gyro", [Quantity("r", "rad/s", "FRD")])
log.source("many", [Quantity(f"force_{k}", "N") for k in range(60)])
def some(start, end):
    for k in range(start, end):
        log.write("gyro", 1e-3 * k, float(k))
    return log.flush()
assert some(0, 1000) and not log.trouble
soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (8500, hard))
assert not some(1000, 3000) and "a.mcap" in log.trouble and not log.lost, (log.trouble, log.lost)
log.write_raw("udp", 0.0, b"x")                   # its channel waits, too
resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
assert some(3000, 4000) and not log.trouble       # what waited is written now
resource.setrlimit(resource.RLIMIT_FSIZE, (8500, hard))
if len(sys.argv) > 2:
    for k in range(80_000):                       # more than it keeps waiting
        log.write("many", 1e-3 * k, *range(60))
    assert not log.flush()
    assert log.lost > 10_000
resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
log.close()
print(log.lost)
"""


@pytest.mark.parametrize("words", [(), ("more",)], ids=["waits", "drops"])
def test_a_full_disk_costs_samples_not_the_session(tmp_path: Path, words: tuple[str, ...]) -> None:
    path = tmp_path / "a.mcap"
    done = subprocess.run([sys.executable, "-c", FULL, str(path), *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    run = read(path)
    assert np.array_equal(run["r"].values[:4000], np.arange(4000))
    lost = int(done.stdout)
    assert (lost > 0) == bool(words)
    assert run.notes == (f"{lost} samples could not be written (the disk was full)",) * bool(words)
    assert not run.repairs
