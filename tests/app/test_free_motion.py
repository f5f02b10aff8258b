"""What counts, as commands say it: cut by default, windows of one log or all, --keep-all, seldom commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.app.commands.arguments import LogPlace, Window, log_places
from towtank.app.files import LogParts, parts_of
from towtank.app.tables.free_motion import left_out_lines, rate_warnings
from towtank.errors import InputError
from towtank.recording import Channel, Content, Recording

from .commands import command, document, refused


@pytest.fixture(scope="module")
def handled(workshop: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of 30 s, disarmed and shaken by a hand before 5 s, from 14 to 16 s and after 26 s."""
    run = tt.read(workshop / "yaw.csv")
    held = [(0.0, 5.0), (14.0, 16.0), (26.0, 30.1)]
    shaken = [
        channel.with_values(
            np.where(
                np.any([(channel.t >= a) & (channel.t < b) for a, b in held], axis=0),
                channel.values + 0.8 * np.sin(3.0 * channel.t),
                channel.values,
            )
        )
        for name, channel in run.channels.items()
        if name in ("r", "p", "q")
    ]
    armed = Channel("armed", [0.0, 5.0, 14.0, 16.0, 26.0], [0.0, 1.0, 0.0, 1.0, 0.0], "1")
    log = tmp_path_factory.mktemp("handled") / "dive.parquet"
    run.replace([*shaken, armed]).write(log)
    return log


VEHICLE = ("--vehicle", "vlbv300")
CUTS = [("disarmed", 0.0, 5.0), ("disarmed", 14.0, 16.0), ("disarmed", 26.0, 30.0)]


def cuts(found: dict) -> list[tuple[str, float, float]]:
    return [(each["kind"], each["start_s"], each["end_s"]) for each in found["left_out"]]


def test_what_a_hand_does_is_not_learned(handled: Path, workshop: Path, tmp_path: Path) -> None:
    """The log learns as its own middle does; with all of it the drag is off by far."""
    words = (*VEHICLE, "--free", "N_rdot,N_rr", "--delay", 0)
    model, report = tmp_path / "mine.toml", tmp_path / "report.html"
    found = document("learn", handled, *words, "-o", model, "--report", report)
    assert cuts(found) == [(kind, start, pytest.approx(end, abs=0.02)) for kind, start, end in CUTS]
    assert [(each["start_s"], each["end_s"]) for each in found["counted"]] == [(5.0, 14.0), (16.0, 26.0)]
    assert found["duration_s"] == pytest.approx(19.0, abs=0.1)
    by_hand = document("learn", workshop / "yaw.csv", *words, "--window", "5,14", "--window", "16,26")
    for name in ("N_rdot", "N_rr"):
        same = pytest.approx(by_hand["coefficients"][name]["value"], rel=2e-3)  # but for the samples at the edges
        assert found["coefficients"][name]["value"] == same
    whole = document("learn", handled, *words, "--keep-all")
    assert whole["left_out"] == []
    assert found["fit"]["r"] > whole["fit"]["r"] + 20.0
    page = report.read_text()
    assert "Left out 14 to 16 s: disarmed" in page
    judged = document("validate", model, handled)
    assert cuts(judged) == cuts(found)
    assert judged["window"] == pytest.approx([5.0, 26.0])
    assert judged["fit"]["r"] > document("validate", model, handled, "--keep-all")["fit"]["r"] + 20.0
    out = command("validate", model, handled, "--report", report).out
    assert "left out 0 to 5 s: disarmed" in out
    assert "--keep-all" in out
    assert "Left out 0 to 5 s: disarmed" in report.read_text()


def test_inspect_says_it_too(handled: Path) -> None:
    found = document("inspect", handled)
    assert [kind for kind, _, _ in cuts(found)] == ["disarmed"] * 3
    assert found["duration_s"] == pytest.approx(30.0, abs=0.02)
    assert found["axes"]["yaw"]["identifiable"] is True
    with_vehicle = document("inspect", handled, *VEHICLE)
    assert with_vehicle["excitation"]["windows"] == [pytest.approx([5.0, 14.0]), pytest.approx([16.0, 26.0])]
    assert with_vehicle["excitation"]["whole"] is True
    assert "left out 26 to 30 s: disarmed" in command("inspect", handled).out


def test_where_nothing_counts(handled: Path, tmp_path: Path) -> None:
    run = tt.read(handled)
    log = tmp_path / "bench.parquet"
    run.replace([Channel("armed", [0.0], [0.0], "1")]).write(log)
    said = refused("learn", log, *VEHICLE)
    assert f"{log}: no part of it shows the vehicle moving freely in water (0 to 30 s: disarmed); --keep-all" in said
    found = document("inspect", log, *VEHICLE)
    assert not any(verdict["identifiable"] for verdict in found["axes"].values())
    assert "no part of the log shows the vehicle moving freely" in found["axes"]["yaw"]["reason"]
    assert found["channels"]
    both = document("learn", handled, log, *VEHICLE, "--free", "N_rdot,N_rr", "--delay", 0)
    assert {each["log"] for each in both["counted"]} == {str(handled)}
    assert {each["log"] for each in both["left_out"]} == {str(handled), str(log)}


