"""What autopilots say of themselves: armed, mode, on the bottom; from every format that has it, and kept in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pymavlink.mavutil import mode_mapping_rover, mode_mapping_sub

from towtank.readers import read
from towtank.readers.ardupilot.states import (
    dataflash_states,
    heartbeat_states,
    mavros_modes,
    mavros_states,
    tells_pressure,
    with_states,
)
from towtank.readers.common.tables import Table, Tables
from towtank.recording import ColumnMapping, Recording
from towtank.recording.channel import Channel
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE, free_motion, mode_names
from towtank.vehicle import load_vehicle

from .encoders import DataFlashWriter, dive_bin, dive_tlog
from .ros_bags import Said, header, imu, multi_array, register, write_mcap2

SIX = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 7)}
KEY, BELOW = DEPTH_BELOW_SURFACE
register(
    "mavros_msgs/msg/State",
    "std_msgs/Header header\nbool connected\nbool armed\nbool guided\nbool manual_input\nstring mode\n"
    "uint8 system_status",
)


def dive(*said: tuple[float, str, tuple[float, ...]]) -> DataFlashWriter:
    parameters = {**SIX, "BARO_PRIMARY": 1.0, "BARO2_GND_PRESS": 100_000.0}
    return dive_bin(20.0, parameters=parameters, said=said)


def arm(t: float, on: int) -> tuple[float, str, tuple[float, ...]]:
    return t, "ARM", (on, 0, 0, 0)


def mode(t: float, number: int) -> tuple[float, str, tuple[float, ...]]:
    return t, "MODE", (number, number, 1)


def event(t: float, number: int) -> tuple[float, str, tuple[float, ...]]:
    return t, "EV", (number,)


def written(folder: Path, data: bytes | bytearray, name: str) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def cuts(run: Recording) -> list[str]:
    return [each.text for each in free_motion(run, load_vehicle("bluerov2")).left_out]


@pytest.mark.parametrize("events", [False, True], ids=["ARM", "EV"])
def test_dataflash_armed(tmp_path: Path, events: bool) -> None:
    """ARM and EV tell changes: before the first one it was the other way round."""
    log = dive(event(4.0, 10), event(16.0, 11)) if events else dive(arm(4.0, 1), arm(16.0, 0))
    run = read(written(tmp_path, log.data, "dive.BIN"))
    assert run["armed"].t == pytest.approx([0.0, 4.0, 16.0])
    assert run["armed"].values.tolist() == [0.0, 1.0, 0.0]
    assert cuts(run) == ["0 to 4 s: disarmed", "16 to 20 s: disarmed"]
    assert (run.start, run.end) == pytest.approx((0.0, 19.98))
    used = {each.name: each.used for each in run.contents if "armed" in each.used}
    assert used == {"EV" if events else "ARM": ("armed",)}


def test_dataflash_modes_and_the_bottom(tmp_path: Path) -> None:
    log = dive(mode(0.0, 19), mode(5.0, 9), mode(9.0, 2), event(14.1, 165), event(14.4, 166))
    run = read(written(tmp_path, log.data, "dive.BIN"))
    assert mode_names(run) == {2: "ALT_HOLD", 9: "SURFACE", 19: "MANUAL"}
    assert run.attributes[KEY] == BELOW
    assert "armed" not in run
    found = cuts(run)
    assert found[0].startswith("5 to 9 s: autopilot in mode SURFACE")
    assert found[1:] == ["14.1 to 14.4 s: on the bottom"]


def test_with_a_mapping_the_states_are_there_too(tmp_path: Path) -> None:
    log = dive(arm(4.0, 1))
    path = written(tmp_path, log.data, "dive.BIN")
    run = read(path, ColumnMapping.model_validate({"thrusters": ["RCOU.C1"], "columns": {"r": "IMU[0].GyrZ"}}))
    assert run.names == ("r", "cmd_1", "armed")
    assert cuts(run) == ["0 to 4 s: disarmed"]


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_files_of_our_own_keep_them(tmp_path: Path, suffix: str) -> None:
    log = dive(arm(4.0, 1), mode(10.0, 9))
    run = read(written(tmp_path, log.data, "dive.BIN"))
    run.write(tmp_path / f"dive.{suffix}")
    again = read(tmp_path / f"dive.{suffix}")
    assert cuts(again) == cuts(run) != []


def test_a_table_that_is_mapped(tmp_path: Path) -> None:
    t = np.arange(200) / 10.0
    rows = "\n".join(f"{x},{np.sin(x)},{1500 + k % 7},{int(5.0 <= x < 15.0)}" for k, x in enumerate(t))
    (tmp_path / "log.csv").write_text(f"t,gyro,pwm,arming\n{rows}\n")
    mapping = {"thrusters": ["pwm"], "columns": {"r": "gyro", "armed": "arming"}}
    run = read(tmp_path / "log.csv", ColumnMapping.model_validate(mapping))
    assert cuts(run) == ["0 to 5 s: disarmed", "15 to 19.9 s: disarmed"]


def test_heartbeats(tmp_path: Path) -> None:
    """Armed between two heartbeats that say so; those of ground stations and companions say nothing."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    log = dive_tlog(30.0, parameters={**SIX, "BARO_PRIMARY": 1.0, "BARO2_GND_PRESS": 100_000.0})
    assert cuts(read(written(tmp_path, log.data, "never.tlog"))) == ["0 to 29.9 s: disarmed"]
    armed = dive_tlog(30.0, parameters={**SIX, "BARO_PRIMARY": 1.0, "BARO2_GND_PRESS": 100_000.0})
    armed._packets = [each for each in armed._packets if not _is_heartbeat(each[1])]
    for k in range(30):
        on = 128 if 5 <= k <= 20 else 0
        armed.add(float(k), mavlink.MAVLink_heartbeat_message(12, 3, 81 + on, 19, 4, 3))
        armed.add(k + 0.2, mavlink.MAVLink_heartbeat_message(6, 8, 192, 0, 4, 3), (255, 190))
    run = read(written(tmp_path, armed.data, "dive.tlog"))
    assert mode_names(run) == {19: "MANUAL"}
    assert run.attributes[KEY] == BELOW
    first, last = (each.partition(" s")[0] for each in cuts(run))
    assert first == "0 to 5"
    assert last == "20 to 29.9"


