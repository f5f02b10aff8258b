"""A mapping to fill in: what names and numbers suggest, and that what is written is read back."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.common.column_names import suggestion
from towtank.readers.common.skeleton import mapping_skeleton
from towtank.recording import Recording, load_mapping
from towtank.recording.standard import STANDARD

DEGREE = np.pi / 180.0


@pytest.mark.parametrize(
    ("name", "quantity", "channel"),
    [
        ("gyro_x", "rates", "p"),
        ("GyrZ", "rates", "r"),
        ("yaw_rate", "rates", "r"),
        ("rollspeed", "rates", "p"),
        ("angular_velocity.y", "rates", "q"),
        ("AccY", "specific force", "ay"),
        ("linear_acceleration.z", "specific force", "az"),
        ("heading_deg", "attitude", "psi"),
        ("pose.orientation.w", "attitude", "qw"),
        ("dvl_vx", "velocity", "u"),
        ("twist.linear.y", "velocity", "v"),
        ("vel_north", "world velocity", "vn"),
        ("depth_m", "position", "z"),
        ("pose.position.x", "position", "x"),
        ("time_ms", "time", "t"),
        ("pwm3", "thruster", "3"),
        ("motor_right", "thruster", "2"),
        ("batt_V", "voltage", "voltage"),
    ],
)
def test_names_that_are_usual_are_known(name: str, quantity: str, channel: str) -> None:
    found = suggestion(name)
    assert found is not None
    assert (found.quantity, found.channel) == (quantity, channel)


@pytest.mark.parametrize("name", ["desired_yaw", "DesRoll", "temperature", "mag_x", "acc_std_x", "batt", "mode", "lat"])
def test_names_that_mean_something_else_are_left_alone(name: str) -> None:
    assert suggestion(name) is None


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A CSV with names, units and signs of its own, and a column of text."""
    t = np.arange(0.0, 20.0, 0.05)
    columns = {
        "time_ms": 1e3 * t,
        "pwm1": 1500.0 + 200.0 * np.sign(np.sin(t)),
        "pwm2": 1500.0 - 200.0 * np.sign(np.sin(t)),
        "pwm3": np.full(t.size, 1500.0),
        "pwm4": np.full(t.size, 1100.0),
        "gyro_x_dps": 20.0 * np.sin(t),
        "acc_z": -9.81 + 0.1 * np.cos(t),
        "roll": 10.0 * np.sin(t),
        "pitch": 5.0 * np.cos(t),
        "yaw": 180.0 + 90.0 * np.sin(0.3 * t),
        "altitude": 2.0 + 0.5 * np.sin(0.2 * t),
        "temperature": 20.0 + 0.0 * t,
    }
    lines = [",".join([*columns, "mode"])]
    lines += [",".join([*(repr(float(values[k])) for values in columns.values()), "manual"]) for k in range(t.size)]
    path = tmp_path / "dive.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_what_is_written_is_accepted_and_means_what_the_columns_hold(table: Path, tmp_path: Path) -> None:
    found = mapping_skeleton(table)
    mapping = tmp_path / "map.toml"
    mapping.write_text(found.text)
    recording = read(table, mapping)
    t = np.arange(0.0, 20.0, 0.05)
    expected = {
        "p": 20.0 * DEGREE * np.sin(t),
        "az": -9.81 + 0.1 * np.cos(t),
        "phi": 10.0 * DEGREE * np.sin(t),
        "theta": 5.0 * DEGREE * np.cos(t),
        "psi": DEGREE * (180.0 + 90.0 * np.sin(0.3 * t)),
        "z": -2.0 - 0.5 * np.sin(0.2 * t),
        "cmd_1": 1500.0 + 200.0 * np.sign(np.sin(t)),
    }
    for name, values in expected.items():
        assert np.allclose(recording[name].t, t)
        assert np.allclose(recording[name], values), name
    assert found.thrusters == ("pwm1", "pwm2", "pwm3")  # the third rests, the fourth drives something else
    assert "temperature" in found.text
    assert "mode" not in found.columns


def test_every_line_that_is_a_comment_with_a_name_can_be_filled_in(table: Path, tmp_path: Path) -> None:
    text = mapping_skeleton(table).text
    filled = text.replace('# u = ""', 'u = "temperature"').replace('# v = ""', 'v = "temperature"')
    assert filled.count("temperature") > text.count("temperature")
    (tmp_path / "map.toml").write_text(filled)
    assert {"u", "v", "psi"} <= set(read(table, tmp_path / "map.toml"))


