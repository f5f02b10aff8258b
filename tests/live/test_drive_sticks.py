"""What sticks do with a vehicle, how they are sent, and what is taken for a pose."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from towtank.errors import InputError
from towtank.live.driving.heard import Autopilot, Measured
from towtank.live.driving.helm import Helm
from towtank.live.driving.sticks import Encoder, Sticks, Way
from towtank.live.links.source import Sample
from towtank.live.pipeline.sorter import Arrival
from towtank.planning import Guard, Space, drawn_around
from towtank.readers.mavlink.senders import Sender
from towtank.vehicle import load_vehicle, thruster_wrench

HEAVY = load_vehicle("bluerov2_heavy")


def sticks_of(name: str) -> Sticks:
    vehicle = load_vehicle(name)
    return Sticks(Guard.of(vehicle, Space.from_text("9x9x5"), drawn_around(vehicle, 1, 0.3)))


def message(data: bytes) -> Any:
    found = dialect.MAVLink(None).parse_buffer(data)
    assert found is not None
    return found[0]


@pytest.mark.parametrize(("name", "frame"), [("bluerov2_heavy", "VECTORED_6DOF"), ("bluerov2", "VECTORED")])
def test_each_stick_pushes_along_its_own_axis_and_the_way_it_says(name: str, frame: str) -> None:
    sticks = sticks_of(name)
    assert sticks.frame.name == frame
    wrench = thruster_wrench(load_vehicle(name), sticks.commands(0.6 * np.eye(6)))
    able = np.abs(wrench.diagonal()) > 0.5
    assert able.tolist() == [True, True, True, True, name == "bluerov2_heavy", True]
    assert (wrench.diagonal()[able] > 0.0).all()


def test_sticks_of_a_wrench_make_that_wrench() -> None:
    sticks, rng = sticks_of("bluerov2_heavy"), np.random.default_rng(2)
    full = np.abs(thruster_wrench(HEAVY, sticks.commands(np.eye(6)))).max(axis=0)
    wanted = rng.uniform(-0.25, 0.25, (60, 6)) * full
    made = thruster_wrench(HEAVY, sticks.commands(sticks.of_wrench(wanted)))
    assert np.sqrt(np.mean(((made - wanted) / full) ** 2)) < 0.02


def test_forces_that_sticks_can_make_come_back_as_these_sticks() -> None:
    sticks = sticks_of("bluerov2_heavy")
    given = np.array([0.4, -0.3, 0.5, 0.1, -0.1, 0.2])
    assert sticks.of_forces(sticks.forces(given)) == pytest.approx(given, abs=0.005)


def test_no_sticks_ask_for_more_than_a_thruster_can() -> None:
    sticks = sticks_of("bluerov2_heavy")
    assert np.abs(sticks.commands(np.ones((1, 6))) - 1500.0).max() <= 400.0
    asked = sticks.of_wrench(np.full((1, 6), 1e4))
    assert np.abs(asked).max() <= 1.0


@pytest.mark.parametrize("name", ["vlbv300", "rexrov", "bluerov_2016", "blueboat"])
def test_a_vehicle_that_is_none_of_ardusubs_frames_is_refused_in_a_line(name: str) -> None:
    with pytest.raises(InputError, match=f"--drive: {name}: "):
        sticks_of(name)


def test_thrusters_that_do_not_rest_at_neutral_are_refused_in_a_line() -> None:
    moved = HEAVY.model_dump()
    first = moved["thrusters"][0]
    first["curve"] |= {"neutral": 1600.0}
    vehicle = HEAVY.__class__.model_validate(moved)
    guard = Guard.of(vehicle, Space.from_text("9x9x5"), drawn_around(HEAVY, 1, 0.3))
    with pytest.raises(InputError, match=f"thruster {first['name']} rests at 1600, expected pulses about 1500 us"):
        Sticks(guard)


def test_manual_control_says_what_ardusub_reads() -> None:
    found = message(Encoder(Way.MANUAL, 255, Sender(7, 1)).sticks(np.array([0.5, -0.25, 0.2, 0.1, -0.1, 1.0])))
    assert found.get_type() == "MANUAL_CONTROL"
    assert (found.get_srcSystem(), found.target) == (255, 7)
    assert (found.x, found.y, found.z, found.r) == (500, -250, 400, 1000)  # z: 500 at rest, less is down
    assert (found.s, found.t, found.enabled_extensions, found.buttons) == (-40, 40, 3, 0)  # us of pitch and roll


def test_overridden_channels_say_what_ardusub_reads() -> None:
    encoder = Encoder(Way.RC, 250, Sender(7, 1))
    found = message(encoder.sticks(np.array([0.5, -0.25, 0.2, 0.1, -0.1, 1.0])))
    channels = [getattr(found, f"chan{n}_raw") for n in range(1, 9)]
    assert found.get_srcSystem() == 250
    assert channels == [1460, 1540, 1420, 1900, 1700, 1400, 65535, 65535]  # pitch roll throttle yaw forward lateral
    released = message(encoder.release())
    assert [getattr(released, f"chan{n}_raw") for n in range(1, 7)] == [0] * 6


def test_neutral_is_neutral() -> None:
    manual, rc = (message(Encoder(way, 255, Sender(1, 1)).neutral()) for way in Way)
    assert (manual.x, manual.y, manual.z, manual.r, manual.s, manual.t) == (0, 0, 500, 0, 0, 0)
    assert {getattr(rc, f"chan{n}_raw") for n in range(1, 7)} == {1500}


# -- what is heard


def arrival(t: float, rank: int = 0, topic: str = "pose", **values: float) -> Arrival:
    return Arrival(t, t, rank, Sample("test", topic, t, t, tuple(values), tuple(values.values())))


PLACE, ANGLES = {"x": 1.0, "y": 2.0, "z": 3.0}, {"phi": 0.1, "theta": -0.1, "psi": 2.0}


def test_a_pose_is_made_of_place_and_attitude_and_as_old_as_the_older() -> None:
    measured = Measured(HEAVY)
    measured.take([arrival(1.0, topic="attitude", **ANGLES)])
    assert measured.t == -math.inf
    measured.take([arrival(1.02, **PLACE)])
    assert measured.t == 1.0
    assert measured.pose.tolist() == [1.0, 2.0, 3.0, 0.1, -0.1, 2.0]
    assert len(measured.poses) == 1


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_is_no_pose(value: float) -> None:
    measured = Measured(HEAVY)
    measured.take([arrival(1.0, **ANGLES, **PLACE), arrival(1.1, **ANGLES, **{**PLACE, "x": value})])
    assert measured.t == 1.0


def test_a_place_that_does_not_change_to_the_last_bit_is_no_measurement() -> None:
    measured = Measured(HEAVY)
    for k in range(10):
        measured.take([arrival(1.0 + 0.1 * k, **ANGLES, **PLACE)])
    assert measured.t == 1.0
    measured.take([arrival(2.1, **ANGLES, **{**PLACE, "x": 1.0 + 1e-9})])
    assert measured.t == 2.1


def test_stamps_that_go_back_are_no_news() -> None:
    measured = Measured(HEAVY)
    measured.take([arrival(5.0, **ANGLES, **PLACE), arrival(4.0, **ANGLES, **{**PLACE, "x": 1.1})])
    assert measured.t == 5.0
    assert measured.pose[0] == 1.0


def test_the_source_named_first_is_followed_and_once_held_on_to_no_other() -> None:
    measured = Measured(HEAVY)
    measured.take([arrival(1.0, rank=1, **ANGLES, **PLACE)])
    measured.take([arrival(1.1, rank=0, topic="mocap", **ANGLES, **{**PLACE, "x": 9.0})])
    assert measured.pose[0] == 9.0
    measured.hold_on(measured.t)
    measured.take([arrival(1.5, rank=1, **ANGLES, **{**PLACE, "x": 1.5})])
    assert (measured.t, measured.pose[0]) == (1.1, 9.0)  # of another origin: a loss, not a pose
    measured.let_go()
    measured.take([arrival(1.6, rank=0, topic="mocap", **ANGLES, **{**PLACE, "x": 9.1})])
    assert measured.pose[0] == 9.1


def test_only_ardusub_in_manual_mode_gives_sticks_to_the_thrusters() -> None:
    autopilot = Autopilot(100.0)
    for kind, mode, manual in ((12, 19, True), (12, 0, False), (12, 2, False), (2, 19, False)):
        row = {"base_mode": 128 | 1, "custom_mode": mode, "autopilot": 3, "type": kind}
        autopilot.hear("HEARTBEAT", lambda row=row: row, 105.0)  # type: ignore[misc]
        assert autopilot.manual is manual
    assert autopilot.armed
    assert (autopilot.link, autopilot.beat) == (5.0, 5.0)


def test_an_autopilot_that_has_said_nothing_is_neither_armed_nor_in_a_mode() -> None:
    silent = Autopilot(100.0)
    assert (silent.armed, silent.manual, silent.submarine) == (False, False, False)
    silent.hear("ATTITUDE", lambda: {}, 101.0)
    assert not silent.armed
    assert (silent.link, silent.beat) == (1.0, -math.inf)


def test_a_place_goes_with_the_attitude_of_its_own_source() -> None:
    """The autopilot's heading is from another north than the tracker's place."""
    measured = Measured(HEAVY)
    measured.take([arrival(1.0, rank=0, topic="ATTITUDE", phi=0.0, theta=0.0, psi=1.2)])
    measured.take([arrival(1.0, rank=1, topic="mocap", **{**ANGLES, "psi": 0.3}, **PLACE)])
    assert measured.pose[5] == 0.3


def test_no_force_is_no_stick() -> None:
    sticks = sticks_of("bluerov2_heavy")
    np.testing.assert_array_equal(sticks.of_forces(np.zeros(8)), np.zeros(6))


def helm() -> Helm:
    found = Helm(Guard.of(HEAVY, Space.from_text("9x9x5"), drawn_around(HEAVY, 1, 0.3)))
    found.anchor(0.0, np.zeros(6))
    return found


def test_after_a_gap_the_motion_is_followed_anew() -> None:
    found = helm()
    for t in (0.0, 0.02, 0.04):
        found.see(t, np.full(6, 1e-3 * t))
    found.see(30.0, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
    for k in range(50):
        found.see(30.02 + 0.02 * k, np.array([0.1, 0.0, 1e-4 * (k % 2), 0.0, 0.0, 0.0]))
    assert found.fault() == ""
    assert np.isfinite(found._observer.state).all()


def test_a_gap_explains_no_jump_of_metres() -> None:
    found = helm()
    found.see(0.0, np.zeros(6))
    found.see(6.0, np.array([2.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert found.fault().startswith("the pose jumped by 2.5 m")


def test_where_nothing_can_be_followed_nothing_is_driven() -> None:
    found = helm()
    found.see(0.0, np.zeros(6))
    found._observer = SimpleNamespace(state=np.full(13, np.nan))  # type: ignore[assignment]
    assert found.fault() == "where the vehicle is cannot be followed"


def test_full_sticks_are_full_and_a_gain_of_the_pilots_is_allowed_for() -> None:
    full = np.array([1.0, -1.0, 0.25, -1.0, 1.0, 0.5])
    manual = message(Encoder(Way.MANUAL, 255, Sender(1, 1)).sticks(full))
    assert (manual.x, manual.y, manual.z, manual.r, manual.s, manual.t) == (1000, -1000, 375, 500, 400, -400)
    beyond = message(Encoder(Way.MANUAL, 255, Sender(1, 1)).sticks(3.0 * full))
    assert (beyond.x, beyond.y, beyond.z, beyond.r) == (1000, -1000, 125, 1000)
    half = message(Encoder(Way.MANUAL, 255, Sender(1, 1), gain=0.5).sticks(full))
    assert (half.x, half.z) == (1000, 250)
    assert message(Encoder(Way.MANUAL, 255, Sender(1, 1), gain=0.5).sticks(3.0 * full)).z == 0
    rc = message(Encoder(Way.RC, 255, Sender(1, 1), gain=0.5).sticks(full))
    assert [getattr(rc, f"chan{n}_raw") for n in range(1, 7)] == [1900, 1100, 1400, 1700, 1900, 1100]


def test_messages_of_sticks_are_numbered_and_addressed() -> None:
    encoder = Encoder(Way.RC, 255, Sender(7, 3))
    found = [message(encoder.neutral()) for _ in range(258)]
    assert [each.get_seq() for each in found] == [k % 256 for k in range(258)]
    assert {(each.target_system, each.target_component) for each in found} == {(7, 3)}


def test_the_gain_of_the_pilot_is_heard_by_its_name() -> None:
    autopilot = Autopilot(100.0)
    assert math.isnan(autopilot.gain)
    for name, value in ((b"Other", 0.1), (b"PilotGain\0", 0.5), (b"PilotGainX", 0.9), (b"Aaaa", 0.2)):
        autopilot.hear("NAMED_VALUE_FLOAT", lambda name=name, value=value: {"name": name, "value": value}, 101.0)  # type: ignore[misc]
    assert autopilot.gain == 0.5
    assert autopilot.beat == -math.inf
    autopilot.hear("ATTITUDE", lambda: {}, 103.0)
    assert autopilot.link == 3.0


def test_outputs_count_where_all_are_there_and_newer() -> None:
    measured = Measured(HEAVY)
    pulses = {f"cmd_{each.name}": 1500.0 + k for k, each in enumerate(HEAVY.thrusters)}
    some = dict(list(pulses.items())[1:])
    measured.take([arrival(1.0, topic="o", **pulses), arrival(1.1, topic="o", **some)])
    measured.take(
        [arrival(0.9, topic="o", **pulses), arrival(1.2, topic="o", **{**pulses, next(iter(pulses)): math.nan})]
    )
    assert measured.outputs_t == 1.0
    assert [(t, each.tolist()) for t, each in measured.outputs] == [(1.0, [1500.0 + k for k in range(8)])]


def test_a_quaternion_will_do_and_where_the_pose_comes_from_is_told() -> None:
    measured = Measured(HEAVY)
    assert measured.text == "nothing"
    half = math.sqrt(0.5)
    measured.take(
        [arrival(1.0, topic="att", qw=half, qx=0.0, qy=0.0, qz=half), arrival(1.0, topic="gps", x=1.0, y=2.0)]
    )
    assert measured.t == -math.inf  # no depth yet
    measured.take([arrival(1.2, topic="baro", rank=1, z=3.0), arrival(1.3, topic="gps", x=1.1, y=2.0)])
    assert measured.pose == pytest.approx([1.1, 2.0, 3.0, 0.0, 0.0, math.pi / 2.0])
    assert measured.t == 1.0
    assert measured.text == "test gps and test att and test baro"


def test_how_far_the_walls_are() -> None:
    found = Helm(Guard.of(HEAVY, Space.from_text("9x8x5"), drawn_around(HEAVY, 1, 0.3)))
    assert found.walls == "not known yet"
    found.anchor(0.0, np.zeros(6))
    found.see(0.0, np.zeros(6))
    found.see(0.1, np.array([1.0, 0.5, 0.25, 0.0, 0.0, 0.0]))
    space, place = found.guard.space, found._place[1]  # type: ignore[index]
    ahead, right, bottom = space.upper - place[:3]
    behind, left, surface = place[:3] - space.lower
    assert found.walls == (
        f"{ahead:.1f} m ahead, {behind:.1f} behind, {right:.1f} right, {left:.1f} left, "
        f"{bottom:.1f} to the bottom, {surface:.1f} to the surface"
    )
    assert (ahead + behind, left + right, bottom + surface) == pytest.approx((9.0, 8.0, 5.0))
