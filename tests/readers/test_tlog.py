"""MAVLink telemetry logs: hand-built ones give the channels that they were built from; senders, clocks, checksums."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.mavlink.format import checksum, layouts
from towtank.readers.mavlink.tlog import decode, scan_tlog
from towtank.recording import ColumnMapping, Recording

from .encoders import TlogWriter, dive_tlog

SIX = {
    **{f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 7)},
    "MOT_2_DIRECTION": -1.0,
    "BARO_PRIMARY": 1.0,
    "BARO2_GND_PRESS": 100_000.0,
    "GPS_TYPE": 14.0,
}


def written(folder: Path, data: bytes | bytearray, name: str = "dive.tlog") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def used(recording: Recording) -> dict[str, tuple[str, ...]]:
    return {content.name: content.used for content in recording.contents if content.used}


def reasons(recording: Recording) -> dict[str, str]:
    return {content.name: content.reason for content in recording.contents}


@pytest.mark.parametrize("versions", [(1,), (2,), (1, 2)], ids=str)
def test_units_signs_and_frames(tmp_path: Path, versions: tuple[int, ...]) -> None:
    run = read(written(tmp_path, dive_tlog(parameters=SIX, versions=versions).data))

    def at(name: str) -> np.ndarray:
        return run[name].t - run["p"].t[0]

    np.testing.assert_allclose(run["p"].values, 0.1 * at("p"), atol=6e-4)  # mrad/s
    np.testing.assert_allclose(run["r"].values, -0.1 * at("r"), atol=6e-4)
    np.testing.assert_allclose(run["ax"].values, 1.0 + at("ax"), atol=5e-3)  # mG
    np.testing.assert_allclose(run["az"].values, -9.80665)
    np.testing.assert_allclose(run["phi"].values, 0.1 + 0.01 * at("phi"), atol=1e-6)
    np.testing.assert_allclose(run["theta"].values, -0.2, atol=1e-6)
    np.testing.assert_allclose(run["z"].values, 2.0 + 0.1 * at("z"), atol=1e-4)
    np.testing.assert_allclose(run["u"].values, 0.2 * np.round(at("u"), 1), atol=1e-6)
    np.testing.assert_allclose(run["v"].values, -0.1, atol=1e-6)
    np.testing.assert_allclose(run["w"].values, 0.05, atol=1e-6)
    np.testing.assert_allclose(run["x"].values, 0.3 * at("x"), atol=1e-5)
    np.testing.assert_allclose(run["voltage"].values, 16.0 - 0.1 * np.round(at("voltage"), 1), atol=1e-3)
    np.testing.assert_allclose(run["cmd_1"].values, 1510.0 + 5.0 * at("cmd_1"), atol=0.51)
    np.testing.assert_allclose(run["cmd_2"].values, 3000.0 - (1520.0 + 5.0 * at("cmd_2")), atol=0.51)
    assert [name for name in run if name.startswith("cmd_")] == [f"cmd_{n}" for n in range(1, 7)]
    assert run.attributes["epoch"].startswith("2023-11-14T22:13:20.00")
    assert not run.repairs


def test_only_the_autopilot_is_believed(tmp_path: Path) -> None:
    """A companion sends another ATTITUDE; the DVL's displacement, which others send to the autopilot, is used."""
    run = read(written(tmp_path, dive_tlog(parameters=SIX).data))
    assert used(run)["ATTITUDE@1.1"] == ("phi", "theta", "psi")
    assert used(run)["VISION_POSITION_DELTA"] == ("u", "v", "w")
    assert reasons(run)["ATTITUDE@1.194"] == "sent by a companion (1.194)"
    assert reasons(run)["HEARTBEAT@255.190"] == "sent by a ground station (255.190)"
    assert any(note.startswith("the autopilot is 1.1; also heard: a companion (1.194)") for note in run.notes)


def test_stamps_of_the_autopilot_undo_what_the_link_held_up(tmp_path: Path) -> None:
    run = read(written(tmp_path, dive_tlog(10.0, parameters=SIX, late=(0.005, 0.3, 0.03, 0.005, 0.8)).data))
    for name in ("p", "phi", "cmd_1", "x"):
        np.testing.assert_allclose(np.diff(run[name].t), 0.1, atol=1e-6)
    np.testing.assert_allclose(run["cmd_1"].t, run["p"].t, atol=2e-3)
    assert any("in place of times of receipt" in note and "up to 795 ms" in note for note in run.notes)


