"""`towtank.learn`, `towtank.validate`, `towtank.inspect`: the same as the commands, from paths or recordings."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.app.results import Judgement, LearnedModel
from towtank.app.terminal.output import plain
from towtank.errors import InputError

from .commands import command, document

SHORT = 600  # characters of a text that shows a result


@pytest.fixture(scope="module")
def learned(workshop: Path) -> LearnedModel:
    return tt.learn(workshop / "yaw.csv", "vlbv300")


@pytest.fixture(scope="module")
def judged(workshop: Path, learned: LearnedModel) -> Judgement:
    return tt.validate(learned, workshop / "surge.csv")


def test_learning_is_the_command_s(learned: LearnedModel, learned_document: dict) -> None:
    told = learned_document
    assert plain(learned.document()) == told
    assert learned["N_rr"].value == told["coefficients"]["N_rr"]["value"]
    assert learned.coefficients.keys() == told["coefficients"].keys()
    assert learned.fit["r"] == told["fit"]["r"]
    assert learned.verdict == told["verdict"]
    with pytest.raises(dataclasses.FrozenInstanceError):
        learned.prior = "other"  # type: ignore[misc]
    with pytest.raises(InputError, match='did you mean "N_rr"'):
        learned["N_rrr"]


def test_recordings_and_paths_are_alike(workshop: Path) -> None:
    log, known = workshop / "yaw.csv", {"free": "N_rdot,N_rr", "delay": 0.0, "window": (0.0, 12.0)}
    learned = tt.learn(log, "vlbv300", **known)
    again = tt.learn([tt.read(log)], tt.load_vehicle("vlbv300"), **known)
    assert again.estimate.values.tolist() == learned.estimate.values.tolist()
    assert again.logs == learned.logs == (str(log),)


def test_windows_free_names_and_prior_are_passed_on(learned: LearnedModel, workshop: Path) -> None:
    known = {"free": "N_rdot,N_rr", "delay": 0.0}
    part = tt.learn(workshop / "yaw.csv", "vlbv300", window=(None, 8.0), prior=learned, **known)
    told = document(
        *("learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--window", ",8", "--delay", 0),
        *("--free", "N_rdot,N_rr", "--prior", _saved(learned, workshop / "before.toml")),
    )
    assert part.estimate.duration == told["duration_s"] < 9.0
    assert {name: each.value for name, each in part.coefficients.items()} == {
        name: pytest.approx(each["value"], rel=1e-9) for name, each in told["coefficients"].items()
    }
    assert part.prior == "vlbv300"


def _saved(learned: LearnedModel, path: Path) -> Path:
    learned.save(path)
    return path


def test_what_is_saved_reads_back_and_reports_are_written(
    learned: LearnedModel, judged: Judgement, tmp_path: Path
) -> None:
    learned.save(tmp_path / "m.toml")
    assert tt.load_vehicle(tmp_path / "m.toml") == learned.model
    assert "yaw.csv" in learned.model.provenance.notes[-1]
    learned.report(tmp_path / "l.html", ["towtank learn yaw.csv"])
    judged.report(tmp_path / "j.html")
    assert "towtank learn yaw.csv" in (tmp_path / "l.html").read_text()
    assert "SHA-256" in (tmp_path / "j.html").read_text()
    with pytest.raises(InputError, match=r"ends in \.html or \.pdf"):
        learned.report(tmp_path / "l.txt")


def test_judging_is_the_command_s(judged: Judgement, learned: LearnedModel, workshop: Path) -> None:
    told = document("validate", _saved(learned, workshop / "same.toml"), workshop / "surge.csv")
    mine = plain(judged.document())
    assert mine.keys() == told.keys()
    for key in told.keys() - {"model"}:  # which is given as a vehicle here and as a file there
        assert _close(mine[key], told[key]) or key == "verdict", key
    assert mine["verdict"].replace(judged.name, "MODEL") == told["verdict"].replace(
        str(workshop / "same.toml"), "MODEL"
    )
    part = tt.validate("vlbv300", [workshop / "surge.csv", workshop / "yaw.csv"], horizon=5.0, window=[(5, 15), (2, 9)])
    assert [prediction.t[0] for prediction in part.scores.predictions] == [5.0, 2.0]
    assert len(part.scores.predictions[0].restarts) == 2
    assert part.horizon == 5.0


def test_a_fit_that_is_required_is_told_by_both(judged: Judgement, workshop: Path) -> None:
    log = workshop / "yaw.csv"
    for percent, code in ((-1e9, 0), (99.9, 1)):
        ran = command("validate", "vlbv300", log, "--require", percent, "--window", "0,8", "--json")
        mine = tt.validate("vlbv300", log, require=percent, window=(0.0, 8.0))
        told = json.loads(ran.out)
        assert ran.code == code
        assert mine.met is (code == 0)
        assert {key: told[key] for key in ("required", "met")} == {"required": percent, "met": code == 0}
        assert {key: plain(mine.document())[key] for key in ("required", "met")} == {
            "required": percent,
            "met": mine.met,
        }
        assert len(mine.lacking) == code
    assert judged.met is None
    assert judged.lacking == ()


def test_commands_that_come_seldom_are_told_by_both(workshop: Path, tmp_path: Path) -> None:
    slow = tmp_path / "slow.csv"
    assert command("simulate", "vlbv300", "yaw-square", "-o", slow, "--duration", 20, "--rate", 5).code == 0
    told = document("validate", "vlbv300", slow)
    mine = tt.validate("vlbv300", slow)
    assert any("commands come at 5 Hz" in text for text in told["warnings"])
    assert list(mine.warnings) == told["warnings"] == mine.document()["warnings"]
    assert "commands come at 5 Hz" in mine._repr_html_()
    mine.report(tmp_path / "slow.html")
    assert "commands come at 5 Hz" in (tmp_path / "slow.html").read_text()


@pytest.mark.parametrize("kind", [int, float, np.int64, np.float64, np.float32])
def test_windows_are_numbers_of_any_kind(kind: type, workshop: Path) -> None:
    found = tt.inspect(workshop / "yaw.csv", window=(kind(5), kind(12)))
    assert (found.recording.start, found.recording.end) == (5.0, 12.0)
    both = tt.inspect([workshop / "yaw.csv"] * 2, window=np.array([[5, 12], [2, 9]], dtype=kind))
    assert isinstance(both, tuple)
    assert [each.recording.start for each in both] == [5.0, 2.0]


def _close(a: object, b: object) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_close(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_close, a, b))
    return a == pytest.approx(b, rel=1e-6) if isinstance(a, float) else a == b


def test_inspecting_is_the_command_s(workshop: Path) -> None:
    found = tt.inspect(workshop / "yaw.csv")
    told = document("inspect", workshop / "yaw.csv")
    assert {**json.loads(json.dumps(plain(found.document()))), "vehicle": None} == told
    both = tt.inspect([workshop / "yaw.csv", tt.read(workshop / "surge.csv")], window=(0.0, 10.0))
    assert isinstance(both, tuple)
    assert [each.recording.end for each in both] == [10.0, 10.0]


def test_results_show_themselves_in_few_words(learned: LearnedModel, judged: Judgement, workshop: Path) -> None:
    found = tt.inspect(workshop / "yaw.csv")
    for each in (learned, judged, found, learned.model, learned.estimate, learned.learning, judged.scores):
        assert len(repr(each)) < SHORT, type(each)
        assert "array(" not in repr(each)
    assert "method" in repr(learned)
    assert "N_rr" in learned._repr_html_()
    assert "<svg" in learned._repr_html_()
    assert "<svg" in judged._repr_html_()
    assert "yaw.csv" in found._repr_html_()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([], "vlbv300", {}), "logs: found none"),
        ((3, "vlbv300", {}), "logs: found an object of type int"),
        (("none.csv", "vlbv300", {}), "none.csv: no such file"),
        (("yaw.csv", "vlbv30", {}), 'did you mean "vlbv300"'),
        (("yaw.csv", 3, {}), "vehicle: found 3, expected a Vehicle"),
        (("yaw.csv", "vlbv300", {"method": "jont"}), 'did you mean "joint"'),
        (("yaw.csv", "vlbv300", {"window": (5.0, 1.0)}), "expected an end after the start"),
        (("yaw.csv", "vlbv300", {"window": (1.0, 2.0, 3.0)}), "expected (start, end) in seconds"),
        (("yaw.csv", "vlbv300", {"window": ("1", 2.0)}), "window: found"),
        (("yaw.csv", "vlbv300", {"window": (np.nan, 2.0)}), "expected finite numbers of seconds"),
        (("yaw.csv", "vlbv300", {"window": (True, 2.0)}), "window: found"),
        (("yaw.csv", "vlbv300", {"window": 5.0}), "window: found 5.0, expected (start, end) in seconds"),
        (("yaw.csv", "vlbv300", {"delay": -0.1}), "delay: found -0.1, expected a number of 0 or more"),
        (("yaw.csv", "vlbv300", {"delay": np.inf}), "delay: found inf, expected a number of 0 or more"),
        (("yaw.csv", "vlbv300", {"delay": "0.1"}), "delay: found '0.1', expected a number of 0 or more"),
        (("yaw.csv", "vlbv300", {"prior": "vlbv300"}), "no coefficient bears a std"),
        (("yaw.csv", "vlbv300", {"free": "N_rrr"}), "N_rrr"),
        (("yaw.csv", "vlbv300", {"mapping": {"columns": {"q": "nix"}}}), 'no column "nix"'),
        (("yaw.csv", "vlbv300", {"mapping": {"colums": {}}}), 'did you mean "columns"'),
    ],
)
def test_wrong_arguments_are_told_in_one_line(
    arguments: tuple, said: str, workshop: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workshop)
    logs, vehicle, options = arguments
    with pytest.raises(InputError) as caught:
        tt.learn(logs, vehicle, **options)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"delay": -0.1}, "delay: found -0.1, expected a number of 0 or more"),
        ({"horizon": 0.0}, "horizon: found 0, expected a number above 0"),
        ({"horizon": np.float64(-2.0)}, "horizon: found -2, expected a number above 0"),
        ({"require": 101.0}, "require: found 101, expected a fit in percent, 100 at most"),
        ({"window": (5, "12")}, "window: found"),
    ],
)
def test_wrong_arguments_of_judging_are_told_in_one_line(options: dict, said: str, workshop: Path) -> None:
    with pytest.raises(InputError) as caught:
        tt.validate("vlbv300", workshop / "yaw.csv", **options)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mapping_is_for_files(workshop: Path) -> None:
    run = tt.read(workshop / "yaw.csv", {"columns": {"t": "t", "r": {"from": "r", "scale": 2.0}}})
    assert run.names == ("r",)
    with pytest.raises(InputError, match="recordings already"):
        tt.inspect(run, mapping={"columns": {"r": "r"}})
