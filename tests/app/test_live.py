"""The command `towtank live`: from links to a model, ended in order, killed and gone on with."""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from towtank import load_vehicle, save_vehicle
from towtank.app.live.coaching import plan_lines
from towtank.app.live.readings import Readings
from towtank.app.live.view import LiveView
from towtank.app.terminal.output import Output
from towtank.live import open_source
from towtank.live.pipeline.instants import rows_of
from towtank.live.session import Session
from towtank.live.warm_up import new_learner
from towtank.planning import Accuracy, Plan, Planned, Segment, read_plan, write_plan
from towtank.planning.coach import Coach
from towtank.readers import read
from towtank.simulation import Mocap, manoeuvre, simulate

from .commands import command, document, process, refused

VEHICLE = "seamor"
FREE = "X_udot,X_uu"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixteen simulated seconds."""
    vehicle = load_vehicle(VEHICLE)
    plan = manoeuvre("surge-sine", vehicle, duration=16.0, dt=0.04, seed=1)
    path = tmp_path_factory.mktemp("live") / "surge.csv"
    simulate(vehicle, commands=plan.commands, dt=0.04, sensors=Mocap(rate=25.0), seed=1).write(path)
    return path


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of one segment for surge, beside a vehicle without thrusters."""
    segment = Segment("telegraph", 6.0, (0,), (20.0,), ((2.0, 4.0),), ((1.0,),))
    expected = tuple(Accuracy(name, 0.5, 0.05, 0.05, 0.05, "") for name in FREE.split(","))
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    write_plan(
        Plan(VEHICLE, "pose", None, 1e-5, (Planned(segment, (1.0, 0.1, 0.1), 0.0),), expected, by_hand=True), path
    )
    save_vehicle(load_vehicle(VEHICLE).model_copy(update={"thrusters": ()}), path.with_name("cup.toml"))
    return path


def test_a_pilot_is_led_in_the_terminal_and_for_programs(plan: Path, tmp_path: Path) -> None:
    """Rest, then the segment, as it is driven after a count-down; it is followed, and a next one designed."""
    vehicle = load_vehicle(VEHICLE)
    made = read_plan(plan)
    rest = np.array([[each.curve.rest for each in vehicle.thrusters]] * 400)
    driven = np.repeat(made.commands(vehicle), 2, axis=0)
    commands = np.vstack([rest[:350], driven, rest])
    simulate(vehicle, commands=commands, dt=0.02, sensors=Mocap(rate=50.0), seed=1).write(tmp_path / "run.csv")
    asked = ("replay:run.csv@1", "--vehicle", VEHICLE, "--free", FREE, "--json-lines", "--plan", str(plan))
    done = process("live", *asked, cwd=tmp_path)
    assert done.code == 0, done
    lines = [json.loads(line) for line in done.out.splitlines()]
    plans = [line["plan"] for line in lines if line.get("plan")]
    assert {"bring", "count", "drive"} <= {each["stage"] for each in plans}
    assert plans[0]["axes"] == ["surge"]
    assert [each["text"].split()[0] for each in plans[0]["movements"]] == ["forward", "back", "forward"]
    assert any(each["done"] is not None for line in plans for each in line["movements"])
    said = [event["text"] for line in lines for event in line.get("events", [])]
    assert "segment 1 begins" in said


def test_lines_of_a_plan_fit_a_terminal(plan: Path) -> None:
    made = read_plan(plan)
    coach = Coach(load_vehicle(VEHICLE), ("X_udot", "X_uu"), 0.05, tuple(each.segment for each in made.segments))
    coach.ask("begin")
    coach.tick(0.0)
    coach.tick(5.0)
    lines = plan_lines(coach.view(5.5))
    assert max(map(len, lines)) <= 80
    assert lines[0] == "Drive segment 1: 6 s left."
    assert lines[1].startswith("  surge  now forward ")
    assert lines[1].endswith("in 1.5 s")
    assert lines[-1] == "0 of 2 known to 5 % after 0 s; least known: X_udot not at all"


