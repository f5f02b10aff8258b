"""`towtank inspect`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import towtank as tt
from towtank.identification.kalman.problem import JointFit
from towtank.identification.offline import joint
from towtank.identification.offline.free_runs import FreeRunVerdict

from .commands import command, document


@pytest.fixture(scope="module")
def delayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All axes of the vlbv300 under motion capture, 80 ms late, with thrusters that take 50 ms."""
    path = tmp_path_factory.mktemp("inspect") / "tank.csv"
    truth = tt.load_vehicle("vlbv300")
    lagged = tuple(each.model_copy(update={"time_constant": 0.05}) for each in truth.thrusters)
    tt.save_vehicle(truth.model_copy(update={"thrusters": lagged}), path.with_name("truth.toml"))
    told = ("simulate", path.with_name("truth.toml"), "tank-session", "-o", path)
    ran = command(*told, "--duration", 90, "--sensors", "mocap", "--delay", 0.08, "--seed", 5)
    assert ran.code == 0, ran
    return path


@pytest.fixture(scope="module")
def of_delayed(delayed: Path) -> dict[str, Any]:
    """What is said of it where the vehicle is known."""
    return document("inspect", delayed, "--vehicle", "vlbv300")


def test_channels(workshop: Path) -> None:
    found = document("inspect", workshop / "yaw.csv")
    channels = {entry["name"]: entry for entry in found["channels"]}
    assert channels["r"]["unit"] == "rad/s"
    assert channels["r"]["frame"] == "FRD"
    assert channels["r"]["rate_hz"] == pytest.approx(50.0)
    assert channels["r"]["missing"] == 0
    assert channels["cmd_aft_port"]["changes"] > 3
    assert found["duration_s"] == pytest.approx(30.0)
    assert found["repairs"]["lines"] == []


def test_velocity_through_the_water_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "adcp.csv"
    ran = command("simulate", "vlbv300", "yaw-stairs", "-o", path, "--sensors", "ins-water", "--current", "0.2,0,0")
    assert ran.code == 0, ran
    channels = {entry["name"]: entry for entry in document("inspect", path)["channels"]}
    assert [channels[name]["unit"] for name in ("u_w", "v_w", "w_w")] == ["m/s"] * 3
    assert channels["u_w"]["rate_hz"] == pytest.approx(5.0)


def test_delay_and_axes_without_a_vehicle(delayed: Path) -> None:
    found = document("inspect", delayed)
    assert found["delay_from"] == "correlation"
    assert found["delay_s"] == pytest.approx(0.08 + 0.05, abs=0.03)  # the lag among it
    assert all(verdict["identifiable"] for verdict in found["axes"].values())
    assert found["axes"]["surge"]["source"] == "derived"
    assert found["axes"]["yaw"]["explained"] > 0.8


def test_delay_and_axes_with_the_vehicle(of_delayed: dict[str, Any]) -> None:
    found = of_delayed
    assert found["delay_from"] == "vehicle"
    assert found["delay_s"] == pytest.approx(0.08, abs=0.01)
    assert found["axes"]["yaw"]["identifiable"] is True
    assert found["axes"]["yaw"]["coefficients"]["N_rdot"] is None
    assert 0.0 < found["delay_std_s"] < 0.01
    assert found["delay_and_lag_s"]["value"] == pytest.approx(0.08 + 0.05, abs=0.01)
    assert 0.0 < found["delay_and_lag_s"]["std"] < 0.01


def test_noise_of_every_channel(delayed: Path, workshop: Path) -> None:
    noise = document("inspect", delayed)["noise"]
    assert noise["x"]["std"] == pytest.approx(1e-3, rel=0.1)
    assert noise["x"]["white"] is True
    noise = document("inspect", workshop / "yaw.csv")["noise"]
    assert noise["r"]["std"] == pytest.approx(2e-3, rel=0.1)
    assert noise["az"]["std"] == pytest.approx(0.02, rel=0.1)
    assert "x" not in noise


def test_how_well_each_coefficient_will_be_known(delayed: Path, of_delayed: dict[str, Any]) -> None:
    found = of_delayed
    known = found["excitation"]["coefficients"]
    assert 0.01 < known["X_udot"]["percent"] < 4.0
    assert "surge drag will be known to " in known["X_uu"]["text"]
    assert found["axes"]["surge"]["prospects"]["X_uu"] == known["X_uu"]
    assert found["excitation"]["whole"] is False
    assert len(found["excitation"]["windows"]) > 1
    out = " ".join(command("inspect", delayed, "--vehicle", "vlbv300", "--window", "0,30").out.split())
    assert "surge mass will be known to" in out
    assert "surge drag to" in out
    assert "Disturbance" in out


