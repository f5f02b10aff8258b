"""MJCF and its module: on a stand-in for the engine, and in MuJoCo itself where it is installed."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from tests.exporters.engine import NO_ACTUATION, NO_GRAVITY, Body, Data, Engine, forward, loaded, step
from tests.exporters.whole import random_commands, random_states, whole_vehicle

from towtank import export, forward_dynamics, load_vehicle, simulate
from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.exporters.heading import heading_of
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

NAMES = ("rexrov", "bluerov2_heavy", "lauv", "vlbv300", "whole")
TURN = np.array([1.0, -1.0, -1.0])  # between north, east, down and north, west, up; forward, starboard and port alike
CURRENT = np.array([0.3, -0.2, 0.1])


@cache
def vehicle_of(name: str) -> Vehicle:
    return (whole_vehicle() if name == "whole" else load_vehicle(name)).model_copy(update={"command_delay": 0.0})


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> Iterator[Engine]:
    made = Engine()
    monkeypatch.setitem(sys.modules, "mujoco", made)
    yield made
    made.passive = None


class Exported(NamedTuple):
    model: Body
    data: Data
    water: Any  # Hydrodynamics
    module: Any


def exported(engine: Engine, vehicle: Vehicle, folder: Path) -> Exported:
    """A vehicle in the stand-in, the module's callback in force."""
    files = export(vehicle, "mujoco", folder / "out").files
    model, module = Body(files[0]), loaded(files[1])
    data = Data(model)
    return Exported(model, data, module.install(model, data), module)


def put(data: Data, eta: Array, nu: Array) -> Array:
    """Give the body a pose and a velocity over ground, both of the package; return R, from its own axes to NED."""
    q = quaternions_from_eulers(np.ascontiguousarray(eta[None, 3:]))[0]
    data.qpos = np.concatenate([eta[:3] * TURN, q[:1], q[1:] * TURN])
    R = rotated(q)
    data.qvel = np.concatenate([R @ nu[:3] * TURN, nu[3:] * TURN])
    return R


def rotated(q: Array) -> Array:
    w, v = q[0], q[1:]
    return np.array([e + 2.0 * (w * np.cross(v, e) + np.cross(v, np.cross(v, e))) for e in np.eye(3)]).T


