"""`--merge`: a second file of one run, in inspect, learn, validate and convert."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.recording import Recording

from .commands import command, document, refused

OFFSET = 12.345


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one run in two files: gyro and commands, and the attitude in degrees on a clock of its own."""
    folder = tmp_path_factory.mktemp("dive")
    whole = folder / "whole.csv"
    words = ("simulate", "bluerov2_heavy", "all-multisine", "-o", whole)
    command(*words, "--duration", 30, "--rate", 50, "--sensors", "ins")
    run = tt.read(whole)
    Recording({name: run[name] for name in run if name.startswith("cmd_") or name in "pqr"}).write(folder / "dive.csv")
    t = run["phi"].t - OFFSET
    angles = np.degrees(np.column_stack([run[name].values for name in ("phi", "theta", "psi")]))
    lines = [",".join(f"{x:.6f}" for x in row) for row in np.column_stack([t, angles])]
    (folder / "mocap.csv").write_text("\n".join(["time,roll,pitch,yaw", *lines]), encoding="utf-8")
    angle = '{{ from = "{}", scale = 0.017453292519943295 }}'
    named = zip(("phi", "theta", "psi"), map(angle.format, ("roll", "pitch", "yaw")), strict=True)
    columns = {"t": '"time"', **dict(named)}
    (folder / "mocap.toml").write_text(
        "[columns]\n" + "\n".join(f"{name} = {column}" for name, column in columns.items()), encoding="utf-8"
    )
    return folder


def merged(dive: Path, offset: str = "") -> tuple[object, ...]:
    return ("--merge", f"{dive / 'mocap.csv'}{offset}", "--merge-map", dive / "mocap.toml")


def test_inspect_says_where_the_second_clock_lies(dive: Path) -> None:
    found = document("inspect", dive / "dive.csv", *merged(dive))
    [how] = found["merged"]
    assert how["file"] == "mocap.csv"
    assert how["offset_s"] == pytest.approx(OFFSET, abs=2e-3)
    assert abs(how["offset_s"] - OFFSET) < 5.0 * how["offset_std_s"] + 1e-4
    assert {each["name"] for each in found["channels"]} >= {"p", "psi"}
    text = " ".join(command("inspect", dive / "dive.csv", *merged(dive)).out.split())
    assert "mocap.csv lies 12.34" in text
    assert "s after dive.csv, by" in text
    assert "heading, 50 Hz" in text


def test_an_offset_by_hand(dive: Path) -> None:
    for text in ("@+12.345", "@12.345", "@1.2345e1"):
        [how] = document("inspect", dive / "dive.csv", *merged(dive, text))["merged"]
        assert how["offset_s"] == 12.345
        assert how["offset_std_s"] is None


def test_validate_and_learn_take_both_files(dive: Path) -> None:
    alone = document("validate", "bluerov2_heavy", dive / "dive.csv")
    both = document("validate", "bluerov2_heavy", dive / "dive.csv", *merged(dive))
    assert alone["fit"]["psi"] is None
    assert both["fit"]["psi"] is not None
    assert both["merged"][0]["text"] in " ".join(
        command("validate", "bluerov2_heavy", dive / "dive.csv", *merged(dive)).out.split()
    )
    learned = document("learn", dive / "dive.csv", "--vehicle", "bluerov2_heavy", *merged(dive))
    assert learned["merged"][0]["offset_s"] == pytest.approx(OFFSET, abs=2e-3)
    assert [each["by"] for each in learned["known_by"]["yaw"]] == ["rate", "heading"]
    assert any("mocap.csv lies 12.34" in text for text in learned["warnings"])


def test_convert_makes_one_file_of_both(dive: Path, tmp_path: Path) -> None:
    one = tmp_path / "run.parquet"
    command("convert", dive / "dive.csv", one, *merged(dive))
    run = tt.read(one)
    assert {"p", "psi"} <= set(run.names)
    assert document("inspect", one)["merged"][0]["file"] == "mocap.csv"


@pytest.mark.parametrize(
    "words, expected",
    [
        (("--merge", "{}/nowhere.csv"), "no such file"),
        (("--merge", "{}/mocap.csv@soon", "--merge-map", "{}/mocap.toml"), 'found "soon", expected a number'),
        (("--merge", "{}/mocap.csv@9e9", "--merge-map", "{}/mocap.toml"), "expected some time in common"),
        (("--merge", "{}/mocap.csv"), "name the columns with --merge-map FILE.toml"),
        (("--merge-map", "{}/mocap.toml"), "there is no --merge FILE"),
        (("--merge", "{}/mocap.csv", "--merge-map", "{}/a", "--merge-map", "{}/b"), "found 2 mappings for 1 file"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(dive: Path, words: tuple[str, ...], expected: str) -> None:
    assert expected in refused("inspect", dive / "dive.csv", *(word.format(dive) for word in words))


def test_an_offset_that_cannot_be_told_says_what_to_do(dive: Path, tmp_path: Path) -> None:
    still = tmp_path / "still.csv"
    t = np.arange(0.0, 30.0, 0.02)
    Recording.from_table(t, {name: 1e-6 * np.sin(t) for name in ("phi", "theta", "psi")}).write(still)
    said = refused("inspect", dive / "dive.csv", "--merge", still)
    assert "the second file hardly moves" in said
    assert "--merge still.csv@+SECONDS" in said


def test_several_logs_are_merged_one_by_one(dive: Path) -> None:
    said = refused("learn", dive / "dive.csv", dive / "whole.csv", "--vehicle", "bluerov2_heavy", *merged(dive))
    assert "found 2 logs, expected one" in said
    assert "towtank convert" in said
