"""The Python file: the package's numbers without the package, in functions and in the loop of another simulator."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from tests.exporters.whole import random_commands, random_states, whole_vehicle

from towtank import export, forward_dynamics, inverse_dynamics, load_vehicle, simulate, thruster_wrench
from towtank.core.arrays import Array
from towtank.vehicle import Vehicle, allocate, thruster_forces

NAMES = ("rexrov", "bluerov2_heavy", "lauv", "vlbv300", "whole")
CURRENT = (0.3, -0.2, 0.1)


@cache
def vehicle_of(name: str) -> Vehicle:
    return whole_vehicle() if name == "whole" else load_vehicle(name)


def loaded(vehicle: Vehicle, folder: Path) -> ModuleType:
    """Return the module that is written for a vehicle."""
    path = export(vehicle, "python", folder / "written.py").files[0]
    specification = importlib.util.spec_from_file_location(f"written_{folder.name}", path)
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    assert specification.loader is not None
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def modules(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ModuleType]:
    return {name: loaded(vehicle_of(name), tmp_path_factory.mktemp(name)) for name in NAMES}


def class_of(module: ModuleType) -> Any:
    return next(each for each in vars(module).values() if hasattr(each, "stepInput"))


def apart(found: Array, expected: Array) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("name", NAMES)
def test_dynamics_are_those_of_the_package(modules: dict[str, ModuleType], name: str) -> None:
    vehicle, module = vehicle_of(name), modules[name]
    eta, nu, tau = random_states(vehicle, 20_000)
    assert apart(module.forward_dynamics(eta, nu, tau), forward_dynamics(vehicle, eta, nu, tau)) <= 1e-12
    assert apart(module.inverse_dynamics(eta, nu, tau), inverse_dynamics(vehicle, eta, nu, tau)) <= 1e-12
    assert np.abs(module.MODEL.M - vehicle.mass_matrix).max() <= 1e-12 * vehicle.mass_matrix.max()


@pytest.mark.parametrize("name", NAMES)
def test_thrusters_are_those_of_the_package(modules: dict[str, ModuleType], name: str) -> None:
    vehicle, module = vehicle_of(name), modules[name]
    commands = random_commands(vehicle, 5000)
    for voltage in (None, 14.2):
        found = module.wrench_of_forces(module.thruster_forces(commands, voltage), np.zeros(6))
        assert apart(found, thruster_wrench(vehicle, commands, voltage)) <= 1e-12
    assert np.isnan(module.thruster_forces(np.full(len(vehicle.thrusters), np.nan))).all()


@pytest.mark.parametrize("name", NAMES)
def test_allocation_is_that_of_the_package(modules: dict[str, ModuleType], name: str) -> None:
    vehicle, module = vehicle_of(name), modules[name]
    full = np.abs(thruster_wrench(vehicle, random_commands(vehicle, 500))).max(axis=0)
    wrenches = np.random.default_rng(5).uniform(-1.5, 1.5, (60, 6)) * full
    wrenches[0] = 0.0
    for voltage in (None, 14.2):
        found = np.array([module.allocate(tau, voltage) for tau in wrenches])
        forces = [thruster_wrench(vehicle, each, voltage) for each in (found, allocate(vehicle, wrenches, voltage))]
        assert np.abs(forces[0] - forces[1]).max() <= 1e-9 * np.abs(forces[1]).max()


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_that_of_the_simulator(modules: dict[str, ModuleType], name: str) -> None:
    vehicle, module = vehicle_of(name), modules[name]
    dt, commands = 0.02, np.repeat(random_commands(vehicle, 6, seed=2), 20, axis=0)
    run = simulate(vehicle, commands=commands, dt=dt, current=CURRENT, delay=0.0, voltage=15.0)
    eta, nu, forces = np.zeros(6), np.zeros(6), np.zeros(len(vehicle.thrusters))
    for k, row in enumerate(commands):
        eta, nu, forces = module.step(eta, nu, forces, row, dt, current=CURRENT, voltage=15.0)
        for i, axis in enumerate(("x", "y", "z")):
            assert abs(eta[i] - run[axis].values[k + 1]) <= 1e-9
        for i, axis in enumerate(("p", "q", "r")):
            assert abs(nu[3 + i] - run[axis].values[k + 1]) <= 1e-9
        for i, axis in enumerate(("phi", "theta", "psi")):
            away = eta[3 + i] - run[axis].values[k + 1]
            assert abs(np.angle(np.exp(1j * away))) <= 1e-6 or abs(eta[4]) > 1.5


def euler_loop(vehicle: Any, commands: Array, h: float) -> Array:
    """Go through commands (n, dimU) as the Python Vehicle Simulator does: the new velocity turns the pose."""
    eta, nu, u_actual = np.zeros(6), vehicle.nu, vehicle.u_actual
    out = []
    for u_control in commands:
        [nu, u_actual] = vehicle.dynamics(eta, nu, u_actual, u_control, h)
        (c1, c2, c3), (s1, s2, s3) = np.cos(eta[3:]), np.sin(eta[3:])
        turn = np.array([[c3 * c2, -s3, 0.0], [s3 * c2, c3, 0.0], [-s2, 0.0, 1.0]])  # world rates of the angles
        tilt = np.array([[1.0, 0.0, -s2], [0.0, c1, c2 * s1], [0.0, -s1, c2 * c1]])
        R = turn @ np.linalg.inv(tilt)
        eta = eta + h * np.concatenate([R @ nu[:3], np.linalg.solve(tilt, nu[3:])])
        out.append(np.concatenate([eta, nu]))
    return np.array(out)


@pytest.mark.parametrize(("name", "seconds"), [("lauv", 20.0), ("bluerov2_heavy", 6.0), ("rexrov", 6.0)])
def test_the_loop_of_the_python_vehicle_simulator_comes_nearer_with_its_step(
    modules: dict[str, ModuleType], name: str, seconds: float
) -> None:
    vehicle, made = vehicle_of(name), class_of(modules[name])
    away = []
    for h in (0.02, 0.01):
        ship = made("stepInput", V_current=0.3, beta_current=30)
        n = round(seconds / h)
        commands = np.array([ship.stepInput(k * h) for k in range(n)])
        current = 0.3 * np.array([np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 0.0])
        run = simulate(vehicle, commands=commands, dt=h, current=current, delay=0.0)
        found = euler_loop(ship, commands, h)
        away.append(max(np.abs(found[:, i] - run[each].values[1:]).max() for i, each in enumerate("xyz")))
    assert away[0] < 0.3  # of some 20 m
    assert 0.45 < away[1] / away[0] < 0.55


@pytest.mark.parametrize("name", NAMES)
def test_a_step_of_the_class_is_euler_with_the_model(modules: dict[str, ModuleType], name: str) -> None:
    """The water's velocity is taken off by the whole attitude, and put back as its derivative says."""
    vehicle, made = vehicle_of(name), class_of(modules[name])
    states, commands = random_states(vehicle, 50), random_commands(vehicle, 50)
    ship = made(V_current=0.4, beta_current=-70)
    h = 1e-3
    for eta, nu, row in zip(states.eta, states.nu, commands, strict=True):
        forces = thruster_forces(vehicle, row)
        new, actual = ship.dynamics(eta, nu, forces, row, h)
        (c1, c2, c3), (s1, s2, s3) = np.cos(eta[3:]), np.sin(eta[3:])
        roll = np.array([[1, 0, 0], [0, c1, -s1], [0, s1, c1]])
        pitch = np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
        yaw = np.array([[c3, -s3, 0], [s3, c3, 0], [0, 0, 1]])
        water = (yaw @ pitch @ roll).T @ (0.4 * np.array([np.cos(np.radians(-70)), np.sin(np.radians(-70)), 0]))
        relative = nu - np.array([*water, 0.0, 0.0, 0.0])
        B = modules[name].CONFIGURATION
        tau = B @ (forces - vehicle.coefficient("inflow_loss") * np.abs(forces) * (B.T @ relative))
        expected = forward_dynamics(vehicle, eta, relative, tau)
        expected[:3] -= np.cross(nu[3:], water)
        assert np.abs((new - nu) / h - expected).max() <= 1e-9 * max(1.0, np.abs(expected).max())
        assert np.abs(actual - forces).max() <= 1e-12 * max(1.0, np.abs(forces).max())


