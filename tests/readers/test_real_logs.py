"""Real logs of ArduSub vehicles: what their makers' tables and other readers say of them, this reader says too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.recording import Recording

SEA = "bluerov2_dvl_sea_2026"
START = 600.07923 - 600.014074  # s from the log's first message to t = 0 of the tables
SAMPLES = ("small.BIN", "small.tlog", "2023-04-18_11-03-34.tlog")


@pytest.fixture(scope="module")
def sea(data: Path) -> Recording:
    return tt.read(next((data / SEA / "orig").glob("*.BIN")))


def table(path: Path) -> dict[str, np.ndarray]:
    with path.open() as lines:
        names = lines.readline().strip().split(",")
    found = np.genfromtxt(path, delimiter=",", skip_header=1)
    return {name: found[:, i] for i, name in enumerate(names)}


def test_the_sea_log_gives_what_its_tables_give(sea: Recording, data: Path) -> None:
    """run_20hz.csv was made from the same log: gyros, accelerometers, attitude and depth agree to its last digit."""
    run = table(data / SEA / "run_20hz.csv")
    t = run["t"] + START
    columns = {"phi": "phi", "theta": "theta", "psi": "psi", "z": "depth_m", "p": "p", "q": "q", "r": "r"}
    columns |= {"ax": "acc_x", "ay": "acc_y", "az": "acc_z"}
    for name, column in columns.items():
        inside = (t >= sea[name].t[0]) & (t <= sea[name].t[-1])
        ours = np.interp(t[inside], sea[name].t, sea[name].values)
        error = np.sqrt(np.mean((ours - run[column][inside]) ** 2))
        assert error < 1e-3 * np.std(run[column]), name
    for n in range(1, 9):
        held = sea[f"cmd_{n}"].values[np.searchsorted(sea[f"cmd_{n}"].t, t + 1e-6, "right") - 1]
        assert np.mean(held == run[f"pwm{n}"]) > 0.99


def test_the_sea_logs_dvl_is_equal(sea: Recording, data: Path) -> None:
    dvl = table(data / SEA / "dvl_8hz.csv")
    for name in "uvw":
        assert len(sea[name]) == dvl["t"].size
        np.testing.assert_allclose(sea[name].t, dvl["t"] + START, atol=1e-5)
        np.testing.assert_allclose(sea[name].values, dvl[name], atol=1e-5)


def test_the_sea_logs_contents(sea: Recording) -> None:
    used = {content.name: content.used for content in sea.contents if content.used}
    assert set(used) == {"VISO", "IMU[0]", "BAT[0]", "BARO[1]", "ATT", "RCOU", "MODE"}
    assert sum(content.count for content in sea.contents) == 82_929 - 172  # FMT and FMTU are the log's dictionary
    assert not sea.repairs


@pytest.mark.parametrize(("name", "damaged"), list(zip(SAMPLES, (0, 4, 1967), strict=True)))
def test_samples(data: Path, name: str, damaged: int) -> None:
    run = tt.read(data / "ardusub_samples" / name)
    assert run.repairs.damaged == damaged
    assert np.median(run["az"].values) == pytest.approx(-9.8, abs=0.15)
    assert {"p", "q", "r", "phi", "theta", "psi", "z", "voltage", "cmd_1", "cmd_6"} <= set(run)


def test_dead_reckoning_of_the_samples(data: Path) -> None:
    """Two of them say by their status bits that nothing aids the filter; the third one is told its position."""
    runs = [tt.read(data / "ardusub_samples" / name) for name in SAMPLES]
    assert ["vn" in run for run in runs] == [False, True, False]


def test_the_tlog_is_what_pymavlink_reads(data: Path) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    from towtank.readers.mavlink.tlog import decode

    path = data / "ardusub_samples" / "small.tlog"
    tables, _ = decode(path.read_bytes(), "log")
    link = mavlink.MAVLink(None)
    link.robust_parsing = True
    raw, at, counts, rolls = path.read_bytes(), 0, {}, []
    while at + 20 < len(raw):
        size = 20 + raw[at + 9] + (13 if raw[at + 10] & 1 else 0)
        for message in link.parse_buffer(raw[at + 8 : at + size]) or ():
            counts[message.get_type()] = counts.get(message.get_type(), 0) + 1
            if message.get_type() == "ATTITUDE":
                rolls.append(message.roll)
        at += size
    assert counts.pop("BAD_DATA") == 4
    assert counts == {kind: sum(len(each) for each in tables.named(kind)) for kind in counts}
    assert tables.tables["ATTITUDE"]["roll"].tolist() == rolls
