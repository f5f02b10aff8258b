"""The force laws of uuv_simulator, written from the description of its format: what moves there is what was imported.

In Gazebo classic a link moves in FLU; the plugin turns its velocity into FRD, makes of it

    - M_A nu_dot - C_A(nu) nu + (linear + u forward) nu + quadratic_ii |nu_i| nu_i

and turns the force back. Buoyancy acts in FLU at its centre, thrusters along the axes of their joints. No line of the
import is used, nor of the package's dynamics: bodies, frames and forces are put together here.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from towtank import import_vehicle, inverse_dynamics, thruster_wrench
from towtank.core.arrays import Array

T = np.diag([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
G = 9.81


def skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def turn(roll: float, pitch: float, yaw: float) -> Array:
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    R_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    R_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    R_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(R_z @ R_y @ R_x)


class Propeller(NamedTuple):
    """Where a thruster's joint is (xyz, rpy), its axis within it, and its conversion."""

    xyz: Array
    rpy: Array
    axis: Array
    conversion: str

    def force(self, w: float) -> float:
        """T(w) by the format's words: c w|w|, Bessa with its dead band, or between points."""
        match self.conversion:
            case "Basic":
                return 0.02 * w * abs(w)
            case "Bessa":
                if w * abs(w) > 4.0:
                    return 0.03 * (w * abs(w) - 4.0)
                return 0.02 * (w * abs(w) + 9.0) if w * abs(w) < -9.0 else 0.0
            case _:
                return float(np.interp(w, [-10.0, 0.0, 10.0], [-5.0, 0.0, 8.0]))

    @property
    def xml(self) -> str:
        """The conversion as the plugin reads it."""
        return {
            "Basic": "<type>Basic</type><rotorConstant>0.02</rotorConstant>",
            "Bessa": "<type>Bessa</type><rotorConstantL>0.02</rotorConstantL><rotorConstantR>0.03</rotorConstantR>"
            "<deltaL>-9</deltaL><deltaR>4</deltaR>",
            "LinearInterp": "<type>LinearInterp</type><inputValues>-10 0 10</inputValues>"
            "<outputValues>-5 0 8</outputValues>",
        }[self.conversion]


