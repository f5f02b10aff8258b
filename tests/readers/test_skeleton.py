"""A mapping to fill in: what names and numbers suggest, and that what is written is read back."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

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


def written(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """A CSV of these columns, cells of NaN empty."""
    rows = zip(*columns.values(), strict=True)
    lines = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")
    return path


def test_a_mapping_says_what_it_supposes_and_lists_all_else(tmp_path: Path) -> None:
    t = np.arange(8) / 4.0
    columns = {
        "time": t,
        "pwm2": 1500.0 + 100.0 * np.sign(np.sin(3.0 * t)),
        "pwm1": 1500.0 - 50.0 * np.sign(np.sin(3.0 * t)),
        "vx": 0.5 * t,
        "vy": 0.0 * t,
        "vel_north": 0.5 * t,
        "imu_yaw": 2.0 * t,
        "yaw_deg": 90.0 * t,
        "heading": 0.01 * t,
        "acc_z": -9.8 + 0.01 * t,
        "Größe": t**2,
    }
    found = mapping_skeleton(written(tmp_path / "dive.csv", columns))
    head, _, body = found.text.partition("\n\n")
    assert head.startswith("# Which of the columns of dive.csv is which channel.\n")
    assert "#   towtank inspect dive.csv --map THIS_FILE\n" in head
    asked = {name: "\n".join(f'# {each} = ""' for each in name) for name in ("xyz", "pqr")}
    assert (
        body
        == f"""\
# Commands: source columns in the order of the vehicle's [[thrusters]], in the unit of its thruster curves.
thrusters = ["pwm1", "pwm2"]
#   pwm1: 1450 .. 1550
#   pwm2: 1400 .. 1600

body = "FRD"                                  # acc_z averages -9.79: z down if it was mostly level; FLU: z up
world = "NED"                                 # x north, y east, z down; ENU: x east, y north, z up

[columns]
t = "time"                                    # s; 0 .. 1.75

# position [m]
{asked["xyz"]}

# attitude: Euler angles, or a quaternion [rad]
# phi = ""
# theta = ""
psi = {{ from = "yaw_deg", scale = 0.017453292519943295 }}  # 0 .. 157.5, in deg
# or: psi = {{ from = "heading", scale = 0.017453292519943295 }}  # 0 .. 0.0175: degrees?
# or: psi = "imu_yaw"                               # 0 .. 3.5

# velocity over ground, along the body [m/s]
u = "vx"                                      # 0 .. 0.875
v = "vy"                                      # always 0
# w = ""

# velocity over ground, along the world's axes [m/s]
# or: vn = "vel_north"                              # 0 .. 0.875

# angular rates [rad/s]
{asked["pqr"]}

# specific force, as an accelerometer measures it [m/s^2]
# ax = ""
# ay = ""
az = "acc_z"                                  # -9.8 .. -9.783

