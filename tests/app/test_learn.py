"""`towtank learn` and `towtank validate` on simulated logs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import towtank as tt
from towtank.vehicle import Coefficient, load_vehicle, save_vehicle

from .commands import command, document, refused

CONTRACT = {
    "verdict",
    "findings",
    "vehicle",
    "logs",
    "method",
    "duration_s",
    "samples",
    "delay_s",
    "coefficients",
    "fit",
    "warnings",
}
CHANNELS = {"u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi"}


@pytest.fixture(scope="module")
def learned(learned_document: dict) -> dict:
    return learned_document


@pytest.fixture(scope="module")
def table(workshop: Path) -> str:
    """What `learn` prints of the first twelve seconds, 80 characters wide."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "80")
        ran = command("learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--window", "0,12")
    assert ran.code == 0, ran
    return ran.out


def test_document_is_the_contract(learned: dict, workshop: Path) -> None:
    assert learned.keys() >= CONTRACT
    assert learned["vehicle"] == "vlbv300"
    assert learned["logs"] == [str(workshop / "yaw.csv")]
    assert learned["method"] in ("joint", "output-error")
    assert learned["remarks"]
    assert learned["duration_s"] == pytest.approx(30.0, abs=0.1)
    assert learned["fit"].keys() >= {"u", "v", "w", "p", "q", "r"}
    for entry in learned["coefficients"].values():
        assert entry.keys() == {"value", "std", "interval", "unit", "identified", "reason", "prior", "narrowed"}
        assert entry["identified"] is (entry["reason"] is None)
        assert entry["identified"] is (entry["narrowed"] <= 0.5)
        assert entry["prior"]["std"] > 0.0
        low, high = entry["interval"]
        assert high - low == pytest.approx(3.92 * entry["std"], rel=1e-3)
        assert (low + high) / 2.0 == pytest.approx(entry["value"])


def test_what_was_supposed_is_told_beside_what_is_left_of_it(learned: dict) -> None:
    supposed = document("vehicle", "prior", "vlbv300")["unknowns"]
    for name, entry in learned["coefficients"].items():
        assert entry["prior"] == pytest.approx({key: supposed[name][key] for key in ("value", "std")}), name
    plain = learned["coefficients"]["N_rr"]  # a number whose unit is that of its coordinate
    assert plain["narrowed"] == pytest.approx(plain["std"] / plain["prior"]["std"])
    assert learned["latency_s"].keys() <= {"position", "attitude", "velocity", "rates", "velocity_through_the_water"}
    assert "velocity" in learned["latency_s"]
    assert {"imu_x", "dvl_y", "marker_z"} <= learned["places_m"].keys()
    assert all(each["std"] > 0.0 for each in learned["latency_s"].values())
    assert learned["waves"] is None