def test_stamps_drift(tmp_path: Path) -> None:
    """An autopilot whose clock is 200 ppm slow stays on the ground station's within a few milliseconds."""
    log = TlogWriter()
    for k in range(6000):
        t = 0.1 * k
        log.add(
            t + (0.05 if k % 3 else 0.0),
            mavlink.MAVLink_attitude_message(round(1e3 * (9.0 + t * (1 - 2e-4))), *[0.1 * k] * 6),
        )
    run = read(written(tmp_path, log.data))
    np.testing.assert_allclose(run["p"].t - run["p"].t[0], 0.1 * np.arange(6000), atol=6e-3)


def test_stamps_of_an_autopilot_that_has_run_for_hours_are_its_own(tmp_path: Path) -> None:
    """Its clock is 300 ppm slow: after ten hours that is eleven seconds."""
    log, late = TlogWriter(), np.random.default_rng(5).exponential(0.2, 2000)
    for k in range(2000):
        t = 0.1 * k
        boot = round(1e3 * (36_000.0 + t) * (1.0 - 3e-4))
        log.add(t + float(late[k]), mavlink.MAVLink_attitude_message(boot, *[0.01 * k] * 6))
    run = read(written(tmp_path, log.data))
    np.testing.assert_allclose(run["p"].t - run["p"].t[0], run["p"].values * 10.0, atol=0.05)


def test_a_restart_of_the_autopilot_leaves_times_of_receipt(tmp_path: Path) -> None:
    log = dive_tlog(20.0, parameters=SIX, boot=500.0)
    for k in range(50):
        log.add(30.0 + 0.1 * k, mavlink.MAVLink_attitude_message(3000 + 100 * k, *[0.1] * 6))
    run = read(written(tmp_path, log.data))
    assert not any("in place of times of receipt" in note for note in run.notes)
    assert run["phi"].t[-1] == pytest.approx(34.9, abs=0.1)


@pytest.mark.parametrize(
    ("flags", "taken"),
    [(831, True), (831 | 128, False), (167, False), (1, False)],
    ids=["aided", "held", "none", "attitude"],
)
def test_unaided_dead_reckoning_is_refused(tmp_path: Path, flags: int, taken: bool) -> None:
    run = read(written(tmp_path, dive_tlog(parameters=SIX, flags=flags, dvl=False).data))
    assert ("vn" in run) is taken
    assert ("x" in run) is taken
    assert "z" in run
    if not taken:
        assert "position, velocity: dead reckoning" in reasons(run)["LOCAL_POSITION_NED"]


def test_relative_position_is_the_velocity_integrated(tmp_path: Path) -> None:
    run = read(written(tmp_path, dive_tlog(parameters=SIX, flags=0b101111, dvl=False).data))
    assert "vn" in run
    assert "x" not in run
    assert "position: dead reckoning, no position aids it" in reasons(run)["LOCAL_POSITION_NED"]


@pytest.mark.parametrize(("kind", "taken"), [(14.0, True), (1.0, False)], ids=["acoustic", "satellites"])
def test_satellites_are_not_heard_under_water(tmp_path: Path, kind: float, taken: bool) -> None:
    """At 2 m of depth a fix of satellites is none; positions sent as GPS_INPUT may be those of an acoustic system."""
    log = dive_tlog(parameters={**SIX, "GPS_TYPE": kind}, dvl=False)
    for k in range(60):
        log.add(0.1 * k, mavlink.MAVLink_gps_raw_int_message(0, 3, 0, 0, 0, 100, 100, 0, 0, 12))
        if taken:
            log.add(
                0.1 * k,
                mavlink.MAVLink_gps_input_message(0, 0, 0, 0, 0, 3, 0, 0, 0.0, 0.0, 0.0, *[0.0] * 6, 9),
                (1, 220),
            )
    run = read(written(tmp_path, log.data))
    assert ("vn" in run) is taken
    if not taken:
        assert "satellites alone aid it" in reasons(run)["LOCAL_POSITION_NED"]


