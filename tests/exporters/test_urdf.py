"""The URDF of blue and auv_controllers: what their controllers make of it is what the export says it keeps."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from tests.exporters.whole import random_states, whole_vehicle

from towtank import InputError, export, import_vehicle, inverse_dynamics, load_vehicle
from towtank.core.arrays import Array
from towtank.core.attitude import rotation_from_euler
from towtank.exporters.request import speed_range
from towtank.vehicle import Vehicle, configuration_matrix, curve_force


def skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


class Controllers:
    """The hydrodynamics of auv_controllers, written from its sources: FRD, M nu_dot + C nu + D nu + g = tau."""

    def __init__(self, path: Path) -> None:
        root = ET.parse(path).getroot().find("hydrodynamics")
        assert root is not None

        def row(tag: str, names: str) -> Array:
            found = root.find(f".//{tag}")
            assert found is not None
            return np.array([float(found.attrib[name]) for name in names.split()])

        self.m = row("mass", "value")[0]
        I = row("inertia", "ixx iyy izz ixy ixz iyz")
        tensor = np.diag(I[:3]) + np.triu(np.array([[0, I[3], I[4]], [0, 0, I[5]], [0, 0, 0]]))
        self.r_G, self.r_B = row("center_of_gravity", "x y z"), row("center_of_buoyancy", "x y z")
        S = self.m * skew(self.r_G)
        self.M_RB = np.block([[self.m * np.eye(3), -S], [S, tensor]])
        self.M_A = np.diag(-row("added_mass", "Xdu Ydv Zdw Kdp Mdq Ndr"))
        self.linear = -row("linear", "Xu Yv Zw Kp Mq Nr")
        self.quadratic = -row("quadratic", "Xuu Yvv Zww Kpp Mqq Nrr")
        self.B = row("buoyancy", "value")[0]

    def wrench(self, eta: Array, nu: Array, nu_dot: Array) -> Array:
        M = self.M_RB + self.M_A
        p, h = np.split(M @ nu, 2)
        gyration = np.concatenate([np.cross(nu[3:], p), np.cross(nu[:3], p) + np.cross(nu[3:], h)])
        down = rotation_from_euler(*eta[3:]).T @ np.array([0.0, 0.0, 1.0])
        weight, lift = self.m * 9.81 * down, -self.B * down
        g = -np.concatenate([weight + lift, np.cross(self.r_G, weight) + np.cross(self.r_B, lift)])
        damping = (self.linear + self.quadratic * np.abs(nu)) * nu
        return np.asarray(M @ nu_dot + gyration + damping + g)


def agrees(path: Path, vehicle: Vehicle) -> float:
    found = Controllers(path)
    eta, nu, nu_dot = random_states(vehicle, 500)
    expected = inverse_dynamics(vehicle, eta, nu, nu_dot)
    wrench = np.array([found.wrench(*each) for each in zip(eta, nu, nu_dot, strict=True)])
    return float((np.abs(wrench - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())


@pytest.mark.parametrize("name", ["bluerov2_heavy", "rexrov", "lauv", "whole"])
def test_the_controllers_move_the_vehicle_that_the_export_says_they_keep(name: str, tmp_path: Path) -> None:
    vehicle = whole_vehicle() if name == "whole" else load_vehicle(name)
    done = export(vehicle, "urdf-hydrodynamics", tmp_path / "m")
    assert agrees(done.files[0], done.kept.vehicle) < 1e-9
    if name == "bluerov2_heavy":
        assert agrees(done.files[0], vehicle) < 1e-9
        assert done.heading.error.endswith("none")
    else:
        assert done.error.max() > 0.0
        assert any("absent" in line or "there" in line for line in done.heading.missing)


def stated(line: str) -> np.ndarray[Any, Any]:
    """The largest error of the wrench (6,) that a heading states."""
    return np.array([float(each.split()[1]) for each in line.partition("rad/s: ")[2].partition(" (")[0].split(", ")])


@pytest.mark.parametrize("name", ["rexrov", "lauv", "whole"])
def test_the_error_that_the_header_states_is_reached_and_not_exceeded(name: str, tmp_path: Path) -> None:
    vehicle = whole_vehicle() if name == "whole" else load_vehicle(name)
    vehicle = vehicle.with_coefficients({"inflow_loss": 0.0})
    done = export(vehicle, "urdf-hydrodynamics", tmp_path / "m")
    found, limit = Controllers(done.files[0]), stated(done.heading.error)
    chance, speeds = np.random.default_rng(5), speed_range(vehicle)
    worst = np.zeros(6)
    for _ in range(2000):
        eta = np.concatenate([np.zeros(3), chance.uniform(-1.0, 1.0, 3) * [np.pi, 0.5 * np.pi, np.pi]])
        nu, nu_dot = (np.clip(chance.uniform(-2.0, 2.0, 6), -1.0, 1.0) * speeds for _ in range(2))
        away = found.wrench(eta, nu, nu_dot) - inverse_dynamics(vehicle, eta, nu, nu_dot)
        worst = np.maximum(worst, np.abs(away))
    assert np.all(worst <= limit + 1e-12 * vehicle.weight)
    assert np.all(worst >= 0.6 * limit - 1e-9 * vehicle.weight)


def test_forward_speed_terms_stand_as_damping_at_the_speed_asked_for(tmp_path: Path) -> None:
    vehicle = whole_vehicle()
    done = export(vehicle, "urdf-hydrodynamics", tmp_path / "m", at_speed=1.5)
    expected = vehicle.coefficient("Y_v") + 1.5 * vehicle.coefficient("Y_uv")
    assert done.kept.vehicle.coefficient("Y_v") == expected
    assert f'Yv="{expected!r}"' in done.files[0].read_text()
    assert any("at 1.5 m/s" in line for line in done.heading.missing)


class ThrustController:
    """The thruster controllers of auv_controllers, out of their parameters: from thrust to pulse."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        self.powers = np.array(parameters["thrust_curve_coefficients"])
        self.thrust = parameters["min_thrust"], parameters["max_thrust"]
        self.dead_band = parameters["min_deadband_pwm"], parameters["max_deadband_pwm"]
        self.neutral = parameters["neutral_pwm"]

    def pulse(self, thrust: float) -> float:
        """Return the pulse [us] for a thrust [N]."""
        low, high = self.thrust
        pulse = float(np.polynomial.polynomial.polyval(min(max(thrust, low), high), self.powers))
        return float(self.neutral) if self.dead_band[0] <= pulse <= self.dead_band[1] else pulse


