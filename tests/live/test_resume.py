"""A session that is gone on with, from its recording and from a checkpoint beside it."""

from __future__ import annotations

import json
import os
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank import Learner, load_vehicle
from towtank.errors import InputError
from towtank.live.links.source import Raw, Sample
from towtank.live.pipeline.instants import rows_of
from towtank.live.pipeline.sorter import Arrival
from towtank.live.recording.checkpoint import Checkpoint, Earlier, earlier
from towtank.live.recording.recorder import Recorder
from towtank.live.session import Session
from towtank.live.warm_up import new_learner
from towtank.readers import read
from towtank.recording import Recording
from towtank.recording.mcap.log import McapLog
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import Vehicle

from .learners import Counting

FREE = ("X_udot", "X_uu")
EPOCH = 1.7e9


class Lines:
    """A link that has its samples ready."""

    name, keeps_time, patient = "test", True, True

    def __init__(self, samples: list[Sample]) -> None:
        self._samples = samples

    def open(self) -> None:
        pass

    def read(self, timeout: float) -> list[Sample]:
        batch, self._samples = self._samples[:50], self._samples[50:]
        return batch

    def state(self) -> Any:
        from towtank.live.links.source import SourceState

        return SourceState(ended=not self._samples)

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("seamor")


@pytest.fixture(scope="module")
def run(vehicle: Vehicle) -> Recording:
    plan = manoeuvre("surge-sine", vehicle, duration=16.0, dt=0.01, seed=2)
    return simulate(vehicle, commands=plan.commands, dt=0.01, sensors=Mocap(rate=100.0), seed=2)


def part(run: Recording, start: float, end: float) -> Lines:
    return Lines(
        [
            Sample("test", "all", EPOCH + t, EPOCH + t, names, values)
            for t, names, values in rows_of(run)
            if start <= t < end
        ]
    )


def learned(
    link: Lines, vehicle: Vehicle, learner: Learner, path: Path, *, checkpoint: Checkpoint | None = None, **before: Any
) -> Learner:
    log = McapLog.resume(path) if path.exists() else McapLog.open(path, epoch=datetime.fromtimestamp(EPOCH, UTC))
    made = Session([("test", link)], vehicle, learner, epoch=EPOCH, log=log, checkpoint=checkpoint)
    if before:
        made.learning.catch_up(before["rows"], since=before["since"], inputs=before["inputs"])
    made.open()
    made.run(threading.Event())
    return learner


def test_a_session_gone_on_with_ends_where_an_uninterrupted_one_does(
    vehicle: Vehicle, run: Recording, tmp_path: Path
) -> None:
    whole = learned(part(run, 0.0, 16.0), vehicle, new_learner(vehicle, "joint", FREE), tmp_path / "whole.mcap")
    path = tmp_path / "dive.mcap"
    learned(part(run, 0.0, 8.0), vehicle, new_learner(vehicle, "joint", FREE), path)
    before = earlier(path, vehicle, Checkpoint(path, {}))
    assert before.epoch == EPOCH
    again = new_learner(vehicle, "joint", FREE)
    rows = before.rows(lambda text, share: None)
    learned(part(run, 8.0, 16.0), vehicle, again, path, rows=rows, since=before.since, inputs=before.inputs)
    again.settle()
    whole.settle()
    change = np.abs(again.estimate.values - whole.estimate.values)
    assert np.all(change < 2.0 * np.maximum(whole.estimate.std, again.estimate.std))
    assert again.estimate.samples > 1600 - 2 * 60  # but for what thrusters answer to before either part


class Kept(Counting):
    """What `Learner.save` and `load` are expected to do, with a learner whose memory is a list."""

    keeps_checkpoints = True

    def __init__(self, seen: list[float] | None = None) -> None:
        super().__init__()
        self.seen = seen or []

    def save(self, path: Path) -> None:
        Path(path).write_text(" ".join(map(repr, self.seen)))

    @classmethod
    def load(cls, path: Path, vehicle: Vehicle, **settings: Any) -> Kept:
        return cls([float(text) for text in Path(path).read_text().split()])


