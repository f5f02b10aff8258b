"""Bad input: exit code 2 and one line that says where, or a counted warning where the data is still usable."""

from __future__ import annotations

import signal as signals
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import towtank as tt

from .commands import command, document, refused

HEADER = "t,r,N"
T = np.arange(600) / 50.0
QUICK = ("--free", "N_rdot,N_rr", "--delay", 0, "--window", "0,10")


def rows(r: Callable[[float], object] = np.cos, t: np.ndarray = T) -> list[str]:
    """Lines of a log of yaw: time, rate, moment."""
    return [f"{x:.4f},{r(x)},{5.0 if int(x) % 2 else -5.0}" for x in t]


def write(folder: Path, lines: list[str], header: str = HEADER) -> Path:
    path = folder / "log.csv"
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


EVERYWHERE = pytest.mark.parametrize(
    "words", [["learn", "--vehicle", "seamor"], ["validate", "seamor"], ["inspect"]], ids=lambda words: words[0]
)


@EVERYWHERE
def test_missing_file(words: list[str], tmp_path: Path) -> None:
    log = tmp_path / "nothing.csv"
    assert refused(*words, log) == f"towtank: {log}: no such file"


@EVERYWHERE
def test_csv_without_time(words: list[str], tmp_path: Path) -> None:
    log = write(tmp_path, rows(), "time,r,N")
    line = refused(*words, log)
    assert str(log) in line
    assert '"t"' in line


@EVERYWHERE
def test_text_where_a_number_belongs(words: list[str], tmp_path: Path) -> None:
    lines = rows()
    lines[40] = "0.8000,fast,5.0"
    log = write(tmp_path, lines)
    line = refused(*words, log)
    assert f"{log}:42:2" in line
    assert '"fast"' in line


def test_unknown_vehicle_key(tmp_path: Path) -> None:
    vehicle = tmp_path / "v.toml"
    vehicle.write_text('name = "v"\n[rigid_body]\nmas = 3.0\ninertia = [1, 1, 1]\n')
    log = write(tmp_path, rows())
    line = refused("learn", log, "--vehicle", vehicle)
    assert str(vehicle) in line
    assert 'did you mean "mass"?' in line


@pytest.mark.parametrize("words", [["learn"], ["validate"], ["inspect"]], ids=lambda words: words[0])
def test_thrusters_that_the_vehicle_lacks(words: list[str], tmp_path: Path) -> None:
    log = write(tmp_path, [f"{x:.3f},{np.sin(x):.4f},1500,1500" for x in T], "time,gyro,a,b")
    mapping = tmp_path / "map.toml"
    mapping.write_text('thrusters = ["a", "b"]\n[columns]\nt = "time"\nr = "gyro"\n')
    vehicle = ["seamor", log] if words == ["validate"] else [log, "--vehicle", "seamor"]
    line = refused(*words, *vehicle, "--map", mapping)
    assert "found commands of 2 thrusters, the vehicle has 6" in line


def test_a_column_of_the_mapping_that_the_log_lacks(tmp_path: Path) -> None:
    log = write(tmp_path, rows())
    mapping = tmp_path / "map.toml"
    mapping.write_text('[columns]\nr = "gyro_z"\n')
    assert "gyro_z" in refused("inspect", log, "--map", mapping)


def test_a_channel_without_values_is_told(tmp_path: Path) -> None:
    log = write(tmp_path, [f"{line},nan" for line in rows()], f"{HEADER},q")
    found = document("learn", log, "--vehicle", "seamor", "--delay", 0)
    assert any('"q" holds no value' in text for text in found["warnings"])
    assert any('"q" holds no value' in note for note in document("inspect", log)["notes"])


@EVERYWHERE
def test_only_a_channel_without_values(words: list[str], tmp_path: Path) -> None:
    log = write(tmp_path, rows(lambda x: "nan"))
    assert str(log) in refused(*words, log)


@EVERYWHERE
def test_three_samples(words: list[str], tmp_path: Path) -> None:
    log = write(tmp_path, rows()[:3])
    assert "found 3 samples, expected at least 4" in refused(*words, log)


