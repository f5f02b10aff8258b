"""The verdict of a session, in the words of the report, and thrusters that are not as the file says."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from towtank.app.live.judge import Driven, Judge, Moment
from towtank.app.live.session import _judge
from towtank.app.tables.fits import usable_document
from towtank.identification import Learner
from towtank.live import Raw, Sample, SourceState
from towtank.live.learning import Row
from towtank.live.pipeline.instants import rows_of
from towtank.live.session import Session
from towtank.live.warm_up import new_learner
from towtank.recording import Recording
from towtank.recording.event import Event
from towtank.report.verdict import learn_verdict, usable_text
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.validation import Usability
from towtank.vehicle import Vehicle, load_vehicle
from towtank.vehicle.thrusters.wiring import Wiring, rewired

from .commands import document

EPOCH = 1.7e9
WRONG = "thruster 1 (hor_front_stbd) pushes the other way than the file says"


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("bluerov2")


@pytest.fixture(scope="module")
def run(vehicle: Vehicle) -> Recording:
    plan = manoeuvre("all-multisine", vehicle, duration=65.0, dt=0.04, seed=1)
    return simulate(vehicle, commands=plan.commands, dt=0.04, sensors=Mocap(rate=25.0), seed=1)


def rows(run: Recording) -> list[Row]:
    return list(rows_of(run))


class Link:
    name, patient, keeps_time = "test", True, True

    def __init__(self, run: Recording) -> None:
        every = [Sample("test", "all", EPOCH + t, EPOCH + t, *pair) for t, *pair in rows_of(run)]
        self._batches = iter([every[k : k + 20] for k in range(0, len(every), 20)])
        self._ended = False

    def open(self) -> None:
        pass

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        batch = next(self._batches, None)
        self._ended = batch is None
        return batch or []

    def state(self) -> SourceState:
        return SourceState(ended=self._ended)

    def close(self) -> None:
        pass


def judged(vehicle: Vehicle, run: Recording) -> tuple[Judge, Session]:
    learner = new_learner(vehicle, "paper")
    link: Any = Link(run)
    session = Session([("test", link)], vehicle, learner, epoch=EPOCH)
    judge = _judge(session, vehicle)
    session.open()
    session.run(threading.Event())
    judge.judge()
    return judge, session


def test_the_verdict_is_that_of_the_report(vehicle: Vehicle, run: Recording) -> None:
    judge, session = judged(vehicle, run)
    assert judge.use is not None
    assert {each.axis for each in judge.use.good} >= {"surge", "sway", "heave", "yaw"}
    estimate = session.learning.learner.estimate
    assert judge.text.startswith(f"{usable_text(judge.use).text}, judged on the last 60 s. ")
    told = learn_verdict(estimate, {}, "the last 60 s", (), (True, True, True, True, False, True), judge.use).text
    assert judge.text == told
    assert judge.findings == ()
    found = usable_document(judge.use)
    assert found is not None
    assert judge.text.startswith(found["text"])


def test_before_anything_is_learned_it_says_what_to_drive(vehicle: Vehicle) -> None:
    """Of what the thrusters can drive by themselves, and of nothing else."""
    boat = load_vehicle("blueboat")
    for each, named in ((vehicle, "surge, sway, heave, roll and yaw"), (boat, "surge and yaw")):
        learner = Learner(each)

        def look(learner: Learner = learner) -> Moment:
            return Moment(learner.model(), learner.estimate, None, ())

        judge = Judge(each, look)
        judge.judge()
        assert judge.text.startswith("Not usable. Nothing could be identified: ")
        assert judge.text.endswith(f" Next: drive {named}, each by itself, up and down in steps.")


def test_it_does_not_go_on_saying_that_nothing_is_known(
    vehicle: Vehicle, run: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until something is identified it looks again soon, then in its own time."""
    monkeypatch.setattr("towtank.app.live.judge._SOON", 0.01)
    monkeypatch.setattr("towtank.app.live.judge._PERIOD", 1000.0)
    before, after = Learner(vehicle, method="paper"), Learner(vehicle, method="paper")
    after.run(run)
    looks: list[bool] = []
    third = threading.Event()

    def look() -> Moment:
        looks.append(len(looks) >= 2)
        if looks[-1]:
            third.set()
        learner = after if looks[-1] else before
        return Moment(learner.model(), learner.estimate, run if looks[-1] else None, ())

    judge = Judge(vehicle, look)
    with judge:
        assert third.wait(60.0)
    assert judge.text.startswith("Usable")
    assert looks == [False, False, True]


