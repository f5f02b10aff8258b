"""Fixed transforms applied to odometry of a sensor's frame; thrusters that have a topic each, in bags and live."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.live.links.ros2.samples import Ros2Samples
from towtank.live.links.ros2.transports import Message
from towtank.readers import read
from towtank.readers.ros.meaning import is_thruster_topic, thruster_order
from towtank.recording.frames.conversion import convert_quaternion
from towtank.recording.frames.rotations import conjugate, multiply, rotate

from .ros_bags import ROS2, Said, cdr, header, odometry, write_mcap2, xyz, xyzw

N = 120
T = 0.05 * np.arange(N)
PLACE = np.column_stack([2.0 * T, np.sin(T), -3.0 + np.cos(T)])  # ENU
Q = quaternions_from_eulers(np.column_stack([0.3 * np.sin(T), 0.2 * np.cos(T), 0.5 * T]))  # FLU to ENU
SPEED = np.column_stack([np.cos(T), 0.1 * T, -0.2 * np.sin(T)])  # FLU
RATES = np.column_stack([0.3 * np.cos(T), 0.01 * T, 0.5 + 0.1 * np.sin(T)])
ARM = np.array([0.3, -0.1, 0.2])  # of the mast in base_link
UP = np.array([0.0, 0.05, 0.4])  # of the camera on the mast
MAST = quaternions_from_eulers(np.array([[0.0, 0.0, 0.7]]))[0]
CAMERA = quaternions_from_eulers(np.array([[0.4, -0.2, 2.0]]))[0]
FLOAT = "std_msgs/msg/Float64"


def transform(parent: str, child: str, place: np.ndarray, turn: np.ndarray) -> Any:
    def make(kind: str, **fields: Any) -> Any:
        return ROS2.types[kind](**fields)

    told = header(0.0, parent)
    stamp = make("builtin_interfaces/msg/Time", **told["stamp"])
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=make("std_msgs/msg/Header", stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=make(
            "geometry_msgs/msg/Transform",
            translation=make("geometry_msgs/msg/Vector3", **xyz(place)),
            rotation=make("geometry_msgs/msg/Quaternion", **xyzw(turn)),
        ),
    )


def seen_by_camera(child: str = "camera_link") -> list[Said]:
    """Return odometry of the camera on the vehicle's mast."""
    arm = ARM + rotate(MAST, UP)
    turn = multiply(MAST, CAMERA)
    place = PLACE + rotate(Q, arm)
    rates = rotate(conjugate(turn), RATES)
    speed = rotate(conjugate(turn), SPEED + np.cross(RATES, arm))
    q = multiply(Q, turn)
    return [
        Said(
            "/vo",
            float(T[k]),
            "nav_msgs/msg/Odometry",
            odometry(T[k], "odom", child, place[k], q[k], speed[k], rates[k]),
        )
        for k in range(N)
    ]


def bag(folder: Path, said: list[Said]) -> Path:
    return write_mcap2(folder / "a.mcap", sorted(said, key=lambda each: each.t))


def test_odometry_of_a_camera_is_moved_to_base_link(tmp_path: Path) -> None:
    tree = [
        transform("rov/base_link", "mast", ARM, MAST),
        transform("mast", "camera_link", UP, CAMERA),
        transform("mast", "lamp", UP, MAST),
    ]
    static = Said("/tf_static", 0.0, "tf2_msgs/msg/TFMessage", {"transforms": tree})
    run = read(bag(tmp_path, [static, *seen_by_camera()]))
    np.testing.assert_allclose(run["x"].values, PLACE[:, 1], atol=1e-9)
    np.testing.assert_allclose(run["y"].values, PLACE[:, 0], atol=1e-9)
    np.testing.assert_allclose(run["z"].values, -PLACE[:, 2], atol=1e-9)
    for name, values in zip("uvw", (SPEED * [1, -1, -1]).T, strict=True):
        np.testing.assert_allclose(run[name].values, values, atol=1e-9)
    for name, values in zip("pqr", (RATES * [1, -1, -1]).T, strict=True):
        np.testing.assert_allclose(run[name].values, values, atol=1e-9)
    found = np.column_stack([run[name].values for name in ("qw", "qx", "qy", "qz")])
    truth = convert_quaternion(Q, body="FLU", world="ENU")
    np.testing.assert_allclose(np.abs(np.einsum("ij,ij->i", found, truth)), 1.0, atol=1e-9)
    assert any('moved from "camera_link" to "rov/base_link"' in note for note in run.notes)
    line = next(each for each in run.contents if each.name == "/tf_static")
    assert line.reason == "fixed transforms, applied to /vo"