def test_the_table_has_the_prior_and_how_late_sensors_are(
    table: str, workshop: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert re.search(r"^Name +Value +± std +95 % interval +Prior +Unit", table, re.MULTILINE)
    assert re.search(r"^N_rr .* -0\.35 ± 0\.1\d ", table, re.MULTILINE)
    assert re.search(r"^velocity arrives [\d.]+ ± [\d.]+ ms (late|early)$", table, re.MULTILINE)
    assert max(map(len, table.splitlines())) <= 80
    monkeypatch.setenv("COLUMNS", "80")
    words = ["learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--window", "0,6", "--method", "paper"]
    assert re.search(r" Before +Unit", command(*words).out)


def test_what_was_moved_is_learned(learned: dict) -> None:
    truth = load_vehicle("vlbv300")
    for name in ("N_rdot", "N_rr"):
        found = learned["coefficients"][name]
        assert found["identified"]
        assert abs(found["value"] - truth.coefficient(name)) < 3.0 * found["std"]
    assert learned["delay_s"] == pytest.approx(0.0, abs=0.005)
    assert learned["fit"]["r"] > 97.0
    assert learned["coefficients"]["K_pp"]["identified"] is False
    total = learned["sums"]["I_z - N_rdot"]
    assert total["std"] < 0.05 * total["value"]  # all that is known of the scale of force
    assert abs(total["value"] - 0.9 - 0.9061) < 3.0 * total["std"]


def test_table_names_what_was_learned_and_why_the_rest_was_not(table: str) -> None:
    assert "N_rdot" in table
    assert "Not identified" in table
    assert "would narrow it" in table.replace("\n", " ")
    assert "Next:" in table
    assert "Repairs(" not in table


def test_levels_of_noise_and_disturbance_are_told(learned: dict) -> None:
    assert learned["noise"]["r"] == {"std": pytest.approx(0.002, rel=0.1), "unit": "rad/s"}
    assert "x" not in learned["noise"]
    assert set(learned["disturbance"]) == set("XYZKMN")
    assert 0.1 < learned["disturbance"]["X"]["std"] < 1.0
    assert learned["disturbance"]["N"]["unit"] == "N m"


@pytest.mark.parametrize("method", ["joint", "output-error", "paper"])
def test_every_method_says_what_it_used(method: str, workshop: Path) -> None:
    words = ["learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--method", method, "--window", "0,15"]
    found = document(*words, "--free", "N_rdot,N_rr", "--delay", 0)
    assert found["method"] in (("joint", "output-error") if method == "joint" else (method,))
    assert found["coefficients"]["N_rdot"]["value"] == pytest.approx(-0.9061, rel=0.05)
    ran = command(*words, "--free", "N_rdot,N_rr", "--delay", 0)
    assert ran.code == 0
    assert "95 % interval" in ran.out
    assert "How it was learned" in ran.out
    assert ("disturbance" in ran.out) is (method != "paper")


QUICK = ("--free", "N_rdot,N_rr", "--delay", 0, "--window", "0,10")
TWO = ("--vehicle", "vlbv300", "--free", "N_rdot, N_rr", "--delay", 0, "--window", "0,15")


@pytest.fixture(scope="module")
def two(workshop: Path) -> dict:
    """What `learn` says of half of `yaw.csv` where two coefficients are free."""
    return document("learn", workshop / "yaw.csv", *TWO)


def test_a_prior_enters_as_information(two: dict, tmp_path: Path, workshop: Path) -> None:
    prior = tmp_path / "prior.toml"
    known = load_vehicle("vlbv300").with_coefficients({"N_rr": Coefficient(value=-0.353, std=1e-4)})
    save_vehicle(known, prior)
    model = tmp_path / "model.toml"
    held = document("learn", workshop / "yaw.csv", *TWO, "--prior", prior, "-o", model)
    assert held["coefficients"]["N_rr"]["value"] == pytest.approx(-0.353, abs=5e-4)
    assert held["coefficients"]["N_rr"]["std"] < 0.5 * two["coefficients"]["N_rr"]["std"]
    assert held["prior"] == str(prior)
    assert any("prior prior.toml" in note for note in load_vehicle(model).provenance.notes)


ONLY = """
name = "lines"
[rigid_body]
mass = 18.0
inertia = [0.6, 0.7, 0.9]
[prior]
"""


def test_a_prior_of_single_lines_is_enough(tmp_path: Path, workshop: Path) -> None:
    prior = tmp_path / "prior.toml"
    prior.write_text(f"{ONLY}N_rr = {{ value = -0.5, std = 1e-4 }}\nlag = {{ value = 0.03, std = 1e-5 }}\n")
    found = document("learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--prior", prior, "--window", "0,12")
    held = found["coefficients"]["N_rr"]
    assert held["value"] == pytest.approx(-0.5, abs=5e-4)
    assert held["prior"] == pytest.approx({"value": -0.5, "std": 1e-4})
    assert not held["identified"]  # nothing that the log says is beyond what was stated
    assert found["lag_s"] == pytest.approx(0.03, abs=5e-4)
    assert found["coefficients"]["N_r"]["prior"]["value"] == 0.0
    prior.write_text(f"{ONLY}latency_velocty = {{ value = 0.1, std = 0.01 }}\n")
    assert 'did you mean "latency_velocity"?' in refused(
        "learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--prior", prior
    )


def test_a_learned_file_is_what_the_next_log_begins_with(workshop: Path) -> None:
    learned = load_vehicle(str(workshop / "learned.toml"))
    words = ["learn", workshop / "surge.csv", "--delay", 0, "--window", "0,12", "--free", "N_rr,X_uu,N_v"]
    beside = document(*words, "--vehicle", "vlbv300", "--prior", workshop / "learned.toml")
    onward = document(*words, "--vehicle", workshop / "learned.toml")
    assert learned.posterior is not None
    for name in ("N_rr", "X_uu", "N_v"):
        k = learned.posterior.names.index(name)
        expected = {"value": learned.posterior.mean[k], "std": learned.posterior.std[k]}
        for found in (beside, onward):
            entry = found["coefficients"][name]
            assert entry["prior"] == pytest.approx(expected)
            assert entry["narrowed"] == pytest.approx(entry["std"] / learned.posterior.prior_std[k])


def test_the_scale_of_thrust_is_within_every_deviation(tmp_path: Path, workshop: Path) -> None:
    vehicle = tmp_path / "v.toml"
    save_vehicle(load_vehicle("vlbv300").model_copy(update={"scale_std": 0.1}), vehicle)
    words = ["learn", workshop / "yaw.csv", *QUICK, "--method", "paper"]
    plain, unsure = document(*words, "--vehicle", "vlbv300"), document(*words, "--vehicle", vehicle)
    one, two = (found["coefficients"]["N_rr"] for found in (plain, unsure))
    assert two["value"] == pytest.approx(one["value"])
    assert two["std"] ** 2 == pytest.approx(one["std"] ** 2 + (0.1 * one["value"]) ** 2, rel=1e-6)
    assert unsure["sums"]["I_z - N_rdot"]["std"] > 0.099 * unsure["sums"]["I_z - N_rdot"]["value"]
    assert "scale of thrust known to 10 %" in command(*words, "--vehicle", vehicle).out


def test_a_scale_that_nothing_fixes_is_told(tmp_path: Path, workshop: Path) -> None:
    vehicle = tmp_path / "v.toml"
    curve = {"kind": "quadratic", "forward": 1.0}
    known = load_vehicle("vlbv300")
    thrusters = tuple({**thruster.model_dump(), "curve": curve} for thruster in known.thrusters)
    save_vehicle(known.model_copy(update={"thrusters": thrusters}), vehicle)
    words = ["learn", workshop / "yaw.csv", *QUICK, "--method", "paper"]
    warned = document(*words, "--vehicle", vehicle)["warnings"]
    assert any("only ratios of the coefficients are known" in text for text in warned)


def test_only_what_is_free_is_learned(two: dict) -> None:
    assert set(two["coefficients"]) == {"N_rdot", "N_rr"}
    assert two["delay_s"] == 0.0
    assert two["delay_std_s"] is None


def test_window_and_several_logs(workshop: Path) -> None:
    logs = [workshop / "yaw.csv", workshop / "surge.csv"]
    words = ("--free", "X_udot,X_uu,N_rdot,N_rr", "--delay", 0)
    found = document("learn", *logs, "--vehicle", "vlbv300", "--window", "5,15", *words)
    assert found["duration_s"] == pytest.approx(20.0, abs=0.2)
    assert found["coefficients"]["X_uu"]["identified"]
    assert found["coefficients"]["N_rr"]["identified"]


def test_model_file_is_a_vehicle_with_provenance(workshop: Path) -> None:
    model = load_vehicle(str(workshop / "learned.toml"))
    off = model.coefficient("N_rr") - load_vehicle("vlbv300").coefficient("N_rr")
    assert abs(off) < 3.0 * (model.deviation("N_rr") or 0.0)
    assert any("learned from yaw.csv" in note for note in model.provenance.notes)
    assert str(workshop) not in (workshop / "learned.toml").read_text()


def test_validate(workshop: Path) -> None:
    found = document("validate", workshop / "learned.toml", workshop / "yaw.csv")
    assert found.keys() >= {"model", "logs", "fit", "rmse", "window"}
    assert found["fit"].keys() == CHANNELS
    assert found["rmse"].keys() == CHANNELS
    assert found["fit"]["r"] > 95.0
    assert found["window"] == pytest.approx([0.0, 30.0], abs=0.02)
    ran = command("validate", workshop / "learned.toml", workshop / "yaw.csv", "--horizon", 5, "--window", "0,12")
    assert ran.code == 0
    assert "RMS error" in ran.out


def test_validate_in_windows(workshop: Path) -> None:
    words = ["validate", "vlbv300", workshop / "yaw.csv", workshop / "surge.csv"]
    assert document(*words, "--window", "10,16")["window"] == pytest.approx([10.0, 16.0], abs=0.02)
    assert document(*words, "--window", "-6,")["window"] == pytest.approx([24.0, 30.0], abs=0.02)


@pytest.mark.parametrize(
    "words, expected",
    [
        (["--method", "papers"], 'did you mean "paper"?'),
        (["--method", "paper", "--prior", "seamor"], "the method paper takes none"),
        (["--prior", "seamor"], "--prior seamor: no coefficient bears a std"),
        (["--prior", "nothing.toml"], "nothing.toml: no such file"),
        (["--report", "r.txt"], "expected a name that ends in .html or .pdf"),
        (["--free", "X_zz"], "X_zz"),
        (["--free", ","], "expected names of coefficients"),
        (["--window", "5"], "expected START,END"),
        (["--window", "500,600"], "no sample in it"),
        (["--delay", "-1"], "--delay: found -1"),
        (["-o", "model.txt"], ".toml"),
        (["--map", "nothing.toml"], "nothing.toml"),
        (["--vehicle", "seamo"], 'did you mean "seamor"?'),
    ],
)
def test_wrong_options(words: list[str], expected: str, workshop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.identification.logs.wiring_of", lambda problem: pytest.fail("it was looked at"))
    start = [] if "--vehicle" in words else ["--vehicle", "vlbv300"]
    assert expected in refused("learn", workshop / "yaw.csv", *start, *words)


def test_validate_refuses_a_horizon_of_nothing(workshop: Path) -> None:
    assert "--horizon: found 0" in refused("validate", "vlbv300", workshop / "yaw.csv", "--horizon", 0)


@pytest.fixture(scope="module")
def contradictory(workshop: Path) -> Path:
    """Twenty seconds of the yaw run with a yaw rate of the wrong sign and a heading that is right."""
    run = tt.read(workshop / "yaw.csv").window(0.0, 20.0)
    r = run["r"]
    run.replace([r.with_values(-r.values)]).write(workshop / "contradictory.csv")
    return workshop / "contradictory.csv"


def test_what_cannot_be_right_comes_first(contradictory: Path) -> None:
    words = ["learn", contradictory, "--vehicle", "vlbv300", "--method", "paper", "--free", "N_rdot,N_rr"]
    found = document(*words, "--delay", 0)
    assert found["verdict"].startswith(
        "Not usable as it is. Something cannot be right: thrusters 1 (aft_port), 2 (aft_stbd), 3 (fwd_port) and 4 "
        "(fwd_stbd) push the other"
    )
    assert [each["what"] for each in found["findings"]] == ["thrusters", "r"]
    assert "r is -1 times what the attitude does" in found["findings"][1]["text"]
    assert all(each.keys() == {"what", "text"} for each in found["findings"])
    assert not any(each["text"] in found["warnings"] for each in found["findings"])
    ran = command(*words, "--delay", 0, "--report", contradictory.with_suffix(".html"))
    out = " ".join(ran.out.split())
    assert out.startswith(" ".join(found["verdict"].split()))
    assert out.index("What cannot be right") < out.index("± std")
    html = contradictory.with_suffix(".html").read_text()
    assert "Something cannot be right" in html
    assert html.index('<section id="findings">') < html.index('<section id="coefficients">')


def test_where_nothing_was_learned_no_model_is_written(workshop: Path, tmp_path: Path) -> None:
    run = tt.read(workshop / "yaw.csv").window(0.0, 0.5)
    run.write(tmp_path / "short.csv")
    words = ["learn", tmp_path / "short.csv", "--vehicle", "vlbv300", "--free", "K_pdot", "-o", tmp_path / "m.toml"]
    ran = command(*words, "--json")
    assert ran.code == 1
    assert json.loads(ran.out)["verdict"].startswith("Not usable")
    assert "m.toml is not written: nothing was learned (--allow-empty" in ran.err
    assert not (tmp_path / "m.toml").exists()
    assert command(*words, "--allow-empty").code == 0
    assert tt.load_vehicle(tmp_path / "m.toml").name == "vlbv300"


def test_the_verdict_begins_with_what_the_model_can_be_used_for(learned: dict) -> None:
    assert learned["verdict"].startswith("Usable for prediction")
    assert learned["usable"]["axes"]["yaw"]["usable"]
    assert learned["usable"]["grade"] == "good"


def test_the_verdict_of_a_sound_log_says_which_axes_are_known(workshop: Path) -> None:
    words = ["learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--method", "paper", "--free", "N_rdot,N_rr"]
    found = document(*words, "--delay", 0)
    assert found["findings"] == []
    told = "Usable for prediction over whole runs (yaw), judged on the logs that it was learned from. Yaw: inertia to "
    assert found["verdict"].startswith(told)
    assert "Next" not in found["verdict"]  # nothing but yaw was asked for
    assert "surge, sway, heave, roll and pitch were not driven" in found["verdict"]
    assert "cannot be right" not in command(*words, "--delay", 0, "--window", "0,12").out


def test_inspect_says_it_before_learning(contradictory: Path, workshop: Path) -> None:
    found = document("inspect", contradictory)["findings"]
    assert [each["what"] for each in found] == ["r"]
    found = document("inspect", contradictory, "--vehicle", "vlbv300")["findings"]
    assert [each["what"] for each in found] == ["thrusters", "r"]
    out = command("inspect", contradictory).out
    assert out.index("What cannot be right") < out.index("Channel")
    assert "cannot be right" not in command("inspect", workshop / "yaw.csv").out
