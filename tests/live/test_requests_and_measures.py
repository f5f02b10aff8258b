"""What is asked of an autopilot and how often; how late the learner is and how hard the vehicle is driven."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from towtank.live.links.mavlink.requests import Requests, parameter_of
from towtank.live.links.mocap.tracked_body import TrackedBody
from towtank.live.pipeline.measures import Excitation, Latency
from towtank.readers.common.column_names import suggestion
from towtank.readers.mavlink.senders import Sender
from towtank.recording.cleaning import find_spikes
from towtank.vehicle import load_vehicle


def decoded(packets: list[bytes]) -> list[mavlink.MAVLink_message]:
    parser = mavlink.MAVLink(None)
    return [message for each in packets for message in parser.parse_buffer(each) or []]


def test_a_rate_is_asked_for_once_a_second_and_four_times_at_most():
    requests = Requests(speaks_first=False)
    requests.aim(Sender(1, 1), 2)
    asked = [
        (t, message)
        for t in np.arange(0.0, 10.0, 0.25).tolist()
        for message in decoded(requests.due(t, t))
        if message.get_type() == "COMMAND_LONG"
    ]
    first = [t for t, message in asked if message.param1 == asked[0][1].param1]
    assert first == [0.0, 1.0, 2.0, 3.0]
    message = asked[0][1]
    assert (message.command, message.target_system, message.target_component) == (511, 1, 1)
    assert (message.param1, message.param2) == (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 20_000.0)  # us, of 50 Hz


def test_parameters_are_asked_for_eight_at_a_time_once_rates_are_settled():
    requests = Requests(speaks_first=False)
    requests.aim(Sender(1, 1), 2)
    for name in requests.asked:
        requests._rates[name].answer = "granted"
    first, second = (decoded(requests.due(t, t)) for t in (0.0, 0.1))
    names = [message.param_id for message in (*first, *second)]
    assert [len(first), len(second)] == [8, 8]
    assert names == [f"SERVO{n}_FUNCTION" for n in range(1, 17)]
    for name in names[:-1]:
        requests.learn(name, 33.0)
    assert "SERVO16_FUNCTION" not in [message.param_id for message in decoded(requests.due(0.9, 0.9))]
    assert "SERVO16_FUNCTION" in [
        message.param_id for t in (1.2, 1.3, 1.4, 1.5) for message in decoded(requests.due(t, t))
    ]


def test_a_heartbeat_goes_out_once_a_second_where_we_speak_first_or_nothing_has_come_for_three():
    first, waiting = Requests(speaks_first=True), Requests(speaks_first=False)
    times = np.arange(0.0, 6.0, 0.25).tolist()
    assert [t for t in times if first.due(t, t)] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert [t for t in times if waiting.due(t, 0.0)] == [3.25, 4.25, 5.25]
    (beat,) = decoded(first.due(7.0, 7.0))
    assert (beat.type, beat.autopilot, beat.system_status) == (6, 8, 4)
    assert beat.get_srcSystem() == 254


def test_a_heartbeat_tells_which_mavlink_it_speaks() -> None:
    (beat,) = decoded(Requests(speaks_first=True).due(0.0, 0.0))
    assert beat.mavlink_version == 3


def test_a_rate_is_asked_for_with_no_more_than_a_message_and_its_interval() -> None:
    requests = Requests(speaks_first=False)
    requests.aim(Sender(1, 1), 2)
    (asked,) = (each for each in decoded(requests.due(0.0, 0.0)) if each.get_type() == "COMMAND_LONG")
    rest = [getattr(asked, f"param{k}") for k in range(3, 8)]
    assert (asked.confirmation, rest) == (0, [0.0] * 5)  # param7 = 0: to whoever asks


def test_answers_are_said_in_words():
    requests = Requests(speaks_first=False)
    requests.aim(Sender(1, 1), 2)

    class Heard:
        sender = Sender(1, 1)

    results = [0, 5, 1, 2, 3, 4]  # 5: in progress, which is no answer
    for k, result in enumerate(results):
        requests.due(10.0 * k, 10.0 * k)
        requests.hear(Heard(), 511.0, float(result))
        requests.hear(Heard(), 400.0, 0.0)  # to another command
    assert requests.said() == [
        f"asked {Sender(1, 1)} for the rates of 7 messages, 1 granted; refused for now: ATTITUDE; "
        "refused: LOCAL_POSITION_NED; not known: RAW_IMU; failed: SCALED_PRESSURE2"
    ]


def test_a_slow_line_is_asked_for_half_of_what_it_carries():
    plenty, slow, slowest = (Requests(speaks_first=False, bandwidth=each) for each in (0.0, 5760.0, 100.0))
    assert plenty.asked["ATTITUDE"] == 50.0
    assert slow.asked["ATTITUDE"] == pytest.approx(
        50.0 * 0.5 * 5760.0 / (48.0 * 227.0)
    )  # 227 messages of 48 bytes a second
    assert slow.asked["SYS_STATUS"] == 2.0
    assert set(slowest.asked.values()) == {2.0}


def test_whole_numbers_that_were_sent_as_bits_are_meant():
    bits = struct.unpack("<f", struct.pack("<i", 33))[0]
    assert parameter_of("SERVO1_FUNCTION", bits, 6.0) == 33.0
    assert parameter_of("SERVO1_FUNCTION", bits, 9.0) == bits  # a real number
    assert parameter_of("SERVO1_FUNCTION", 33.0, 6.0) == 33.0
    assert parameter_of("SERVO1_FUNCTION", 0.0, 6.0) == 0.0


def test_latencies_are_known_to_a_twentieth():
    latency = Latency()
    assert math.isnan(latency.percentile(0.5))
    assert math.isnan(latency.milliseconds()["max"])
    for k in range(1, 1001):
        latency.add(1e-5 * k)  # 0.01 to 10 ms
    found = latency.milliseconds()
    assert latency.count == 1000
    assert found["max"] == pytest.approx(10.0)
    assert 5.0 <= found["median"] <= 5.0 * 1.05
    assert 9.9 <= found["p99"] <= 10.0
    latency.add(1e-9)
    latency.add(1e6)
    assert latency.milliseconds()["max"] == pytest.approx(1e9)
    assert latency.percentile(0.0) <= 1e-6


def test_excitation_is_the_root_mean_square_of_the_last_ten_seconds():
    excitation = Excitation(load_vehicle("vlbv300"))
    assert excitation.rms == ()
    for k in range(3000):  # 30 s at 100 Hz
        t = 0.01 * k
        force = 100.0 if t < 18.5 else 3.0
        excitation.see(t, {"wrench": np.array([force, 0.0, -4.0, np.nan, 0.0, 0.5])})
    assert excitation.rms == pytest.approx((3.0, 0.0, 4.0, 0.0, 0.0, 0.5))
    assert len(excitation._seen) == 100


def test_a_tracked_body_with_its_y_up_is_turned_and_one_that_is_not_seen_is_counted():
    half = math.sqrt(0.5)
    body = TrackedBody(None, up="y")
    found = body.channels((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    assert (found["x"], found["y"], found["z"]) == pytest.approx((-3.0, 1.0, -2.0))  # NED of x, -z, y in ENU
    level = TrackedBody(None).channels((1.0, 2.0, 3.0), (half, 0.0, 0.0, half))  # faces north
    assert (level["x"], level["y"], level["z"]) == pytest.approx((2.0, 1.0, -3.0))
    assert abs(level["qw"]) == pytest.approx(1.0)
    for place, q in (((1.1e4, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), ((0.0,) * 3, (0.85, 0.0, 0.0, 0.0))):
        assert body.channels(place, q) == {}
    assert body.channels((9e3, 0.0, 0.0), (0.95, 0.0, 0.0, 0.0))
    assert (body.seen, body.hidden) == (2, 2)


@pytest.mark.parametrize(
    "name, channel, scale",
    [
        ("yaw_deg", "psi", math.pi / 180.0),
        ("roll_cdeg", "phi", math.pi / 18000.0),
        ("pitch_mrad", "theta", 1e-3),
        ("gyro_x_dps", "p", math.pi / 180.0),
        ("gyro_y_deg_s", "q", math.pi / 180.0),
        ("gyro_z_rad_s", "r", 1.0),
        ("gyro_z_rads", "r", 1.0),
        ("gyro_z_mrads", "r", 1e-3),
        ("depth_cm", "z", 0.01),
        ("depth_mm", "z", 1e-3),
        ("altitude_cm", "z", -0.01),
        ("vel_x_mms", "u", 1e-3),
        ("vel_y_cms", "v", 0.01),
        ("surge_knots", "u", 1852.0 / 3600.0),
        ("acc_z_g", "az", 9.80665),
        ("acc_x_mg", "ax", 9.80665e-3),
        ("acc_y_m_s2", "ay", 1.0),
        ("force_x_kgf", "X", 9.80665),
        ("torque_z_nm", "N", 1.0),
        ("battery_mv", "voltage", 1e-3),
        ("time_s", "t", 1.0),
        ("time_sec", "t", 1.0),
        ("time_secs", "t", 1.0),
        ("time_ms", "t", 1e-3),
        ("time_us", "t", 1e-6),
        ("stamp_usec", "t", 1e-6),
        ("stamp_ns", "t", 1e-9),
        ("stamp_nsec", "t", 1e-9),
    ],
)
def test_a_unit_at_the_end_of_a_name_scales_to_si(name, channel, scale):
    found = suggestion(name)
    assert found is not None
    assert found.channel == channel
    assert found.scale == pytest.approx(scale, rel=1e-5)


def test_wrong_samples_beside_a_gap_and_at_the_ends_are_left_alone():
    t = np.arange(400) / 100.0
    x = 1e-3 * np.random.default_rng(0).normal(size=t.size)
    x[200] = 1.0
    assert find_spikes(t, x).tolist() == [200]
    for late in (200, 201):
        assert not find_spikes(np.where(np.arange(400) >= late, t + 1.0, t), x).size
    ends = x.copy()
    ends[[0, 200, 399]] = 1.0, 0.0, 1.0
    assert not find_spikes(t, ends).size


def test_an_axis_that_is_only_rounding_is_not_excited() -> None:
    vehicle = load_vehicle("vlbv300")
    excitation = Excitation(vehicle)
    assert excitation.rms == ()
    excitation.see(0.0, {"velocity": np.ones(6)})
    assert excitation.rms == ()
    excitation.see(0.0, {"wrench": np.array([100.0, 1e-8, 1e-6, np.nan, 0.0, 3.0])})
    assert excitation.rms == (100.0, 0.0, pytest.approx(1e-6), 0.0, 0.0, 3.0)
    excitation.see(0.05, {"wrench": np.zeros(6)})  # ten times a second will do
    assert excitation.rms[0] == 100.0
    excitation.see(0.1, {"wrench": np.zeros(6)})
    assert excitation.rms[0] == pytest.approx(100.0 / np.sqrt(2.0))
    for k in range(2, 102):
        excitation.see(0.101 * k, {"wrench": np.zeros(6)})
    assert excitation.rms[0] == 0.0


def test_nothing_at_all_excites_nothing() -> None:
    excitation = Excitation(load_vehicle("vlbv300"))
    excitation.see(0.0, {"wrench": np.zeros(6)})
    assert excitation.rms == (0.0,) * 6


def test_latencies_of_no_time_and_of_very_long_ones_are_counted() -> None:
    latency = Latency()
    assert math.isnan(latency.percentile(0.5))
    for seconds in (0.0, 1e-6, 1e-6, 1e6):
        latency.add(seconds)
    assert latency.count == 4
    assert latency.percentile(0.5) == 1e-6
    assert latency.milliseconds()["max"] == 1e9
    assert 1e2 < latency.percentile(1.0) <= 1e6
