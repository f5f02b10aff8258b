"""What ROS messages mean: a motion told in the frames of ROS comes back in NED and FRD."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.mcap.scan import scan_mcap
from towtank.readers.ros.meaning import MEANINGS, meaning_of
from towtank.readers.ros.tables import ros_tables
from towtank.recording import Content, Recording
from towtank.recording.frames.conversion import convert_quaternion

from .ros_bags import Said, header, imu, multi_array, odometry, register, write_mcap2, xyz, xyzw

N = 120
T = 0.05 * np.arange(N)
POSITION = np.column_stack([np.sin(T), 2.0 * T, 3.0 + np.cos(T)])  # NED
EULER = np.column_stack([0.3 * np.sin(T), 0.2 * np.cos(T), 0.5 * T])
Q = quaternions_from_eulers(EULER)  # FRD to NED
BODY = np.column_stack([np.cos(T), 0.1 * T, -0.2 * np.sin(T)])  # any vector, FRD
RATES = np.column_stack([0.3 * np.cos(T), 0.01 * T, 0.5 + 0.1 * np.sin(T)])
WORLD = np.column_stack([np.cos(3 * T), np.sin(3 * T), 0.3 * np.cos(T)])  # any vector, NED

register("mavros_msgs/msg/RCOut", "std_msgs/Header header\nuint16[] channels")
register("dvl_msgs/msg/DVLBeam", "int64 id\nfloat64 velocity\nfloat64 distance\nfloat64 rssi\nfloat64 nsd\nbool valid")
register(
    "dvl_msgs/msg/DVL",
    "std_msgs/Header header\nfloat64 time\ngeometry_msgs/Vector3 velocity\nfloat64 fom\nfloat64[] covariance\n"
    "float64 altitude\nDVLBeam[] beams\nbool velocity_valid\nint64 status\nstring form",
)
register(
    "marine_acoustic_msgs/msg/Dvl",
    "std_msgs/Header header\nuint8 velocity_mode\nuint8 dvl_type\ngeometry_msgs/Vector3 velocity\n"
    "float64[9] velocity_covar\nfloat64 altitude\nfloat64 course_gnd\nfloat64 speed_gnd\nuint8 num_good_beams\n"
    "float32 sound_speed\nbool beam_ranges_valid\nbool beam_velocities_valid\n"
    "geometry_msgs/Vector3[4] beam_unit_vec\nfloat64[4] range\nfloat32[4] range_covar\nfloat32[4] beam_quality\n"
    "float32[4] beam_velocity\nfloat32[4] beam_velocity_covar",
)


def flu(vector: np.ndarray) -> np.ndarray:
    return vector * [1.0, -1.0, -1.0]


def enu(vector: np.ndarray) -> np.ndarray:
    return np.column_stack([vector[:, 1], vector[:, 0], -vector[:, 2]])


def attitude(world: str, body: str) -> np.ndarray:
    """Return the attitude from the body's frame to the world's; its own inverse conversion."""
    return convert_quaternion(Q, body=body, world=world)


def log(path: Path, topic: str, kind: str, fields: Callable[[int], dict[str, Any]], *more: Said) -> Recording:
    said = [Said(topic, float(T[k]), kind, fields(k)) for k in range(N)]
    return read(write_mcap2(path / "a.mcap", sorted([*said, *more], key=lambda each: each.t)))


def quaternions(run: Recording) -> np.ndarray:
    return np.column_stack([run[name].values for name in ("qw", "qx", "qy", "qz")])


def vectors(run: Recording, *names: str) -> np.ndarray:
    return np.column_stack([run[name].values for name in names])


def same_rotation(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.allclose(np.abs(np.einsum("ij,ij->i", a, b)), 1.0, atol=1e-9))


def line(run: Recording, name: str) -> Content:
    return next(each for each in run.contents if each.name == name)


@pytest.mark.parametrize(
    ("frame", "child", "world", "body"),
    [
        ("odom", "base_link", "ENU", "FLU"),
        ("map", "rov/base_link_frd", "ENU", "FRD"),
        ("map_ned", "base_link_fsd", "NED", "FRD"),
        ("world_ned", "base_link", "NED", "FRD"),
        ("world_ned", "base_link_flu", "NED", "FLU"),
        ("", "", "ENU", "FLU"),
    ],
)
def test_odometry(tmp_path: Path, frame: str, child: str, world: str, body: str) -> None:
    place = POSITION if world == "NED" else enu(POSITION)
    linear, angular = (BODY, RATES) if body == "FRD" else (flu(BODY), flu(RATES))
    q = attitude(world, body)
    run = log(
        tmp_path,
        "/odom",
        "nav_msgs/msg/Odometry",
        lambda k: odometry(T[k], frame, child, place[k], q[k], linear[k], angular[k]),
    )
    assert np.allclose(vectors(run, "x", "y", "z"), POSITION)
    assert same_rotation(quaternions(run), Q)
    assert np.allclose(vectors(run, "u", "v", "w"), BODY)
    assert np.allclose(vectors(run, "p", "q", "r"), RATES)
    assert any(world in note for note in run.notes)
    assert any(body in note for note in run.notes)


@pytest.mark.parametrize(("frame", "body"), [("imu_link", "FLU"), ("", "FLU"), ("imu_link_frd", "FRD")])
def test_imu(tmp_path: Path, frame: str, body: str) -> None:
    world = "NED" if body == "FRD" else "ENU"
    gravity = np.column_stack([np.sin(T), 0.1 * T, -9.8 + 0.1 * np.cos(T)])
    rates, force = (RATES, gravity) if body == "FRD" else (flu(RATES), flu(gravity))
    q = attitude(world, body)
    run = log(tmp_path, "/imu", "sensor_msgs/msg/Imu", lambda k: imu(T[k], frame, q[k], rates[k], force[k]))
    assert np.allclose(vectors(run, "p", "q", "r"), RATES)
    assert np.allclose(vectors(run, "ax", "ay", "az"), gravity)
    assert same_rotation(quaternions(run), Q)


def test_imu_fields_that_are_not_measured(tmp_path: Path) -> None:
    def without(k: int) -> dict[str, Any]:
        absent = np.zeros(9)
        absent[0] = -1.0
        message = imu(T[k], "", [0, 0, 0, 0], RATES[k], [0.0, 0.001 * k, 9.8])
        return {**message, "linear_acceleration_covariance": absent}

    run = log(tmp_path, "/imu", "sensor_msgs/msg/Imu", without)
    assert run.names == ("p", "q", "r")
    assert line(run, "/imu").reason == "attitude, specific force: no value"


def test_an_imu_whose_gravity_points_up_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="gravity points up in it"):
        log(tmp_path, "/imu", "sensor_msgs/msg/Imu", lambda k: imu(T[k], "", Q[k], RATES[k], [0.0, 0.01 * k, -9.8]))


def test_rates_in_degrees_are_recognised_by_the_attitude(tmp_path: Path) -> None:
    """Body rates of the motion itself, in degrees per second."""
    phi, theta = EULER[:, 0], EULER[:, 1]
    d = np.column_stack([0.3 * np.cos(T), -0.2 * np.sin(T), np.full(N, 0.5)])
    p = d[:, 0] - np.sin(theta) * d[:, 2]
    q = np.cos(phi) * d[:, 1] + np.sin(phi) * np.cos(theta) * d[:, 2]
    r = -np.sin(phi) * d[:, 1] + np.cos(phi) * np.cos(theta) * d[:, 2]
    rates = flu(np.column_stack([p, q, r]))
    told = attitude("ENU", "FLU")

    def said(scale: float) -> Callable[[int], dict[str, Any]]:
        return lambda k: imu(T[k], "", told[k], scale * rates[k], [0.0, 0.001 * k, 9.8])

    (tmp_path / "right").mkdir()
    assert "r" in log(tmp_path / "right", "/imu", "sensor_msgs/msg/Imu", said(1.0))
    run = log(tmp_path, "/imu", "sensor_msgs/msg/Imu", said(180.0 / np.pi))
    np.testing.assert_allclose(np.column_stack([run[name].values for name in "pqr"]), np.column_stack([p, q, r]))
    assert any("were in degrees per second, not radians: 57." in note for note in run.notes)
    (tmp_path / "other").mkdir()
    run = log(tmp_path / "other", "/imu", "sensor_msgs/msg/Imu", said(17.0))
    assert "r" not in run
    assert "times the rates of its own attitude, neither radians nor degrees" in line(run, "/imu").reason


@pytest.mark.parametrize("covariance", [False, True])
def test_poses_and_twists(tmp_path: Path, covariance: bool) -> None:
    suffix = "WithCovarianceStamped" if covariance else "Stamped"
    place, q = enu(POSITION), attitude("ENU", "FLU")

    def wrapped(name: str, inner: dict[str, Any]) -> Any:
        return {name: inner, "covariance": np.zeros(36)} if covariance else inner

    twists = [
        Said(
            "/dvl/twist",
            float(T[k]) + 0.01,
            f"geometry_msgs/msg/Twist{suffix}",
            {
                "header": header(T[k] + 0.01, "base_link"),
                "twist": wrapped("twist", {"linear": xyz(flu(BODY)[k]), "angular": xyz([0, 0, 0])}),
            },
        )
        for k in range(N)
    ]
    run = log(
        tmp_path,
        "/vrpn_mocap/rov/pose",
        f"geometry_msgs/msg/Pose{suffix}",
        lambda k: {
            "header": header(T[k], "world"),
            "pose": wrapped("pose", {"position": xyz(place[k]), "orientation": xyzw(q[k])}),
        },
        *twists,
    )
    assert np.allclose(vectors(run, "x", "y", "z"), POSITION)
    assert same_rotation(quaternions(run), Q)
    assert np.allclose(vectors(run, "u", "v", "w"), BODY)
    assert line(run, "/dvl/twist").reason == "rates: it never changes: the field is filled in, not measured"


@pytest.mark.parametrize("covariance", [False, True])
def test_a_pose_that_was_estimated_stands_behind_one_that_was_tracked(tmp_path: Path, covariance: bool) -> None:
    kind = f"geometry_msgs/msg/Pose{'WithCovarianceStamped' if covariance else 'Stamped'}"
    place, q = enu(POSITION), attitude("ENU", "FLU")

    def pose(k: int, off: float) -> dict[str, Any]:
        told = {"position": xyz(place[k] + off), "orientation": xyzw(q[k])}
        return {
            "header": header(T[k], "world"),
            "pose": {"pose": told, "covariance": np.zeros(36)} if covariance else told,
        }

    tracked = [Said("/mocap/rov", float(T[k]) + 0.001, kind, pose(k, 0.0)) for k in range(N)]
    run = log(tmp_path, "/slam/pose", kind, lambda k: pose(k, 5.0), *tracked)
    assert np.allclose(vectors(run, "x", "y", "z"), POSITION)
    assert line(run, "/slam/pose").reason == "position, depth, attitude: /mocap/rov is nearer the sensor"


def test_a_twist_in_the_world_is_a_velocity_north_east_and_down(tmp_path: Path) -> None:
    told = enu(WORLD)
    run = log(
        tmp_path,
        "/velocity_local",
        "geometry_msgs/msg/TwistStamped",
        lambda k: {"header": header(T[k], "map"), "twist": {"linear": xyz(told[k]), "angular": xyz([0, 0, k])}},
    )
    assert run.names == ("vn", "ve", "vd")
    assert np.allclose(vectors(run, "vn", "ve", "vd"), WORLD)


@pytest.mark.parametrize(("frame", "told"), [("base_link", flu), ("base_link_frd", lambda vector: vector)])
def test_a_wrench(tmp_path: Path, frame: str, told: Callable[[np.ndarray], np.ndarray]) -> None:
    run = log(
        tmp_path,
        "/wrench",
        "geometry_msgs/msg/WrenchStamped",
        lambda k: {
            "header": header(T[k], frame),
            "wrench": {"force": xyz(told(BODY)[k]), "torque": xyz(told(RATES)[k])},
        },
    )
    assert np.allclose(vectors(run, "X", "Y", "Z", "K", "M", "N"), np.column_stack([BODY, RATES]))


@pytest.mark.parametrize(
    ("topic", "names"),
    [("/imu/angular_velocity", "p q r"), ("/imu/acceleration", "ax ay az"), ("/dvl/velocity", "u v w")],
)
def test_a_bare_vector_is_what_its_topic_says(tmp_path: Path, topic: str, names: str) -> None:
    run = log(
        tmp_path,
        topic,
        "geometry_msgs/msg/Vector3Stamped",
        lambda k: {"header": header(T[k], "base_link"), "vector": xyz(flu(BODY)[k])},
    )
    assert np.allclose(vectors(run, *names.split()), BODY)


def dvl_a50(k: int, frame: str = "dvl_A50/velocity_link") -> dict[str, Any]:
    return {
        "header": header(T[k], frame),
        "time": 100.0,
        "velocity": xyz(BODY[k]),
        "fom": 0.01,
        "covariance": np.zeros(9),
        "altitude": 1.0,
        "beams": [],
        "velocity_valid": k % 10 > 0,
        "status": 0,
        "form": "json_v3",
    }


def test_the_dvls_of_water_linked_tell_when_they_lost_the_bottom(tmp_path: Path) -> None:
    run = log(tmp_path, "/dvl/data", "dvl_msgs/msg/DVL", dvl_a50)
    valid = np.arange(N) % 10 > 0
    assert np.array_equal(run["u"].t, read(tmp_path / "a.mcap")["u"].t)
    assert np.allclose(vectors(run, "u", "v", "w"), BODY[valid])
    assert any("at the DVL's own place" in note for note in run.notes)


def test_a_dvl_on_water_track_is_no_velocity_over_ground(tmp_path: Path) -> None:
    def said(k: int) -> dict[str, Any]:
        four = np.zeros(4, dtype=np.float32)
        lost = k % 10 == 0
        return {
            "header": header(T[k], "dvl"),
            "velocity_mode": 2 if k >= 100 else 1,
            "dvl_type": 0,
            "velocity": xyz([0, 0, 0] if lost else BODY[k]),
            "velocity_covar": np.zeros(9),
            "altitude": 1.0,
            "course_gnd": 0.0,
            "speed_gnd": 0.0,
            "num_good_beams": 0 if lost else 4,
            "sound_speed": 1500.0,
            "beam_ranges_valid": True,
            "beam_velocities_valid": True,
            "beam_unit_vec": [],
            "range": np.zeros(4),
            "range_covar": four,
            "beam_quality": four,
            "beam_velocity": four,
            "beam_velocity_covar": four,
        }

    from .ros_bags import ROS2

    unit = [ROS2.types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=1.0)] * 4
    run = log(tmp_path, "/dvl", "marine_acoustic_msgs/msg/Dvl", lambda k: {**said(k), "beam_unit_vec": unit})
    kept = (np.arange(N) < 100) & (np.arange(N) % 10 > 0)
    assert np.allclose(vectors(run, "u", "v", "w"), BODY[kept])
    tracked = (np.arange(N) >= 100) & (np.arange(N) % 10 > 0)
    assert np.allclose(vectors(run, "u_w", "v_w", "w_w"), BODY[tracked])
    assert any(note.startswith("/dvl: velocity through the water in FRD, at the DVL's own") for note in run.notes)


def test_depth_from_pressure_and_why_not(tmp_path: Path) -> None:
    def said(level: float) -> Callable[[int], dict[str, Any]]:
        return lambda k: {"header": header(T[k], ""), "fluid_pressure": level + 9806.65 * T[k], "variance": 0.0}

    run = log(tmp_path, "/pressure", "sensor_msgs/msg/FluidPressure", said(101_325.0))
    assert np.allclose(run["z"].values, T)
    assert any("101325 Pa at the surface, water of 1000 kg/m^3" in note for note in run.notes)
    with pytest.raises(InputError, match="no absolute pressure in Pa"):
        log(tmp_path, "/pressure", "sensor_msgs/msg/FluidPressure", said(0.0))


def battery(k: int, voltage: float) -> Said:
    empty = np.empty(0, dtype=np.float32)
    names = ("temperature", "current", "charge", "capacity", "design_capacity", "percentage")
    codes = ("power_supply_status", "power_supply_health", "power_supply_technology")
    fields = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "voltage": voltage,
        **dict.fromkeys(names, 0.0),
        **dict.fromkeys(codes, 0),
        "present": True,
        "cell_voltage": empty,
        "cell_temperature": empty,
        "location": "",
        "serial_number": "",
    }
    return Said("/battery", float(T[k]), "sensor_msgs/msg/BatteryState", fields)


def test_outputs_that_move_are_the_thrusters_in_order(tmp_path: Path) -> None:
    def said(k: int) -> dict[str, Any]:
        outputs = [1500 + k, 1500, 0, 65535, 1600 - k, 0]
        return {"header": header(T[k], ""), "channels": np.array(outputs, dtype=np.uint16)}

    run = log(
        tmp_path, "/mavros/rc/out", "mavros_msgs/msg/RCOut", said, *(battery(k, 16.0 * (k % 5 > 0)) for k in range(N))
    )
    assert [name for name in run.names if name.startswith("cmd")] == ["cmd_1", "cmd_2"]
    assert np.array_equal(run["cmd_2"].values, 1600.0 - np.arange(N))
    assert any("outputs 1, 5, which move, are taken" in note for note in run.notes)
    assert np.array_equal(run["voltage"].values, np.full(96, 16.0))
    assert run["voltage"].t[0] == pytest.approx(T[1])


@pytest.mark.parametrize("kind", ["Float64", "Float32", "UInt16"])
def test_an_array_is_thrusters_where_its_topic_says_so(tmp_path: Path, kind: str) -> None:
    def said(k: int) -> dict[str, Any]:
        return multi_array([k, 2 * k], dtype=kind.lower())

    assert "cmd_2" in log(tmp_path, "/rov/thrusters", f"std_msgs/msg/{kind}MultiArray", said)
    with pytest.raises(InputError, match="no message that can be used; it has /rov/numbers; name what is what"):
        log(tmp_path, "/rov/numbers", f"std_msgs/msg/{kind}MultiArray", said)


def test_the_autopilots_velocity_without_anything_that_aids_it_is_refused(tmp_path: Path) -> None:
    def said(k: int) -> dict[str, Any]:
        return odometry(T[k], "map", "base_link", POSITION[k], Q[k], BODY[k], RATES[k])

    run = log(tmp_path, "/mavros/local_position/odom", "nav_msgs/msg/Odometry", said)
    assert run.names == ("z", "qw", "qx", "qy", "qz", "p", "q", "r")
    assert "position, velocity: the autopilot's filter, and nothing in the recording aids its velocity" in (
        line(run, "/mavros/local_position/odom").reason
    )
    dvl = [
        Said("/dvl/data", float(T[k]), "dvl_msgs/msg/DVL", {**dvl_a50(k), "velocity_valid": False}) for k in range(N)
    ]
    assert "u" in log(tmp_path, "/mavros/local_position/odom", "nav_msgs/msg/Odometry", said, *dvl)


def test_a_velocity_that_says_that_it_is_unsure_is_refused(tmp_path: Path) -> None:
    def said(k: int) -> dict[str, Any]:
        message = odometry(T[k], "odom", "base_link", POSITION[k], Q[k], BODY[k], RATES[k])
        message["twist"]["covariance"][0] = 4.0
        return message

    run = log(tmp_path, "/odom", "nav_msgs/msg/Odometry", said)
    assert "u" not in run
    assert "± 2 m/s" in line(run, "/odom").reason


@pytest.mark.parametrize(
    ("topic", "why"),
    [
        ("/mavros/vision_pose/pose", "what something is told"),
        ("/target/pose", "what something is told"),
        ("/dvl/dead_reckoning", "dead reckoning"),
        ("/gps/pose", "satellites are not seen under water"),
    ],
)
def test_names_that_say_that_it_is_no_measurement(tmp_path: Path, topic: str, why: str) -> None:
    def said(k: int) -> dict[str, Any]:
        return {"header": header(T[k], "map"), "pose": {"position": xyz(POSITION[k]), "orientation": xyzw(Q[k])}}

    other = [Said("/imu", float(T[k]), "sensor_msgs/msg/Imu", imu(T[k], "", Q[k], RATES[k], BODY[k])) for k in range(N)]
    run = log(tmp_path, topic, "geometry_msgs/msg/PoseStamped", said, *other)
    assert "x" not in run
    assert why in line(run, topic).reason


def test_the_nearest_to_the_sensor_is_used(tmp_path: Path) -> None:
    def said(k: int) -> dict[str, Any]:
        return odometry(T[k], "odom", "base_link", POSITION[k], Q[k], BODY[k], RATES[k])

    dvl = [Said("/dvl/data", float(T[k]), "dvl_msgs/msg/DVL", dvl_a50(k)) for k in range(N)]
    run = log(tmp_path, "/odom", "nav_msgs/msg/Odometry", said, *dvl)
    assert "u" in line(run, "/dvl/data").used
    assert line(run, "/odom").reason == "velocity: /dvl/data is nearer the sensor"


def test_the_same_for_a_table_cut_into_pieces(tmp_path: Path) -> None:
    """The live link will ask for a few rows at a time."""
    said = [
        *(Said("/odom", float(t), "nav_msgs/msg/Odometry", odometry(t, "map_ned", "base", p, q, b, r))
          for t, p, q, b, r in zip(T, POSITION, Q, BODY, RATES, strict=True)),
        *(Said("/imu", float(T[k]), "sensor_msgs/msg/Imu", imu(T[k], "", Q[k], RATES[k], BODY[k])) for k in range(N)),
        *(Said("/dvl/data", float(T[k]), "dvl_msgs/msg/DVL", dvl_a50(k)) for k in range(N)),
        *(battery(k, 15.0) for k in range(N)),
    ]  # fmt: skip
    content = scan_mcap(write_mcap2(tmp_path / "a.mcap", said), lambda heading: True)
    tables = ros_tables("a", content.topics, content.repairs).tables.tables
    assert len(tables) == 4
    for table in tables.values():
        whole = meaning_of(table)
        assert whole
        cuts = [0, 1, 7, 64, N]
        pieces = [meaning_of(table.rows(a, b)) for a, b in pairwise(cuts)]
        for i, source in enumerate(whole):
            assert [piece[i].note for piece in pieces] == [source.note] * len(pieces)
            for name, values in source.channels.items():
                assert np.array_equal(
                    np.concatenate([piece[i].channels[name] for piece in pieces]), values, equal_nan=True
                )


def test_every_type_of_the_list_is_known() -> None:
    for name in ("Odometry", "PoseStamped", "Imu", "FluidPressure", "BatteryState", "RCOut", "Dvl", "DVL", "DVLDR"):
        assert any(kind.rpartition("/")[2] == name for kind in MEANINGS)