def parameters_of(path: Path) -> dict[str, dict[str, Any]]:
    nodes = YAML(typ="safe", pure=True).load(path)
    return {name: node["ros__parameters"] for name, node in nodes.items()}


@pytest.mark.parametrize("name", ["bluerov2_heavy_wu", "bluerov2_heavy", "rexrov", "lauv", "vlbv300"])
def test_the_yaml_has_the_allocation_and_turns_thrust_into_pulses(name: str, tmp_path: Path) -> None:
    vehicle = load_vehicle(name)
    done = export(vehicle, "urdf-hydrodynamics", tmp_path / "m")
    assert done.files[1].read_text().startswith("# towtank: urdf-hydrodynamics 2026\n")
    nodes = parameters_of(done.files[1])
    allocation = nodes["thruster_allocation_matrix_controller"]
    assert allocation["thrusters"] == [each.name for each in vehicle.thrusters]
    tam = np.array([allocation["tam"][row] for row in ("x", "y", "z", "rx", "ry", "rz")])
    np.testing.assert_allclose(tam, configuration_matrix(vehicle), rtol=0.0, atol=1e-11)
    said = [line for line in done.heading.missing if line.startswith("curve of ")]
    off = {
        part: float(line.rpartition("up to ")[2].split()[0])
        for line in said
        for part in line[9:].split(":")[0].split(", ")
    }
    back = import_vehicle(done.files[0]).vehicle
    for thruster, imported in zip(vehicle.thrusters, back.thrusters, strict=True):
        controller = ThrustController(nodes[f"{thruster.name}_controller"])
        curve = thruster.curve
        low, high = curve.limits or (curve.rest - 1.0, curve.rest + 1.0)
        commands = np.linspace(low, high, 101)
        forces = np.asarray(curve_force(curve, commands)) * thruster.gain
        reach = (
            1.0 if 900.0 <= curve.rest <= 2100.0 else 400.0 / max(1.0, abs(low - curve.rest), abs(high - curve.rest))
        )
        pulses = np.array([controller.pulse(each) for each in forces])
        driven = (forces != 0.0) & (pulses != controller.neutral)
        meant = (curve.rest if reach == 1.0 else 1500.0) + reach * (commands - curve.rest)
        found = np.interp(pulses[driven], meant, forces)
        assert np.abs(found - forces[driven]).max() <= 1.01 * off.get(thruster.name, 1e-6 * np.abs(forces).max())
        # what was imported pushes as hard as asked for at the pulse that the controller sends
        again = np.asarray(curve_force(imported.curve, pulses[driven])) * imported.gain
        np.testing.assert_allclose(again, forces[driven], atol=2e-3 * np.abs(forces).max())


def test_lists_of_the_yaml_are_of_one_type_as_ros_wants_them(tmp_path: Path) -> None:
    nodes = parameters_of(export("rexrov", "urdf-hydrodynamics", tmp_path / "m").files[1])
    for name, parameters in nodes.items():
        rows = parameters["tam"].values() if "tam" in parameters else [parameters["thrust_curve_coefficients"]]
        assert all(type(each) is float for row in rows for each in row), name
        assert all(type(parameters.get(key, 0.0)) is float for key in ("min_thrust", "max_thrust"))
        assert all(type(value) is int for key, value in parameters.items() if key.endswith("_pwm"))