def started(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    """Start `towtank live` and wait until it listens."""
    command = [sys.executable, "-m", "towtank", "live", *arguments, "--vehicle", VEHICLE, "--free", FREE]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("listening"):
            return process
    raise AssertionError(process.communicate())


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


def datagrams(log: Path) -> list[tuple[float, bytes]]:
    return [
        (t, json.dumps({"t": t, **dict(zip(names, values, strict=True))}).encode())
        for t, names, values in rows_of(read(log))
    ]


def send(feed: list[tuple[float, bytes]], port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        began = time.monotonic()
        for t, data in feed:
            time.sleep(max(began + t - feed[0][0] - time.monotonic(), 0.0))
            link.sendto(data, ("127.0.0.1", port))


def test_a_log_replayed_ends_in_a_document_and_a_model(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = (f"replay:{log}@0", "--vehicle", VEHICLE, "--free", FREE)
    monkeypatch.chdir(tmp_path)
    found = document("live", *asked, "--record", "dive.mcap", "-o", "mine.toml")
    truth = load_vehicle(VEHICLE)
    for name in FREE.split(","):
        assert found["coefficients"][name]["value"] == pytest.approx(truth.coefficient(name), rel=0.05)
    assert found["live"]["samples"] == found["live"]["instants"] == 401
    assert found["live"]["dropped"] == found["live"]["late"] == found["live"]["bad"] == 0
    learn = {"vehicle", "logs", "method", "duration_s", "samples", "delay_s", "coefficients", "fit", "warnings"}
    assert learn < found.keys()
    assert found["fit_of"] == "the recording dive.mcap"
    assert found["fit_reason"] is None
    validated = document("validate", tmp_path / "mine.toml", tmp_path / "dive.mcap")
    fits = {name: value for name, value in validated["fit"].items() if value is not None}
    assert fits["x"] > 95.0
    assert {name: found["fit"][name] for name in fits} == pytest.approx(fits, abs=0.01)
    assert found["noise"]["x"] == {"std": pytest.approx(0.001, rel=0.2), "unit": "m"}
    assert set(found["noise"]) == {"x", "y", "z", "phi", "theta", "psi"}
    model = load_vehicle(tmp_path / "mine.toml")
    assert model.coefficient("X_uu") == pytest.approx(found["coefficients"]["X_uu"]["value"])
    assert "learned live from replay:" in str(model.provenance.notes)
    assert len(read(tmp_path / "dive.mcap")["x"].measured) == 401
    assert "dive.mcap" in refused("live", *asked, "--record", tmp_path / "dive.mcap")  # never overwritten


def test_without_a_recording_the_last_minute_is_judged(log: Path) -> None:
    asked = ("live", f"replay:{log}@0", "--vehicle", VEHICLE, "--free", FREE)
    found = document(*asked)
    assert found["fit_of"] == "the last 16 s"
    assert found["fit"]["x"] > 95.0
    early = document(*asked, "--for", "0.05")
    assert early["fit_reason"] == "nothing was identified"
    assert set(early["fit"].values()) == {None}


def test_foxglove_is_served_where_it_says(log: Path) -> None:
    asked = ("live", f"replay:{log}@0", "--vehicle", VEHICLE, "--free", FREE, "--json")
    done = command(*asked, "--foxglove", "127.0.0.1:0")
    assert done.code == 0, done
    assert "foxglove: ws://127.0.0.1:" in done.err
    assert json.loads(done.out)["live"]["samples"] == 401
    assert "--foxglove" in refused(*asked, "--foxglove=nowhere")


def test_killed_and_gone_on_with(log: Path, tmp_path: Path) -> None:
    feed, port = datagrams(log), free_port()
    arguments = (f"json:127.0.0.1:{port}", "--record", "dive.mcap", "--json-lines")
    first = started(*arguments, cwd=tmp_path)
    send(feed[:130], port)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    missing = 130 - len(read(tmp_path / "dive.mcap")["x"])
    assert missing <= 25  # one second
    second = started(*arguments, "--resume", cwd=tmp_path)
    send(feed[130:260], port)
    time.sleep(0.3)
    second.send_signal(signal.SIGTERM)
    lines = [json.loads(line) for line in second.communicate()[0].splitlines()]
    assert second.returncode == 0
    assert len(lines) >= 4
    assert lines[-1]["final"]
    kept = read(tmp_path / "dive.mcap")
    assert len(kept["x"]) == 260 - missing
    assert lines[-1]["coefficients"]["X_uu"]["identified"]
    assert lines[-1]["duration_s"] == pytest.approx(10.4, abs=1.5)  # both parts
    assert not kept.repairs
    assert load_vehicle(tmp_path / "dive.toml").name == VEHICLE  # nobody asked: beside the recording
    assert any(note.startswith("live json:") for note in kept.notes)


def test_ctrl_c_ends_in_order(log: Path, tmp_path: Path) -> None:
    process = started(f"replay:{log}", "--record", "dive.mcap", "-o", "mine.toml", cwd=tmp_path)
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert "learned live, method joint" in out
    assert "model written to mine.toml" in out
    assert load_vehicle(tmp_path / "mine.toml").name == VEHICLE
    kept = read(tmp_path / "dive.mcap")
    assert 25 < len(kept["x"]) < 250
    assert not kept.repairs  # closed, with its summary


def test_lines_of_standard_input_are_learned_from(log: Path, tmp_path: Path) -> None:
    (tmp_path / "lines.json").write_bytes(b"\n".join(data for _, data in datagrams(log)) + b"\nbroken\n")
    command = [sys.executable, "-m", "towtank", "live", "-", "--vehicle", VEHICLE, "--free", FREE, "--json"]
    with (tmp_path / "lines.json").open("rb") as lines:
        done = subprocess.run(command, stdin=lines, capture_output=True, text=True, cwd=tmp_path, check=True)
    document = json.loads(done.stdout)
    assert document["live"]["instants"] == 401
    assert document["live"]["bad"] == 1
    assert document["coefficients"]["X_uu"]["identified"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("pigeon", "--vehicle", VEHICLE), 'source "pigeon": expected one of'),
        (("replay:none.csv", "--vehicle", VEHICLE), "none.csv: no such file"),
        (("json:127.0.0.1:5005", "--vehicle", "nemo"), "nemo"),
        (("json:127.0.0.1:5005", "--vehicle", VEHICLE, "--method", "output-error"), "expected one of"),
        (("json:127.0.0.1:5005", "--vehicle", VEHICLE, "--resume"), "--record FILE.mcap"),
        (("json:127.0.0.1:5005", "--vehicle", VEHICLE, "--record", "a.csv"), "ends in .mcap"),
        (("json:127.0.0.1:5005", "--vehicle", VEHICLE, "--window", "-1"), "--window"),
        (("json:127.0.0.1:5005", "--vehicle", VEHICLE, "--json", "--json-lines"), "expected one of them"),
        (("-", "-", "--vehicle", VEHICLE), "twice"),
        (("json:127.0.0.1:5005", "--vehicle", VEHICLE, "--plan", "none.toml"), "none.toml: no such file"),
        (("json:127.0.0.1:5005", "--vehicle", VEHICLE, "--plan", "PLAN", "--method", "paper"), "use joint"),
        (("json:127.0.0.1:5005", "--vehicle", "CUP", "--plan", "PLAN"), "has no thrusters"),
    ],
)
def test_wrong_arguments_are_one_line(arguments: tuple[str, ...], said: str, tmp_path: Path, plan: Path) -> None:
    from typer.testing import CliRunner

    from towtank.app.cli import app

    before = Path.cwd()
    there = {"PLAN": plan, "CUP": plan.with_name("cup.toml")}
    os.chdir(tmp_path)
    try:
        done = CliRunner().invoke(app, ["live", *(str(there.get(each, each)) for each in arguments)])
    finally:
        os.chdir(before)
    assert done.exit_code == 2
    line = done.stderr.strip().splitlines()[-1]
    assert said in line
    assert line.startswith("towtank")
    assert list(tmp_path.iterdir()) == []


def test_the_view_fits_eighty_columns(log: Path) -> None:
    vehicle = load_vehicle(VEHICLE)
    text = f"replay:{log}@0"
    session = Session([(text, open_source(text, vehicle))], vehicle, new_learner(vehicle, "joint"), epoch=time.time())
    readings = Readings(session, vehicle)
    session.open()
    status = session.run(threading.Event(), seconds=12.0)
    assert np.isclose(status.learnt.t - 0.0, 12.0, atol=2.0)
    output = Output()
    output.console = Console(width=80, height=60, record=True, file=io.StringIO(), force_terminal=True)
    output.console.print(LiveView(output, vehicle, "joint").picture(status, readings.read(status)))
    shown = output.console.export_text().splitlines()
    assert max(map(len, shown)) <= 80
    assert shown[0].startswith("seamor, method joint  0:00:")
    assert any(line.startswith("X_uu") and "±" in line and "%" in line for line in shown)
    assert any("dropped 0, late 0, bad 0" in line for line in shown)
    assert len(shown) < 60
    assert any(line.startswith("Nothing can be said yet") for line in shown)  # nobody judges this session
    assert any(line.startswith("prediction, 10 s: off by u 0.") for line in shown)
