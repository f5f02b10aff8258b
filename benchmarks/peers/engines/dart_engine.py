"""Runs in an environment with dartpy: DART as Gazebo drives it, on an SDF file.

    python dart_engine.py FOLDER

FOLDER/runs.json lists the runs: the SDF, a file of states (down, nu, tau), forces of the thrusters held over time, and
steps [s]. Accelerations and tracks are written to FOLDER/<run>.npz. The spatial inertia is put together as gz-physics
does it (body's and file's, the file's turned into DART's order), gravity of such a link as a force at its centre; the
forces of the systems Hydrodynamics, Buoyancy and Thruster are those of `tests/exporters/gazebo.py`, taken at the
beginning of a step.
"""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import dartpy as dart
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tests" / "exporters"))

from gazebo import AXES, Gazebo, floats

ORDER = [3, 4, 5, 0, 1, 2]  # DART has the angular part first
GRAVITY = np.array([0.0, 0.0, -9.81])


class Engine:
    """A world with the model of an SDF file, its propellers locked."""

    def __init__(self, path: Path, step: float) -> None:
        self.gazebo = Gazebo(path)
        self.world = dart.simulation.World()
        self.world.setGravity(GRAVITY)
        self.world.setTimeStep(step)
        self.skeleton = dart.dynamics.Skeleton("vehicle")
        model = ET.parse(path).getroot().find(".//model")
        links = {each.get("name"): each for each in model.findall("link")}
        self.joint, self.base = self.skeleton.createFreeJointAndBodyNodePair()
        self.centre, self.mass = self._inertia(self.base, links["base_link"])
        self.thrusters = []
        for joint in model.findall("joint"):
            link = links[joint.findtext("child")]
            properties = dart.dynamics.RevoluteJointProperties()
            properties.mAxis = floats(joint.findtext("axis/xyz"))
            properties.mT_ParentBodyToJoint = dart.math.Isometry3()
            properties.mT_ParentBodyToJoint.set_translation(floats(link.findtext("pose"))[:3])
            hinge, body = self.skeleton.createRevoluteJointAndBodyNodePair(self.base, properties)
            hinge.setActuatorType(dart.dynamics.ActuatorType.LOCKED)
            self._inertia(body, link)
            axis = floats(joint.findtext("axis/xyz"))
            self.thrusters.append((body, axis / np.linalg.norm(axis)))
        self.world.addSkeleton(self.skeleton)

    @staticmethod
    def _inertia(body: dart.dynamics.BodyNode, link: ET.Element) -> tuple[np.ndarray, float]:
        inertial = link.find("inertial")
        mass, centre = float(inertial.findtext("mass")), floats(inertial.findtext("pose") or "0 0 0")[:3]
        I = np.zeros((3, 3))
        for i in range(3):
            for j in range(i, 3):
                I[i, j] = I[j, i] = float(inertial.findtext(f"inertia/i{'xyz'[i]}{'xyz'[j]}"))
        found = dart.dynamics.Inertia(mass, centre, I)
        tags = inertial.find("fluid_added_mass")
        if tags is not None:
            M = np.zeros((6, 6))
            for each in tags:
                i, j = AXES.index(each.tag[0]), AXES.index(each.tag[1])
                M[i, j] = M[j, i] = float(each.text)
            found.setSpatialTensor(found.getSpatialTensor() + M[np.ix_(ORDER, ORDER)])
            body.setGravityMode(False)
        body.setInertia(found)
        return centre, mass

    def place(self, R: np.ndarray, nu: np.ndarray) -> None:
        """Put the vehicle at the origin with a velocity (6,) in the body frame."""
        pose = dart.math.Isometry3()
        pose.set_rotation(R)
        dart.dynamics.FreeJoint.setTransformOf(self.joint, pose)
        world = dart.dynamics.Frame.World()
        self.joint.setSpatialVelocity(np.concatenate([nu[3:], nu[:3]]), world, self.base)

    def push(self, tau: np.ndarray | None, forces: np.ndarray | None) -> None:
        """Apply what Gazebo's systems would at this state, and a wrench (6,) or the thrusters' forces."""
        R = self.base.getWorldTransform().rotation()
        twist = self.base.getSpatialVelocity()
        nu = np.concatenate([twist[3:], twist[:3]])
        down = R.T @ np.array([0.0, 0.0, -1.0])
        gazebo = self.gazebo
        wrench = gazebo.damping(nu[None])[0] + (0.0 if tau is None else tau)
        lift = -gazebo.volume * gazebo.density * gazebo.gravity * down
        wrench[:3] += lift
        wrench[3:] += np.cross(gazebo.lift / gazebo.volume, lift)
        zero = np.zeros(3)
        self.base.addExtForce(wrench[:3], zero, True, True)
        self.base.addExtTorque(wrench[3:], True)
        self.base.addExtForce(self.mass * GRAVITY, self.centre, False, True)
        for k, (body, axis) in enumerate(self.thrusters):
            if forces is not None:
                body.addExtForce(forces[k] * axis, zero, True, True)

    def acceleration(self, R: np.ndarray, nu: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return d nu/dt (6,)."""
        self.place(R, nu)
        self.skeleton.clearExternalForces()
        self.push(tau, None)
        self.skeleton.computeForwardDynamics()
        return self.base.getSpatialAcceleration()[[3, 4, 5, 0, 1, 2]]

    def track(self, forces: np.ndarray, hold: float, step: float) -> np.ndarray:
        """Return positions (n, 3) after every hold."""
        self.place(np.eye(3), np.zeros(6))
        out = []
        for row in forces:
            for _ in range(round(hold / step)):
                self.push(None, row)
                self.world.step()
            out.append(self.base.getWorldTransform().translation().copy())
        return np.array(out)


def main() -> None:
    """Do the runs of a folder."""
    folder = Path(sys.argv[1])
    for run in json.loads((folder / "runs.json").read_text()):
        given = np.load(folder / f"{run['name']}_states.npz")
        path = Path(run["sdf"])
        engine = Engine(path, 0.002)
        found = {
            "acceleration": np.array(
                [
                    engine.acceleration(R, nu, tau)
                    for R, nu, tau in zip(given["R"], given["nu"], given["tau"], strict=True)
                ]
            )
        }
        for kind in run["kinds"]:
            for step in run["steps"]:
                found[f"{kind}_{step}"] = Engine(path, step).track(given[kind], run["hold"], step)
        np.savez(folder / f"{run['name']}.npz", **found)


if __name__ == "__main__":
    main()
