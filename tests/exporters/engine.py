"""A stand-in for MuJoCo: one free body of an exported model.xml, by Newton and Euler.

It reads masses, sites and actuators from the file and knows nothing of the exporter. The world is z up; qvel is the
velocity of the body's origin in the world and its angular velocity in the body. Runge-Kutta as MuJoCo 4 has it: the
callback is called in every stage, and attitudes are of fourth order, too.
"""

from __future__ import annotations

import importlib.util
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from towtank.core.arrays import Array

NO_GRAVITY, NO_ACTUATION, NO_CLAMP = 1, 2, 4


class Engine(ModuleType):
    """What the exported module takes of the package `mujoco`."""

    def __init__(self) -> None:
        super().__init__("mujoco")
        self.__version__ = "4.0.0"
        self.mjtObj = SimpleNamespace(mjOBJ_BODY="body", mjOBJ_ACTUATOR="actuator")
        self.mjtJoint = SimpleNamespace(mjJNT_FREE=0)
        self.mjtDisableBit = SimpleNamespace(
            mjDSBL_GRAVITY=NO_GRAVITY, mjDSBL_ACTUATION=NO_ACTUATION, mjDSBL_CLAMPCTRL=NO_CLAMP
        )
        self.passive: Callable[[Any, Any], None] | None = None

    def mj_name2id(self, model: Body, kind: str, name: str) -> int:
        names = model.names[kind]
        return names.index(name) if name in names else -1

    def mj_factorM(self, model: Body, data: Data) -> None:
        data.factor = np.linalg.inv(whole(data.M))

    def get_mjcb_passive(self) -> Callable[[Any, Any], None] | None:
        return self.passive

    def set_mjcb_passive(self, passive: Callable[[Any, Any], None] | None) -> None:
        self.passive = passive


def numbers(text: str) -> Array:
    return np.array([float(each) for each in text.split()])


def rotation(q: Array) -> Array:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class Body:
    """The model of a file: a body with one light body fixed to it, and actuators at sites."""

    def __init__(self, path: Path) -> None:
        root = ET.parse(path).getroot()
        body = root.find("worldbody/body")
        assert body is not None
        option = root.find("option")
        assert option is not None
        inertial = body.find("inertial")
        assert inertial is not None
        xx, yy, zz, xy, xz, yz = numbers(inertial.get("fullinertia", ""))
        self.masses = [float(inertial.get("mass", ""))]
        self.centres = [numbers(inertial.get("pos", ""))]
        inertias = [np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])]
        self.lifts = [0.0]
        for light in body.findall("body"):
            own = light.find("inertial")
            assert own is not None
            self.masses.append(float(own.get("mass", "")))
            self.centres.append(numbers(own.get("pos", "")))
            inertias.append(np.diag(numbers(own.get("diaginertia", ""))))
            self.lifts.append(float(light.get("gravcomp", "0")))
        self.mass = sum(self.masses)
        self.centre = sum(m * c for m, c in zip(self.masses, self.centres, strict=True)) / self.mass
        self.inertia = np.zeros((3, 3))
        for m, c, I in zip(self.masses, self.centres, inertias, strict=True):
            d = c - self.centre
            self.inertia += I + m * (np.dot(d, d) * np.eye(3) - np.outer(d, d))
        sites = {each.get("name"): numbers(each.get("pos", "")) for each in body.findall("site")}
        actuators = root.findall("actuator/general")
        self.places = [sites[each.get("site")] for each in actuators]
        self.gears = [numbers(each.get("gear", ""))[:3] for each in actuators]
        self.lags = [float(each.get("dynprm", "0")) for each in actuators]
        self.names = {"body": ["world", body.get("name", "")], "actuator": [each.get("name", "") for each in actuators]}
        self.opt = SimpleNamespace(gravity=numbers(option.get("gravity", "")), disableflags=0)
        self.timestep = float(option.get("timestep", ""))
        self.body_jntadr, self.jnt_type, self.jnt_dofadr = [-1, 0], [0], [0]
        self.body_subtreemass, self.dof_armature = np.full(2, self.mass), np.zeros(6)
        self.M_rowadr = [0, 1, 3, 6, 10, 15]
        self.actuator_ctrladr = list(range(len(actuators)))
        self.actuator_ctrllimited = [each.get("ctrllimited") == "true" for each in actuators]
        self.actuator_ctrlrange = [numbers(each.get("ctrlrange", "0 0")) for each in actuators]
        lagged = np.cumsum([lag > 0.0 for lag in self.lags]) - 1
        self.actuator_actadr = [int(k) if lag > 0.0 else -1 for k, lag in zip(lagged, self.lags, strict=True)]