def test_motion_capture_that_is_sent_to_the_autopilot(tmp_path: Path) -> None:
    log = dive_tlog(parameters=SIX, dvl=False)
    covariance = [float("nan")] + [0.0] * 20
    for k in range(600):
        t = 0.01 * k
        q = [np.cos(0.05), 0.0, 0.0, np.sin(0.05)]
        message = mavlink.MAVLink_odometry_message(
            round(1e6 * (1e9 + t)), 1, 12, t, 0.5, 2.0, q, 1.0, 0.0, -0.1, 0.0, 0.0, 0.2, covariance, covariance
        )
        log.add(t + (0.1 if k % 7 == 3 else 0.0), message, (1, 197))
    run = read(written(tmp_path, log.data))
    assert used(run)["ODOMETRY"] == ("x", "y", "z", "qw", "qx", "qy", "qz", "u", "v", "w", "p", "q", "r")
    np.testing.assert_allclose(run["qz"].values, np.sin(0.05), atol=1e-7)
    np.testing.assert_allclose(run["w"].values, -0.1, atol=1e-7)
    np.testing.assert_allclose(np.diff(run["x"].t), 0.01, atol=1e-5)  # the sender's clock, not the link's


def test_odometry_in_other_frames_is_not_taken_for_these(tmp_path: Path) -> None:
    log = dive_tlog(parameters=SIX, dvl=False)
    for k in range(600):
        message = mavlink.MAVLink_odometry_message(
            0, 4, 11, 1.0, 2.0, 3.0, [1.0, 0, 0, 0], *[9.0] * 6, [0.0] * 21, [0.0] * 21
        )
        log.add(0.01 * k, message, (1, 197))
    run = read(written(tmp_path, log.data))
    assert "ODOMETRY" not in used(run)
    assert "no value" in reasons(run)["ODOMETRY"]


def test_instances_and_arrays(tmp_path: Path) -> None:
    log = dive_tlog(parameters=SIX)
    for k in range(20):
        for name, value in (("Lights", 0.5), ("Gain", 0.1 * k)):
            log.add(0.3 * k, mavlink.MAVLink_named_value_float_message(0, name.encode(), value))
    path = written(tmp_path, log.data)
    run = read(
        path,
        ColumnMapping.model_validate({"columns": {"u": "NAMED_VALUE_FLOAT[Gain].value", "q": "ATTITUDE@1.194.roll"}}),
    )
    np.testing.assert_allclose(run["u"].values, 0.1 * np.arange(20), rtol=1e-6)
    np.testing.assert_allclose(run["q"].values, 9.0)
    run = read(path, ColumnMapping.model_validate({"columns": {"w": "VISION_POSITION_DELTA.position_delta[2]"}}))
    np.testing.assert_allclose(run["w"].values, 0.005, rtol=1e-6)


def test_raw_units_of_other_autopilots_are_not_guessed(tmp_path: Path) -> None:
    log = TlogWriter()
    for k in range(50):
        log.add(0.1 * k, mavlink.MAVLink_heartbeat_message(12, 12, 0, 0, 4, 3))
        log.add(0.1 * k, mavlink.MAVLink_attitude_message(100 * k, *[0.01 * k] * 6))
        log.add(0.1 * k, mavlink.MAVLink_raw_imu_message(1, *[900] * 9))
    run = read(written(tmp_path, log.data))
    assert "ax" not in run
    assert "only ArduPilot's are known" in reasons(run)["RAW_IMU"]


def test_pressures_by_their_old_names(tmp_path: Path) -> None:
    parameters = {"GND_ABS_PRESS2": 100_000.0, "GND_SPEC_GRAV": 1.024}
    run = read(written(tmp_path, dive_tlog(parameters=parameters).data))
    t = run["z"].t - run["p"].t[0]
    np.testing.assert_allclose(run["z"].values, (2.0 + 0.1 * t) / 1.024, atol=1e-3)