@EVERYWHERE
def test_time_that_restarts(words: list[str], tmp_path: Path) -> None:
    log = write(tmp_path, rows() + rows(lambda x: float(np.cos(x + 1.0))))
    assert str(log) in refused(*words, log)


def test_samples_out_of_order_are_counted(tmp_path: Path) -> None:
    lines = rows()
    lines[100:110] = lines[100:110][::-1]
    log = write(tmp_path, lines)
    assert document("inspect", log)["repairs"]["disorder"] > 0
    found = document("learn", log, "--vehicle", "seamor", "--delay", 0)
    assert any("out of order" in text for text in found["warnings"])


def test_infinities_are_counted(tmp_path: Path) -> None:
    log = write(tmp_path, rows(lambda x: "inf" if 3.0 <= x < 3.1 else np.cos(x)))
    assert document("inspect", log)["repairs"]["infinities"] == 5
    found = document("learn", log, "--vehicle", "seamor", "--delay", 0)
    assert any("5 infinite values" in text for text in found["warnings"])


def test_an_indefinite_mass_is_told(tmp_path: Path, workshop: Path) -> None:
    vehicle = tmp_path / "v.toml"
    tt.save_vehicle(tt.load_vehicle("vlbv300").with_coefficients({"X_udot": 60.0}), vehicle)
    words = ("learn", workshop / "yaw.csv", "--vehicle", vehicle, *QUICK)
    ran = command(*words)
    assert ran.code == 0
    assert "towtank: warning:" in ran.err
    assert "not positive definite" in ran.err
    found = document(*words)
    assert any("not positive definite" in text for text in found["warnings"])


def test_a_singular_mass_is_refused(tmp_path: Path, workshop: Path) -> None:
    vehicle = tmp_path / "v.toml"
    known = tt.load_vehicle("vlbv300")
    tt.save_vehicle(known.with_coefficients({"X_udot": known.rigid_body.mass}), vehicle)
    ran = command("simulate", vehicle, "yaw-sine", "-o", tmp_path / "log.csv")
    assert ran.code == 2
    assert "singular" in ran.err
    assert not (tmp_path / "log.csv").exists()


@pytest.mark.parametrize(
    "content, expected",
    [
        (b"", "empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(64), "log.csv"),
        (b"t,r\n1,2,3\n" * 9, "log.csv"),
        (b"\xa3\x95" + bytes(50), "DataFlash"),
    ],
    ids=["empty", "picture", "ragged", "dataflash"],
)
def test_what_is_no_log(content: bytes, expected: str, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_bytes(content)
    assert expected in refused("inspect", log)


def test_a_failing_command_leaves_the_old_file(tmp_path: Path, workshop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = tmp_path / "model.toml"
    model.write_text("old")

    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fails)
    ran = command("learn", workshop / "yaw.csv", "--vehicle", "vlbv300", *QUICK, "-o", model)
    assert ran.code == 1
    assert "No space left" in ran.err
    assert ran.err.count("\n") == 1
    assert model.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["model.toml"]


SLOW_DISK = """
import os, sys, time
def fsync(handle):
    print("writing", flush=True)
    time.sleep(60)
os.fsync = fsync
from towtank.app.cli import main
main()
"""


def _heed_interrupts() -> None:
    """Undo what a shell does to its background jobs."""
    signals.signal(signals.SIGINT, signals.default_int_handler)


@pytest.mark.parametrize("signal, code", [("SIGTERM", 143), ("SIGINT", 130)])
def test_an_interrupted_command_leaves_nothing(signal: str, code: int, tmp_path: Path) -> None:
    words = ["simulate", "seamor", "surge-sine", "-o", "log.csv", "--duration", "2"]
    run = subprocess.Popen(
        [sys.executable, "-c", SLOW_DISK, *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_heed_interrupts,
    )
    assert run.stdout is not None
    assert run.stdout.readline() == "writing\n"
    assert list(tmp_path.iterdir()) != []
    time.sleep(0.1)
    run.send_signal(getattr(signals, signal))
    _, err = run.communicate(timeout=30)
    assert run.returncode == code
    assert err == ""
    assert list(tmp_path.iterdir()) == []