def test_windows_of_one_log_and_of_all(workshop: Path) -> None:
    yaw, surge = workshop / "yaw.csv", workshop / "surge.csv"
    words = (*VEHICLE, "--free", "N_rdot", "--delay", 0)
    found = document("learn", f"{yaw}@2,8@20,", surge, *words, "--window", "3,7")
    spans = [(each["log"], round(each["start_s"], 2), round(each["end_s"], 2)) for each in found["counted"]]
    assert spans == [(str(yaw), 2.0, 8.0), (str(yaw), 20.0, 30.0), (str(surge), 3.0, 7.0)]
    assert found["logs"] == [str(yaw), str(surge)]
    assert found["left_out"] == []
    words = ("validate", workshop / "learned.toml", f"{yaw}@0,8@14,22", "--folds", 2, "--method", "paper")
    folds = document(*words)["cross_validation"]
    assert {each["log"] for fold in folds["folds"] for each in fold["windows"]} == {str(yaw)}
    assert document("inspect", f"{yaw}@5,20")["start_s"] == pytest.approx(5.0)


def test_a_stretch_without_motion_is_no_part(workshop: Path) -> None:
    """The recorder lost all sensors but the commands while the vehicle was armed for a second time."""
    run = tt.read(workshop / "yaw.csv")
    motion = [
        Channel(name, channel.t[channel.t < 12.0], channel.values[channel.t < 12.0], channel.unit, channel.frame)
        for name, channel in run.channels.items()
        if not name.startswith("cmd_")
    ]
    states = Channel("armed", [0.0, 12.0, 15.0, 28.0], [1.0, 0.0, 1.0, 0.0], "1")
    lost = run.replace([*motion, states])
    [found] = parts_of([LogPlace(Path("dive"))], [lost], None, keep_all=False)
    assert [(part.start, round(part.end)) for part in found.parts] == [(0.0, 12)]
    assert [each.kind for each in found.left_out] == ["disarmed", "no motion", "disarmed"]


def test_windows_that_overlap_are_one(workshop: Path) -> None:
    words = (workshop / "yaw.csv", "--window", "12,20", "--window", "5,15")
    found = document("validate", workshop / "learned.toml", *words)
    assert [(each["start_s"], each["end_s"]) for each in found["counted"]] == [(5.0, 20.0)]


def places(*texts: str) -> list[LogPlace]:
    return log_places([Path(text) for text in texts], ["1,2"])


def test_a_file_whose_name_bears_an_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("dive.BIN", "rov@sea.BIN", "odd@3,4"):
        Path(name).touch()
    one, own = Window(1.0, 2.0), Window(5.0, None)
    assert places("dive.BIN", "rov@sea.BIN", "odd@3,4") == [
        LogPlace(Path("dive.BIN"), (one,)),
        LogPlace(Path("rov@sea.BIN"), (one,)),
        LogPlace(Path("odd@3,4"), (one,)),
    ]
    assert places("dive.BIN@5,", "rov@sea.BIN@5,@1,2", "odd@3,4@5,") == [
        LogPlace(Path("dive.BIN"), (own,)),
        LogPlace(Path("rov@sea.BIN"), (own, one)),
        LogPlace(Path("odd@3,4"), (own,)),
    ]
    assert places("absent.BIN@5,")[0].path == Path("absent.BIN")
    assert places("rov@absent.BIN") == [LogPlace(Path("rov@absent.BIN"), (one,))]


@pytest.mark.parametrize("text", ["12", "a,b", "60,10", "1,2,3"])
def test_a_wrong_window_of_one_log(workshop: Path, text: str) -> None:
    log = workshop / "yaw.csv"
    with pytest.raises(InputError, match=r"after the @: found "):
        log_places([Path(f"{log}@{text}")], None)
    assert "after the @" in refused("inspect", f"{log}@{text}")


def commanded(rate: float, table: str) -> LogParts:
    t = np.arange(0.0, 60.0, 1.0 / rate)
    run = Recording.from_table(t, {"cmd_1": np.sin(t), "r": np.cos(t)})
    contents = (Content(table, "", t.size, rate, ("cmd_1",)),) if table else ()
    whole = Recording(run.channels, "dive", contents=contents)
    return LogParts(Path("dive"), whole, (whole,), ())


@pytest.mark.parametrize(
    ("rate", "table", "words"),
    [
        (10.0, "RCOU", ("at 10 Hz (RCOU)", "the 100 ms between two", "LOG_BITMASK", "--record FILE.mcap")),
        (2.0, "SERVO_OUTPUT_RAW", ("at 2 Hz", "the 500 ms between two", "SRn_RC_CHAN", "--record FILE.mcap")),
        (5.0, "", ("at 5 Hz. Unless every change of a command is recorded", "whenever they change")),
    ],
)
def test_commands_that_come_seldom(rate: float, table: str, words: tuple[str, ...]) -> None:
    [said] = rate_warnings([commanded(rate, table)])
    assert all(word in said for word in words)


def test_commands_that_come_often_or_now_and_then() -> None:
    assert not rate_warnings([commanded(50.0, "RCOU")])
    t = np.cumsum(np.tile([0.2, 3.0, 0.4, 5.0], 8))
    run = Recording.from_table(t, {"cmd_1": np.sin(t)})
    assert not rate_warnings([LogParts(Path("dive"), run, (run,), ())])


def test_logs_are_named_where_there_are_several() -> None:
    whole = commanded(50.0, "").recording
    assert left_out_lines([LogParts(Path("a"), whole, (whole,), ())]) == []
