"""The demo: what it says, writes and returns, and how well it learns."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from towtank.app.demo import files
from towtank.app.demo import run as demo
from towtank.app.demo import stream as streaming
from towtank.app.demo.progress import SETTLED, SETTLING, WAITING, LearningCurve, quantities, readings
from towtank.app.demo.run import run_demo
from towtank.app.demo.stream import pose_and_commands, stream
from towtank.app.demo.table import coefficient_table
from towtank.app.terminal.output import json_text
from towtank.errors import InputError
from towtank.identification import Learner, learn_recordings
from towtank.recording import read_parquet
from towtank.simulation import tank
from towtank.simulation.tank import FREE, tank_session, unseen_session
from towtank.vehicle import load_vehicle

FILES = {
    "demo.html",
    "vlbv300_learned.toml",
    "tank_session.parquet",
    "unseen_session.parquet",
    "convergence.png",
    "prediction.png",
}


@dataclass(frozen=True)
class Ran:
    folder: Path
    text: str
    document: dict[str, Any]


def console(*, terminal: bool = False) -> Console:
    return Console(file=io.StringIO(), width=80, highlight=False, force_terminal=terminal, color_system=None)


def text_of(shown: Console) -> str:
    assert isinstance(shown.file, io.StringIO)
    return shown.file.getvalue()


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    shown = console()
    document = run_demo(folder, seconds=20.0, fast=True, browser=True, console=shown)
    return Ran(folder, text_of(shown), json.loads(json_text(document)))


def test_it_writes_all_files_and_nothing_else(ran: Ran) -> None:
    assert {path.name for path in ran.folder.iterdir()} == FILES
    assert {Path(file).name for file in ran.document["files"]} == FILES
    assert all((ran.folder / name).stat().st_size > 1000 for name in FILES)


def test_the_document_has_what_scripts_rely_on(ran: Ran) -> None:
    document = ran.document
    assert (document["vehicle"], document["seconds"], document["samples"]) == ("vlbv300", 20.0, 2000)
    assert set(document["coefficients"]) > set(FREE)
    entry = document["coefficients"]["Y_vdot"]
    assert set(entry) == {"truth", "value", "std", "unit", "identified", "reason", "error_percent", "error_in_std"}
    assert entry["identified"]
    assert entry["error_in_std"] == pytest.approx((entry["value"] - entry["truth"]) / entry["std"])
    assert document["sums"]["m - Y_vdot"]["truth"] == pytest.approx(37.65)
    assert set(document["latency_ms"]) == {"median", "p99", "max"}
    assert document["fit"]["theta"] > 50.0


def test_piped_output_is_plain_lines(ran: Ran) -> None:
    assert "\x1b" not in ran.text
    assert "\r" not in ran.text
    told = [line.split()[2] for line in ran.text.splitlines() if " s  " in line and "±" in line]
    assert told == ["surge", "sway", "heave", "roll", "yaw", "pitch"]
    assert "towtank learn YOUR_LOG --vehicle" in ran.text


def test_the_page_stands_alone(ran: Ran) -> None:
    page = (ran.folder / "demo.html").read_text(encoding="utf-8")
    assert page.count('class="chart"') >= len(FREE) + 6 + 6  # settling, predictions, their errors
    assert "<script" not in page
    assert "src=" not in page
    assert str(ran.folder) not in page
    assert "m − X_udot" in page
    assert "of the truth" in page
    assert 'class="truth"' in page


def test_the_model_and_the_logs_can_be_read_again(ran: Ran) -> None:
    model = load_vehicle(ran.folder / "vlbv300_learned.toml")
    assert model.command_delay == pytest.approx(0.05, abs=0.01)
    assert model.hydrodynamics["Y_vv"].std is not None
    assert model.hydrodynamics["Y_vv"].value == pytest.approx(ran.document["coefficients"]["Y_vv"]["value"])
    log = read_parquet(ran.folder / "tank_session.parquet")
    assert {"x", "psi", "cmd_aft_port"} <= set(log.names)
    assert read_parquet(ran.folder / "unseen_session.parquet").duration == 30.0


@contextmanager
def sketched() -> Iterator[None]:
    """Run demos without their pictures and their warm-up, which `ran` has, and with one reading a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "png", lambda figure: bytes(2000))
        patch.setattr(demo, "warm_up", lambda: None)
        patch.setattr(streaming, "_READING", 1.0)
        yield


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """The shortest session, on a terminal."""
    folder, shown = tmp_path_factory.mktemp("short"), console(terminal=True)
    with sketched():
        document = run_demo(folder, seconds=2.0, fast=True, browser=False, console=shown)
    return Ran(folder, text_of(shown), document)


def test_a_terminal_gets_a_live_table(short: Ran) -> None:
    assert "\x1b[" in short.text
    assert "2 of 2 s, 0 s to go: finished" in short.text
    last = short.text.rsplit("Coefficient", 1)[1]
    assert "m - X_udot" in last
    assert max(len(line) for line in last.splitlines() if "\x1b" not in line and "towtank" not in line) <= 80


