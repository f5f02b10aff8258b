"""What messages mean as they come: the same channels as of a log, stamps, aiding, thrusters, several senders."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from towtank.live import Sample
from towtank.live.links.mavlink.frames import Framer
from towtank.live.links.mavlink.samples import MavlinkSamples, MavlinkStamps
from towtank.readers.common.tables import Table
from towtank.readers.mavlink.format import layouts
from towtank.readers.mavlink.senders import Sender

from .mavlink_peer import AIDED, UNAIDED, Autopilot, second

EIGHT = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 9)}
EPOCH = 1.7e9


class Heard:
    """Feeds a link as the source does, at times of its own."""

    def __init__(self, parameters: dict[str, float] | None = None, thrusters: int = 8) -> None:
        self.samples = MavlinkSamples(layouts(), thrusters)
        self.parameters = EIGHT if parameters is None else parameters
        self.framer = Framer(layouts(), stream=False)

    def take(self, sent: list[tuple[float, bytes]], late: float = 0.01) -> list[Sample]:
        found: list[Sample] = []
        for t, data in sorted(sent, key=lambda each: each[0]):
            found += self.samples.take([(frame, EPOCH + t + late) for frame in self.framer.feed(data)])
            if self.samples.hurry:
                self.decide(t)
        return found

    def decide(self, t: float) -> None:
        self.samples.decide(EPOCH + t, self.parameters, settled=True)


def channel(samples: list[Sample], name: str) -> NDArray[np.float64]:
    return np.array(
        [value for sample in samples for key, value in zip(sample.names, sample.values, strict=True) if key == name]
    )


def turning(flags: int = AIDED, heard: Heard | None = None) -> list[Sample]:
    autopilot, heard = Autopilot(), heard or Heard()
    assert heard.take(second(autopilot, 0.0, flags) + second(autopilot, 1.0, flags)) == []
    heard.decide(2.0)
    return heard.take(second(autopilot, 2.0, flags) + second(autopilot, 3.0, flags))


def test_each_message_becomes_its_channels() -> None:
    found = turning()
    assert {sample.topic for sample in found} == {"ATTITUDE", "HEARTBEAT", "LOCAL_POSITION_NED", "SERVO_OUTPUT_RAW"}
    np.testing.assert_allclose(channel(found, "psi")[:3], [1.0, 1.025, 1.05], atol=1e-6)
    np.testing.assert_allclose(channel(found, "r"), 0.5)
    np.testing.assert_allclose(channel(found, "z"), 3.0)
    np.testing.assert_allclose(channel(found, "cmd_3")[:20], 1530.0 + np.arange(20))


def test_velocity_in_the_world_is_turned_into_the_body() -> None:
    found = turning()
    assert channel(found, "vn").size == 0
    phi, theta = 0.01, -0.02  # what ATTITUDE says beside yaw
    ahead = np.array([0.4, 0.0, 0.1])
    pitch = np.array([[math.cos(theta), 0, -math.sin(theta)], [0, 1, 0], [math.sin(theta), 0, math.cos(theta)]])
    roll = np.array([[1, 0, 0], [0, math.cos(phi), math.sin(phi)], [0, -math.sin(phi), math.cos(phi)]])
    for name, expected in zip("uvw", roll @ pitch @ ahead, strict=True):
        np.testing.assert_allclose(channel(found, name), expected, atol=4e-4)  # stamps count milliseconds


def test_stamps_are_the_autopilots_on_the_clock_of_receipt() -> None:
    found = [sample for sample in turning() if sample.topic == "ATTITUDE"]
    sent = np.concatenate((2.0 + np.arange(20) / 20, 3.0 + np.arange(20) / 20))
    np.testing.assert_allclose([sample.t - EPOCH for sample in found], sent + 0.01, atol=2e-3)


def test_microseconds_of_32_bits_begin_anew() -> None:
    wrap = 2.0**32 * 1e-6
    autopilot, heard = Autopilot(boot=wrap - 2.5), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    found = [sample for sample in heard.take(second(autopilot, 2.0)) if sample.topic == "SERVO_OUTPUT_RAW"]
    np.testing.assert_allclose([sample.t - EPOCH for sample in found], 2.012 + np.arange(20) / 20, atol=2e-3, rtol=0)


def test_the_counter_of_milliseconds_begins_anew_after_fifty_days_and_nothing_starts() -> None:
    autopilot, heard = Autopilot(boot=2.0**32 * 1e-3 - 2.5), Heard()
    heard.take(_attitudes(autopilot, 0.0, 2.0))
    heard.decide(2.0)
    found = [sample for sample in heard.take(_attitudes(autopilot, 2.0, 4.0)) if sample.topic != "HEARTBEAT"]
    assert heard.samples.restarts == 0
    assert heard.samples.strange == 0
    np.testing.assert_allclose([sample.t - EPOCH for sample in found], 2.01 + np.arange(40) / 20, atol=2e-3, rtol=0)


def _attitudes(autopilot: Autopilot, start: float, end: float) -> list[tuple[float, bytes]]:
    times = np.arange(start, end - 1e-9, 0.05).tolist()
    return [(start, autopilot.heartbeat()), *((t, autopilot.attitude(t, 0.1, 0.5)) for t in times)]


def test_a_message_whose_stamp_cannot_be_is_passed_over() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    strange = Autopilot(boot=50_000.0)  # another vehicle on the same line, under the same number
    found = heard.take(second(autopilot, 2.0) + [(t, strange.attitude(t, 3.0)) for t in (2.3, 2.6)])
    assert np.abs(channel(found, "psi") - 3.0).min() > 0.5
    assert heard.samples.strange == 2


def test_what_is_held_up_keeps_its_stamp() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    heard.take(second(autopilot, 2.0))
    (held_up,) = heard.take([(3.0, autopilot.attitude(3.0))], late=0.3)
    assert held_up.received - EPOCH == pytest.approx(3.3)
    assert held_up.t - EPOCH == pytest.approx(3.01, abs=2e-3)


def test_what_a_stall_held_up_keeps_its_stamps_whatever_field_bears_them() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    heard.take(second(autopilot, 2.0))
    sent = sorted(second(autopilot, 3.0) + second(autopilot, 4.0), key=lambda each: each[0])
    frames = [frame for _, data in sent for frame in heard.framer.feed(data)]
    arrivals = [(frame, EPOCH + 63.0 + 1e-4 * k) for k, frame in enumerate(frames)]  # a minute late, all at once
    found = [s for first in range(0, len(arrivals), 32) for s in heard.samples.take(arrivals[first : first + 32])]
    assert heard.samples.strange == 0
    for topic, after in (("ATTITUDE", 0.0), ("LOCAL_POSITION_NED", 0.001), ("SERVO_OUTPUT_RAW", 0.002)):
        stamps = [sample.t - EPOCH for sample in found if sample.topic == topic]
        np.testing.assert_allclose(stamps, 3.01 + after + np.arange(40) / 20, atol=2e-3, rtol=0)


@pytest.mark.parametrize("looked", [[], [10.0, 15.0, 63.0]])
def test_a_silence_says_nothing_of_what_is_sent(looked: list[float]) -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    heard.take(second(autopilot, 2.0))
    for t in looked:
        heard.decide(t)
    first, *others = (t_data for start in (3.0, 4.0) for t_data in sorted(second(autopilot, start)))
    found = heard.take([first], late=60.0)
    heard.decide(63.0)  # one message alone has come by now
    found += heard.take(others, late=60.0)
    found += heard.take(second(autopilot, 65.0))
    heard.decide(66.0)
    found += heard.take(second(autopilot, 66.0))
    assert channel(found, "psi").size == channel(found, "z").size == channel(found, "cmd_1").size == 80


def test_an_autopilot_that_is_silent_gives_way_to_another() -> None:
    first, other, heard = Autopilot(), Autopilot(system=2), Heard()
    heard.take(second(first, 0.0) + second(other, 0.0) + second(first, 1.0) + second(other, 1.0))
    heard.decide(2.0)
    assert str(heard.samples.autopilot.sender) == "1.1"
    for start in range(2, 12):
        heard.take(second(other, float(start)))
    heard.decide(12.0)
    assert str(heard.samples.autopilot.sender) == "2.1"


def test_dead_reckoning_is_no_velocity() -> None:
    heard = Heard()
    found = turning(UNAIDED, heard)
    assert channel(found, "u").size == channel(found, "x").size == 0
    assert channel(found, "psi").size == 40
    assert any("dead reckoning" in line for line in heard.samples.said())


def test_aiding_that_is_lost_ends_the_velocity_at_once() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    assert channel(heard.take(second(autopilot, 2.0)), "u").size == 20
    assert channel(heard.take(second(autopilot, 3.0, UNAIDED)), "u").size == 0
    assert channel(heard.take(second(autopilot, 4.0)), "u").size == 20


def test_thrusters_by_the_parameters() -> None:
    crossed = {**{f"SERVO{n}_FUNCTION": 33.0 + 8 - n for n in range(1, 9)}, "MOT_2_DIRECTION": -1.0}
    found = turning(heard=Heard(crossed))
    np.testing.assert_allclose(channel(found, "cmd_8")[:3], [1510, 1511, 1512])
    np.testing.assert_allclose(channel(found, "cmd_2")[:3], [3000 - 1570, 3000 - 1571, 3000 - 1572])


def test_thrusters_without_parameters_are_the_first_outputs() -> None:
    heard = Heard({}, thrusters=6)
    found = turning(heard=heard)
    assert channel(found, "cmd_6").size == 40
    assert channel(found, "cmd_7").size == 0
    assert any("no SERVOn_FUNCTION" in line for line in heard.samples.said())


@pytest.mark.parametrize(("thrusters", "which"), [(1, "output 1 is"), (2, "outputs 1 to 2 are")])
def test_which_outputs_are_taken_without_parameters_is_said(thrusters: int, which: str) -> None:
    heard = Heard({}, thrusters=thrusters)
    turning(heard=heard)
    expected = f"no SERVOn_FUNCTION among the parameters: {which} taken for the thrusters in order, none mirrored"
    assert any(expected in line for line in heard.samples.said())


def test_what_came_late_before_the_first_decision_tells_how_late_later_messages_are() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0), late=0.3)
    heard.take(second(autopilot, 1.0), late=0.01)
    heard.decide(2.0)
    found = [sample for sample in heard.take(second(autopilot, 2.0), late=0.3) if sample.topic == "ATTITUDE"]
    np.testing.assert_allclose([sample.t - EPOCH for sample in found], 2.01 + np.arange(20) / 20, atol=2e-3, rtol=0)


def test_until_the_parameters_are_settled_there_are_no_commands() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0))
    heard.samples.decide(EPOCH + 1.0, {}, settled=False)
    assert channel(heard.take(second(autopilot, 1.0)), "cmd_1").size == 0


def test_a_second_vehicle_and_a_ground_station_are_not_mixed_in() -> None:
    autopilot, other, heard = Autopilot(), Autopilot(system=2), Heard()
    station = Autopilot(system=255, component=190)

    def crowd(start: float) -> list[tuple[float, bytes]]:
        others = [(start + 0.3, other.heartbeat()), (start + 0.4, station.heartbeat(8, 6))]
        return [*second(autopilot, start), *others, (start + 0.5, other.attitude(start, -2.0))]

    heard.take(crowd(0.0) + crowd(1.0))
    heard.decide(2.0)
    assert channel(heard.take(crowd(2.0)), "psi").min() > 0.9
    assert heard.samples.autopilot.sender == (1, 1)
    assert "another autopilot (2.1), a ground station (255.190)" in heard.samples.said()[0]


def test_the_autopilot_that_was_followed_is_kept() -> None:
    autopilot, other, heard = Autopilot(), Autopilot(system=2), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    heard.take(second(autopilot, 2.0) + second(other, 2.0, rate=100.0))
    heard.decide(3.0)
    assert heard.samples.autopilot.sender == (1, 1)
    assert heard.samples.autopilot.others == {(2, 1): "another autopilot"}
    assert channel(heard.take(second(autopilot, 3.0) + second(other, 3.0, rate=100.0)), "psi").size == 20
    for start in range(4, 12):
        heard.take(second(other, float(start)))
    heard.decide(12.0)
    assert heard.samples.autopilot.sender == (2, 1)


def test_an_autopilot_that_starts_anew_is_followed() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    heard.take(second(autopilot, 2.0))
    autopilot.boot = -2.0
    heard.take(second(autopilot, 4.0) + second(autopilot, 5.0))
    found = [sample for sample in heard.take(second(autopilot, 6.0)) if sample.topic == "ATTITUDE"]
    assert heard.samples.restarts == 1
    np.testing.assert_allclose([sample.t - EPOCH for sample in found], 6.01 + np.arange(20) / 20, atol=2e-3, rtol=0)


def test_a_dvl_of_another_sender_is_nearer_the_sensor_and_stands_off_the_origin() -> None:
    autopilot, dvl = Autopilot(), Autopilot(component=197)
    heard = Heard({**EIGHT, "VISO_POS_X": 0.2})

    def with_dvl(start: float) -> list[tuple[float, bytes]]:
        found = second(autopilot, start)
        for k in range(20):
            t = start + k / 20 + 0.004
            stamp = round(1e6 * (5000.0 + t))
            packed = dialect.MAVLink_vision_position_delta_message(stamp, 50_000, [0, 0, 0.025], [0.05, 0.01, 0], 90.0)
            found.append((t, dvl.pack(packed)))
        return found

    heard.take(with_dvl(0.0) + with_dvl(1.0))
    heard.decide(2.0)
    found = [sample for sample in heard.take(with_dvl(2.0)) if "u" in sample.names]
    assert {sample.topic for sample in found} == {"VISION_POSITION_DELTA"}
    np.testing.assert_allclose(channel(found, "u"), 1.0, atol=1e-6)
    np.testing.assert_allclose(channel(found, "v"), 0.2 - 0.5 * 0.2, atol=1e-6)
    np.testing.assert_allclose([sample.t - EPOCH for sample in found], 2.014 + np.arange(20) / 20, atol=2e-3)


def test_a_flood_of_senders_keeps_memory_bounded() -> None:
    heard = Heard()
    for system in range(1, 250):
        autopilot = Autopilot(system=system)
        heard.take([(0.001 * system, autopilot.attitude(1.0)), (0.001 * system, autopilot.heartbeat())])
    assert len(heard.samples._history) <= 200
    heard.decide(1.0)
    assert heard.samples.autopilot.sender is not None


def test_heartbeats_tell_armed_and_mode_from_the_first_sample_on() -> None:
    """The one that came before anything was decided is told again: what it says is in force."""
    autopilot, heard = Autopilot(), Heard()
    before = [(0.0, autopilot.heartbeat()), (0.05, autopilot.heartbeat(armed=True, mode=19))]
    heard.take([*before, *second(autopilot, 0.1)[2:]])
    assert heard.samples.attributes == {}
    heard.decide(1.5)
    found = heard.take([*second(autopilot, 2.0)[2:], (3.0, autopilot.heartbeat(mode=9))])
    beats = [sample for sample in found if sample.topic == "HEARTBEAT"]
    assert [each.names for each in beats] == [("armed", "mode")] * 2
    assert [each.values for each in beats] == [(1.0, 19.0), (0.0, 9.0)]
    assert [each.received - EPOCH for each in beats] == pytest.approx([0.06, 3.01])
    assert "9 SURFACE" in heard.samples.attributes["modes"]
    rover = Heard()
    rover.take([(0.0, autopilot.heartbeat(kind=11)), *second(autopilot, 0.1)[2:]])
    rover.decide(1.5)
    assert "16 INITIALISING" in rover.samples.attributes["modes"]


def test_heartbeats_of_others_say_nothing_of_the_vehicle() -> None:
    autopilot, station, heard = Autopilot(), Autopilot(255, 190), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    found = heard.take([(2.1, station.heartbeat(8, 6, armed=True)), (2.2, autopilot.heartbeat())])
    assert [each.values for each in found if each.topic == "HEARTBEAT"] == [(0.0, 0.0)] * 2  # the one before, and this


def test_a_depth_by_pressure_is_that_below_the_surface() -> None:
    autopilot = Autopilot()
    deep = Heard({**EIGHT, "BARO2_GND_PRESS": 101_300.0, "BARO_SPEC_GRAV": 1.0})
    sent = [(0.05 * k, autopilot.pressure(0.05 * k, 1013.0 + 98.0 * 2.0)) for k in range(30)]
    deep.take(sent + second(autopilot, 0.0, UNAIDED))
    deep.decide(1.5)
    found = deep.take([(2.0, autopilot.pressure(2.0, 1013.0 + 98.0 * 2.0))])
    assert channel(found, "z") == pytest.approx([2.0])
    assert deep.samples.attributes["depth"] == "below the water's surface, by pressure"


def test_a_flood_of_senders_does_not_silence_the_autopilot_that_is_followed() -> None:
    autopilot, heard = Autopilot(), Heard()
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    for system in range(2, 250):
        heard.take([(2.0, Autopilot(system=system).attitude(1.0))])
    heard.take([(2.1, autopilot.pack(dialect.MAVLink_raw_imu_message(2_100_000, *[1] * 9)))])  # its first one
    assert (dialect.MAVLINK_MSG_ID_RAW_IMU, autopilot_sender(heard)) in heard.samples._history


def autopilot_sender(heard: Heard) -> object:
    return heard.samples.autopilot.sender


@pytest.mark.parametrize(("field", "unit"), [("time_boot_ms", 1e-3), ("time_usec", 1e-6), ("usec", 1e-6)])
def test_stamps_are_in_the_units_of_their_fields(field: str, unit: float) -> None:
    own = 50.0 + 0.1 * np.arange(30)
    received = 1000.0 + own + 0.002
    table = Table("A", received, {field: np.round(own / unit)})
    stamps = MavlinkStamps().of(table, Sender(1, 1), received)
    np.testing.assert_allclose(np.diff(stamps), 0.1, atol=1e-4)
    np.testing.assert_allclose(stamps, received, atol=1e-2)
    assert np.isnan(MavlinkStamps().of(Table("A", received, {}), Sender(1, 1), received)).all()


def test_whom_a_link_hears_is_said() -> None:
    heard, autopilot = Heard(), Autopilot(7, 1)
    assert heard.samples.said() == []
    heard.take(second(autopilot, 0.0) + second(autopilot, 1.0))
    heard.decide(2.0)
    assert heard.samples.said()[0] == "hears autopilot 7.1"
    alone, station = Heard(), Autopilot(255, 190)
    alone.take([(0.1 * k, station.heartbeat(autopilot=8, kind=6)) for k in range(9)])
    alone.decide(2.0)
    assert alone.samples.said()[0].startswith("hears no autopilot")