def test_a_frame_that_nothing_leads_from_is_said(tmp_path: Path) -> None:
    static = Said(
        "/tf_static", 0.0, "tf2_msgs/msg/TFMessage", {"transforms": [transform("base_link", "lamp", ARM, MAST)]}
    )
    run = read(bag(tmp_path, [static, *seen_by_camera()]))
    assert any('no fixed transform leads from "camera_link"' in note for note in run.notes)
    (tmp_path / "plain").mkdir()
    plain = read(bag(tmp_path / "plain", seen_by_camera()))
    np.testing.assert_array_equal(run["x"].values, plain["x"].values)


@pytest.mark.parametrize(
    ("parent", "place", "turn"),
    [
        ("base_link", ARM, np.zeros(4)),  # no attitude
        ("base_link", ARM, 1.2 * MAST),
        ("base_link", np.array([np.nan, 0.0, 0.0]), MAST),
        ("", ARM, MAST),
    ],
)
def test_a_fixed_transform_that_is_none_moves_nothing(
    tmp_path: Path, parent: str, place: np.ndarray, turn: np.ndarray
) -> None:
    tree = {"transforms": [transform(parent, "camera_link", place, turn)]}
    run = read(bag(tmp_path, [Said("/tf_static", 0.0, "tf2_msgs/msg/TFMessage", tree), *seen_by_camera()]))
    (tmp_path / "plain").mkdir()
    plain = read(bag(tmp_path / "plain", seen_by_camera()))
    for name in ("x", "z", "u", "p", "qw"):
        np.testing.assert_array_equal(run[name].values, plain[name].values)
    assert any('no fixed transform leads from "camera_link"' in note for note in run.notes)


def test_odometry_of_base_link_stays(tmp_path: Path) -> None:
    static = Said(
        "/tf_static", 0.0, "tf2_msgs/msg/TFMessage", {"transforms": [transform("odom", "base_link", ARM, MAST)]}
    )
    run = read(bag(tmp_path, [static, *seen_by_camera("base_link")]))
    assert next(each for each in run.contents if each.name == "/tf_static").reason.endswith("nothing needs them")


@pytest.mark.parametrize(
    "pattern",
    ["/rov/thrusters/{}/input", "/model/rov/joint/thruster{}_joint/cmd_thrust", "/thruster_{}/cmd", "/thruster_{}"],
)
def test_a_topic_for_each_thruster(tmp_path: Path, pattern: str) -> None:
    numbers = (10, 2, 1)
    said = [
        Said(pattern.format(n), float(t) + 0.001 * n, FLOAT, {"data": float(100 * n + t)}) for t in T for n in numbers
    ]
    run = read(bag(tmp_path, [*said, *seen_by_camera("base_link")]))
    commands = [name for name in run if name.startswith("cmd_")]
    assert commands == ["cmd_1", "cmd_2", "cmd_3"]
    for name, number in zip(commands, sorted(numbers), strict=True):
        known = run[name].measured
        np.testing.assert_allclose(known.values, 100 * number + T, atol=1e-12)
        np.testing.assert_allclose(np.diff(known.t), 0.05, atol=1e-9)
    reasons = {each.name: each.reason for each in run.contents}
    assert reasons[pattern.format(10)] == f"commands: joined to {pattern.format(1)}"
    assert any("in the order of their numbers" in note for note in run.notes)


def test_what_is_no_thruster() -> None:
    assert not is_thruster_topic("/thruster_1/temperature", FLOAT)
    assert not is_thruster_topic("/rov/thrusters/1/input", "std_msgs/msg/String")
    assert not is_thruster_topic("/arm/joint_1/cmd", FLOAT)
    mixed = [("/a/thrusters/0/input", FLOAT), ("/b/thruster_3/cmd", FLOAT), ("/a/thrusters/1/input", FLOAT)]
    assert thruster_order(mixed) == {"/a/thrusters/0/input": 1, "/a/thrusters/1/input": 2}


def test_live_each_topic_is_its_thruster() -> None:
    epoch = 1.7e9
    samples = Ros2Samples(None)

    def second(start: float) -> list[Message]:
        found = []
        for k in range(20):
            t = start + k / 20
            for n in (0, 1, 2):
                data = cdr(Said("", 0.0, FLOAT, {"data": 10.0 * n + t}))
                found.append(Message(f"/rov/thrusters/{n}/input", FLOAT, epoch + t, data))
        return found

    assert samples.take(second(0.0) + second(1.0)) == []
    samples.decide(epoch + 2.0)
    found = samples.take(second(2.0))
    assert len(found) == 60
    for number in (1, 2, 3):
        own = [each for each in found if each.names == (f"cmd_{number}",)]
        np.testing.assert_allclose([each.values[0] for each in own], 10.0 * (number - 1) + 2.0 + np.arange(20) / 20)
    assert any("in the order of their numbers" in note for note in samples.notes)
