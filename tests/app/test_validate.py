"""`towtank validate`: what the errors are, which model is better, and how a model generalises."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import towtank as tt

from .commands import command, document, refused

CHANNELS = {"u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi"}
KINDS = {"white", "nearly white", "disturbed", "drifting", "follows the command", "none", "diverged", "unknown"}


@pytest.fixture(scope="module")
def wrong(workshop: Path) -> Path:
    """A model with twice the drag in surge."""
    path = workshop / "wrong.toml"
    right = tt.load_vehicle("vlbv300")
    tt.save_vehicle(right.with_coefficients({"X_uu": 2.0 * right.coefficient("X_uu")}), path)
    return path


def narrow(*words: object, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", "80")
    ran = command(*words)
    assert ran.code == 0, ran
    assert max(map(len, ran.out.splitlines())) <= 80
    assert "…" not in ran.out
    return ran.out


def test_errors_in_the_document(workshop: Path) -> None:
    found = document("validate", "vlbv300", workshop / "surge.csv")
    assert found.keys() >= {"model", "logs", "fit", "rmse", "window", "residuals"}
    assert "comparison" not in found
    measured = {name for name, fit in found["fit"].items() if fit is not None}
    assert set(found["residuals"]) == measured
    for one in found["residuals"].values():
        assert one["verdict"] in KINDS
        assert one["text"]
        for part in ("free_running", "one_step"):
            assert len(one[part]["lag_s"]) == len(one[part]["autocorrelation"]) == len(one[part]["band_95"])
    surge = found["residuals"]["u"]
    assert 0.0 <= surge["free_running"]["ljung_box"]["p"] <= 1.0
    assert 0.0 <= surge["command"]["p"] <= 1.0
    assert len(surge["command"]["lag_s"]) == len(surge["command"]["correlation"])
    assert found["residuals"]["r"]["command"] is None


def test_scripts_can_require_a_fit(workshop: Path, wrong: Path) -> None:
    truth = ("validate", workshop / "truth.toml", workshop / "surge.csv", "--json")
    good = command(*truth, "--require", 60)
    assert good.code == 0
    told = json.loads(good.out)
    assert (told["required"], told["met"]) == (60.0, True)
    assert told["verdict"].startswith("Usable for prediction")
    bad = command("validate", wrong, workshop / "surge.csv", "--require", 99, "--json")
    assert bad.code == 1
    assert json.loads(bad.out)["met"] is False
    assert "--require 99: found a fit of" in bad.err
    assert refused(*truth, "--require", 101).startswith("towtank: --require: found 101")


def test_a_fault_is_told_in_words(workshop: Path, wrong: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = narrow("validate", wrong, workshop / "surge.csv", monkeypatch=monkeypatch)
    assert "What the errors are" in out
    assert "surge errors follow the command" in out
    assert "the model lacks something" in " ".join(out.split())
    right = narrow("validate", workshop / "truth.toml", workshop / "surge.csv", monkeypatch=monkeypatch)
    assert "surge errors follow the command" not in right


def test_a_delay_can_be_given(workshop: Path) -> None:
    words = ["validate", "vlbv300", workshop / "yaw.csv", "--window", "0,12"]
    as_is, late = document(*words), document(*words, "--delay", 0.3)
    assert as_is["delay_s"] is None
    assert late["delay_s"] == 0.3
    assert late["fit"]["r"] < as_is["fit"]["r"] - 3.0
    assert document(*words, "--delay", 0)["fit"] == as_is["fit"]
    assert "delay 300 ms" in command(*words, "--delay", 0.3).out


def test_models_against_each_other(workshop: Path, wrong: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = workshop / "long.csv"
    made = ["simulate", "vlbv300", "surge-multisine", "-o", log, "--duration", 90, "--rate", 25]
    ran = command(*made, "--sensors", "ins", "--seed", 2)
    assert ran.code == 0, ran
    words = ["validate", wrong, log, "--against", "vlbv300", "--against", "vlbv300_as_published"]
    found = document(*words)
    assert found["fit"] == document("validate", wrong, log)["fit"]
    versus = found["comparison"]
    assert versus["models"] == [str(wrong), "vlbv300", "vlbv300_as_published"]
    assert versus["fit"][str(wrong)] == found["fit"]
    surge = versus["channels"]["u"]
    assert surge["best"] != str(wrong)
    assert surge["others"][str(wrong)]["real"] is True
    assert surge["others"][str(wrong)]["behind"] > 5.0
    assert "residuals" in found
    out = narrow(*words, "--window", "0,30", monkeypatch=monkeypatch)
    assert "Models on the same logs" in out
    assert "worse (p" in out


def test_a_model_against_its_copy(workshop: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.toml"
    tt.save_vehicle(tt.load_vehicle("vlbv300"), copy)
    ran = command("validate", "vlbv300", workshop / "surge.csv", "--against", copy)
    assert "the same" in ran.out
    assert "no model is really better" in ran.out


def test_folds(workshop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["validate", "vlbv300", workshop / "yaw.csv", "--folds", 3, "--method", "paper", "--delay", 0]
    found = document(*words)
    assert found["fit"].keys() == CHANNELS
    assert found["fit"]["r"] > 95.0
    folds = found["cross_validation"]
    assert len(folds["folds"]) == 3
    assert folds["folds"][0]["windows"] == [{"log": str(workshop / "yaw.csv"), "window": [0.0, pytest.approx(10.0)]}]
    assert folds["folds"][1]["fit"]["r"] > 90.0
    yaw = folds["coefficients"]["N_rr"]
    assert yaw.keys() == {"value", "std", "unit", "folds", "folds_std", "p", "overconfident"}
    assert len(yaw["folds"]) == 3
    out = narrow(*words, "--window", "0,15", monkeypatch=monkeypatch)
    assert "learned on the others" in out
    assert "N_rr" in out


def test_folds_of_several_logs_and_a_window(workshop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["validate", "vlbv300", workshop / "yaw.csv", workshop / "surge.csv", "--method", "paper", "--delay", 0]
    out = narrow(*words, "--folds", 3, "--window", "0,9", monkeypatch=monkeypatch)
    assert "log 1: yaw.csv" in " ".join(out.split())
    assert "log 2: " in out
    found = document(*words, "--folds", 3, "--window", "0,9")
    assert [len(fold["windows"]) for fold in found["cross_validation"]["folds"]] == [1, 2, 1]


@pytest.mark.parametrize(
    "words, expected",
    [
        (["--delay", "-1"], "--delay: found -1"),
        (["--delay", "soon"], "--delay"),
        (["--folds", "1"], "--folds: found 1"),
        (["--folds", "many"], "--folds"),
        (["--folds", "100", "--method", "paper"], "use fewer"),
        (["--folds", "3", "--method", "papers"], 'did you mean "paper"?'),
        (["--method", "paper"], "only --folds learns anew"),
        (["--folds", "3", "--against", "seamor"], "cannot be combined with --against"),
        (["--against", "vlbv300"], '"vlbv300" twice'),
        (["--against", "seamo"], 'did you mean "seamor"?'),
        (["--against", "nothing.toml"], "nothing.toml"),
    ],
)
def test_wrong_options(words: list[str], expected: str, workshop: Path) -> None:
    assert expected in refused("validate", "vlbv300", workshop / "yaw.csv", *words)


POOL = """
thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]
[columns]
p = "gyro_p"
q = "gyro_q"
r = "gyro_r"
"""


@pytest.fixture(scope="module")
def pool(data: Path, tmp_path_factory: pytest.TempPathFactory) -> list[object]:
    """Words that validate the catalog's vehicle on a run in a pool."""
    logs = sorted((data / "bluerov_pool_2016").glob("yaw_1_2016*.csv"))
    if not logs:
        pytest.skip(f"no yaw_1_2016*.csv in {data / 'bluerov_pool_2016'}")
    mapping = tmp_path_factory.mktemp("pool") / "map.toml"
    mapping.write_text(POOL)
    return ["validate", "bluerov_2016", logs[0], "--map", mapping]


def test_a_real_vehicle_in_a_pool(pool: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    found = document(*pool)
    assert found["residuals"].keys() == {"p", "q", "r"}
    yaw = found["residuals"]["r"]
    assert yaw["verdict"] == "follows the command"  # the catalog's yaw coefficients are a guess
    assert yaw["command"]["p"] < 0.001
    assert found["residuals"]["q"]["command"] is None
    narrow(*pool, monkeypatch=monkeypatch)


def test_folds_of_a_real_run(pool: list[object]) -> None:
    found = document(*pool, "--folds", 4, "--method", "paper")
    assert found["fit"]["r"] > 65.0
    yaw = found["cross_validation"]["coefficients"]["N_r"]
    assert not yaw["overconfident"]
    assert 0.3 < yaw["folds_std"] / yaw["std"] < 3.0