def _is_heartbeat(packet: bytes) -> bool:
    """Whether a packet of MAVLink 2 is a HEARTBEAT, message 0."""
    return packet[0] == 0xFD and packet[7:10] == b"\0\0\0"


def test_mavros(tmp_path: Path) -> None:
    said = []
    still = {"connected": True, "guided": False, "manual_input": True, "system_status": 4}
    for k in range(400):
        t = k / 20.0
        motion = imu(t, "base_link", (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, np.sin(t)), (0.0, 0.0, 9.8))
        pulses = multi_array([1500.0 + k % 9, 1500.0])
        said.append(Said("/mavros/imu/data", t, "sensor_msgs/msg/Imu", motion))
        said.append(Said("/thrusters/pwm", t, "std_msgs/msg/Float64MultiArray", pulses))
        if k % 20 == 0:
            mode = "MANUAL" if k < 300 else "SURFACE"
            state = {"header": header(t, ""), "armed": k >= 100, "mode": mode, **still}
            said.append(Said("/mavros/state", t, "mavros_msgs/msg/State", state))
    run = read(write_mcap2(tmp_path / "run.mcap", said))
    assert mode_names(run) == {0: "MANUAL", 1: "SURFACE"}
    found = cuts(run)
    assert found[0] == "0 to 5 s: disarmed"
    assert found[1].startswith("15 to 19.9 s: autopilot in mode SURFACE")
    assert {each.name: each.used for each in run.contents}["/mavros/state"] == ("armed", "mode")


@pytest.mark.parametrize(
    ("kind", "number", "name"),
    [
        *((12.0, *each) for each in mode_mapping_sub.items()),
        *((11.0, *each) for each in mode_mapping_rover.items() if each[1] != "LEARNING"),  # which ArduPilot gave up
    ],
)
def test_modes_have_the_names_that_ardupilot_gives_them(kind: float, number: int, name: str) -> None:
    t = np.arange(4.0)
    run = Recording.from_table(t, {"r": np.sin(t)})
    table = Table("HEARTBEAT", t, {"base_mode": 0.0 * t, "custom_mode": number + 0.0 * t, "type": kind + 0.0 * t})
    assert mode_names(with_states(run, *heartbeat_states(table))) == {number: name}


