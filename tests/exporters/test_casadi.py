"""The CasADi module: its formulas run on NumPy as they stand, and the real thing where CasADi is installed."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.exporters.reference import (
    derivative,
    random_full_states,
    rate_of_commands,
    rate_of_wrench,
    wrench_of_forces,
)
from tests.exporters.whole import random_commands, random_states, whole_vehicle

from towtank import export, forward_dynamics, load_vehicle, simulate
from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.exporters.heading import heading_of
from towtank.exporters.programs.c99 import FIELDS, values_of
from towtank.vehicle import Vehicle, thruster_forces

NAMES = ("rexrov", "bluerov2_heavy", "lauv", "vlbv300", "whole")


@cache
def vehicle_of(name: str) -> Vehicle:
    return (whole_vehicle() if name == "whole" else load_vehicle(name)).model_copy(update={"command_delay": 0.0})


def text_of(vehicle: Vehicle, folder: Path) -> str:
    return export(vehicle, "casadi", folder / "model.py").files[0].read_text()


# -- without CasADi: the same lines of the module, on numbers


def stacked(*parts: Any) -> Array:
    arrays = [np.asarray(each, dtype=np.float64) for each in parts]
    if any(each.ndim == 2 for each in arrays):
        return np.vstack(arrays)
    return np.concatenate([np.atleast_1d(each) for each in arrays]) if arrays else np.zeros(0)


def beside(*parts: Any) -> Array:
    arrays = [np.asarray(each, dtype=np.float64) for each in parts]
    return np.hstack(arrays) if arrays[0].ndim == 2 else np.array([arrays])


NUMBERS = SimpleNamespace(
    DM=SimpleNamespace(zeros=np.zeros),
    SX=SimpleNamespace(eye=np.eye, zeros=lambda *shape: np.zeros(shape)),
    vertcat=stacked,
    horzcat=beside,
    skew=lambda a: np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]]),
    cross=np.cross,
    dot=np.dot,
    fabs=np.abs,
    sqrt=np.sqrt,
    norm_2=np.linalg.norm,
    if_else=lambda condition, there, otherwise: there if condition else otherwise,
)


def on_numbers(vehicle: Vehicle, folder: Path) -> dict[str, Any]:
    """The module's own functions, before any casadi.Function is made of them."""
    text = text_of(vehicle, folder).split("\n_MADE = ")[0].replace("import casadi as ca\n", "")
    text = text.replace("CONFIGURATION = ca.DM(", "CONFIGURATION = np.array(")
    names: dict[str, Any] = {"ca": NUMBERS, "np": np}
    exec(compile(text, "model.py", "exec"), names)
    return names


