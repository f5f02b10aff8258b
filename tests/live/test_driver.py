"""The driver by hand: when it can be switched on, what it says of it, and what it sends step by step."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from towtank.live.driving.driver import Driver, Outside, Task
from towtank.live.driving.heard import Autopilot, Measured
from towtank.live.driving.helm import Helm
from towtank.live.driving.interlock import PERIOD, STALE, Stage
from towtank.live.driving.sticks import Encoder, Way
from towtank.live.links.source import Sample
from towtank.live.pipeline.sorter import Arrival
from towtank.planning import Guard, Space, drawn_around
from towtank.readers.mavlink.senders import Sender
from towtank.vehicle import load_vehicle

HEAVY = load_vehicle("bluerov2_heavy")
GOOD = {
    "FRAME_CONFIG": 2.0, "FS_PILOT_INPUT": 2.0, "FS_PILOT_TIMEOUT": 0.25, "JS_GAIN_DEFAULT": 1.0, "SYSID_MYGCS": 253.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def guard() -> Guard:
    return Guard.of(HEAVY, Space.from_text("9x9x5"), drawn_around(HEAVY, 1, 0.3))


class Rig:
    """A driver with everything around it by hand."""

    def __init__(self, guard: Guard, way: Way = Way.MANUAL, parameters: dict[str, float] | None = None) -> None:
        self.t = 100.0
        self.parameters = dict(GOOD) if parameters is None else parameters
        self.said: list[tuple[str, str]] = []
        self.sent: list[Any] = []
        self.task: Task | None = None
        self.encoders: list[tuple[Way, int, float]] = []
        self.autopilot, self.measured = Autopilot(0.0), Measured(HEAVY)
        self.helm = Helm(guard)
        outside = Outside(
            send=lambda data: self.sent.append(dialect.MAVLink(None).parse_buffer(data)[0]),
            encoder=self.encoder,
            parameters=lambda: self.parameters,
            task=lambda t: self.task,
            happened=lambda text, fault: self.said.append((text, fault)),
        )
        self.driver = Driver(self.helm, self.autopilot, self.measured, way, outside, now=lambda: self.t)
        self.see()

    def encoder(self, way: Way, system: int, gain: float) -> Encoder:
        self.encoders.append((way, system, gain))
        return Encoder(way, system, Sender(1, 1), gain)

    def see(self, *, armed: bool = True, kind: int = 12) -> None:
        row = {"base_mode": 128 * armed, "custom_mode": 19, "autopilot": 3, "type": kind}
        self.autopilot.hear("HEARTBEAT", lambda: row, self.t)
        pose = {"x": 1e-6 * self.t, "y": 0.0, "z": 0.0, "phi": 0.0, "theta": 0.0, "psi": 0.0}
        outputs = {f"cmd_{each.name}": 1500.0 for each in HEAVY.thrusters}
        for topic, values in (("pose", pose), ("outputs", outputs)):
            sample = Sample("test", topic, self.t, self.t, tuple(values), tuple(values.values()))
            self.measured.take([Arrival(self.t, self.t, 0, sample)])

    def steps(self, count: int, *, key: bool = True) -> None:
        for _ in range(count):
            self.t += PERIOD
            self.see()
            if key:
                self.driver.hold()
            self.driver.step()


def task(clock: float = 0.0) -> Task:
    wrench = np.zeros((500, 6))
    wrench[:, 0] = 5.0
    return Task(wrench, clock)


def test_it_is_switched_on_where_everything_is_known(guard: Guard) -> None:
    rig = Rig(guard)
    assert rig.driver.switch(True) == ""
    assert rig.encoders == [(Way.MANUAL, 253, 1.0)]
    assert rig.driver.interlock.stage is Stage.READY
    [(text, fault)] = rig.said
    assert text.startswith("switched on; pose by test pose; walls: ")
    assert fault == ""
    assert rig.driver.switch(True) == "it is on already"
    assert rig.driver.switch(False) == ""
    assert rig.said[1:] == [("switched off", "")]
    assert rig.driver.standing.walls == ""


@pytest.mark.parametrize(
    ("way", "changes", "said"),
    [
        (Way.MANUAL, {"FRAME_CONFIG": 1.0}, "the autopilot's FRAME_CONFIG is 1, the vehicle's file is of frame 2"),
        (Way.MANUAL, {"FS_PILOT_INPUT": 0.0}, "FS_PILOT_INPUT is off"),
        (Way.RC, {"ACRO_YAW_P": 3.3}, "ACRO_YAW_P is 3.3, which scales the yaw stick"),
        (Way.RC, {"ACRO_YAW_P": 3.38}, ""),
        (Way.MANUAL, {"JS_GAIN_DEFAULT": 0.5}, "the pilot's gain is 50 %: set it to 1, or use --drive-by rc"),
        (Way.MANUAL, {"JS_GAIN_DEFAULT": math.nan}, "the pilot's gain is not told"),
        (Way.MANUAL, {"JS_THR_GAIN": 0.4}, "JS_THR_GAIN is 0.4"),
        (Way.RC, {"JS_GAIN_DEFAULT": 0.5, "JS_THR_GAIN": 0.4}, ""),
    ],
)
def test_an_autopilot_that_would_not_do_as_told_is_refused(
    guard: Guard, way: Way, changes: dict[str, float], said: str
) -> None:
    rig = Rig(guard, way, GOOD | changes)
    why = rig.driver.switch(True)
    assert why.startswith(said) if said else why == ""
    if said:
        assert rig.said == [(f"not switched on: {why}", "")]
        assert rig.driver.switch(True) == why
        assert len(rig.said) == 1  # said once
        assert rig.driver.interlock.stage is Stage.OFF


def test_what_the_autopilot_says_of_the_gain_counts_more_than_its_default(guard: Guard) -> None:
    rig = Rig(guard)
    rig.autopilot.gain = 0.25
    assert rig.driver.switch(True).startswith("the pilot's gain is 25 %")
    rig.autopilot.gain = 1.0
    rig.parameters["JS_GAIN_DEFAULT"] = 0.1
    rig.t += 0.1
    rig.see()
    assert rig.driver.switch(True) == ""


def test_only_a_submarine_that_is_known_is_driven(guard: Guard) -> None:
    rig = Rig(guard)
    rig.see(kind=2)
    assert rig.driver.switch(True) == "no ArduSub is heard"
    unknown = Rig(guard)
    unknown.encoder = lambda way, system, gain: None  # type: ignore[assignment, method-assign, return-value]
    unknown.driver._outside = SimpleNamespace(**{**vars(unknown.driver._outside), "encoder": unknown.encoder})  # type: ignore[assignment]
    assert unknown.driver.switch(True) == "no autopilot is known yet"


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({}, "FS_PILOT_INPUT is not known: what stops the thrusters when the link breaks?"),
        ({"FS_PILOT_INPUT": 2.0}, "FS_PILOT_INPUT is not known"),
        ({"FS_PILOT_INPUT": 2.0, "FS_PILOT_TIMEOUT": 3.0}, "FS_PILOT_TIMEOUT is 3 s: thrusters go on for so long"),
    ],
)
def test_what_is_doubtful_is_said_and_no_more(guard: Guard, parameters: dict[str, float], said: str) -> None:
    rig = Rig(guard, Way.RC, parameters)
    assert rig.driver.switch(True) == ""
    assert rig.encoders == [(Way.RC, 255, 1.0)]
    assert len(rig.said) == 2
    assert rig.said[1][0].startswith(said)


def test_sticks_are_sent_while_the_key_is_held_and_a_segment_is_under_way(guard: Guard) -> None:
    rig = Rig(guard)
    rig.steps(3)
    assert rig.sent == []
    assert rig.driver.switch(True) == ""
    rig.steps(3)
    assert rig.sent == []  # no segment
    rig.task = task()
    rig.driver.let_go()
    rig.steps(2, key=False)
    assert rig.sent == []
    rig.t += 2.0 * STALE
    rig.see()
    rig.steps(3)
    assert rig.driver.interlock.stage is Stage.DRIVING
    assert ("drives", "") in rig.said
    assert [each.get_type() for each in rig.sent] == ["MANUAL_CONTROL"] * len(rig.sent)
    assert rig.sent[-1].x > 0
    standing = rig.driver.standing
    assert (standing.stage, standing.held, standing.bent) == (Stage.DRIVING, True, False)
    assert standing.walls != ""
    count = len(rig.sent)
    rig.driver.let_go()
    rig.steps(20, key=False)
    assert rig.said[-1] == ("stopped: the key was let go", "the key was let go")
    assert count < len(rig.sent) < count + 20
    assert {(each.x, each.y, each.z, each.r) for each in rig.sent[count:]} == {(0, 0, 500, 0)}
    assert not rig.driver.standing.held


def test_channels_that_were_overridden_are_let_go_of(guard: Guard) -> None:
    rig = Rig(guard, Way.RC)
    rig.task = task()
    assert rig.driver.switch(True) == ""
    rig.t += 0.01
    rig.steps(4)
    assert rig.driver.interlock.stage is Stage.DRIVING
    assert rig.driver.switch(False) == ""
    rig.steps(20)
    forward = [each.chan5_raw for each in rig.sent]
    assert forward[-1] == 0
    assert 1500 in forward
    assert max(forward) > 1500
    assert rig.said[-1][0] == "stopped: switched off"
    assert rig.driver.interlock.stage is Stage.OFF


def test_a_segment_that_has_ended_waits_for_the_next(guard: Guard) -> None:
    rig = Rig(guard)
    rig.task = task()
    assert rig.driver.switch(True) == ""
    rig.t += 0.01
    rig.steps(4)
    rig.task = None
    rig.steps(20)
    assert ("thrust off at the end of the segment", "") in rig.said
    assert rig.driver.interlock.stage is Stage.READY
    rig.task = task(20.0)
    assert rig.task.over
    assert not task(19.99).over
    rig.t += 2.0 * STALE
    rig.see()
    count = len(rig.sent)
    rig.steps(5)
    assert len(rig.sent) == count


def test_the_source_of_the_pose_is_held_on_to_until_it_is_switched_off(guard: Guard) -> None:
    rig = Rig(guard)

    def tracked(x: float) -> float:
        pose = {"x": x, "y": 0.0, "z": 0.0, "phi": 0.0, "theta": 0.0, "psi": 0.0}
        sample = Sample("test", "mocap", rig.t, rig.t, tuple(pose), tuple(pose.values()))
        rig.measured.take([Arrival(rig.t, rig.t, 0, sample)])
        return float(rig.measured.pose[0])

    assert rig.driver.switch(True) == ""
    rig.steps(3)
    rig.t += 0.01
    assert tracked(7.0) != 7.0
    assert rig.driver.switch(False) == ""
    assert rig.driver.interlock.stage is Stage.OFF
    rig.t += 0.01
    assert tracked(7.5) == 7.5


def test_an_error_of_the_program_itself_is_a_stop(guard: Guard) -> None:
    rig = Rig(guard)
    rig.task = task()
    assert rig.driver.switch(True) == ""
    rig.t += 0.01
    rig.steps(4)
    rig.driver._failed(ValueError("broken"))
    assert rig.said[-1][0] == "stopped: the drive has failed (ValueError: broken)"
    ready = Rig(guard)
    assert ready.driver.switch(True) == ""
    ready.driver._failed(ValueError("broken"))
    assert ready.said[-1] == ("the drive has failed (ValueError: broken)", "")
