"""`towtank inspect --map-skeleton`: from a log with columns of its own to a mapping that is accepted."""

from __future__ import annotations

from pathlib import Path

import pytest

from .commands import command, document, refused


@pytest.fixture
def log(tmp_path: Path) -> Path:
    rows = [f"{0.1 * k},{1500 + 100 * (k // 20 % 2)},{0.1 * (k % 7)}" for k in range(200)]
    path = tmp_path / "dive.csv"
    path.write_text("seconds,pwm1,gyro_z\n" + "\n".join(rows) + "\n")
    return path


def test_the_mapping_is_printed_or_written_and_then_accepted(log: Path, tmp_path: Path) -> None:
    mapping = tmp_path / "map.toml"
    found = document("inspect", log, "--map-skeleton", "-o", mapping)
    assert found["mapping"] == mapping.read_text()
    assert found["suggested"] == {"t": "seconds", "r": "gyro_z"}
    assert found["thrusters"] == ["pwm1"]
    assert found["columns"] == ["seconds", "pwm1", "gyro_z"]
    assert command("inspect", log, "--map-skeleton").out.rstrip() == mapping.read_text().rstrip()
    channels = document("inspect", log, "--map", mapping)["channels"]
    assert {each["name"] for each in channels} == {"r", "cmd_1"}


def test_what_does_not_go_together_is_refused(log: Path, tmp_path: Path) -> None:
    assert "--map-skeleton and --vehicle" in refused("inspect", log, "--map-skeleton", "--vehicle", "seamor")
    assert "--map-skeleton and --keep-all" in refused("inspect", log, "--map-skeleton", "--keep-all")
    assert "--map-skeleton and --merge" in refused("inspect", log, "--map-skeleton", "--merge", log)
    within = refused("inspect", f"{log}@2,5", "--map-skeleton")
    assert "--map-skeleton and the window in dive.csv@2,5: found both" in within
    assert "leave the other out" in within
    assert "only --map-skeleton writes" in refused("inspect", log, "-o", tmp_path / "map.toml")
    assert "ends in .toml" in refused("inspect", log, "--map-skeleton", "-o", tmp_path / "map.txt")
    assert "no such file" in refused("inspect", tmp_path / "none.csv", "--map-skeleton")