@pytest.mark.parametrize("name", NAMES)
def test_its_formulas_are_those_of_the_package(name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    module = on_numbers(vehicle, tmp_path)
    p, current = module["DEFAULTS"], np.array([0.3, -0.2, 0.1])
    x, _ = random_full_states(vehicle, 40)
    u = random_commands(vehicle, 40, seed=3)
    assert np.abs(module["_mass"](p) - vehicle.mass_matrix).max() <= 1e-12 * vehicle.mass_matrix.max()
    for voltage in (None, 14.2):
        expected = rate_of_commands(vehicle, x, u, np.tile(current, (40, 1)), voltage)
        found = np.array([module["_rate"](p, *row, current, voltage or 0.0) for row in zip(x, u, strict=True)])
        assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max()


def test_its_step_is_that_of_the_simulator(tmp_path: Path) -> None:
    vehicle = without_lag(vehicle_of("whole"))
    module = on_numbers(vehicle, tmp_path)
    commands, dt, current = np.repeat(random_commands(vehicle, 5, seed=2), 10, axis=0), 0.02, np.array([0.3, -0.2, 0.1])
    x, states = start(current), []
    for row in commands:
        x = module["_step"](module["DEFAULTS"], x, row, dt, current, 0.0)
        states.append(x)
    assert far(np.array(states), vehicle, commands, dt, current) <= 1e-11


def without_lag(vehicle: Vehicle) -> Vehicle:
    thrusters = tuple(each.model_copy(update={"time_constant": 0.0}) for each in vehicle.thrusters)
    return vehicle.model_copy(update={"thrusters": thrusters})


def start(current: Array) -> Array:
    return np.concatenate([np.zeros(3), [1.0, 0.0, 0.0, 0.0], -current, np.zeros(3)])


def far(states: Array, vehicle: Vehicle, commands: Array, dt: float, current: Array) -> float:
    """The largest difference of positions and angular rates from the simulator."""
    run = simulate(vehicle, commands=commands, dt=dt, current=current)
    columns = dict(zip("xyzpqr", (0, 1, 2, 10, 11, 12), strict=True))
    return max(float(np.abs(states[:, k] - run[name].values[1:]).max()) for name, k in columns.items())


# -- the text


def test_parameters_have_their_names_and_values(tmp_path: Path) -> None:
    vehicle = vehicle_of("whole")
    module = on_numbers(vehicle, tmp_path)
    assert tuple(module["DEFAULTS"]) == FIELDS
    assert module["DEFAULTS"] == values_of(vehicle)
    with pytest.raises(ValueError, match="X_uuu: no parameter"):
        module["parameters"](X_uuu=1.0)


def test_the_same_model_gives_the_same_text_that_compiles(tmp_path: Path) -> None:
    for name in (*NAMES, "seamor"):
        vehicle = load_vehicle(name) if name == "seamor" else vehicle_of(name)
        text = text_of(vehicle, tmp_path)
        assert text == text_of(vehicle, tmp_path)
        assert "@" not in "".join(line for line in text.splitlines() if " @ " not in line)
        compile(text, "model.py", "exec")
        heading = heading_of(text)
        assert heading is not None
        assert heading.title == "casadi 3.8"
        assert heading.missing == ()


def test_a_vehicle_without_thrusters_takes_a_wrench(tmp_path: Path) -> None:
    vehicle = vehicle_of("lauv").model_copy(update={"thrusters": ()})
    text = text_of(vehicle, tmp_path)
    assert "The input u is the wrench" in text
    assert "thruster_forces(u, voltage)" not in text
    module = on_numbers(vehicle, tmp_path)
    eta, nu, tau = random_states(vehicle, 1)
    x = np.concatenate([eta[0, :3], quaternions_from_eulers(eta[:, 3:].copy())[0], nu[0]])
    found = module["_rate"](module["DEFAULTS"], x, tau[0], np.zeros(3), 0.0)
    assert np.abs(found[7:] - forward_dynamics(vehicle, eta, nu, tau)[0]).max() <= 1e-12


# -- with CasADi


def module_of(vehicle: Vehicle, folder: Path) -> ModuleType:
    """The module as it is imported; the test is skipped without CasADi."""
    pytest.importorskip("casadi", reason="CasADi is not installed; `make engines` has it")
    spec = importlib.util.spec_from_file_location(
        "model_of_casadi", export(vehicle, "casadi", folder / "m.py").files[0]
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", NAMES)
def test_functions_and_derivatives_are_those_of_the_package(name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    module = module_of(vehicle, tmp_path)
    n = 30
    (x, steps), u = random_full_states(vehicle, n), random_commands(vehicle, n, seed=3)
    still, p = np.zeros((n, 3)), module.parameters()

    def mapped(function: Any, *inputs: Array) -> Array:
        return np.array([np.array(function(*row)).ravel() for row in zip(*inputs, strict=True)])

    assert np.abs(mapped(module.f, x, u) - rate_of_commands(vehicle, x, u, still)).max() <= 1e-9
    tau = random_states(vehicle, n).tau
    current = np.tile([0.3, -0.2, 0.1], (n, 1))
    found = np.array([np.array(module.dynamics(*row, p)).ravel() for row in zip(x[:, :13], tau, current, strict=True)])
    assert np.abs(found - rate_of_wrench(vehicle, x, tau, current)).max() <= 1e-9
    assert np.abs(mapped(module.thruster_forces, u, np.zeros(n)) - thruster_forces(vehicle, u)).max() <= 1e-9
    forces = thruster_forces(vehicle, u)
    pushed = np.array(
        [np.array(module.wrench_of_forces(*row, p)).ravel() for row in zip(x[:, 7:13], forces, strict=True)]
    )
    assert np.abs(pushed - wrench_of_forces(vehicle, x[:, 7:13], forces)).max() <= 1e-9

    slopes = derivative(lambda at: rate_of_commands(vehicle, at, u, still), x, steps)
    for k in range(n):
        A, _ = module.jacobian(x[k], u[k])
        assert np.abs(np.array(A) - slopes[k]).max() <= 1e-9 * max(1.0, np.abs(slopes[k]).max())


def test_parameters_change_the_motion_as_the_vehicle_changes(tmp_path: Path) -> None:
    vehicle = vehicle_of("whole")
    module = module_of(vehicle, tmp_path)
    eta, nu, tau = random_states(vehicle, 1)
    q = quaternions_from_eulers(eta[:, 3:].copy())
    other = vehicle.with_coefficients({"X_uu": -30.0, "Y_uv": 3.0, "N_0": 0.5, "Z_qdot": 0.3})
    found = module.forward_dynamics(q[0], nu[0], tau[0], module.parameters(X_uu=-30.0, Y_uv=3.0, N_0=0.5, Z_qdot=0.3))
    assert np.abs(np.array(found).ravel() - forward_dynamics(other, eta, nu, tau)[0]).max() <= 1e-9
