"""A recording that is gone on with: after it was closed, killed, torn anywhere."""

from __future__ import annotations

import os
import random
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from towtank.errors import InputError
from towtank.readers import read
from towtank.recording import Recording
from towtank.recording.channel import standard_channel
from towtank.recording.mcap.format import Quantity
from towtank.recording.mcap.log import McapLog

EPOCH = datetime(2026, 5, 4, 12, 0, tzinfo=UTC)
POSE = [Quantity("x", "m", "NED"), Quantity("psi", "rad", "NED-FRD")]


def begun(path: Path, *, close: bool) -> list[int]:
    """Write three chunks of a hundred samples; return the size of the file after each."""
    log = McapLog.open(path, source="udp:14550", epoch=EPOCH, attributes={"vehicle": "seamor"}, interval=1e9)
    log.source("mavlink/ATTITUDE", POSE)
    sizes = []
    for chunk in range(3):
        for k in range(100 * chunk, 100 * chunk + 100):
            log.write("mavlink/ATTITUDE", 0.01 * k, float(k), 0.5)
            log.write_raw("mavlink", 0.01 * k, bytes([k % 256]))
        log.flush()
        sizes.append(path.stat().st_size)
    if close:
        log.close(["closed once"])
    else:
        os.close(log._descriptor)
    return sizes


def gone_on_with(path: Path) -> None:
    with McapLog.resume(path) as log:
        assert log.sources == {"mavlink/ATTITUDE": ("x", "psi")}
        log.source("json/5000", [Quantity("r", "rad/s", "FRD")])
        for k in range(1000, 1100):
            log.write("mavlink/ATTITUDE", 0.01 * k, float(k), 0.5)
            log.write("json/5000", 0.01 * k, float(k))
            log.write_raw("mavlink", 0.01 * k, b"raw")
        assert log.size <= path.stat().st_size


@pytest.mark.parametrize("close", [True, False])
def test_both_parts_are_one_recording(tmp_path: Path, close: bool) -> None:
    path = tmp_path / "dive.mcap"
    begun(path, close=close)
    gone_on_with(path)
    run = read(path)
    assert run.attributes == {"vehicle": "seamor", "epoch": EPOCH.isoformat()}
    assert run.source == "udp:14550"
    assert run.notes == (("closed once",) if close else ())
    assert np.array_equal(run["x"].values, [*range(300), *range(1000, 1100)])
    assert np.array_equal(run["r"].values, range(1000, 1100))
    assert not run.repairs
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 900
        assert sum(1 for _ in reader.iter_messages()) == 900
        assert sum(1 for _ in reader.iter_messages(topics=["/mavlink/ATTITUDE"])) == 400


def test_wherever_it_was_torn_whole_chunks_stay(tmp_path: Path) -> None:
    chance = random.Random(4)
    for _ in range(25):
        path = tmp_path / "dive.mcap"
        sizes = begun(path, close=False)
        cut = chance.randrange(sizes[0], sizes[2])
        os.truncate(path, cut)
        gone_on_with(path)
        run = read(path)
        whole = 100 * sum(cut >= size for size in sizes)
        found = run["x"].values
        assert list(found[-100:]) == list(range(1000, 1100))
        assert whole <= found.size - 100 <= whole + 100  # of a chunk whose index is torn, the messages stay
        assert list(found[:-100]) == list(range(found.size - 100))
        with path.open("rb") as stream:
            assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) >= 2 * whole + 300
        path.unlink()


def test_it_can_be_gone_on_with_many_times(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    begun(path, close=True)
    for k in range(5):
        with McapLog.resume(path) as log:
            log.write("mavlink/ATTITUDE", 10.0 + k, float(k), 0.0)
    assert np.array_equal(read(path)["x"].values, [*range(300), *range(5)])


def test_what_is_no_recording_of_a_session_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such recording"):
        McapLog.resume(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("t,x\n0,1\n")
    with pytest.raises(InputError, match="not MCAP"):
        McapLog.resume(tmp_path / "text.mcap")
    (tmp_path / "foreign.mcap").write_bytes(b"\x89MCAP0\r\n")
    before = (tmp_path / "foreign.mcap").read_bytes()
    with pytest.raises(InputError, match="not a recording of towtank"):
        McapLog.resume(tmp_path / "foreign.mcap")
    assert (tmp_path / "foreign.mcap").read_bytes() == before
    Recording({"x": standard_channel("x", [0.0, 1.0], [1.0, 2.0])}).write(tmp_path / "whole.mcap")
    with McapLog.resume(tmp_path / "whole.mcap") as log:  # one that was written whole is gone on with just as well
        log.write(next(iter(log.sources)), 2.0, 3.0)
    assert np.array_equal(read(tmp_path / "whole.mcap")["x"].values, [1.0, 2.0, 3.0])
