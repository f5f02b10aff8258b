"""The function file in the form of MSS: what it says, and the package's numbers from GNU Octave where that is there."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.io import loadmat, savemat
from tests.exporters.whole import random_commands, random_states, whole_vehicle

from towtank import export, forward_dynamics, load_vehicle
from towtank.core.arrays import Array
from towtank.core.attitude import euler_rates_matrix, quaternions_from_eulers, rotation_from_euler
from towtank.exporters.programs.mss import function_text, matrices_of
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

NAMES = ("rexrov", "bluerov2_heavy", "lauv", "vlbv300", "whole")
OCTAVE = shutil.which("octave-cli")
VC, BETA, WC, VOLTAGE = 0.4, -1.1, 0.15, 14.2
SCRIPT = """
load('given.mat');
n = rows(X);
still = zeros(n, 12); flowing = zeros(n, 12); turned = zeros(n, 13); speed = zeros(n, 1); late = zeros(n, columns(C));
for k = 1:n
    still(k, :) = model(X(k, :), C(k, :));
    [flowing(k, :), speed(k)] = model(X(k, :)', C(k, :)', Vc, betaVc, w_c, [], voltage);
    q = [X(k, 1:9), Q(k, :)];
    [turned(k, :), ~, M, B, f_dot] = model(q, C(k, :), Vc, betaVc, w_c, f(k, :));
    late(k, 1:numel(f_dot)) = f_dot;
end
[~, ~, M0, B0] = model();
nothing = model(NaN(12, 1), NaN(columns(C), 1));
save('-v6', 'found.mat', 'still', 'flowing', 'turned', 'speed', 'late', 'M', 'B', 'M0', 'B0', 'nothing');
"""


@cache
def vehicle_of(name: str) -> Vehicle:
    if name == "bare":
        return load_vehicle("lauv").model_copy(update={"thrusters": ()})
    return whole_vehicle() if name == "whole" else load_vehicle(name)


class Case(NamedTuple):
    """States (n, 6) each, commands (n, m) and forces (n, m) that act."""

    eta: Array
    nu: Array
    commands: Array
    forces: Array


def case_of(vehicle: Vehicle, count: int = 120) -> Case:
    eta, nu, tau = random_states(vehicle, count)
    if not vehicle.thrusters:
        return Case(eta, nu, tau, np.zeros((count, 0)))
    commands = random_commands(vehicle, count)
    return Case(eta, nu, commands, thruster_forces(vehicle, np.roll(commands, 1, axis=0)))


def rates(vehicle: Vehicle, case: Case, forces: Array | None, water_ned: Array) -> Array:
    """Return the package's derivative (n, 12) of x in the order of MSS; forces None: the commands are wrenches."""
    out = np.empty((len(case.eta), 12))
    for k, (eta, nu) in enumerate(zip(case.eta, case.nu, strict=True)):
        R = rotation_from_euler(*eta[3:])
        water = np.concatenate([R.T @ water_ned, np.zeros(3)])
        if forces is None:
            tau = case.commands[k]
        else:
            B = configuration_matrix(vehicle)
            inflow = B.T @ (nu - water)
            tau = B @ (forces[k] - vehicle.coefficient("inflow_loss") * np.abs(forces[k]) * inflow)
        nu_dot = forward_dynamics(vehicle, eta, nu - water, tau)
        nu_dot[:3] -= np.cross(nu[3:], water[:3])
        out[k] = np.concatenate([nu_dot, R @ nu[:3], euler_rates_matrix(eta[3], eta[4]) @ nu[3:]])
    return out


def apart(found: Array, expected: Array) -> float:
    """The largest difference of a column, as a share of its largest number."""
    return float(np.max(np.abs(found - expected).max(axis=0) / (1.0 + np.abs(expected).max(axis=0))))