def acceleration(data: Data, R: Array, nu: Array) -> Array:
    """The package's acceleration (6,) out of that of the engine."""
    linear = R.T @ (data.qacc[:3] * TURN) - np.cross(nu[3:], nu[:3])
    return np.concatenate([linear, data.qacc[3:] * TURN])


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_are_those_of_the_package(engine: Engine, name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    model, data, water, _ = exported(engine, vehicle, tmp_path)
    eta, nu, tau = random_states(vehicle, 30)
    B, loss = configuration_matrix(vehicle), vehicle.coefficient("inflow_loss")
    commands = random_commands(vehicle, 30, seed=1)
    steady = thruster_forces(vehicle, commands)
    for k in range(30):
        R = put(data, eta[k], nu[k])
        carried = R.T @ CURRENT
        relative = nu[k] - np.concatenate([carried, np.zeros(3)])
        water.current[:] = CURRENT * TURN
        water.command(commands[k])
        data.act[:] = [steady[k, j] for j, a in enumerate(model.actuator_actadr) if a >= 0]
        data.xfrc_applied[1] = np.concatenate([R @ tau[k, :3] * TURN, R @ tau[k, 3:] * TURN])
        arm = np.array(vehicle.rigid_body.centre_of_gravity)
        given = tau[k] + np.concatenate([np.zeros(3), np.cross(arm, tau[k, :3])])
        given += B @ (steady[k] - loss * np.abs(steady[k]) * (relative @ B))
        forward(engine, model, data)
        expected = forward_dynamics(vehicle, eta[k], relative, given)
        expected[:3] -= np.cross(nu[k, 3:], carried)
        assert np.abs(acceleration(data, R, nu[k]) - expected).max() <= 1e-9 * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("name", ["whole", "bluerov2_heavy"])
def test_a_run_is_that_of_the_simulator(engine: Engine, name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    model, data, water, _ = exported(engine, vehicle, tmp_path)
    commands = np.repeat(random_commands(vehicle, 6, seed=2), 50, axis=0)
    run = simulate(vehicle, commands=commands, dt=model.timestep, current=CURRENT)
    water.current[:] = CURRENT * TURN
    states = []
    for row in commands:
        water.command(row)
        step(engine, model, data)
        states.append(np.concatenate([data.qpos[:3] * TURN, data.qvel[3:] * TURN]))
    far = np.abs(np.array(states) - np.column_stack([run[each].values[1:] for each in "xyzpqr"])).max(axis=0)
    assert far[:3].max() <= 1e-7
    assert far[3:].max() <= 5e-6  # the lag of thrusters, exact in the simulator, by Runge-Kutta here


def test_thruster_curves_are_those_of_the_package(engine: Engine, tmp_path: Path) -> None:
    vehicle = vehicle_of("whole")
    _, data, water, _ = exported(engine, vehicle, tmp_path)
    commands = random_commands(vehicle, 200, seed=4)
    for voltage in (None, 14.2):
        found = np.array([water.forces(row, voltage) for row in commands])
        expected = thruster_forces(vehicle, commands, voltage)
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
    water.command(commands[1], 18.0)
    assert np.abs(data.ctrl - thruster_forces(vehicle, commands[1], 18.0)).max() <= 1e-12
    assert np.isnan(water.forces([np.nan] * 6)).all()


def test_the_model_by_itself_floats_upright(engine: Engine, tmp_path: Path) -> None:
    vehicle = vehicle_of("whole")
    model, data, _, _ = exported(engine, vehicle, tmp_path)
    engine.passive = None
    eta = np.array([0.0, 0, 0, 0.3, -0.2, 0.7])
    R = put(data, eta, np.zeros(6))
    forward(engine, model, data)
    restoring = np.zeros(6)
    down = R.T @ [0.0, 0.0, 1.0]
    restoring[:3] = vehicle.weight_minus_buoyancy * down
    restoring[3:] = np.cross(vehicle.restoring_moment, down)
    expected = np.linalg.solve(vehicle.rigid_body_matrix, restoring)
    assert np.abs(acceleration(data, R, np.zeros(6)) - expected).max() <= 1e-5  # a millionth of the mass is the float's


def test_switches_of_the_engine_are_kept(engine: Engine, tmp_path: Path) -> None:
    """Without gravity or actuation the vehicle keeps its own restoring forces, and has no thrust."""
    vehicle = vehicle_of("whole")
    model, data, water, _ = exported(engine, vehicle, tmp_path)
    eta, nu, _ = (each[0] for each in random_states(vehicle, 1))
    water.command(random_commands(vehicle, 1, seed=3)[0])
    model.opt.disableflags = NO_GRAVITY | NO_ACTUATION
    R = put(data, eta, nu)
    forward(engine, model, data)
    expected = forward_dynamics(vehicle, eta, nu, np.zeros(6))
    assert np.abs(acceleration(data, R, nu) - expected).max() <= 1e-9


def test_forces_that_the_module_never_sees_find_the_whole_mass(engine: Engine, tmp_path: Path) -> None:
    """As those of contacts: they come after the callback, and must not be answered by the rigid body alone."""
    vehicle = vehicle_of("whole")
    model, data, _, _ = exported(engine, vehicle, tmp_path)
    eta, nu, tau = (each[0] for each in random_states(vehicle, 1))
    R = put(data, eta, nu)
    for data.qfrc_applied in (np.zeros(6), np.concatenate([R @ tau[:3] * TURN, tau[3:] * TURN])):
        forward(engine, model, data)
        expected = forward_dynamics(vehicle, eta, nu, tau if data.qfrc_applied.any() else np.zeros(6))
        assert np.abs(acceleration(data, R, nu) - expected).max() <= 1e-9


def test_mass_is_added_once_however_often_the_engine_calls_back(engine: Engine, tmp_path: Path) -> None:
    vehicle = vehicle_of("whole")
    model, data, water, _ = exported(engine, vehicle, tmp_path)
    put(data, *(each[0] for each in random_states(vehicle, 1)[:2]))
    forward(engine, model, data)
    once = data.M.copy()
    water.apply(model, data)
    assert np.array_equal(data.M, once)


def test_callbacks_before_it_stay_and_other_models_are_left_alone(engine: Engine, tmp_path: Path) -> None:
    seen = []
    engine.passive = lambda model, data: seen.append(model)
    made = exported(engine, vehicle_of("lauv"), tmp_path)
    forward(engine, made.model, made.data)
    assert seen == [made.model]
    other = Data(Body(tmp_path / "out" / "model.xml"))
    forward(engine, Body(tmp_path / "out" / "model.xml"), other)
    assert len(seen) == 2
    assert not np.array_equal(other.M, made.data.M)
    with pytest.raises(ValueError, match="nothing: the model has no body of this name with a free joint"):
        made.module.install(made.model, made.data, "nothing")
    del made.model.actuator_ctrladr
    with pytest.raises(RuntimeError, match=r"found MuJoCo .*, expected 4\.0 or newer"):
        made.module.install(made.model, made.data)


def test_what_mjcf_refuses_is_given_to_it_otherwise(engine: Engine, tmp_path: Path) -> None:
    """Moments of inertia that no body has, and nothing that lifts: the module still moves it as it is."""
    base = vehicle_of("lauv")
    rigid = base.rigid_body.model_copy(update={"inertia": (0.05, 1.0, 2.0)})
    heavy = base.with_coefficients({"W_minus_B": base.weight + 5.0, "BG_z": 2.0}).model_copy(
        update={"rigid_body": rigid}
    )
    done = export(heavy, "mujoco", tmp_path / "heavy")
    assert len(done.heading.missing) == 3
    inertial = ET.parse(done.files[0]).getroot().find("worldbody/body/inertial")
    assert inertial is not None
    moments = [float(each) for each in inertial.get("fullinertia", "").split()][:3]
    assert 2.0 * max(moments) <= sum(moments)
    model, data, _, _ = exported(engine, heavy, tmp_path)
    eta, nu, _ = (each[0] for each in random_states(heavy, 1))
    R = put(data, eta, nu)
    forward(engine, model, data)
    expected = forward_dynamics(heavy, eta, nu, np.zeros(6))
    assert np.abs(acceleration(data, R, nu) - expected).max() <= 1e-9 * (1.0 + np.abs(expected).max())


def test_the_same_model_gives_the_same_files(tmp_path: Path) -> None:
    vehicle = load_vehicle("bluerov2_heavy")
    pair = [[each.read_bytes() for each in export(vehicle, "mujoco", tmp_path / k).files] for k in "ab"]
    assert pair[0] == pair[1]
    for text in pair[0]:
        heading = heading_of(text.decode())
        assert heading is not None
        assert heading.title == "mujoco 4.0"
        assert heading.error.endswith("none")
    compile(pair[0][1], "towtank_mujoco.py", "exec")
    bare = export(vehicle.model_copy(update={"thrusters": ()}), "mujoco", tmp_path / "bare").files[0]
    assert ET.parse(bare).getroot().find("actuator") is None


# -- in MuJoCo


@pytest.mark.parametrize("name", NAMES)
def test_mujoco_moves_as_the_simulator_does(name: str, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed; `make engines` has it")
    if int(mujoco.__version__.split(".")[0]) < 4:
        pytest.skip("before MuJoCo 4 attitudes are of second order under Runge-Kutta")
    vehicle = vehicle_of(name)
    files = export(vehicle, "mujoco", tmp_path / "out").files
    model = mujoco.MjModel.from_xml_path(str(files[0]))
    data = mujoco.MjData(model)
    water = loaded(files[1]).install(model, data)
    try:
        water.current[:] = CURRENT * TURN
        commands = np.repeat(random_commands(vehicle, 6, seed=2), 50, axis=0)
        run = simulate(vehicle, commands=commands, dt=0.005, current=CURRENT)
        states = []
        for row in commands:
            water.command(row)
            mujoco.mj_step(model, data)
            states.append(data.qpos[:3] * TURN)
    finally:
        mujoco.set_mjcb_passive(None)
    assert np.abs(np.array(states) - np.column_stack([run[each].values[1:] for each in "xyz"])).max() <= 1e-7