def test_a_thruster_that_pushes_the_other_way_is_an_event_and_in_the_verdict(vehicle: Vehicle, run: Recording) -> None:
    wrong = rewired(vehicle, Wiring((0,)))
    judge, session = judged(wrong, run)
    events = [each for each in session.events.all if each.kind == "wiring"]
    assert len(events) == 1
    assert events[0].text.startswith(f"{WRONG}; it is learned as the file has them")
    assert f"omething cannot be right: {events[0].text}" in judge.text
    assert session.learning.learner.vehicle is wrong  # the estimate goes on as it was asked for
    assert [each.direction for each in session.learning.learner.model().thrusters] == [
        each.direction for each in wrong.thrusters
    ]


def test_the_wiring_is_looked_at_as_driving_goes_on(run: Recording) -> None:
    driven = Driven()
    looked: list[float] = []
    for minute in range(5):
        for t, names, values in rows(run):
            driven.add(60.0 * minute + t, dict(zip(names, values, strict=True)))
            if t > 60.0:
                break
            if found := driven.due():
                looked.append(driven.seconds)
                assert sum(each.duration for each in found) == pytest.approx(driven.seconds, abs=0.2)
    assert looked == pytest.approx([30.0, 60.0, 120.0, 240.0], abs=0.1)
    assert driven.due() == []
    assert driven._stretches == [[]]  # nothing more is kept


def test_stretches_that_are_left_out_are_no_driving(run: Recording) -> None:
    driven = Driven()
    for t, names, values in rows(run):
        if 10.0 <= t < 40.0:
            continue
        if t == 40.0:
            driven.break_off()
        driven.add(t, dict(zip(names, values, strict=True)))
    found = driven.due()
    assert driven.seconds == pytest.approx(35.0, abs=0.2)
    assert [(each.start, each.end) for each in found] == [
        (0.0, pytest.approx(9.96)),
        (40.0, pytest.approx(65.0, abs=0.05)),
    ]


def test_a_change_of_the_vehicle_begins_the_judging_anew(vehicle: Vehicle, run: Recording) -> None:
    learner = Learner(vehicle, method="paper")
    learner.run(run)

    def used(at: float) -> Usability | None:
        moment = Moment(learner.model(), learner.estimate, run, [Event(at, "change", "a payload")])
        judge = Judge(vehicle, lambda: moment)
        judge.judge()
        return judge.use

    whole, part, late = used(-5.0), used(45.0), used(63.5)
    assert whole is not None
    assert part is not None
    assert late is not None
    assert (whole.duration, part.duration) == (pytest.approx(65.0, abs=0.1), pytest.approx(20.0, abs=0.1))
    assert late.axes == ()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, run: Recording, vehicle: Vehicle) -> Path:
    import towtank as tt

    folder = tmp_path_factory.mktemp("wiring")
    run.write(folder / "run.csv")
    tt.save_vehicle(rewired(vehicle, Wiring((0,))), folder / "wrong.toml")
    return folder


def test_validate_says_first_that_a_thruster_pushes_the_other_way(files: Path) -> None:
    wrong = document("validate", files / "wrong.toml", files / "run.csv")
    assert wrong["verdict"].startswith(
        f"Something cannot be right: {WRONG}; the model is judged as its file has them. "
    )
    assert [each["what"] for each in wrong["findings"]] == ["thrusters"]
    right = document("validate", "bluerov2", files / "run.csv")
    assert right["findings"] == []
    assert right["verdict"].startswith("Usable")
    assert wrong["fit"]["psi"] < right["fit"]["psi"]  # it is judged as it is
