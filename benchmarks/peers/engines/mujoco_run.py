"""Runs exported models in MuJoCo, in an environment that has it and not towtank: python mujoco_run.py FOLDER.

Reads runs.json (name, files, current, number of steps) and NAME_in.npz (commands) of the folder; writes NAME.npz with
the poses (steps, 6) in NED and roll, pitch, yaw, the seconds that a step took, and what a contact carries where the
vehicle is pressed on the ground with 30 N.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

TURN = np.array([1.0, -1.0, -1.0])


def played(folder: Path, run: dict) -> tuple[np.ndarray, float]:
    """Return the poses (steps, 6) and the seconds of a step."""
    spec = importlib.util.spec_from_file_location("exported", Path(run["files"]) / "towtank_mujoco.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    model = mujoco.MjModel.from_xml_path(str(Path(run["files"]) / "model.xml"))
    data = mujoco.MjData(model)
    water = module.install(model, data)
    water.current[:] = np.array(run["current"]) * TURN
    commands = np.load(folder / f"{run['name']}_in.npz")["commands"]
    poses = np.empty((len(commands), 6))
    began = time.perf_counter()
    for k, row in enumerate(commands):
        water.command(row)
        mujoco.mj_step(model, data)
        poses[k, :3] = data.qpos[:3] * TURN
        poses[k, 3:] = angles(data.qpos[3], *(data.qpos[4:] * TURN))
    taken = (time.perf_counter() - began) / len(commands)
    mujoco.set_mjcb_passive(None)  # no model can be compiled while a callback of another one is in force
    return poses, taken


def pressed(files: Path, push: float) -> float:
    """Return the force [N] in the contact of a vehicle that its thrusters press on the ground for 30 s."""
    spec = importlib.util.spec_from_file_location("exported", files / "towtank_mujoco.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    scene = mujoco.MjSpec.from_string(
        '<mujoco><option timestep="0.005" integrator="RK4"/>'
        '<worldbody><geom type="plane" size="9 9 1" pos="0 0 -0.5"/></worldbody></mujoco>'
    )
    scene.attach(mujoco.MjSpec.from_file(str(files / "model.xml")), prefix="a_", frame=scene.worldbody.add_frame())
    scene.body(f"a_{module.BODY}").add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.2, 0.1], mass=0)
    model = scene.compile()
    data = mujoco.MjData(model)
    module.install(model, data, prefix="a_")
    data.ctrl[:] = np.linalg.pinv(module.CONFIGURATION) @ [0.0, 0.0, -push, 0.0, 0.0, 0.0]
    mujoco.mj_step(model, data, 6000)
    mujoco.set_mjcb_passive(None)
    return float(data.qfrc_constraint[2]) - module.NET_WEIGHT


def angles(w: float, x: float, y: float, z: float) -> list[float]:
    """Return roll, pitch and yaw of a quaternion."""
    return [
        np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0)),
        np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)),
    ]


if __name__ == "__main__":
    place = Path(sys.argv[1])
    print(f"MuJoCo {mujoco.__version__}")
    for each in json.loads((place / "runs.json").read_text()):
        found, seconds = played(place, each)
        contact = pressed(Path(each["files"]), 30.0) if each["pressed"] else np.nan
        np.savez(place / f"{each['name']}.npz", poses=found, seconds=seconds, contact=contact)
