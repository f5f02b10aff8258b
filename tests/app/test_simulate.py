"""`towtank manoeuvre list` and `towtank simulate`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.simulation import MANOEUVRES, SENSORS

from .commands import command, document, refused


def test_manoeuvre_list() -> None:
    found = document("manoeuvre", "list")
    assert [entry["name"] for entry in found["manoeuvres"]] == list(MANOEUVRES)
    assert found["sensors"] == list(SENSORS)
    out = command("manoeuvre", "list").out
    assert "multisine" in out
    assert "tank-session" in out


def test_simulate_writes_what_the_library_simulates(tmp_path: Path) -> None:
    log = tmp_path / "log.parquet"
    found = document("simulate", "seamor", "surge-sine", "-o", log, "--duration", 3, "--rate", 50)
    assert found["samples"] == 151
    assert found["duration_s"] == pytest.approx(3.0)
    vehicle = tt.load_vehicle("seamor")
    from towtank.simulation import manoeuvre

    again = tt.simulate(vehicle, **manoeuvre("surge-sine", vehicle, duration=3.0, dt=0.02).inputs, substeps=2)
    np.testing.assert_array_equal(tt.read(log)["u"].values, again["u"].values)


def test_the_same_seed_gives_the_same_file(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    for path, seed in zip(files, (3, 3, 4), strict=True):
        words = ["--sensors", "mocap", "--disturbance", 1, "--seed", seed, "--duration", 5]
        assert command("simulate", "vlbv300", "all-multisine", "-o", path, *words).code == 0
    first, second, third = (path.read_bytes() for path in files)
    assert first == second
    assert first != third


def test_current_and_delay(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    words = ["--current", "0.2,0,0", "--delay", 0.5, "--duration", 4]
    found = document("simulate", "seamor", "surge-square", "-o", log, *words)
    assert found["delay_s"] == 0.5
    assert found["current"] == [0.2, 0.0, 0.0]
    assert tt.read(log)["x"].values[10] > 0.0


def test_waves(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    found = document("simulate", "seamor", "surge-square", "-o", log, "--waves", "0.05,6", "--duration", 40)
    assert found["waves"] == {"rms_m_s": 0.05, "period_s": 6.0, "begin_s": 0.0}
    assert np.std(tt.read(log)["w"].values) > 0.02  # nothing else moves it up and down
    found = document("simulate", "seamor", "surge-square", "-o", log, "--waves", "0.05,6,5", "--duration", 40)
    assert found["waves"]["begin_s"] == 5.0
    heave = tt.read(log)["w"]
    assert np.std(heave.values[heave.t < 5.0]) < 1e-3 < 0.02 < np.std(heave.values[heave.t > 5.0])


def test_a_file_as_manoeuvre(tmp_path: Path) -> None:
    orders = tmp_path / "orders.csv"
    orders.write_text("t,X\n0,10\n1,-10\n2,0\n3,0\n")
    log = tmp_path / "log.csv"
    found = document("simulate", "seamor", orders, "-o", log)
    assert found["manoeuvre"].endswith("orders.csv")
    assert found["duration_s"] == pytest.approx(4.0)
    assert {"u", "X"} <= set(found["channels"])


def test_a_mapped_file_as_manoeuvre(tmp_path: Path) -> None:
    orders, mapping = tmp_path / "orders.csv", tmp_path / "map.toml"
    orders.write_text("time,a,b,c,d,e,f\n" + "".join(f"{k},20,20,20,20,0,0\n" for k in range(5)))
    mapping.write_text('thrusters = ["a", "b", "c", "d", "e", "f"]\n[columns]\nt = "time"\n')
    found = document("simulate", "seamor", orders, "-o", tmp_path / "log.csv", "--map", mapping)
    assert "cmd_aft_port" in found["channels"]


def test_output_tells_the_next_command(tmp_path: Path) -> None:
    ran = command("simulate", "seamor", "surge-sine", "-o", tmp_path / "log.csv", "--duration", 2)
    assert "Next: towtank learn" in ran.out


@pytest.mark.parametrize(
    "words, expected",
    [
        (["seamo", "yaw-sine"], 'did you mean "seamor"?'),
        (["seamor", "yaw-sin"], 'did you mean "yaw-sine"?'),
        (["seamor", "nothing.csv"], "nothing.csv: no such file"),
        (["lauv", "yaw-sine"], "cannot command yaw"),
        (["seamor", "yaw-sine", "--duration", "-1"], "--duration: found -1"),
        (["seamor", "yaw-sine", "--duration", "nan"], "--duration: found nan"),
        (["seamor", "yaw-sine", "--duration", "1e9"], "expected at most"),
        (["seamor", "yaw-sine", "--rate", "0"], "--rate: found 0"),
        (["seamor", "yaw-sine", "--delay", "-1"], "--delay: found -1"),
        (["seamor", "yaw-sine", "--sensors", "mocapp"], 'did you mean "mocap"?'),
        (["seamor", "yaw-sine", "--seed", "-1"], "--seed: found -1"),
        (["seamor", "yaw-sine", "--current", "1,2"], "expected three numbers"),
        (["seamor", "yaw-sine", "--current", "1,b,2"], 'found "b"'),
        (["seamor", "yaw-sine", "--waves", "0.1"], '--waves: found "0.1", expected RMS,PERIOD'),
        (["seamor", "yaw-sine", "--waves", "0.1,6,-1"], "waves: begin: found -1"),
        (["seamor", "yaw-sine", "--waves", "0.1,0"], "waves: period: found 0 s"),
        (["seamor", "yaw-sine", "--disturbance", "-3"], "--disturbance: found -3"),
    ],
)
def test_wrong_input(words: list[str], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert expected in refused("simulate", *words, "-o", "log.csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name, expected", [("log.txt", ".csv or .parquet"), ("no/log.csv", "does not exist")])
def test_wrong_output(name: str, expected: str, tmp_path: Path) -> None:
    assert expected in refused("simulate", "seamor", "yaw-sine", "-o", tmp_path / name)