def test_a_checkpoint_spares_what_it_holds(
    vehicle: Vehicle, run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "dive.mcap"
    checkpoint = Checkpoint(path, {"method": "joint", "free": ("X_u",)})
    first = Kept()
    learned(part(run, 0.0, 4.0), vehicle, first, path, checkpoint=checkpoint)  # type: ignore[arg-type]
    assert checkpoint.path == tmp_path / "dive.mcap.state"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["dive.mcap", "dive.mcap.state"]
    learned(part(run, 4.0, 6.0), vehicle, Kept(), path)  # type: ignore[arg-type]
    monkeypatch.setattr(Learner, "load", Kept.load)
    before = earlier(path, vehicle, Checkpoint(path, {"method": "joint", "free": ["X_u"]}))
    assert isinstance(before.learner, Kept)
    assert before.learner.seen == first.seen
    assert before.since == pytest.approx(3.99, abs=1e-6)
    assert len(before.inputs) == len(vehicle.thrusters)
    rows = list(before.rows(lambda text, share: None))
    assert len(rows) == 200
    assert rows[0][0] == pytest.approx(4.0, abs=1e-6)
    other = earlier(path, vehicle, Checkpoint(path, {"method": "paper", "free": ["X_u"]}))
    assert other.learner is None  # of other settings: everything is learned once more
    assert len(list(other.rows(lambda text, share: None))) == 600


def test_a_damaged_checkpoint_is_passed_over(vehicle: Vehicle, run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    learned(part(run, 0.0, 2.0), vehicle, new_learner(vehicle, "joint", FREE), path)
    checkpoint = Checkpoint(path, {})
    for content in (b"", b"{", b'{"version": 2}\n', b"\xff\n\n", b'{"version": 2, "t": "x"}\nabc'):
        checkpoint.path.write_bytes(content)
        assert earlier(path, vehicle, checkpoint).learner is None


def test_nothing_of_killed_sessions_stays_in_memory(tmp_path: Path) -> None:
    memory = Path("/dev/shm")
    if not memory.is_dir():
        pytest.skip("no folder in memory")
    left = memory / "towtank-4194305-test"  # a number that no process has
    left.mkdir(exist_ok=True)
    (left / "part").write_bytes(b"part")
    others = set(memory.glob(f"towtank-{os.getpid()}-*"))
    checkpoint = Checkpoint(tmp_path / "dive.mcap", {})
    assert checkpoint.save(Kept([1.0]), 1.0, wait=True)  # type: ignore[arg-type]
    assert not left.exists()
    [own] = set(memory.glob(f"towtank-{os.getpid()}-*")) - others
    assert list(own.iterdir()) == []
    del checkpoint
    assert not own.exists()


def test_a_checkpoint_that_cannot_be_written_is_said_and_no_more(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "gone" / "dive.mcap", {})
    assert not checkpoint.save(Kept([1.0]), 1.0, wait=True)  # type: ignore[arg-type]
    assert "dive.mcap.state" in checkpoint.trouble


def test_a_recording_of_other_thrusters_is_refused(vehicle: Vehicle, run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    learned(part(run, 0.0, 1.0), vehicle, new_learner(vehicle, "joint", FREE), path)
    with pytest.raises(InputError, match="thruster"):
        earlier(path, load_vehicle("bluerov2_heavy"), Checkpoint(path, {}))


def test_a_computer_whose_clock_lies_behind_the_recording_goes_on_from_its_end(
    run: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = Earlier(EPOCH, recording=run)
    now = EPOCH + run.end + 5.0
    monkeypatch.setattr("towtank.live.recording.checkpoint.steady_time", lambda: now)
    assert before.now_epoch() == EPOCH
    now = EPOCH - 86_400.0
    assert now - before.now_epoch() == pytest.approx(run.end + 3.0, abs=1e-3)


def test_a_checkpoint_after_another_waits_for_it_and_takes_its_place(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "dive.mcap", {"method": "joint"})
    for k in range(3):
        assert checkpoint.save(Kept([float(k)]), float(k), wait=True)  # type: ignore[arg-type]
    head, _, body = checkpoint.path.read_bytes().partition(b"\n")
    assert json.loads(head) == {"version": 2, "method": "joint", "t": 2.0}
    assert body == b"2.0"
    assert [each.name for each in tmp_path.iterdir()] == ["dive.mcap.state"]


def test_while_one_waits_for_the_disk_no_other_is_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    busy, seen = threading.Event(), Checkpoint._put
    monkeypatch.setattr(Checkpoint, "_put", lambda self, head, part: (busy.wait(20.0), seen(self, head, part)))
    checkpoint = Checkpoint(tmp_path / "dive.mcap", {})
    assert checkpoint.save(Kept([1.0]), 1.0)  # type: ignore[arg-type]
    assert not checkpoint.save(Kept([2.0]), 2.0)  # type: ignore[arg-type]
    busy.set()
    assert checkpoint.save(Kept([3.0]), 3.0, wait=True)  # type: ignore[arg-type]
    assert b'"t": 3.0' in checkpoint.path.read_bytes()
    assert checkpoint.trouble == ""


def test_a_learner_that_keeps_no_checkpoint_writes_none(tmp_path: Path) -> None:
    class Forgetful(Kept):
        keeps_checkpoints = False

    assert not Checkpoint(tmp_path / "dive.mcap", {}).save(Forgetful(), 1.0, wait=True)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_why_a_checkpoint_cannot_be_written_is_told_in_the_systems_words(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "gone" / "dive.mcap", {})
    checkpoint.save(Kept([1.0]), 1.0, wait=True)  # type: ignore[arg-type]
    assert checkpoint.trouble == f"{checkpoint.path}: No such file or directory"

    class Refuses(Kept):
        def save(self, path: Path) -> None:
            raise InputError("is not to be saved")

    assert not checkpoint.save(Refuses(), 1.0, wait=True)  # type: ignore[arg-type]
    assert checkpoint.trouble == f"{checkpoint.path}: is not to be saved"
    (tmp_path / "gone").mkdir()
    assert checkpoint.save(Kept([1.0]), 1.0, wait=True)  # type: ignore[arg-type]
    assert checkpoint.trouble == ""


def test_columns_that_come_later_are_sources_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recorder = Recorder(McapLog.open(path))
    recorder.start()

    def put(t: float, **values: float) -> None:
        sample = Sample("json", "/a b/", t, t, tuple(values), tuple(values.values()))
        recorder.put([Arrival(t, t, 0, sample)], [])

    put(0.0, u=1.0, v=2.0)
    put(0.1, u=3.0)
    put(0.2, w=4.0, u=5.0)
    put(0.3, p=6.0)
    put(0.4, w=7.0)
    recorder.close(["all of it"])
    assert recorder.state().count == 5
    assert recorder.state().lost == 0
    found = read(path)
    assert [(each.name, each.count) for each in found.contents] == [
        ("/json/a_b", 3),
        ("/json/a_b 2", 2),
        ("/json/a_b 3", 1),
    ]
    assert found["u"].values.tolist() == [1.0, 3.0, 5.0]
    assert found["w"].t.tolist() == [0.2, 0.4]
    assert found.notes == ("all of it",)


def test_what_a_disk_does_not_take_in_time_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.live.recording.recorder._PATIENCE", 300)
    recorder = Recorder(McapLog.open(tmp_path / "a.mcap"))  # not started: nothing is written
    sample = Sample("json", "a", 0.0, 0.0, ("u",), (1.0,))
    for k in range(4):
        recorder.put([Arrival(0.1 * k, 0.0, 0, sample)], [])
    recorder.put([], [])
    recorder.put([], [(0.5, Raw("json", "a", 0.5, b"x" * 200))])
    assert (recorder.state().count, recorder.state().lost) == (2, 3)
    recorder.start()
    recorder.close()
    assert read(tmp_path / "a.mcap").notes == ("3 samples and packets were lost: the disk did not take them",)


def test_inputs_in_force_and_the_rows_that_follow(run: Recording) -> None:
    told: list[float] = []
    before = Earlier(EPOCH, since=15.0, recording=run)
    rows = list(before.rows(lambda text, share: told.append(share)))
    assert rows[0][0] == pytest.approx(15.01)
    assert told[0] == pytest.approx(0.01 / (run.end - 15.0))
    assert told[-1] == pytest.approx(1.0)
    assert list(Earlier(EPOCH).rows(lambda text, share: None)) == []
    whole: list[float] = []
    assert len(list(Earlier(EPOCH, recording=run).rows(lambda text, share: whole.append(share)))) == len(whole)
    assert whole[0] == 0.0
