"""The drive against a simulated ArduSub: faults in simulated time, walls, and a live session over real sockets."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import drive_link
import drive_study
from drive_rig import FAULTS, Rig, World
from simulated_sub import SimulatedSub

from towtank.live.driving.interlock import PERIOD, Stage
from towtank.live.driving.sticks import Way
from towtank.vehicle import load_vehicle

WITHIN = 0.3  # s
OVER_SOCKETS = ("pose", "link, from the vehicle", "link, both ways", "operator lets go", "arm switch")


def rig(way: Way = Way.MANUAL, **changes: object) -> Rig:
    sub = SimulatedSub(load_vehicle(drive_study.VEHICLE), drive_study.START, **changes)  # type: ignore[arg-type]
    found = Rig(sub, drive_study.helm(), drive_study.gentle(), way, world=World(key=False))
    found.run(0.6)
    return found


def begun(found: Rig) -> Rig:
    assert found.switch(True) == ""
    found.begin()
    found.world.key = True
    return found


@pytest.mark.parametrize("way", list(Way))
def test_every_fault_stops_thrust_in_time_and_nothing_is_sent_afterwards(way: Way) -> None:
    rng = np.random.default_rng(5)
    one = Rig(
        SimulatedSub(load_vehicle(drive_study.VEHICLE), drive_study.START),
        drive_study.helm(),
        drive_study.gentle(),
        way,
    )
    for number in range(len(FAULTS)):
        found = drive_study.befall(one, rng, number)
        assert found.after == 0, found
        assert found.commands <= WITHIN, found
        assert found.thrust <= WITHIN, found


@pytest.mark.parametrize("way", list(Way))
def test_a_segment_is_driven_as_it_was_planned_and_then_let_go_of(way: Way) -> None:
    found = begun(rig(way))
    found.run(found.lead + 1.0 + 4 * PERIOD)
    wanted, sticks = found.wrench[24], found.helm.sticks_of
    given = sticks.forces(sticks.of_wrench(wanted[None])[0]) @ found.helm.guard.brake.matrix.T
    assert found.sub.outputs == pytest.approx(sticks.commands(sticks.of_wrench(wanted[None])[0]), abs=3.0)
    full = np.abs(sticks.forces(np.eye(6)) @ found.helm.guard.brake.matrix.T).max(axis=0)
    assert np.abs((given - wanted) / full).max() < 0.03
    found.run(8.0)
    assert found.stage is Stage.READY
    assert found.said[1:] == ["drives", "thrust off at the end of the segment"]
    assert not found.sub.thrusting


def test_a_vehicle_off_its_file_is_kept_off_the_walls_through_the_mixer() -> None:
    clearance, bent = drive_study.wall(3)
    assert clearance > 0.0
    assert bent > 0.2


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"gain": 0.5}, "the pilot's gain is 50 %"),
        ({"frame": 1}, "FRAME_CONFIG is 1"),
        ({"parameters": {"FS_PILOT_INPUT": 0.0}}, "FS_PILOT_INPUT is off"),
    ],
)
def test_a_vehicle_that_would_not_do_as_told_is_not_driven(changes: dict[str, object], said: str) -> None:
    shown = {name: value for name, value in changes.items() if name != "frame"}
    found = rig(**shown)
    if "frame" in changes:
        found.sub.parameters["FRAME_CONFIG"] = float(changes["frame"])  # type: ignore[arg-type]
    assert said in found.switch(True)
    found.begin()
    found.world.key = True
    found.run(2.0)
    assert found.sent == []


def test_half_the_pilots_gain_does_not_matter_where_channels_are_overridden() -> None:
    found = begun(rig(Way.RC, gain=0.5))
    found.run(1.0)
    assert found.stage is Stage.DRIVING
    assert found.sub.thrusting


def test_an_autopilot_that_obeys_another_ground_station_is_spoken_to_as_that_one() -> None:
    found = begun(rig(master=249))
    found.run(1.0)
    assert found.sub.thrusting


def test_where_the_autopilot_goes_on_for_long_without_sticks_it_is_said() -> None:
    found = begun(rig(timeout=3.0))
    assert any("FS_PILOT_TIMEOUT is 3 s" in each for each in found.said)


def test_a_session_over_sockets_drives_a_segment_and_each_loss_ends_thrust(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In real time on whatever computer this is: each loss must end thrust in time in one of two attempts."""
    monkeypatch.setattr("towtank.planning.coach._COUNT", 0.5)
    sub = SimulatedSub(load_vehicle(drive_study.VEHICLE), drive_study.START)
    record = tmp_path / "driven.mcap"
    plan = drive_link.plan_of(100, duration=2.5)
    with drive_link.driven(sub, plan, record=record, free=("X_udot", "X_uu")) as run:
        for _ in range(drive_link.ATTEMPTS):
            run.begin()
            if run.until(lambda: any(" driven: " in each.text for each in run.session.events.all), 6.0):
                break
        assert "thrust off at the end of the segment" in run.told
        assert any(" driven: " in each.text for each in run.session.events.all)
        run.driving.ask("drive-off")
        for name in OVER_SOCKETS:
            tries = []
            while len(tries) < 2 and not any(0.0 <= each <= WITHIN for each in tries):
                took, after = drive_link.lost(run, name)
                assert after == 0, (name, run.told)
                tries.append(took)
            assert any(0.0 <= each <= WITHIN for each in tries), (name, tries)
        told = run.told
    kinds = {message.get_type() for _, message in sub.got}
    assert kinds <= {"MANUAL_CONTROL", "COMMAND_LONG", "PARAM_REQUEST_READ", "HEARTBEAT"}
    commands = {message.command for _, message in sub.got if message.get_type() == "COMMAND_LONG"}
    assert commands == {511}  # rates alone: nothing arms, nothing changes modes
    assert "drives" in told
    assert b"/raw/drive/sent" in record.read_bytes()


def test_an_error_of_the_program_itself_ends_thrust(monkeypatch: pytest.MonkeyPatch) -> None:
    found = begun(rig())
    found.run(found.lead + 1.0)
    before = len(found.sent)
    assert found.stage is Stage.DRIVING

    def fails(*_: object) -> None:
        raise RuntimeError("no such thing")

    monkeypatch.setattr(found.helm, "sticks", fails)
    with pytest.raises(RuntimeError) as error:
        found.driver.step()
    found.driver._failed(error.value)  # as its thread does
    assert found.stage is Stage.STOPPING
    monkeypatch.setattr(found.helm, "see", fails)  # what is broken may stay broken
    for _ in range(20):
        found.driver.step()
    assert found.stage is Stage.OFF
    assert len(found.sent) == before + 10
    assert found.said[-1] == "stopped: the drive has failed (RuntimeError: no such thing)"


def test_a_yaw_stick_that_the_autopilot_scales_is_refused() -> None:
    found = rig()
    found.sub.parameters["ACRO_YAW_P"] = 2.0
    found.run(1.0)
    assert found.switch(True).startswith("ACRO_YAW_P is 2, which scales the yaw stick")