class Data:
    """The state of a body, and what acts on it."""

    def __init__(self, model: Body) -> None:
        self.qpos, self.qvel = np.array([0.0, 0, 0, 1, 0, 0, 0]), np.zeros(6)
        self.act = np.zeros(sum(lag > 0.0 for lag in model.lags))
        self.ctrl = np.zeros(len(model.lags))
        self.qfrc_passive, self.qfrc_applied, self.qacc = np.zeros(6), np.zeros(6), np.zeros(6)
        self.xfrc_applied = np.zeros((2, 6))
        self.xmat = np.zeros((2, 9))
        self.M, self.factor = np.zeros(21), np.zeros((6, 6))


def thrust_of(model: Body, data: Data) -> Array:
    if model.opt.disableflags & NO_ACTUATION:
        return np.zeros(len(model.lags))
    ctrl = clamped(model, data)
    return np.array([data.act[a] if a >= 0 else ctrl[k] for k, a in enumerate(model.actuator_actadr)])


def clamped(model: Body, data: Data) -> Array:
    out = data.ctrl.copy()
    for k, limited in enumerate(model.actuator_ctrllimited):
        if limited and not model.opt.disableflags & NO_CLAMP:
            out[k] = np.clip(out[k], *model.actuator_ctrlrange[k])
    return out


def whole(packed: Array) -> Array:
    """The symmetric matrix (6, 6) of which the lower half is given row by row (21,)."""
    out = np.zeros((6, 6))
    out[np.tril_indices(6)] = packed
    return np.asarray(out + np.tril(out, -1).T)


def mass_of(model: Body, R: Array) -> Array:
    """The mass matrix (6, 6) by the origin's velocity in the world and the angular velocity in the body."""
    m, x, y, z = model.mass, *model.centre
    S = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[m * np.eye(3), -m * R @ S], [m * S @ R.T, model.inertia - m * S @ S]])


def forward(engine: Engine, model: Body, data: Data) -> Array:
    """Write qacc, and return the rates of the activations."""
    R = rotation(data.qpos[3:] / np.linalg.norm(data.qpos[3:]))
    data.xmat[1] = R.ravel()
    data.M = mass_of(model, R)[np.tril_indices(6)]
    engine.mj_factorM(model, data)
    gravity = np.zeros(3) if model.opt.disableflags & NO_GRAVITY else model.opt.gravity
    data.qfrc_passive = np.zeros(6)
    for m, centre, share in zip(model.masses, model.centres, model.lifts, strict=True):
        lift = -share * m * gravity
        data.qfrc_passive += np.concatenate([lift, np.cross(centre, R.T @ lift)])
    if engine.passive is not None:
        engine.passive(model, data)
    generalised = data.qfrc_passive + data.qfrc_applied
    force = generalised[:3] + model.mass * gravity
    moment = generalised[3:] + np.cross(model.centre, R.T @ (model.mass * gravity))  # about the origin, body axes
    for place, gear, thrust in zip(model.places, model.gears, thrust_of(model, data), strict=True):
        force = force + R @ gear * thrust
        moment = moment + np.cross(place, gear * thrust)
    pull, torque = data.xfrc_applied[1].reshape(2, 3)
    force = force + pull
    moment = moment + R.T @ torque + np.cross(model.centres[0], R.T @ pull)
    omega = data.qvel[3:]
    inward = model.mass * np.cross(omega, np.cross(omega, model.centre))
    turning = np.cross(model.centre, inward) + np.cross(omega, model.inertia @ omega)
    data.qacc = data.factor @ np.concatenate([force - R @ inward, moment - turning])
    ctrl = clamped(model, data)
    return np.array([(ctrl[k] - data.act[a]) / model.lags[k] for k, a in enumerate(model.actuator_actadr) if a >= 0])


def step(engine: Engine, model: Body, data: Data) -> None:
    """Advance by a time step."""
    h = model.timestep
    start = np.concatenate([data.qpos, data.qvel, data.act])
    total, state = start.copy(), start
    for stage in range(4):
        data.qpos, data.qvel, data.act = state[:7], state[7:13], state[13:]
        rates = forward(engine, model, data)
        w, v = data.qpos[3], data.qpos[4:]
        turning = 0.5 * np.concatenate([[-np.dot(v, data.qvel[3:])], w * data.qvel[3:] + np.cross(v, data.qvel[3:])])
        rate = np.concatenate([data.qvel[:3], turning, data.qacc, rates])
        total = total + rate * h / (6.0 if stage in (0, 3) else 3.0)
        state = start + rate * (h if stage == 2 else 0.5 * h)
    total[3:7] /= np.linalg.norm(total[3:7])
    data.qpos, data.qvel, data.act = total[:7].copy(), total[7:13].copy(), total[13:].copy()


def loaded(path: Path) -> ModuleType:
    """A module that was exported."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
