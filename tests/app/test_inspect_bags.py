"""`inspect` of a bag whose topics mean nothing by their types: what it holds is what one asks for."""

from __future__ import annotations

import sys
from pathlib import Path

from .commands import command, document

sys.path.append(str(Path(__file__).resolve().parents[1] / "readers"))

from ros_bags import Said, multi_array, write_bag1


def bag(folder: Path) -> Path:
    said = []
    for k in range(100):
        said.append(
            Said("/rov/thrusters", 0.05 * k, "std_msgs/msg/UInt16MultiArray", multi_array([1500 + k], "uint16"))
        )
        said.append(Said("/rov/gyro", 0.05 * k, "std_msgs/msg/Float32MultiArray", multi_array([0.0, 0.1 * k], "f4")))
    return write_bag1(folder / "a.bag", said)


def test_commands_alone_are_shown_with_what_could_be_mapped(tmp_path: Path) -> None:
    found = document("inspect", bag(tmp_path))
    assert [each["name"] for each in found["channels"]] == ["cmd_1"]
    [gyro] = [each for each in found["contents"] if each["name"] == "/rov/gyro"]
    assert gyro["reason"] == "means nothing by its type; to be mapped: data[]"
    assert {axis["reason"] for axis in found["axes"].values()} == {
        "no motion recorded: neither pose nor velocity, rates or specific force"
    }
    shown = command("inspect", tmp_path / "a.bag")
    assert shown.code == 0
    assert "/rov/gyro" in shown.out
    assert "no motion recorded" in " ".join(shown.out.split())


def test_the_mapping_that_it_suggests_works(tmp_path: Path) -> None:
    path = bag(tmp_path)
    mapping = tmp_path / "map.toml"
    mapping.write_text('thrusters = ["/rov/thrusters.data[0]"]\n[columns]\nr = "/rov/gyro.data[1]"\n')
    found = document("inspect", path, "--map", mapping)
    assert found["axes"]["yaw"]["source"] == "measured"
    nothing = command("inspect", path, "--map", mapping, "--vehicle", "no-such")
    assert nothing.code == 2
