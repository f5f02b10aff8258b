"""Gazebo's force laws written from its sources, to move what is in an SDF file: no line of the exporter is used.

gz-sim Hydrodynamics.cc and Buoyancy.cc of 2025; gz-physics dartsim: the spatial inertia of a link with added mass is
the body's plus the file's matrix, gravity acts on the body's mass at its centre.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

AXES, FORCES, VELOCITIES = "xyzpqr", "xyzkmn", "UVWPQR"


def skew(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def floats(text: str | None) -> Array:
    return np.array([float(each) for each in (text or "").split()])


class Gazebo:
    """A model, all of its links rigid, in FLU about the origin of base_link."""

    def __init__(self, path: Path, *, gravity: float = 9.81, density: float = 1000.0) -> None:
        model = ET.parse(path).getroot().find(".//model")
        assert model is not None
        self.gravity, self.density = gravity, density
        self.rigid, self.added = np.zeros((6, 6)), np.zeros((6, 6))
        self.mass, self.moment = 0.0, np.zeros(3)
        self.volume, self.lift = 0.0, np.zeros(3)
        places: dict[str, Array] = {}
        for link in model.findall("link"):
            origin = floats(link.findtext("pose") or "0 0 0 0 0 0")
            assert not np.any(origin[3:])
            places[link.get("name", "")] = origin[:3]
            inertial = link.find("inertial")
            assert inertial is not None
            r = origin[:3] + floats(inertial.findtext("pose") or "0 0 0 0 0 0")[:3]
            m = float(inertial.findtext("mass") or "nan")
            I = np.zeros((3, 3))
            for i in range(3):
                for j in range(i, 3):
                    value = float(inertial.findtext(f"inertia/i{'xyz'[i]}{'xyz'[j]}") or "nan")
                    I[i, j] = I[j, i] = value
            S = skew(r)
            self.rigid += np.block([[m * np.eye(3), -m * S], [m * S, I - m * S @ S]])
            self.mass, self.moment = self.mass + m, self.moment + m * r
            tags = inertial.find("fluid_added_mass")
            for each in [] if tags is None else tags:
                i, j = AXES.index(each.tag[0]), AXES.index(each.tag[1])
                self.added[i, j] = self.added[j, i] = float(each.text or "nan")
            for shape in link.findall("collision"):
                volume = float(np.prod(floats(shape.findtext("geometry/box/size"))))
                self.volume += volume
                self.lift += volume * floats(shape.findtext("pose"))[:3]
        plugin = next(each for each in model.findall("plugin") if "Hydrodynamics" in each.get("name", ""))
        self.linear, self.absolute = np.zeros((6, 6)), np.zeros((6, 6, 6))
        self.bilinear, self.late = np.zeros((6, 6, 6)), np.zeros((6, 6))
        self.coriolis = plugin.findtext("disable_coriolis") != "true"
        for i, a in enumerate(FORCES):
            for j, b in enumerate(VELOCITIES):
                self.linear[i, j] = float(plugin.findtext(a + b) or 0.0)
                self.late[i, j] = float(plugin.findtext(f"{a}Dot{b}") or 0.0)
                for k, c in enumerate(VELOCITIES):
                    self.absolute[i, j, k] = float(plugin.findtext(f"{a}{b}abs{c}") or 0.0)
                    self.bilinear[i, j, k] = float(plugin.findtext(a + b + c) or 0.0)
        self.thrusters = []
        for each in model.findall("plugin"):
            if "Thruster" not in each.get("name", ""):
                continue
            joint = next(j for j in model.findall("joint") if j.get("name") == each.findtext("joint_name"))
            axis = floats(joint.findtext("axis/xyz"))
            self.thrusters.append((places[joint.findtext("child") or ""], axis / np.linalg.norm(axis)))

    @property
    def spatial(self) -> Array:
        """What DART takes: inertia and added mass (6, 6)."""
        return self.rigid + self.added

    def damping(self, nu: Array) -> Array:
        """The plugin's damping force (n, 6) of velocities (n, 6)."""
        return np.asarray(
            nu @ self.linear.T
            + np.einsum("ijk,nj,nk->ni", self.absolute, nu, np.abs(nu))
            + np.einsum("ijk,nj,nk->ni", self.bilinear, nu, nu)
        )

    def hydrostatics(self, down: Array) -> Array:
        """Gravity and buoyancy (n, 6) where `down` (n, 3) is the direction of gravity in the body frame."""
        weight, lift = self.mass * self.gravity * down, -self.volume * self.density * self.gravity * down
        centre = self.lift / self.volume if self.volume else np.zeros(3)
        turn = np.cross(self.moment / self.mass, weight) + np.cross(centre, lift)
        return np.hstack([weight + lift, turn])

    def acceleration(self, down: Array, nu: Array, tau: Array) -> Array:
        """d nu/dt (n, 6) of the engine; added mass of the plugin as if it acted at once."""
        M = self.spatial
        momentum = nu @ M.T
        p, h, v, w = momentum[:, :3], momentum[:, 3:], nu[:, :3], nu[:, 3:]
        gyration = np.hstack([np.cross(w, p), np.cross(v, p) + np.cross(w, h)])
        force = tau + self.damping(nu) + self.hydrostatics(down) - gyration
        return np.asarray(np.linalg.solve(M - self.late, force.T).T)

    def wrench(self, forces: Array) -> Array:
        """The wrench (n, 6) of the thrusters' forces (n, thrusters)."""
        columns = [np.concatenate([axis, np.cross(place, axis)]) for place, axis in self.thrusters]
        return np.asarray(forces @ np.array(columns))