def test_battery_by_its_cells(tmp_path: Path) -> None:
    log = TlogWriter()
    for k in range(20):
        cells = [4000, 4100, 4050, *[65535] * 7]
        log.add(0.1 * k, mavlink.MAVLink_battery_status_message(0, 0, 0, 0, cells, 0, 0, 0, 90))
        log.add(0.1 * k, mavlink.MAVLink_attitude_message(100 * k, *[0.01 * k] * 6))
    run = read(written(tmp_path, log.data))
    np.testing.assert_allclose(run["voltage"].values, 12.15)


def test_wrong_checksums_are_counted_and_named(tmp_path: Path) -> None:
    log = dive_tlog(parameters=SIX)
    plain = read(written(tmp_path, log.data))
    broken = bytearray(log.data)
    at = [i for i in range(len(broken)) if broken[i : i + 1] == b"\xfd" and broken[i + 7 : i + 10] == b"\x1e\0\0"]
    for place in at[10:30]:
        broken[place + 12] ^= 0x40
    run = read(written(tmp_path, broken, "broken.tlog"))
    assert run.repairs.damaged == 20
    assert any("wrong checksum" in line and "10 ATTITUDE of 1.1" in line for line in run.repairs.lines)
    assert len(run["phi"]) == len(plain["phi"]) - 10


@pytest.mark.parametrize("cut", [0.3, 0.5001, 0.77])
def test_cut_at_both_ends(tmp_path: Path, cut: float) -> None:
    whole = dive_tlog(20.0, parameters=SIX).data
    run = read(written(tmp_path, whole[int(len(whole) * 0.1) + 3 : int(len(whole) * cut)]))
    assert 1 <= run.repairs.damaged <= 2
    assert run.duration == pytest.approx(20.0 * (cut - 0.1), abs=0.5)


def test_garbage_between_packets(tmp_path: Path) -> None:
    whole = bytes(dive_tlog(20.0, parameters=SIX).data)
    noise = np.random.default_rng(2).bytes(4000) + b"\xfd" * 300 + b"\xfe\x09"
    run = read(written(tmp_path, whole[:5000] + noise + whole[5000:]))
    assert run.repairs.damaged <= 3
    assert any("bytes that are no message" in line for line in run.repairs.lines)
    assert run.duration == pytest.approx(19.9, abs=0.1)


def test_logs_one_after_the_other(tmp_path: Path) -> None:
    """Receipt is on the clock of the world: sessions that do not overlap make one log, in order of time."""
    first, later = dive_tlog(10.0, parameters=SIX), dive_tlog(8.0, parameters=SIX, epoch=1_700_000_100.0)
    run = read(written(tmp_path, later.data + first.data))
    assert run.duration == pytest.approx(107.9, abs=0.2)
    run = read(written(tmp_path, first.data + dive_tlog(8.0, parameters=SIX).data))
    assert run.duration == pytest.approx(9.9, abs=0.2)
    assert any("the clock goes back once" in note for note in run.notes)


def test_what_is_no_log(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"dive\.tlog: no MAVLink packet with a right checksum in it"):
        read(written(tmp_path, np.random.default_rng(3).bytes(20_000)))
    log = TlogWriter()
    for k in range(20):
        log.add(0.1 * k, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), (255, 190))
    with pytest.raises(InputError, match=r"no message that can be used; it has HEARTBEAT"):
        read(written(tmp_path, log.data))


def test_messages_that_the_dialect_lacks(tmp_path: Path) -> None:
    log = dive_tlog(parameters=SIX)
    strange = b"\xfd\x03\0\0\x05\x01\x01\xff\xff\x07abc\x12\x34"
    before = b"".join(round(1.7e15).to_bytes(8, "big") + strange for _ in range(7))
    run = read(written(tmp_path, before + log.data))
    assert run.repairs.damaged == 0
    assert any("7 messages of unknown numbers (524287)" in line for line in run.repairs.lines)


def test_decoding_is_pymavlinks() -> None:
    """Every number of every message is what pymavlink's own reader says."""
    log = dive_tlog(3.0, parameters=SIX, versions=(1, 2))
    tables, _ = decode(bytes(log.data), "log")
    rows: dict[str, list[Any]] = {}
    for message in mavlink.MAVLink(None).parse_buffer(b"".join(log.packets)):
        rows.setdefault(message.get_type(), []).append(message)
    for kind, messages in rows.items():
        assert sum(len(table) for table in tables.named(kind)) == len(messages)
        for table in tables.named(kind):
            sender = table.name.partition("@")[2]
            own = [each for each in messages if sender in ("", f"{each.get_srcSystem()}.{each.get_srcComponent()}")]
            for column in table.columns:
                name, _, element = column.rstrip("]").partition("[")
                values = [getattr(each, name) for each in own]
                expected = [value[int(element)] for value in values] if element else values
                assert table[column].tolist() == expected, (kind, column)