def test_the_class_has_what_the_python_vehicle_simulator_reads(modules: dict[str, ModuleType]) -> None:
    made = class_of(modules["bluerov2_heavy"])
    ship = made()
    assert (ship.name, ship.dimU, len(ship.controls)) == ("bluerov2_heavy", 8, 8)
    assert (ship.controlMode, ship.V_c, ship.beta_c) == ("stepInput", 0.0, 0.0)
    assert isinstance(ship.controlDescription, str)
    assert 0.2 < ship.L < 2.0
    assert ship.nu.shape == (6,)
    assert ship.u_actual.shape == (8,)
    assert np.abs(ship.M - ship.MRB - ship.MA).max() <= 1e-12
    with pytest.raises(ValueError, match="it has stepInput"):
        made("DPcontrol")


def test_parameters_can_be_changed_and_wrong_ones_are_refused(modules: dict[str, ModuleType]) -> None:
    module, vehicle = modules["whole"], vehicle_of("whole")
    changes = {"X_uu": -30.0, "Y_uv": 3.0, "N_0": 0.5, "K_p2": 0.2, "X_wdot": 0.3, "BG_z": 9.0}
    eta, nu, tau = random_states(vehicle, 100)
    found = module.forward_dynamics(eta, nu, tau, module.prepare({**module.PARAMETERS, **changes}))
    assert apart(found, forward_dynamics(vehicle.with_coefficients(changes), eta, nu, tau)) <= 1e-12
    for name in ("X_uuu", "Q_u", "X_", "X_v2", "Y_vw", "x_G2", "X_udott"):
        with pytest.raises(ValueError, match=f'"{name}" is not a parameter'):
            module.prepare({**module.PARAMETERS, name: 1.0})
    with pytest.raises(ValueError, match="not positive definite"):
        module.prepare({**module.PARAMETERS, "m": -50.0})