@pytest.mark.parametrize(
    ("kinds", "name"),
    [
        *(((10.0,), "HOLD"), ((11.0,), "HOLD"), ((9.0,), "GUIDED"), ((12.0,), "GUIDED")),
        *(((11.0, 11.0, 12.0), "HOLD"), ((11.0, 12.0), "GUIDED"), ((), "GUIDED")),
    ],
)
def test_rovers_and_boats_have_modes_of_their_own(kinds: tuple[float, ...], name: str) -> None:
    table = Table("HEARTBEAT", np.arange(float(len(kinds))), {"type": np.array(kinds)})
    _, modes = heartbeat_states(table)
    assert modes[4] == name


@pytest.mark.parametrize(
    ("parameters", "said", "rover"),
    [
        ({"SERVO1_FUNCTION": 26.0}, (), True),
        ({"SERVO12_FUNCTION": 70.0}, (), True),
        ({"SERVO1_FUNCTION": 73.0, "SERVO3_FUNCTION": 74.0}, (), True),
        ({"SERVO1_FUNCTION": 33.0, "RC1_FUNCTION": 26.0}, ("ArduSub V4.1",), False),
        ({}, ("ArduRover V4.2",), True),
        ({}, (), False),
    ],
)
def test_a_rover_is_known_by_its_outputs_or_its_words(
    parameters: dict[str, float], said: tuple[str, ...], rover: bool
) -> None:
    messages = Table("MSG", np.arange(float(len(said))), {}, text={"Message": said})
    _, modes = dataflash_states(Tables("dive.BIN", {"MSG": messages}, parameters))
    assert modes[4] == ("HOLD" if rover else "GUIDED")


def test_a_state_told_now_and_then_is_on_between_two_that_say_so() -> None:
    on = np.array([0.0, 1.0, 1.0, 0.0, 1.0])
    t = np.array([4.0, 1.0, 2.0, 3.0, 5.0])[[1, 2, 3, 0, 4]]
    table = Table("HEARTBEAT", t, {"base_mode": 128.0 * on + 127.0, "custom_mode": np.array([0.0, 4.0, 4.0, 9.0, 9.0])})
    states, modes = heartbeat_states(table)
    assert states["armed"][0] == "HEARTBEAT"
    assert states["armed"][1].values.tolist() == [0.0, 1.0, 0.0, 0.0, 1.0]
    assert states["mode"][1].values.tolist() == [0.0, 4.0, 4.0, 9.0, 9.0]
    assert (modes[9], modes[20]) == ("SURFACE", "MOTOR_DETECT")


def test_states_without_a_time_are_left_out_and_of_two_at_once_the_last_counts() -> None:
    t = np.array([2.0, np.nan, 0.0, 0.0])
    table = Table("/state", t, {"armed": np.array([0.0, 1.0, 1.0, 0.0])}, text={"mode": ("a,b", "", "x", "a,b")})
    states, modes = mavros_states(table)
    assert (states["armed"][1].t.tolist(), states["armed"][1].values.tolist()) == ([0.0, 2.0], [0.0, 0.0])
    assert states["mode"][1].values.tolist() == [0.0, 0.0]
    assert modes == mavros_modes({"a,b": 0, "": 1, "x": 2}) == {0: "A B", 1: "none", 2: "X"}


def test_modes_that_have_no_name_keep_their_number_and_states_of_the_recording_itself_come_first() -> None:
    t = np.arange(10.0)
    own = Recording.from_table(t, {"r": np.sin(t)}).replace([Channel("armed", t, np.ones(10), "1", "")])
    table = Table(
        "HEARTBEAT", t, {"base_mode": 0.0 * t, "custom_mode": 19.0 + 80.0 * (t > 4.0), "type": 12.0 + 0.0 * t}
    )
    run = with_states(own, *heartbeat_states(table))
    assert run["armed"].values.tolist() == [1.0] * 10
    assert mode_names(run) == {19: "MANUAL", 99: "mode 99"}


@pytest.mark.parametrize(
    ("name", "tells"),
    [
        *(("BARO", True), ("BARO[1]", True), ("BAR3", True), ("SCALED_PRESSURE2@1.1", True)),
        *(("mavlink/SCALED_PRESSURE", True), ("BAROX", False), ("SCALED_PRESSURE4", False)),
        *(("SCALED_PRESSURE/x", False), ("XBARO", False)),
    ],
)
def test_tables_of_pressure_are_known_by_their_names(name: str, tells: bool) -> None:
    assert tells_pressure(name) is tells
