"""The report of `towtank live`: at its end, and while it learns."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from towtank.app.live.reports import LearnedCurve, LiveReports
from towtank.app.live.session import LiveOptions
from towtank.identification import Learner
from towtank.live import open_source
from towtank.live.session import Session
from towtank.recording.event import Event
from towtank.report.sections.events import event_section
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import load_vehicle

from .pages import Page, numbers_agree, run

VEHICLE, SECONDS, WHEN = "seamor", 40.0, 25.0
ASKED = ("--vehicle", VEHICLE, "--free", "X_udot,X_uu")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vehicle that takes up four kilograms."""
    bare = load_vehicle(VEHICLE)
    heavy = bare.with_coefficients({"X_udot": bare.coefficient("X_udot") - 4.0, "X_uu": 1.3 * bare.coefficient("X_uu")})
    plan = manoeuvre("surge-square", bare, duration=SECONDS, dt=0.02, seed=1)
    path = tmp_path_factory.mktemp("live") / "payload.csv"
    simulate(
        bare,
        commands=plan.commands,
        dt=0.02,
        sensors=Mocap(rate=50.0),
        disturbance=OrnsteinUhlenbeck(std=0.1),
        changes=[(WHEN, heavy)],
        seed=1,
    ).write(path)
    return path


def test_at_the_end_it_says_what_happened(log: Path, tmp_path: Path) -> None:
    report, record = tmp_path / "report.html", tmp_path / "dive.mcap"
    document = run("live", f"replay:{log}@0", *ASKED, "--record", record, "--report", report)
    page = Page(report.read_text(encoding="utf-8"))
    page.self_contained()
    assert {"coefficients", "events", "prediction", "convergence", "log", "origin"} <= set(page.sections)
    assert "the vehicle changed" in page.text
    assert "surge inertia +" in page.text.lower()
    assert "since the vehicle changed" in page.text
    assert page.html.count('class="cut"') >= 2  # one in each chart of the course
    assert f"towtank live replay:{log}@0 --vehicle seamor --record {record}" in page.text
    keys = {key for key, _, _ in page.numbers}
    assert {"coefficients/X_udot/value", "coefficients/X_uu/interval/0", "duration_s", "samples"} <= keys
    fits = {key.partition("/")[2]: value for key, value, _ in page.numbers if key.startswith("fit/")}
    assert fits["x"] > 70.0
    errors = {key.partition("/")[2]: value for key, value, _ in page.numbers if key.startswith("rmse/")}
    numbers_agree(page, {**document, "fit": fits, "rmse": errors})


def test_it_can_be_had_while_it_learns(log: Path) -> None:
    vehicle, text = load_vehicle(VEHICLE), f"replay:{log}@0"
    learner = Learner(vehicle, free=("X_udot", "X_uu"))
    session = Session([(text, open_source(text, vehicle))], vehicle, learner, epoch=time.time())
    reports = LiveReports(session, LiveOptions((text,), VEHICLE))
    session.open()
    thread = threading.Thread(target=session.run, args=(threading.Event(),))
    thread.start()
    while not session.learning.now.instants:
        time.sleep(0.01)
    early = Page(reports.now().decode())
    thread.join()
    assert "events" not in early.sections
    assert session.learning.now.instants > 1500
    late = Page(reports.now().decode())
    assert "events" in late.sections
    assert "the last 15 s, since the vehicle changed" in late.text


def test_events_stand_in_the_order_of_their_time() -> None:
    later = Event(30.0, "mark", "skid <b>fitted</b>")
    change = Event(10.0, "change", "net weight +2.0 ± 0.1 N", {"noticed": 11.25})
    html = event_section((later, change), 1.7e9)
    page = Page(html)
    assert html.index("Net weight") < html.index("Skid")
    assert "&lt;b&gt;" in html
    assert "noticed 1.2 s later" in page.text
    assert "22:13:30" in page.text
    assert "UTC" not in event_section((change,), float("nan"))
    assert event_section((), 0.0) == ""


def test_estimates_over_time_are_kept_in_constant_memory() -> None:
    vehicle = load_vehicle(VEHICLE)
    learner = Learner(vehicle, free=("X_udot", "X_uu"))
    curve = LearnedCurve(learner)
    for k in range(10_000):
        curve(0.5 * k, {})
    kept = curve.convergence(learner.estimate)
    assert 400 <= kept.t.size <= 800
    assert kept.t[-1] > 4900.0
    assert np.all(np.diff(kept.t) >= 0.5)