def test_without_thrusters_a_wrench_drives_it(tmp_path: Path) -> None:
    vehicle = vehicle_of("lauv").model_copy(update={"thrusters": ()})
    module = loaded(vehicle, tmp_path)
    ship = class_of(module)()
    assert ship.controls == list("XYZKMN")
    tau = np.array([5.0, 0.0, 1.0, 0.0, 0.1, 0.0])
    nu, actual = ship.dynamics(np.zeros(6), np.zeros(6), ship.u_actual, tau, 0.01)
    assert np.abs(nu - 0.01 * forward_dynamics(vehicle, np.zeros(6), np.zeros(6), tau)).max() <= 1e-15
    assert np.array_equal(actual, tau)
    eta, nu, forces = module.step(np.zeros(6), np.zeros(6), np.zeros(0), np.zeros(0), 0.01, wrench=tau)
    run = simulate(vehicle, wrench=tau[None, :], dt=0.01)
    assert abs(eta[0] - run["x"].values[1]) <= 1e-15
    assert forces.shape == (0,)


def test_it_runs_alone_and_finds_its_own_numbers(tmp_path: Path) -> None:
    path = export(vehicle_of("whole"), "python", tmp_path / "a.py").files[0]
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import a; print(a.self_test(), 'towtank' in sys.modules)"
    )
    said = subprocess.run([sys.executable, "-I", "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert float(said[0]) <= 1e-13
    assert said[1] == "False"
    tmp_path.joinpath("b.py").write_text(path.read_text().replace('"m": 18.6,', '"m": 18.7,'))
    code = code.replace("import a; print(a.", "import b; print(b.")
    said = subprocess.run([sys.executable, "-I", "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert float(said[0]) > 1e-4


def test_files_are_the_same_each_time_and_open_with_the_model(tmp_path: Path) -> None:
    first, second = (export("vlbv300", "python", tmp_path / f"{k}.py").files[0] for k in "ab")
    assert first.read_bytes() == second.read_bytes()
    assert first.read_text().splitlines()[:2] == ["# towtank: python numpy", "# vehicle: vlbv300"]
    assert max(len(line) for line in first.read_text().splitlines()) <= 120


@pytest.mark.parametrize("name", ["step", "np", "Model", "class", "9 lives"])
def test_a_name_that_is_a_word_of_the_program_gets_another(name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of("lauv").model_copy(update={"name": name})
    module = loaded(vehicle, tmp_path)
    assert module.self_test() <= 1e-13
    assert class_of(module)().name == name