def test_layouts_are_pymavlinks() -> None:
    for number, layout in layouts().items():
        kind = mavlink.mavlink_map[number]
        assert (layout.name, layout.dtype.itemsize) == (kind.msgname, kind.unpacker.size)


def test_outputs_of_the_second_port_are_joined(tmp_path: Path) -> None:
    log = dive_tlog(parameters={**SIX, "SERVO17_FUNCTION": 39.0})
    for k in range(40):
        servos = {f"servo{n}_raw": 1500 + (k if n == 1 else 0) for n in range(1, 17)}
        log.add(0.1 * k + 0.02, mavlink.MAVLink_servo_output_raw_message(round(1e5 * k), 1, **servos))
    run = read(written(tmp_path, log.data))
    assert [name for name in run if name.startswith("cmd_")] == [f"cmd_{n}" for n in range(1, 8)]
    np.testing.assert_allclose(run["cmd_7"].measured.values, 1500.0 + np.arange(40))
    assert any("are joined to those of SERVO_OUTPUT_RAW[0]" in note for note in run.notes)


@pytest.mark.parametrize(
    ("flags", "refused"), [(0b1111111, ""), (0b10100111, "the filter reports that nothing aids it")]
)
def test_px4_tells_its_aiding_in_a_message_of_its_own(tmp_path: Path, flags: int, refused: str) -> None:
    log = TlogWriter()
    for k in range(50):
        t = 0.1 * k
        log.add(t, mavlink.MAVLink_heartbeat_message(12, 12, 0, 0, 0, 3))  # submarine, PX4
        log.add(t, mavlink.MAVLink_estimator_status_message(round(1e5 * k), flags, *([0.1] * 8)))
        log.add(t, mavlink.MAVLink_local_position_ned_message(100 * k, t, 0.0, 1.0, 1.0 + t, 0.0, 0.0))
        log.add(t, mavlink.MAVLink_attitude_message(100 * k, 0.01 * k, 0.0, 0.0, 0.1, 0.0, 0.0))
    run = read(written(tmp_path, log.data))
    assert ("vn" in run or "u" in run) is not refused
    assert refused in reasons(run)["LOCAL_POSITION_NED"]


def test_a_file_that_is_mostly_something_else_costs_a_bounded_search(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []
    monkeypatch.setattr("towtank.readers.mavlink.tlog.checksum", lambda data: tried.append(1) or checksum(data))
    monkeypatch.setattr("towtank.readers.mavlink.tlog._MANY_VAIN", 100)
    monkeypatch.setattr("towtank.readers.mavlink.tlog._MOST_VAIN", 300)
    good = bytes(dive_tlog(parameters=SIX).data)
    whole = scan_tlog(good, layouts())
    noise = b"\0" * 20 + b"\xfe\x01\x02\0" * 2000  # might all be packets of version 1, type 0 or 254
    found = scan_tlog(good + noise + good, layouts())  # behind a time packets are found after any number of others
    assert not found.given_up
    assert sum(len(each.payloads) for each in found.groups.values()) >= 2 * sum(
        len(each.payloads) for each in whole.groups.values()
    )
    tried.clear()
    stamped = b"\0\x05\0\0\0\0\0\0\xfe\x00\0\0\0\0\x01\x02" * 2000
    lost = scan_tlog(good + b"\0" * 20 + stamped, layouts())
    assert lost.given_up
    assert len(tried) <= 400 + len(whole.groups) + sum(len(each.payloads) for each in whole.groups.values())


def test_the_checksum_is_that_of_mavlink() -> None:
    from pymavlink.generator.mavcrc import x25crc

    chance = np.random.default_rng(1)
    for size in range(300):
        data = chance.bytes(size)
        assert checksum(data) == x25crc(data).crc