def test_angles_beyond_a_turn_are_radians_where_the_pitch_says_so(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    rows = [f"{x},{0.1 * np.sin(x)},{0.5 * np.cos(x)},{0.8 * x}" for x in t]
    path = tmp_path / "spin.csv"
    path.write_text("t,ekf_roll,ekf_pitch,ekf_yaw\n" + "\n".join(rows) + "\n")
    columns = tomllib.loads(mapping_skeleton(path).text)["columns"]
    assert columns == {"t": "t", "phi": "ekf_roll", "theta": "ekf_pitch", "psi": "ekf_yaw"}


@pytest.mark.parametrize(
    ("factor", "turns"), [(1.0, 0), (1.0, 3), (100.0, 0)], ids=["degrees", "unwrapped degrees", "hundredths"]
)
def test_the_angles_of_a_calm_vehicle_have_the_unit_of_its_heading(tmp_path: Path, factor: float, turns: int) -> None:
    """Roll and pitch of a degree look like radians; the heading beside them does not."""
    t = np.arange(0.0, 20.0, 0.1)
    angles = {
        "roll": 0.8 * np.sin(t),
        "pitch": 1.2 * np.cos(t),
        "yaw": 200.0 + 150.0 * np.sin(0.3 * t) + 18.0 * turns * t,
    }
    if factor > 1.0:
        angles["pitch"] = 3.0 * angles["pitch"]
    rows = zip(t, *(factor * values for values in angles.values()), strict=True)
    path = tmp_path / "calm.csv"
    path.write_text("t,roll,pitch,yaw\n" + "\n".join(",".join(repr(float(x)) for x in row) for row in rows) + "\n")
    (tmp_path / "map.toml").write_text(mapping_skeleton(path).text)
    recording = read(path, tmp_path / "map.toml")
    for channel, name in (("phi", "roll"), ("theta", "pitch"), ("psi", "yaw")):
        assert np.allclose(recording[channel].values, DEGREE * angles[name]), channel


def test_gravity_tells_which_way_z_points(tmp_path: Path) -> None:
    rows = [f"{0.1 * k},{0.01 * (k % 3)},{9.8 + 0.01 * (k % 2)}" for k in range(100)]
    path = tmp_path / "up.csv"
    path.write_text("t,acc_x,acc_z\n" + "\n".join(rows) + "\n")
    assert tomllib.loads(mapping_skeleton(path).text)["body"] == "FLU"


def test_a_recording_of_our_own_maps_to_itself(tmp_path: Path) -> None:
    t = np.arange(0.0, 5.0, 0.1)
    names = [name for name in STANDARD if not name.startswith("q") or name == "q"]
    run = Recording.from_table(t, {**{name: np.sin(t + k) for k, name in enumerate(names)}, "cmd_aft": np.cos(t)})
    for suffix in (".csv", ".parquet"):
        run.write(tmp_path / f"run{suffix}")
        found = mapping_skeleton(tmp_path / f"run{suffix}")
        (tmp_path / "map.toml").write_text(found.text)
        assert found.suggested.keys() >= {"u", "psi", "cmd_aft"}
        again = read(tmp_path / f"run{suffix}", tmp_path / "map.toml")
        assert all(again[name] == run[name] for name in found.suggested if name != "t")


def test_messages_are_named_by_table_and_field(tmp_path: Path) -> None:
    t = np.arange(0.0, 5.0, 0.1)
    Recording.from_table(t, {"u": np.sin(t), "cmd_aft": np.cos(t)}).write(tmp_path / "run.mcap")
    found = mapping_skeleton(tmp_path / "run.mcap")
    assert "t" not in tomllib.loads(found.text)["columns"]
    (tmp_path / "map.toml").write_text(found.text)
    again = read(tmp_path / "run.mcap", load_mapping(tmp_path / "map.toml"))
    assert np.allclose(again["u"], np.sin(t))


def test_elements_of_an_array_of_thrusters_are_commands() -> None:
    found = [suggestion(f"data[{k}]", "/rovio/thrusters", "std_msgs/msg/Float32MultiArray") for k in range(3)]
    assert [each and (each.quantity, each.channel) for each in found] == [("thruster", str(k)) for k in range(3)]


def test_every_usual_channel_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,b\n0,1\n1,2\n2,3\n3,5\n")
    text = mapping_skeleton(tmp_path / "a.csv").text
    asked = ["x", "y", "z", "phi", "theta", "psi", "u", "v", "w", "p", "q", "r", "ax", "ay", "az"]
    filled = text
    for name in asked:
        assert f'\n# {name} = ""' in text, name
        filled = filled.replace(f'# {name} = ""', f'{name} = "b"')
    (tmp_path / "map.toml").write_text(filled)
    assert set(read(tmp_path / "a.csv", tmp_path / "map.toml")) == set(asked)


def test_files_without_numbers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "words.csv"
    path.write_text("a,b\nx,y\nz,w\n")
    with pytest.raises(InputError, match=r"words\.csv: holds no column of numbers"):
        mapping_skeleton(path)
    path.write_text("a,b\n1,2\n3\n")
    with pytest.raises(InputError, match=r"words\.csv:3: found 1 cells, expected 2"):
        mapping_skeleton(path)