@pytest.mark.skipif(OCTAVE is None, reason="no GNU Octave")
@pytest.mark.parametrize("name", [*NAMES, "bare"])
def test_octave_gives_the_numbers_of_the_package(name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    case = case_of(vehicle)
    function = function_text(vehicle)
    word = re.match(r"function \[.*?\] = (\w+)\(", function)
    assert word is not None
    tmp_path.joinpath("model.m").write_text(re.sub(rf"\b{word[1]}\b", "model", function))
    given = {"X": np.hstack([case.nu, case.eta]), "Q": quaternions_from_eulers(np.ascontiguousarray(case.eta[:, 3:]))}
    given |= {"C": case.commands, "f": case.forces, "Vc": VC, "betaVc": BETA, "w_c": WC, "voltage": VOLTAGE}
    savemat(tmp_path / "given.mat", given)
    tmp_path.joinpath("run_all.m").write_text(SCRIPT)
    run = subprocess.run(
        [str(OCTAVE), "--norc", "--quiet", "run_all.m"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert tmp_path.joinpath("found.mat").exists(), run.stderr
    found = loadmat(tmp_path / "found.mat")
    flow = np.array([VC * np.cos(BETA), VC * np.sin(BETA), WC])
    steady = (
        [None, None] if not vehicle.thrusters else [thruster_forces(vehicle, case.commands, v) for v in (None, VOLTAGE)]
    )
    assert apart(found["still"], rates(vehicle, case, steady[0], np.zeros(3))) <= 1e-12
    assert apart(found["flowing"], rates(vehicle, case, steady[1], flow)) <= 1e-12
    lag = np.array([each.time_constant for each in vehicle.thrusters])
    acting = None if steady[0] is None else np.where(lag > 0.0, case.forces, steady[0])
    expected = rates(vehicle, case, acting, flow)
    assert apart(found["turned"][:, :9], expected[:, :9]) <= 1e-12
    q, p = given["Q"], case.nu[:, 3:]
    turning = np.column_stack([-(q[:, 1:] * p).sum(axis=1), q[:, :1] * p + np.cross(q[:, 1:], p)])
    assert np.abs(found["turned"][:, 9:] - 0.5 * turning).max() <= 1e-14
    assert np.abs(found["speed"][:, 0] - np.linalg.norm(case.nu[:, :3], axis=1)).max() <= 1e-14
    for key in ("M", "M0"):
        assert np.abs(found[key] - vehicle.mass_matrix).max() <= 1e-12 * vehicle.mass_matrix.max()
    assert np.isnan(found["nothing"][:9]).all()
    if steady[0] is not None:
        assert np.abs(found["B"] - configuration_matrix(vehicle)).max() == 0.0
        slope = np.divide(steady[0] - case.forces, lag, out=np.zeros_like(case.forces), where=lag > 0.0)
        assert apart(found["late"], slope) <= 1e-12


@pytest.mark.parametrize("name", NAMES)
def test_the_matrices_are_the_model(name: str) -> None:
    """Put together by hand, they give the package's wrench."""
    vehicle = vehicle_of(name)
    of = matrices_of(vehicle)
    eta, nu, tau = random_states(vehicle, 200)
    for pose, v, push in zip(eta, nu, tau, strict=True):
        h = (of["MRB"] + of["MA"]) @ v
        coriolis = np.concatenate([np.cross(v[3:], h[:3]), np.cross(v[:3], h[:3]) + np.cross(v[3:], h[3:])])
        k = rotation_from_euler(*pose[3:])[2]
        g = -np.concatenate([of["W_minus_B"] * k, np.cross(of["BG"], k)])
        drag = of["D"] @ v + of["Dn"] @ (np.abs(v) * v) - v[0] * (of["F"] @ v) - of["A"] * v * v
        nu_dot = np.linalg.solve(of["MRB"] + of["MA"], push + of["tau_0"] - coriolis - drag - g)
        expected = forward_dynamics(vehicle, pose, v, push)
        assert np.abs(nu_dot - expected).max() <= 1e-11 * max(1.0, np.abs(expected).max())


def test_files_are_the_same_each_time_and_open_with_the_model(tmp_path: Path) -> None:
    first, second = (export("vlbv300", "mss", tmp_path / f"{k}.m").files[0] for k in "ab")
    assert first.read_bytes() == second.read_bytes()
    lines = first.read_text().splitlines()
    assert lines[:2] == ["% towtank: mss octave", "% vehicle: vlbv300"]
    assert next(line for line in lines if not line.startswith("%") and line).startswith(
        "function [xdot, U, M, B, f_dot]"
    )


@pytest.mark.parametrize("name", [*NAMES, "bare"])
def test_blocks_of_the_program_end(name: str) -> None:
    """Without an engine: every function and block has its end, brackets match, and no mark of the template is left."""
    text = re.sub(r"%.*|'[^'\n]*'(?=[,)])", "", function_text(vehicle_of(name)))
    words = re.findall(r"(?<![\w(])(function|if|for|switch|end)\b(?!\))", text)
    assert words.count("end") == len(words) - words.count("end")
    for pair in ("()", "[]", "{}"):
        assert text.count(pair[0]) == text.count(pair[1])
    assert not re.search(r"@\w+@", text)
    assert text.isascii()


@pytest.mark.parametrize("name", ["cross3", "while", "end", "lag", "4 thrusters"])
def test_a_name_that_is_a_word_of_the_program_gets_another(name: str) -> None:
    text = function_text(vehicle_of("lauv").model_copy(update={"name": name}))
    word = re.match(r"function \[.*?\] = (\w+)\(", text)
    assert word is not None
    assert word[1].endswith("_vehicle") or word[1] == "v_4_thrusters"