def test_free_runs_have_their_say_as_where_it_is_learned(delayed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They may know less than the filter says alone: what is promised is what `learn` then states."""
    asked = list[bool]()

    def verdict(problem: Any, by_filter: JointFit, *others: Any, always: bool) -> FreeRunVerdict:
        asked.append(always)
        return FreeRunVerdict(True, replace(by_filter, covariance=4.0 * by_filter.covariance), "free runs speak")

    monkeypatch.setattr(joint, "free_run_verdict", verdict)
    log, vehicle = tt.read(delayed).window(20.0, 35.0), tt.load_vehicle("vlbv300")
    inspected, learned = tt.inspect(log, vehicle), tt.learn(log, vehicle)
    assert asked == [False, False]
    promised = {name: each.std for axis in inspected.axes.values() for name, each in axis.prospects.items()}
    assert promised
    for name, std in promised.items():
        assert std == pytest.approx(learned.estimate[name].std, rel=1e-6)


def test_level_of_the_disturbance(workshop: Path) -> None:
    found = document("inspect", workshop / "surge.csv", "--vehicle", "vlbv300")["disturbance"]
    assert found["X"]["std"] == pytest.approx(0.3, rel=0.5)
    assert found["X"]["unit"] == "N"
    without = document("inspect", workshop / "surge.csv")
    assert without["disturbance"] == {}
    assert without["excitation"] == {}


def test_a_quick_look_gives_the_delay_a_deviation(delayed: Path) -> None:
    found = document("inspect", delayed)
    assert 0.0 < found["delay_std_s"] < 0.01


def test_velocity_in_the_world(tmp_path: Path, workshop: Path) -> None:
    run = tt.read(workshop / "yaw.csv")
    t, psi = run["psi"].t, run["psi"].values
    world = {"vn": 0.1 * np.cos(psi), "ve": 0.1 * np.sin(psi), "vd": 0.0 * t}
    log = tmp_path / "gps.csv"
    run.without("u", "v", "w").replace(tt.Recording.from_table(t, world).channels).write(log)
    found = document("inspect", log)
    channels = {entry["name"]: entry for entry in found["channels"]}
    assert channels["u"]["frame"] == "FRD"
    assert channels["u"]["max"] == pytest.approx(0.1, abs=0.01)
    assert any("turned into the body" in note for note in found["notes"])
    assert found["axes"]["surge"]["source"] == "measured"


def test_an_axis_that_was_not_moved(workshop: Path) -> None:
    axes = document("inspect", workshop / "yaw.csv", "--vehicle", "vlbv300")["axes"]
    assert axes["yaw"]["identifiable"] is True
    reasons = [reason for reason in axes["surge"]["coefficients"].values() if reason]
    assert reasons
    assert all("would narrow it" in reason for reason in reasons)
    axes = document("inspect", workshop / "yaw.csv")["axes"]
    assert axes["yaw"]["identifiable"] is True
    assert axes["heave"]["identifiable"] is False


def test_a_speed_that_was_not_measured(tmp_path: Path, workshop: Path) -> None:
    run = tt.read(workshop / "yaw.csv")
    log = tmp_path / "gyro.csv"
    run.without("x", "y", "z", "phi", "theta", "psi", "u", "v", "w").write(log)
    axes = document("inspect", log)["axes"]
    assert axes["surge"]["source"] == "absent"
    assert "not measured" in axes["surge"]["reason"]
    assert axes["yaw"]["source"] == "measured"


def test_depth_heading_and_acceleration_are_motion(tmp_path: Path) -> None:
    whole = tmp_path / "all.csv"
    command("simulate", "bluerov2_heavy", "all-multisine", "-o", whole, "--duration", 40, "--sensors", "ins")
    run = tt.read(whole)
    log = tmp_path / "depth-and-compass.csv"
    run.without("u", "v", "w", "phi", "theta", "ax", "ay", "az").write(log)
    axes = document("inspect", log)["axes"]
    assert axes["heave"]["source"] == "derived"
    assert axes["heave"]["identifiable"] is True
    assert axes["heave"]["known_by"] == [{"channel": "z", "by": "depth", "rate_hz": pytest.approx(10.0)}]
    assert [each["by"] for each in axes["yaw"]["known_by"]] == ["rate", "heading"]
    assert "depth, 10 Hz" in command("inspect", log).out


def test_a_log_without_inputs(tmp_path: Path) -> None:
    log = tmp_path / "drift.csv"
    t = np.arange(200) / 50.0
    tt.Recording.from_table(t, {"r": np.sin(t)}).write(log)
    for words in ([], ["--vehicle", "seamor"]):
        found = document("inspect", log, *words)
        assert found["delay_s"] is None
        assert not any(verdict["identifiable"] for verdict in found["axes"].values())
        assert "no inputs" in found["axes"]["yaw"]["reason"]


def test_holes_and_a_troubled_clock(tmp_path: Path) -> None:
    t = np.arange(400) / 50.0
    rows = [f"{x:.3f},{np.sin(x):.6f},5" for x in t if not 3.0 < x < 4.0]
    rows[10], rows[11] = rows[11], rows[10]
    rows.append(rows[-1])
    log = tmp_path / "log.csv"
    log.write_text("t,r,N\n" + "\n".join(rows) + "\n")
    found = document("inspect", log)
    channel = found["channels"][0]
    assert channel["gaps"] == 1
    assert channel["missing"] == 49
    assert channel["longest_gap_s"] == pytest.approx(1.0)
    assert found["repairs"]["disorder"] >= 1
    assert found["repairs"]["duplicates"] == 1
    out = command("inspect", log).out
    assert "out of order" in out
    assert "gap" in out


def test_window(workshop: Path) -> None:
    assert document("inspect", workshop / "yaw.csv", "--window", "5,")["start_s"] == pytest.approx(5.0)


def test_output_is_readable(workshop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for words in ([], ["--vehicle", "vlbv300"]):
        ran = command("inspect", workshop / "yaw.csv", "--window", "0,12", *words)
        assert ran.code == 0
        assert "What can be identified" in ran.out
        assert max(map(len, ran.out.splitlines()[1:])) <= 80
