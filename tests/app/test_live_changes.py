"""`towtank live` and a vehicle that changes: events in the document, the lines and the view; configurations."""

from __future__ import annotations

import io
import json
import math
import time
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from towtank import load_vehicle
from towtank.app.live.readings import Readings
from towtank.app.live.view import LiveView, event_line, likely_line
from towtank.app.terminal.output import Output
from towtank.identification import Learner
from towtank.live import open_source
from towtank.live.session import Session
from towtank.recording.event import Event
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Coefficient, Vehicle
from towtank.vehicle.configurations import Configurations

from .commands import command, document, refused

VEHICLE, SECONDS, WHEN = "seamor", 45.0, 28.0
MORE, SHARE = 4.0, 1.3
ASKED = ("--vehicle", VEHICLE, "--free", "X_udot,X_uu")


def heavier(std: float | None = None) -> Vehicle:
    """Four kilograms and 30 % of drag more in surge."""
    bare = load_vehicle(VEHICLE)
    inertia, drag = bare.coefficient("X_udot") - MORE, SHARE * bare.coefficient("X_uu")
    changes = {name: Coefficient(value=value, std=std) for name, value in (("X_udot", inertia), ("X_uu", drag))}
    return bare.with_coefficients(changes)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bare = load_vehicle(VEHICLE)
    plan = manoeuvre("surge-square", bare, duration=SECONDS, dt=0.04, seed=1)
    path = tmp_path_factory.mktemp("changes") / "payload.mcap"
    push = OrnsteinUhlenbeck(std=0.1)
    simulate(
        bare,
        commands=plan.commands,
        dt=0.04,
        sensors=Mocap(rate=25.0),
        disturbance=push,
        changes=[(WHEN, heavier())],
        seed=1,
    ).write(path)
    return path


def test_a_change_is_told_in_the_document(log: Path, tmp_path: Path) -> None:
    folder = Configurations(tmp_path / "known")
    folder.save(load_vehicle(VEHICLE), "bare")
    folder.save(heavier(std=0.5), "with the gripper")
    found = document("live", f"replay:{log}@0", *ASKED, "--configurations", tmp_path / "known")
    events = {each["kind"]: each for each in found["events"]}
    assert set(events) == {"change", "configuration"}
    change = events["change"]
    assert WHEN - 1.0 < change["t"] < WHEN + 2.0
    assert 0.0 < change["details"]["noticed"] - WHEN < 4.0
    assert "surge inertia +" in change["text"]
    step, std = change["details"]["X_udot"], change["details"]["X_udot_std"]
    assert -step == pytest.approx(MORE, abs=max(4.0 * std, 0.5))
    assert events["configuration"]["details"]["configuration"] == "with the gripper"
    assert found["live"]["likely"]["with the gripper"] > 0.6 > found["live"]["likely"]["bare"]
    assert found["coefficients"]["X_uu"]["value"] == pytest.approx(heavier().coefficient("X_uu"), rel=0.05)


def test_nobody_watches_where_that_is_not_wanted(log: Path) -> None:
    ran = command("live", f"replay:{log}@0", *ASKED, "--no-changes", "--json-lines")
    last = json.loads(ran.out.splitlines()[-1])
    assert last["final"]
    assert last["events"] == []
    assert last["live"]["instants"] > 1000


def test_lines_tell_each_event_once_and_the_recording_is_gone_on_with(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = (*ASKED, "--record", "dive.mcap")
    ran = command("live", f"replay:{log}@0", *asked, "--json-lines")
    lines = [json.loads(line) for line in ran.out.splitlines()]
    told = [event["text"] for line in lines[:-1] for event in line["events"]]
    assert len(told) == len(set(told))
    assert [each["kind"] for each in lines[-1]["events"]] == ["change"]
    Configurations(tmp_path / "known").save(heavier(), "heavy")
    again = (f"replay:{log}@0", *asked, "--resume", "--for", "2", "--configurations", "known")
    ran = command("live", *again)
    assert ran.code == 0, ran
    happened = ran.out.split("What happened")[1]
    assert "resumed" in happened
    assert lines[-1]["events"][0]["text"].partition(",")[0] in happened


def test_the_view_shows_the_last_three_and_the_likely(log: Path) -> None:
    vehicle = load_vehicle(VEHICLE)
    text = f"replay:{log}@0"
    session = Session([(text, open_source(text, vehicle))], vehicle, Learner(vehicle, "paper"), epoch=0.0)
    events = tuple(Event(10.0 * k, "mark", f"event {k}, with ± and −") for k in range(5))
    learnt = replace(session.status().learnt, likely={"bare": 0.031, "heavy": 0.962, "other": 0.001})
    status = replace(session.status(), events=events, learnt=learnt)
    output = Output()
    output.console = Console(width=80, record=True, file=io.StringIO(), force_terminal=True)
    output.console.print(LiveView(output, vehicle, "joint").picture(status, Readings(session, vehicle).read(status)))
    shown = output.console.export_text()
    assert "event 1" not in shown
    assert [line for line in shown.splitlines() if "event" in line] == [
        f"0:00:{10 * k}  event {k}, with ± and −" for k in (2, 3, 4)
    ]
    assert "configuration: heavy 96 %, bare 3 %" in shown
    assert max(map(len, shown.splitlines())) <= 80


def test_an_event_has_the_time_of_day(monkeypatch: pytest.MonkeyPatch) -> None:
    event = Event(61.0, "change", "surge inertia +4.0 ± 0.1 kg m²")
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "UTC")
        time.tzset()
        assert event_line(event, 1.7e9) == "22:14:21  surge inertia +4.0 ± 0.1 kg m²"
    time.tzset()
    assert event_line(event, math.nan, ascii_only=True) == "0:01:01  surge inertia +4.0 +- 0.1 kg m^2"
    assert likely_line({"bare": 1e-5}) == "configuration: none of those known"


def test_wrong_configurations_are_one_line(tmp_path: Path) -> None:
    asked = ("live", "json:127.0.0.1:5005", *ASKED, "--configurations")
    assert "no such folder" in refused(*asked, tmp_path / "nowhere")
    assert "found both" in refused(*asked, tmp_path, "--no-changes")
    Configurations(tmp_path).save(load_vehicle(VEHICLE), "bare")
    assert "the method paper" in refused(*asked, tmp_path, "--method", "paper")
    (tmp_path / "bare.toml").write_text("name = 3\n")
    assert "bare.toml" in refused(*asked, tmp_path)
