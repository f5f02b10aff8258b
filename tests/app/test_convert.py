"""`towtank convert`, and what `inspect` says of a log of messages."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import towtank as tt

from .commands import command, document, refused

sys.path.append(str(Path(__file__).resolve().parents[1] / "readers"))

from encoders import dive_bin

SIX = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 7)}
HELD = 0b10100111  # the filter says that nothing aids it


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("dive") / "dive.BIN"
    path.write_bytes(dive_bin(20.0, parameters=SIX, dvl=False, flags=HELD).data[:-5])
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mcap"])
def test_every_way_there_and_back(dive: Path, tmp_path: Path, suffix: str) -> None:
    found = document("convert", dive, tmp_path / f"a{suffix}")
    source, there = tt.read(dive), tt.read(tmp_path / f"a{suffix}")
    assert found["channels"] == {name: len(channel) for name, channel in source.channels.items()}
    assert list(there) == list(source)
    for name, channel in source.channels.items():
        np.testing.assert_array_equal(there[name].t, channel.t)
        np.testing.assert_array_equal(there[name].values, channel.values)
    if suffix != ".csv":
        assert there == source
        assert there.contents == source.contents
    for other in (".csv", ".parquet", ".mcap"):
        assert command("convert", tmp_path / f"a{suffix}", tmp_path / f"b{other}").code == 0
        assert tt.read(tmp_path / f"b{other}")["p"] == source["p"]


def test_with_a_mapping(dive: Path, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text('[columns]\np = "IMU[1].GyrX"\n')
    ran = command("convert", dive, tmp_path / "a.csv", "--map", tmp_path / "map.toml")
    assert ran.code == 0, ran
    assert tt.read(tmp_path / "a.csv").names == ("p",)
    assert "1 channel, " in ran.out
    assert "damaged message" in ran.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("{dive}", "a.xyz"), r'OUT: found "a.xyz", expected a name that ends in .csv or .parquet or .mcap'),
        (("{dive}", "none/a.csv"), "the folder none does not exist"),
        (("none.BIN", "a.csv"), "none.BIN: no such file"),
        (("own.csv", "own.csv"), "this is the log itself"),
        (("{dive}", "a.csv", "--map", "none.toml"), "none.toml: no such mapping file"),
    ],
)
def test_refused(
    dive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.csv").write_text("t,u\n0,1\n1,2\n2,3\n3,4\n")
    assert message in refused("convert", *(word.format(dive=dive) for word in words))
    assert (tmp_path / "own.csv").read_text().startswith("t,u\n0,1")
    assert not list(tmp_path.glob("a.*"))


def test_a_log_that_cannot_be_read_leaves_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "bad.BIN").write_bytes(b"\xa3\x95\x80 nothing")
    (tmp_path / "old.csv").write_text("old")
    refused("convert", tmp_path / "bad.BIN", tmp_path / "old.csv")
    assert (tmp_path / "old.csv").read_text() == "old"


def test_inspect_tells_what_the_log_holds(dive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = document("inspect", dive)
    contents = {content["name"]: content for content in found["contents"]}
    assert contents["IMU[0]"]["used"] == ["p", "q", "r", "ax", "ay", "az"]
    assert contents["IMU[0]"]["count"] == 1000
    assert contents["IMU[0]"]["rate"] == pytest.approx(50.0)
    assert "dead reckoning" in contents["XKF1[0]"]["reason"]
    assert found["attributes"]["since_boot_s"] == "100.000000"
    monkeypatch.setenv("COLUMNS", "80")
    out = command("inspect", dive).out
    assert "What the log holds" in out
    assert max(map(len, out.splitlines())) <= 80
    text = " ".join(out.split())
    assert "dead reckoning" in text
    assert "1 damaged message (left out)" in text
    assert found["axes"]["surge"]["source"] == "absent"  # the filter's velocity was not taken
    assert [each["by"] for each in found["axes"]["heave"]["known_by"]] == ["depth", "acceleration"]
    assert "acceleration, 50 Hz" in text


def test_a_table_has_no_contents(workshop: Path) -> None:
    assert document("inspect", workshop / "yaw.csv")["contents"] == []
    assert "What the log holds" not in command("inspect", workshop / "yaw.csv").out


def test_learning_from_a_log_of_messages(dive: Path) -> None:
    """Thrusters that the vehicle lacks are named, so a .BIN goes the whole way to learning."""
    text = refused("learn", dive, "--vehicle", "bluerov2_heavy")
    assert "dive.BIN: found commands of 6 thrusters, the vehicle has 8" in text
