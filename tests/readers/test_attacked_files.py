"""Files that an attack got through with: each is read now, or refused in our own words."""

from __future__ import annotations

import sqlite3
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from tests.pace import within

from towtank.errors import InputError
from towtank.readers import read
from towtank.recording.consistency.rates import rate_scales
from towtank.recording.mcap.log import McapLog, Quantity
from towtank.recording.recording import Recording

from .encoders import DataFlashWriter, dive_tlog
from .ros_bags import Said, imu, write_bag2


def test_a_stamp_beyond_the_year_9999_costs_the_date_alone(tmp_path: Path) -> None:
    (tmp_path / "a.tlog").write_bytes(bytes(dive_tlog(4.0, epoch=9.2e12).data))
    run = read(tmp_path / "a.tlog")
    assert "epoch" not in run.attributes
    assert run.duration == pytest.approx(3.9, abs=0.2)
    assert any("expected one before 2100" in note for note in run.notes)


def test_infinite_times_of_a_database_are_damaged_messages(tmp_path: Path) -> None:
    said = [
        Said(
            "/imu",
            0.05 * k,
            "sensor_msgs/msg/Imu",
            imu(0.05 * k, "base_link", (1.0, 0.0, 0.0, 0.0), (0.1, 0.2 * k, 0.3), (0.0, 0.0, 9.8)),
        )
        for k in range(40)
    ]
    [path] = write_bag2(tmp_path / "bag", said).glob("*.db3")
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET timestamp = 9e999 WHERE id = 5")
        database.execute("UPDATE messages SET timestamp = -1e300 WHERE id = 7")
    database.close()
    run = read(path)
    assert run.repairs.damaged >= 1
    assert run.duration < 3.0


def test_a_log_that_goes_to_and_fro_between_two_formats_keeps_its_order(tmp_path: Path) -> None:
    one, two = DataFlashWriter(), DataFlashWriter()
    one.define("ATT", "Qff", "TimeUS,Roll,Pitch", number=200)
    two.define("ATT", "Qfff", "TimeUS,Roll,Pitch,Yaw", number=200)
    heads = bytes(one.data[89:]), bytes(two.data[89:])
    data = bytes(one.data[:89])
    for k in range(40):
        each = (one, two)[k % 2]
        start = len(each.data)
        each.add("ATT", 1e6 + 1e5 * k, 1.0 * k, 0.0, *([0.0] * (k % 2)))
        data += heads[k % 2] + bytes(each.data[start:])
    (tmp_path / "a.BIN").write_bytes(data)
    run = read(tmp_path / "a.BIN")
    assert run["phi"].values == pytest.approx(np.radians(np.arange(40.0)))
    assert not run.repairs.disorder


def test_formats_without_end_are_damaged(tmp_path: Path) -> None:
    data = bytes(DataFlashWriter().data)
    for k in range(300):
        log = DataFlashWriter()
        log.define("AB", "QB", f"TimeUS,X{k}", number=200)
        log.add("AB", 1e6 + 1e4 * k, 1)
        data += bytes(log.data[89:])
    (tmp_path / "a.BIN").write_bytes(data)
    with pytest.raises(InputError, match="no message that can be used"):
        read(tmp_path / "a.BIN")


def test_marks_of_chunks_that_are_none_end_the_search(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + b"\x04\x00\x00\x00op=\x05\0" * 100_000)
    with within(6.0), pytest.raises(InputError, match="no message"):
        read(path)


def test_broken_chunks_are_named_a_few_and_counted_all(tmp_path: Path) -> None:
    def record(opcode: int, body: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(body)) + body

    broken = record(6, struct.pack("<QQQI", 0, 0, 99, 7) + b"\x04\0\0\0zstd" + struct.pack("<Q", 4) + b"abcd")
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + record(1, b"\0" * 8) + broken * 500)
    with pytest.raises(InputError, match="500 damaged messages") as found:
        read(path)
    assert str(found.value).count("left out:") <= 6


def test_rates_are_not_compared_over_a_pause_of_weeks() -> None:
    """A grid over it would take gigabytes."""
    t = np.concatenate([0.02 * np.arange(400), 2e6 + 0.02 * np.arange(400)])
    run = Recording.from_table(t, {"r": np.cos(t), "psi": np.sin(t)})
    assert rate_scales(run) == []
    assert rate_scales(Recording.from_table(t[:400], {"r": np.cos(t[:400]), "psi": np.sin(t[:400])}))


def test_names_that_cannot_be_printed_stand_as_escapes() -> None:
    assert str(InputError("a.csv: found \x1b[31mred\x07 and \u202eleft\nhere")) == (
        "a.csv: found \\x1b[31mred\\x07 and \\u202eleft here"
    )
    assert len(str(InputError("a.csv: " + "u" * 100_000 + " end"))) < 2000
    assert str(InputError("a.csv: " + "u" * 100_000 + " end")).endswith(" end")


@pytest.mark.parametrize("suffix", ["parquet", "db3", "mat"])
def test_damaged_files_are_refused_without_a_librarys_words(suffix: str, tmp_path: Path) -> None:
    heads = {"parquet": b"PAR1", "db3": b"SQLite format 3\0", "mat": b"\x89HDF\r\n\x1a\n"}
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(heads[suffix] + bytes(range(256)) * 40)
    with pytest.raises(InputError, match=r"not a readable .* expected") as found:
        read(path)
    assert "(" not in str(found.value).removeprefix(str(path))


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_a_live_session_of_a_row_or_two_is_inspected_or_refused(rows: int, tmp_path: Path) -> None:
    from towtank.app.cli import app
    from towtank.recording.mcap.format import Quantity
    from towtank.recording.mcap.log import McapLog

    with McapLog.open(tmp_path / "a.mcap") as log:
        log.source("all", [Quantity("u", "m/s", "FRD"), Quantity("X", "N", "FRD")])
        for k in range(rows):
            log.write("all", 0.02 * k, 1.0, 2.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=rf"a\.mcap: found {rows} samples of motion, expected at least 4"):
            app(["inspect", str(tmp_path / "a.mcap"), "--json"], standalone_mode=False)


def test_a_column_of_our_own_without_a_name_is_refused_with_its_place(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with McapLog.open(path) as log:
        log.source("dvl", [Quantity("u", "m/s", "FRD"), Quantity("")])
        for k in range(9):
            log.write("dvl", 0.1 * k, 0.1, 0.2)
    with pytest.raises(InputError) as raised:
        read(path)
    assert str(raised.value) == f"{path}: /dvl: found a channel without a name, expected one"