THEIRS = """/**:
  thruster_allocation_matrix_controller:
    ros__parameters:
      thrusters: [one, two]
      tam: {x: [0.6, 1], y: [0.8, 0], z: [0, 0], rx: [0.0, 0.0], ry: [0.0, 0.0], rz: [-0.2, 0.3]}
  one_controller:
    ros__parameters:
      {thruster: one, thrust_curve_coefficients: [1500.0, 8.0], min_thrust: -40.0, max_thrust: 50,
       min_deadband_pwm: 1470, max_deadband_pwm: 1528, neutral_pwm: 1500}
  two_controller:
    ros__parameters:
      {thruster: two, thrust_curve_coefficients: [1500.0, -8.0, 0.0, 0.004], min_thrust: -40.0, max_thrust: 40.0,
       min_deadband_pwm: 1500, max_deadband_pwm: 1500, neutral_pwm: 1500}
  three_controller:
    ros__parameters: {thruster: three, thrust_curve_coefficients: [1500.0, 8.0]}
"""


def theirs(folder: Path, text: str) -> Path:
    path = export("bluerov2_heavy", "urdf-hydrodynamics", folder).files[0]
    (folder / "thrusters.yaml").write_text(text)
    return path


def test_the_yaml_of_others_is_read_and_comes_back_the_same_from_the_second_time_on(tmp_path: Path) -> None:
    found = import_vehicle(theirs(tmp_path / "m", THEIRS))
    one, two = found.vehicle.thrusters
    assert one.direction == pytest.approx((0.6, 0.8, 0.0))
    # the point of its line that is next to the origin: 0.25 m beside it
    np.testing.assert_allclose(np.cross(one.position, one.direction), [0.0, 0.0, -0.2], atol=1e-15)
    assert np.linalg.norm(one.position) == pytest.approx(0.2)
    np.testing.assert_allclose(one.curve.static(np.array([1260.0, 1540.0, 1860.0])), [-30.0, 5.0, 45.0], atol=1e-9)
    assert curve_force(one.curve, [1471.0, 1529.0]).tolist() == [0.0, 0.0]  # the wider side of the dead band
    assert two.curve.static(np.array([1400.0]))[0] > 0.0
    assert "thrusters.yaml: curve of three, which tam does not have" in found.left
    assert any("thruster one: the dead band reaches 30 us" in each for each in found.doubts)
    assert any("thruster two: its polynomial turns back" in each for each in found.doubts)
    vehicle, pairs = found.vehicle, []
    for folder in ("first", "second", "third"):
        files = export(vehicle, "urdf-hydrodynamics", tmp_path / folder).files
        pairs.append([each.read_bytes() for each in files])
        vehicle = import_vehicle(files[0]).vehicle
    assert pairs[1] == pairs[2]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rz: [-0.2, 0.3]", "rz: [-0.2]", "tam: rz: found 1 numbers, expected 2"),
        ("rz: [-0.2, 0.3]", "rz: [-0.2, much]", 'tam: rz: found "much", expected a number'),
        ("rz: [-0.2, 0.3]", "rz: 3", "tam: rz: found int, expected a list"),
        ("rz: [-0.2, 0.3]", "", "tam: rz: found nothing, expected a list"),
        ("x: [0.6, 1]", "x: [0.6, 4]", "found a force of length 4 in tam"),
        ("thruster: two", "thruster: too", "found no thrust_curve_coefficients of the thruster two"),
        ("thruster: two", "thruster: [", "not valid YAML"),
        ("min_thrust: -40.0, max_thrust: 50", "min_thrust: 4.0, max_thrust: 50", "expected a range around 0"),
        ("neutral_pwm: 1500}\n  two", "neutral_pwm: .nan}\n  two", "neutral_pwm: found nan, expected a finite number"),
        ("one", "o ne", "letters, digits"),
        ("thrusters: [one, two]", "thrusters: &a [*a, one]", "expected"),
        ("/**:", "[" * 1000, "not valid YAML"),
    ],
)
def test_a_yaml_that_is_wrong_is_one_clear_line(old: str, new: str, words: str, tmp_path: Path) -> None:
    path = theirs(tmp_path / "m", THEIRS.replace(old, new))
    with pytest.raises(InputError) as error:
        import_vehicle(path)
    assert words in str(error.value)
    assert str(tmp_path / "m") in str(error.value)


def test_a_yaml_without_an_allocation_is_said_to_be_left(tmp_path: Path) -> None:
    found = import_vehicle(theirs(tmp_path / "m", "a: 1\n"))
    assert found.vehicle.thrusters == ()
    assert any("no thruster_allocation_matrix_controller" in each for each in found.left)


def test_an_attribute_that_is_missing_is_one_clear_line(tmp_path: Path) -> None:
    path = export("bluerov2_heavy", "urdf-hydrodynamics", tmp_path / "m").files[0]
    path.write_text(path.read_text().replace(' Zdw="-18.68"', ""))
    with pytest.raises(Exception, match=r"hydrodynamics/added_mass Zdw: found nothing, expected a number"):
        import_vehicle(path)