def test_a_payload_is_noticed_told_and_learned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fifteen seconds with the payload are enough for all that is promised of three quarters of a minute."""
    assert tank.PAYLOAD_TAIL == 60.0
    monkeypatch.setattr(tank, "PAYLOAD_TAIL", 30.0)
    shown = console()
    with sketched():
        document = run_demo(tmp_path, seconds=12.0, fast=True, payload=True, console=shown)
    assert document["seconds"] == 42.0
    (change,) = [event for event in document["events"] if event["kind"] == "change"]
    assert change["t"] == pytest.approx(27.0, abs=1.0)
    assert change["details"]["noticed"] < 32.0
    assert "net weight +" in change["text"]
    weight = document["coefficients"]["W_minus_B"]
    assert weight["truth"] == 2.0
    assert weight["value"] == pytest.approx(2.0, abs=max(4.0 * weight["std"], 0.2))
    assert document["coefficients"]["Z_ww"]["truth"] == pytest.approx(1.3 * -61.836, rel=1e-3)
    assert document["sums"]["m - X_udot"]["truth"] == pytest.approx(42.419)
    assert document["sums"]["m - X_udot"]["error_percent"] == pytest.approx(0.0, abs=2.0)
    text = text_of(shown)
    assert "0:00:2" in text
    assert "net weight +" in text
    page = (tmp_path / "demo.html").read_text(encoding="utf-8")
    assert "What happened" in page
    assert "a payload taken up after 27 s" in page
    assert page.count('class="truth"') >= len(FREE) + 1
    assert load_vehicle(tmp_path / "vlbv300_learned.toml").weight_minus_buoyancy == pytest.approx(weight["value"])
    assert {path.name for path in tmp_path.iterdir()} == FILES


def test_the_table_fits_an_old_terminal() -> None:
    truth = tank_session(2.0).truth
    shown = Console(file=io.StringIO(), width=80, highlight=False)
    shown.print(coefficient_table(LearningCurve(quantities(truth)), "surge", ascii_only=True))
    text = text_of(shown)
    assert text.isascii()
    assert "…" not in text
    assert len(text.splitlines()) <= 16


@pytest.mark.parametrize("seconds", [0.5, 1e5, float("nan")])
def test_a_session_too_short_or_too_long_is_refused(tmp_path: Path, seconds: float) -> None:
    with pytest.raises(InputError, match=r"--seconds: found .*, expected 2 to 3600"):
        run_demo(tmp_path / "out", seconds=seconds, fast=True, browser=False, console=console())
    assert not (tmp_path / "out").exists()


def test_a_file_in_place_of_the_folder_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(InputError, match="found a file, expected a folder"):
        run_demo(tmp_path / "taken", seconds=2.0, fast=True, browser=False, console=console())
    assert (tmp_path / "taken").read_text() == "mine"


def test_a_short_session_says_what_it_could_not_learn(short: Ran) -> None:
    missing = [entry for entry in short.document["coefficients"].values() if not entry["identified"]]
    assert missing
    assert all(entry["reason"] for entry in missing)
    assert {path.name for path in short.folder.iterdir()} == FILES


def test_real_time_takes_the_time_of_the_session() -> None:
    session = tank_session(2.0)
    moments: list[float] = []
    began = time.perf_counter()
    course = LearningCurve(quantities(session.truth))
    stream(
        session,
        Learner(session.known),
        course,
        paced=True,
        show=lambda moment: moments.append(moment.t),
    )
    assert time.perf_counter() - began >= 1.95
    assert len(moments) >= 5
    assert moments[-1] == 2.0


def test_the_session_is_the_same_every_time_and_stays_in_the_tank() -> None:
    times, poses, commands = pose_and_commands(tank_session())
    again = pose_and_commands(tank_session())
    assert np.array_equal(poses, again[1])
    assert np.array_equal(commands, again[2])
    assert not np.array_equal(poses, pose_and_commands(tank_session(seed=2))[1])
    assert times[-1] == pytest.approx(179.99)
    assert np.abs(commands).max() < 60.0  # within the range of the thrusters' bench fit
    extent = np.ptp(poses[:, :3], axis=0)
    assert (extent < 4.0).all()
    assert (poses[:, 2] > 0.0).all()


def test_every_axis_has_its_turn_and_rests_lie_between() -> None:
    session = tank_session(60.0)
    assert [session.axis_at(t) for t in (5.0, 15.0, 25.0, 35.0, 45.0, 55.0)] == [
        "surge", "sway", "heave", "roll", "yaw", "pitch"
    ]  # fmt: skip
    assert session.axis_at(10.0) == ""
    assert unseen_session().turns == ()


def test_the_learner_is_told_no_coefficient() -> None:
    session = tank_session(2.0)
    assert not session.known.hydrodynamics
    assert session.known.coefficient("BG_z") == 0.0
    assert session.known.rigid_body == session.truth.rigid_body


def test_the_states_of_a_course() -> None:
    truth = tank_session(2.0).truth
    course = LearningCurve(quantities(truth)[:1])
    assert course.states == (WAITING,)
    for t in range(12):
        course.t.append(float(t))
        course.values.append(np.array([np.nan if t < 2 else 40.0 + (3.0 if t < 5 else 0.0)]))
        course.std.append(np.array([0.5]))
    assert course.states == (SETTLED,)
    assert LearningCurve(course.learned, course.t[:9], course.values[:9], course.std[:9]).states == (SETTLING,)
    assert LearningCurve(course.learned, course.t[:2], course.values[:2], course.std[:2]).states == (WAITING,)


def test_the_session_teaches_what_the_demo_promises() -> None:
    session = tank_session()
    learning = learn_recordings(session.known, [session.recording])
    assert learning.method == "joint"
    assert learning.delay == pytest.approx(0.05, abs=3.0 * learning.delay_std)
    learned = quantities(session.truth)
    values, std = readings(learning.estimate, learned)
    for quantity, value, deviation in zip(learned, values, std, strict=True):
        limit = 7.0 if quantity.kind == "drag" else 1.0  # linear drag is learned beside it
        error = 100.0 * abs(value / quantity.truth - 1.0)
        assert error <= limit, f"{quantity.name}: {error:.2f} % off, promised {limit:g} %"
        assert abs(value - quantity.truth) <= 3.0 * deviation, quantity.name
