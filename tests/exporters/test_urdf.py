"""The URDF of blue and auv_controllers: what their controllers make of it is what the export says it keeps."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from tests.exporters.whole import random_states, whole_vehicle

from towtank import export, import_vehicle, inverse_dynamics, load_vehicle
from towtank.core.arrays import Array
from towtank.core.attitude import rotation_from_euler
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


def test_forward_speed_terms_stand_as_damping_at_the_speed_asked_for(tmp_path: Path) -> None:
    vehicle = whole_vehicle()
    done = export(vehicle, "urdf-hydrodynamics", tmp_path / "m", at_speed=1.5)
    expected = vehicle.coefficient("Y_v") + 1.5 * vehicle.coefficient("Y_uv")
    assert done.kept.vehicle.coefficient("Y_v") == expected
    assert f'Yv="{expected!r}"' in done.files[0].read_text()
    assert any("at 1.5 m/s" in line for line in done.heading.missing)


def test_the_yaml_has_the_allocation_and_turns_thrust_into_pulses(tmp_path: Path) -> None:
    vehicle = load_vehicle("bluerov2_heavy_wu")
    text = export(vehicle, "urdf-hydrodynamics", tmp_path / "m").files[1].read_text()
    assert text.startswith("# towtank: urdf-hydrodynamics 2026\n")
    rows = {name.strip(): value for name, _, value in (line.partition(":") for line in text.splitlines())}
    T = configuration_matrix(vehicle)
    for k, name in enumerate(("x", "y", "z", "rx", "ry", "rz")):
        np.testing.assert_allclose(np.fromstring(rows[name].strip(" []"), sep=","), T[k], rtol=0.0, atol=1e-11)
    block = text.split(f"{vehicle.thrusters[0].name}_controller:")[1]
    powers = np.fromstring(block.split("coefficients: [")[1].split("]")[0], sep=",")
    stated = float(block.split("at most ")[1].split(" N")[0])
    curve = vehicle.thrusters[0].curve
    low, high = curve.limits or (curve.rest - 1.0, curve.rest + 1.0)
    commands = np.linspace(low, high, 101)
    forces = np.asarray(curve_force(curve, commands))
    driven = forces != 0.0
    pulses = np.polynomial.polynomial.polyval(forces[driven], powers)
    if high - low <= 100.0:
        pulses = curve.rest + (pulses - 1500.0) / 400.0
    back = np.interp(pulses, commands, forces)
    assert np.abs(back - forces[driven]).max() <= 1.05 * stated


def test_an_attribute_that_is_missing_is_one_clear_line(tmp_path: Path) -> None:
    path = export("bluerov2_heavy", "urdf-hydrodynamics", tmp_path / "m").files[0]
    path.write_text(path.read_text().replace(' Zdw="-18.68"', ""))
    with pytest.raises(Exception, match=r"hydrodynamics/added_mass Zdw: found nothing, expected a number"):
        import_vehicle(path)