class Classic:
    """A vehicle of chance in Gazebo classic, its centre of gravity at the link's origin."""

    def __init__(self, seed: int) -> None:
        chance = np.random.default_rng(seed)
        self.mass, self.volume, self.density = 18.0, 0.0175, 1028.0
        half = chance.normal(0.0, 0.2, (3, 3))
        self.inertia = np.diag([0.9, 1.1, 1.3]) + half @ half.T
        whole = chance.normal(0.0, 1.0, (6, 6))
        self.added = np.diag([4.0, 16.0, 16.0, 0.8, 1.3, 1.3]) + 0.2 * whole @ whole.T  # FRD, positive
        self.linear = -np.diag([2.0, 23.0, 23.0, 0.3, 9.0, 9.0]) + chance.normal(0.0, 1.0, (6, 6))
        self.quadratic = -np.diag([3.0, 80.0, 80.0, 0.1, 9.0, 9.0]) + chance.normal(0.0, 1.0, (6, 6))
        self.forward = np.zeros((6, 6))
        for i, j in ((1, 1), (1, 5), (2, 2), (2, 4), (3, 3), (4, 2), (4, 4), (5, 1), (5, 5)):  # that a vehicle knows
            self.forward[i, j] = chance.normal(0.0, 3.0)
        self.centre = chance.normal(0.0, 0.05, 3)  # of buoyancy, FLU
        self.propellers = [
            Propeller(*chance.normal(0.0, 0.5, (2, 3)), axis / np.linalg.norm(axis), kind)
            for kind, axis in zip(("Basic", "Bessa", "LinearInterp"), chance.normal(0.0, 1.0, (3, 3)), strict=True)
        ]

    def urdf(self) -> str:
        """The file."""

        def row(values: Array) -> str:
            return " ".join(map(repr, np.ravel(values).tolist()))

        I, out = self.inertia.tolist(), []
        for k, each in enumerate(self.propellers):
            out.append(
                f'<link name="p{k}"/><joint name="j{k}" type="continuous"><parent link="base"/><child link="p{k}"/>'
                f'<origin xyz="{row(each.xyz)}" rpy="{row(each.rpy)}"/><axis xyz="{row(each.axis)}"/></joint>'
                f'<gazebo><plugin filename="libuuv_thruster_ros_plugin.so"><linkName>p{k}</linkName>'
                f"<jointName>j{k}</jointName><conversion>{each.xml}</conversion></plugin></gazebo>"
            )
        return f"""<robot name="chance"><link name="base"><inertial><mass value="{self.mass}"/>
        <inertia ixx="{I[0][0]!r}" ixy="{I[0][1]!r}" ixz="{I[0][2]!r}" iyy="{I[1][1]!r}" iyz="{I[1][2]!r}"
        izz="{I[2][2]!r}"/></inertial></link>
        <gazebo><plugin filename="libuuv_underwater_object_ros_plugin.so"><fluid_density>{self.density}</fluid_density>
        <link name="base"><volume>{self.volume}</volume><center_of_buoyancy>{row(self.centre)}</center_of_buoyancy>
        <hydrodynamic_model><type>fossen</type><added_mass>{row(self.added)}</added_mass>
        <linear_damping>{row(self.linear)}</linear_damping>
        <linear_damping_forward_speed>{row(self.forward)}</linear_damping_forward_speed>
        <quadratic_damping>{row(self.quadratic)}</quadratic_damping></hydrodynamic_model></link></plugin></gazebo>
        {"".join(out)}</robot>"""

    def needed(self, up: Array, nu: Array, nu_dot: Array) -> Array:
        """The wrench (6,) in FLU, about the link's origin, that moves it so; `up` in the body frame."""
        v, w = nu[:3], nu[3:]
        inertial = np.concatenate(
            [
                self.mass * (nu_dot[:3] + np.cross(w, v)),
                self.inertia @ nu_dot[3:] + np.cross(w, self.inertia @ w),
            ]
        )
        frd, frd_dot = T @ nu, T @ nu_dot
        p, h = np.split(self.added @ frd, 2)
        coriolis = np.concatenate([np.cross(frd[3:], p), np.cross(frd[:3], p) + np.cross(frd[3:], h)])
        water = -self.added @ frd_dot - coriolis + (self.linear + frd[0] * self.forward) @ frd
        water += np.diag(self.quadratic) * np.abs(frd) * frd
        lift = self.volume * self.density * G * up
        hydrostatic = np.concatenate([lift - self.mass * G * up, np.cross(self.centre, lift)])
        return np.asarray(inertial - T @ water - hydrostatic)

    def thrust(self, speeds: Array) -> Array:
        """The wrench (6,) in FLU of the propellers' speeds [rad/s]."""
        out = np.zeros(6)
        for each, w in zip(self.propellers, speeds, strict=True):
            push = each.force(float(w)) * (turn(*each.rpy) @ each.axis)
            out += np.concatenate([push, np.cross(each.xyz, push)])
        return out


@pytest.mark.parametrize("seed", range(5))
def test_what_was_imported_moves_as_gazebo_classic_does(seed: int, tmp_path: Path) -> None:
    classic, chance = Classic(seed), np.random.default_rng(100 + seed)
    path = tmp_path / "chance.urdf"
    path.write_text(classic.urdf())
    found = import_vehicle(path)
    assert not [line for line in found.left if "quadratic_damping" not in line]
    assert len(found.left) == 30  # couplings of quadratic damping, which act on nothing there
    eta = np.zeros((200, 6))
    eta[:, 3:] = chance.uniform(-1.4, 1.4, (200, 3))
    nu, nu_dot = chance.normal(0.0, 1.0, (2, 200, 6))
    wrench = inverse_dynamics(found.vehicle, eta, nu, nu_dot)
    expected = np.empty((200, 6))
    for k, (phi, theta, _) in enumerate(eta[:, 3:]):
        # NED: down in the body is (-sin theta, cos theta sin phi, cos theta cos phi), and up in FLU its turn
        down = np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
        expected[k] = T @ classic.needed(-(T[:3, :3] @ down), T @ nu[k], T @ nu_dot[k])
    np.testing.assert_allclose(wrench, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
    speeds = chance.uniform(-9.0, 9.0, (200, 3))
    pushed = np.array([T @ classic.thrust(each) for each in speeds])
    np.testing.assert_allclose(
        thruster_wrench(found.vehicle, speeds), pushed, rtol=0.0, atol=1e-9 * np.abs(pushed).max()
    )