# What else the log holds:
#   "Größe"                                   0 .. 3.062
"""
    )
    assert found.suggested == {"t": "time", "psi": "yaw_deg", "u": "vx", "v": "vy", "az": "acc_z"}
    assert found.columns == tuple(columns)


def suggested(path: Path, **columns: float) -> dict[str, object]:
    """The mapping of a table whose columns go from nought to these values and back."""
    there_and_back = np.append(np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.0, 50))
    table = {"t": np.arange(100) / 10.0} | {name: most * there_and_back for name, most in columns.items()}
    found: dict[str, object] = tomllib.loads(mapping_skeleton(written(path / "table.csv", table)).text)["columns"]
    return found


@pytest.mark.parametrize(
    ("most", "scale"),
    [
        ({"yaw": 24.9}, 1.0),
        ({"yaw": 25.1}, DEGREE),
        ({"yaw": 399.0}, DEGREE),
        ({"yaw": 401.0}, 0.01 * DEGREE),
        ({"yaw": 24.9, "pitch": 1.64}, 1.0),
        ({"yaw": 24.9, "pitch": 1.66}, DEGREE),
        ({"yaw": 3599.0, "pitch": 94.9}, DEGREE),
        ({"yaw": 3601.0, "pitch": 94.9}, 0.01 * DEGREE),
        ({"yaw": 3000.0, "pitch": 95.1}, 0.01 * DEGREE),
    ],
)
def test_the_largest_angle_of_a_family_tells_its_unit(tmp_path: Path, most: dict[str, float], scale: float) -> None:
    found = suggested(tmp_path, **most)
    expected = "yaw" if scale == 1.0 else {"from": "yaw", "scale": pytest.approx(scale)}
    assert found["psi"] == expected


@pytest.mark.parametrize(
    ("name", "most", "scale"),
    [
        ("gyro_z", 24.9, 1.0),
        ("gyro_z", 25.1, 1e-3),
        ("yaw_rate", 24.9, 1.0),
        ("yaw_rate", 25.1, DEGREE),
    ],
)
def test_a_rate_that_no_vehicle_has_is_in_another_unit(tmp_path: Path, name: str, most: float, scale: float) -> None:
    found = suggested(tmp_path, **{name: most})
    assert found["r"] == (name if scale == 1.0 else {"from": name, "scale": pytest.approx(scale)})


@pytest.mark.parametrize(
    ("usual", "scale"),
    [
        *((0.69, 1.0), (0.71, 9.80665), (-1.29, 9.80665), (1.31, 1.0), (9.8, 1.0)),
        *((699.0, 1.0), (701.0, 9.80665e-3), (-1299.0, 9.80665e-3), (1301.0, 1.0)),
    ],
)
def test_gravity_tells_the_unit_of_an_accelerometer(tmp_path: Path, usual: float, scale: float) -> None:
    columns = {"t": np.arange(20) / 10.0, "acc_z": usual + 1e-3 * (np.arange(20) % 2)}
    found = tomllib.loads(mapping_skeleton(written(tmp_path / "table.csv", columns)).text)["columns"]["az"]
    assert found == ("acc_z" if scale == 1.0 else {"from": "acc_z", "scale": pytest.approx(scale)})


@pytest.mark.parametrize(
    ("mean", "frame", "said"),
    [(4.8, "FRD", "x forward"), (5.0, "FLU", "z up if"), (-4.8, "FRD", "x forward"), (-5.0, "FRD", "z down if")],
)
def test_half_of_gravity_tells_where_down_is(tmp_path: Path, mean: float, frame: str, said: str) -> None:
    columns = {"t": np.arange(20) / 10.0, "acc_z": mean + 1e-3 * (np.arange(20) % 2)}
    text = mapping_skeleton(written(tmp_path / "table.csv", columns)).text
    assert tomllib.loads(text)["body"] == frame
    assert said in next(line for line in text.splitlines() if line.startswith("body"))


@pytest.mark.parametrize(
    ("name", "step", "scale"),
    [
        ("time", 1.9, 1.0),
        ("time", 2.0, 1e-3),
        ("time", 999.0, 1e-3),
        ("time", 1000.0, 1e-6),
        ("time", 999_999.0, 1e-6),
        ("time", 1e6, 1e-9),
        ("time_us", 0.02, 1e-6),
    ],
)
def test_the_steps_of_a_time_tell_its_unit(tmp_path: Path, name: str, step: float, scale: float) -> None:
    columns = {name: step * np.arange(20), "surge": np.sin(np.arange(20.0))}
    found = tomllib.loads(mapping_skeleton(written(tmp_path / "table.csv", columns)).text)["columns"]["t"]
    assert found == (name if scale == 1.0 else {"from": name, "scale": pytest.approx(scale)})


def test_of_two_attitudes_one_is_named_and_a_quaternion_is_whole_or_not_there(tmp_path: Path) -> None:
    wave = np.sin(np.arange(20.0))
    four = {f"q_{axis}": 0.5 + 0.1 * wave for axis in "wxyz"}
    three = {name: four[name] for name in list(four)[:3]}
    angles = {"roll": 0.1 * wave, "pitch": 0.1 * wave, "yaw": wave}
    named = []
    for columns in (four, three, four | angles):
        table = written(tmp_path / "table.csv", {"t": np.arange(20) / 10.0, **columns})
        named.append(mapping_skeleton(table).suggested.keys() - {"t"})
    assert named == [{"qw", "qx", "qy", "qz"}, set(), {"phi", "theta", "psi"}]


def test_a_table_without_a_time_is_asked_for_its_rate_and_many_thrusters_stand_below_each_other(tmp_path: Path) -> None:
    wave = np.sin(np.arange(20.0))
    columns = {f"of_the_bow_thruster_command_{k}": (k + 1.0) * wave for k in range(8)}
    text = mapping_skeleton(written(tmp_path / "table.csv", columns)).text
    assert f"\n# {'rate = 100.0':44}  # Hz, of the rows: no column is known to be a time" in text
    assert "thrusters = [\n" + "".join(f'    "{name}",\n' for name in columns) + "]\n" in text
    assert tomllib.loads(text)["thrusters"] == list(columns)
    assert 'thrusters = ["", ""]' in mapping_skeleton(written(tmp_path / "table.csv", {"yaw": wave})).text


def test_what_else_a_log_of_messages_holds_is_listed_by_table(tmp_path: Path) -> None:
    t = np.arange(0.0, 5.0, 0.1)
    path = tmp_path / "run.mat"
    few = {"time": t, "salt": t, "oxygen": 2.0 * t}
    many = {"time": t[:25], **{f"cell_of_the_array_{k}": t[:25] for k in range(13)}}
    savemat(path, {"water": few, "array": many})
    text = mapping_skeleton(path).text
    rest = text.partition("# What else the log holds:\n")[2]
    assert "#   water, 10 Hz: water.salt (0 .. 4.9), water.oxygen (0 .. 9.8)\n" in rest
    assert rest.count("cell_of_the_array_") == 13
    assert "cell_of_the_array_0 (" not in rest
    assert max(map(len, text.splitlines())) <= 115
    assert "# The messages have times of their own.\n" in text
    assert 'body = "FRD"                                  # x forward, y to starboard, z down;' in text


def test_files_without_numbers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "words.csv"
    path.write_text("a,b\nx,y\nz,w\n")
    with pytest.raises(InputError, match=r"words\.csv: holds no column of numbers"):
        mapping_skeleton(path)
    path.write_text("a,b\n1,2\n3\n")
    with pytest.raises(InputError, match=r"words\.csv:3: found 1 cells, expected 2"):
        mapping_skeleton(path)


def test_what_is_about_one_is_no_gravity_but_in_az(tmp_path: Path) -> None:
    one = 1.0 + 1e-3 * (np.arange(20) % 2)
    columns = {"t": np.arange(20) / 10.0, "surge": one, "acc_x": one, "voltage": one, "acc_z": one}
    found = tomllib.loads(mapping_skeleton(written(tmp_path / "table.csv", columns)).text)["columns"]
    assert (found["u"], found["ax"], found["voltage"]) == ("surge", "acc_x", "voltage")
    assert found["az"] == {"from": "acc_z", "scale": pytest.approx(9.80665)}
