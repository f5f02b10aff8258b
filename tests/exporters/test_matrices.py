"""The model to first order, as a .mat file and as a Python file: derivatives, trims, and what the files say."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat
from tests.exporters.whole import whole_vehicle

from towtank import InputError, export, forward_dynamics, load_vehicle
from towtank.core.arrays import Array
from towtank.core.attitude import euler_rates_matrix, rotation_from_euler
from towtank.exporters.programs.matrices import STATES, Linear, linearised
from towtank.vehicle import Posterior, Vehicle, configuration_matrix, thruster_forces

NAMES = ("rexrov", "bluerov2_heavy", "lauv", "vlbv300", "whole")
SPEEDS = (0.0, 0.5, -0.3)
OCTAVE = shutil.which("octave-cli")


@cache
def vehicle_of(name: str) -> Vehicle:
    return whole_vehicle() if name == "whole" else load_vehicle(name)


def rate(vehicle: Vehicle, x: Array, forces: Array, wrench: Array) -> Array:
    """Return the package's derivative of x = [eta; nu] by forces of the thrusters and a wrench."""
    eta, nu = x[:6], x[6:]
    B = configuration_matrix(vehicle)
    tau = wrench + B @ (forces - vehicle.coefficient("inflow_loss") * np.abs(forces) * (B.T @ nu))
    position = rotation_from_euler(*eta[3:]) @ nu[:3]
    angles = euler_rates_matrix(eta[3], eta[4]) @ nu[3:]
    return np.concatenate([position, angles, forward_dynamics(vehicle, eta, nu, tau)])


def differences(function: Any, count: int) -> Array:
    """Return the derivative at 0 of a function of (count,) by central differences of three widths.

    Terms of the first and second power of the width go out: |nu| nu makes the first, all that is smooth the second.
    """
    columns = []
    for j in range(count):
        found = []
        for h in (2e-3, 1e-3, 5e-4):
            step = h * np.eye(count)[j]
            found.append((function(step) - function(-step)) / (2.0 * h))
        columns.append((found[0] - 6.0 * found[1] + 8.0 * found[2]) / 3.0)
    return np.array(columns).T


def trim_of(linear: Linear) -> Array:
    x = np.zeros(12)
    x[6] = linear.speed
    return x


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_package(name: str, speed: float) -> None:
    vehicle, linear = vehicle_of(name), linearised(vehicle_of(name), speed)
    x, forces, none, still = trim_of(linear), linear.forces, np.zeros(6), np.zeros(len(linear.forces))
    found = {
        "A": differences(lambda d: rate(vehicle, x + d, forces, linear.rest), 12),
        "B": differences(lambda d: rate(vehicle, x, forces + d, linear.rest), len(forces)),
        "A_wrench": differences(lambda d: rate(vehicle, x + d, still, linear.wrench), 12),
        "B_wrench": differences(lambda d: rate(vehicle, x, still, linear.wrench + d), 6),
    }
    for key, expected in found.items():
        away = np.abs(getattr(linear, key) - expected).max()
        assert away <= 1e-9 * max(1.0, np.abs(expected).max()), key
    assert np.abs(rate(vehicle, x, forces, linear.rest)[6:]).max() <= 1e-12 * (1.0 + np.abs(forces).max())
    assert np.abs(rate(vehicle, x, still, linear.wrench)[6:]).max() <= 1e-12 * (1.0 + np.abs(forces).max())
    assert rate(vehicle, x, forces, linear.rest)[:6] == pytest.approx([speed, *none[1:]], abs=0.0)


def test_commands_of_the_trim_make_its_forces() -> None:
    vehicle = vehicle_of("bluerov2_heavy")
    linear = linearised(vehicle, 0.5)
    assert linear.beyond == ()
    assert np.abs(thruster_forces(vehicle, linear.commands) - linear.forces).max() <= 1e-6
    assert not linear.rest.any()


def test_a_trim_that_cannot_be_had_is_said(tmp_path: Path) -> None:
    done = export("bluerov2_heavy", "matlab", tmp_path / "a.mat", at_speed=5.0)
    assert any("more than these thrusters can do: hor_front" in line for line in done.heading.missing)
    done = export("lauv", "matlab", tmp_path / "a.mat", at_speed=1.0)
    [said] = [line for line in done.heading.missing if "which they cannot make" in line]
    assert "Z " in said
    assert "Y " not in said
    weak = vehicle_of("lauv").with_coefficients({"inflow_loss": 0.4})
    with pytest.raises(InputError, match=r"--at-speed: at 3 m/s the thruster .* has lost all its thrust"):
        export(weak, "state-space", tmp_path / "a.py", at_speed=3.0)


def loaded(path: Path) -> ModuleType:
    specification = importlib.util.spec_from_file_location("written_linear", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", NAMES)
def test_the_python_file_has_the_matrices(name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    path = export(vehicle, "state-space", tmp_path / "a.py", at_speed=0.5).files[0]
    module, linear = loaded(path), linearised(vehicle, 0.5)
    A, B, C, D = module.matrices("wrench")
    for found, expected in (
        (module.A, linear.A),
        (module.B, linear.B),
        (A, linear.A_wrench),
        (B, linear.B_wrench),
    ):
        assert np.abs(found - expected).max() <= 1e-14 * np.abs(expected).max()
    assert np.array_equal(C, np.eye(12))
    assert D.shape == (12, 6)
    assert tuple(module.STATES) == STATES
    assert len(module.STATE_UNITS) == 12
    assert len(module.INPUTS["forces"]) == len(vehicle.thrusters) == len(module.TRIM_COMMANDS)
    assert np.array_equal(module.TRIM_FORCES, linear.forces)
    with pytest.raises(ValueError, match='found "thrust", expected forces or wrench'):
        module.matrices("thrust")
    lines = path.read_text().splitlines()
    assert lines[0] == "# towtank: state-space python-control"
    assert max(len(line) for line in lines if not line.startswith("# ")) <= 120
    first, second = (export(vehicle, "state-space", tmp_path / f"{k}.py", at_speed=0.5).files[0] for k in "bc")
    assert first.read_bytes() == second.read_bytes() == path.read_bytes()


def test_the_python_file_needs_no_python_control(tmp_path: Path) -> None:
    path = export("lauv", "state-space", tmp_path / "plant.py").files[0]
    code = (
        f"import sys; sys.path.insert(0, {str(path.parent)!r}); sys.modules['control'] = None; import plant;"
        " print(plant.A[0, 6])"
    )
    said = subprocess.run([sys.executable, "-I", "-c", code], check=True, capture_output=True, text=True).stdout
    assert float(said) == 1.0


def test_python_control_takes_it(tmp_path: Path) -> None:
    pytest.importorskip("control", reason="python-control is not installed")
    module = loaded(export("bluerov2_heavy", "state-space", tmp_path / "a.py", at_speed=0.5).files[0])
    plant = module.state_space()
    assert plant.state_labels == list(STATES)
    assert plant.input_labels == module.INPUTS["forces"]
    assert np.array_equal(plant.A, module.A)


def test_without_thrusters_the_input_is_the_wrench(tmp_path: Path) -> None:
    bare = vehicle_of("lauv").model_copy(update={"thrusters": ()})
    module = loaded(export(bare, "state-space", tmp_path / "a.py", at_speed=1.0).files[0])
    assert module.B.shape == (12, 6)
    with pytest.raises(ValueError, match="expected wrench"):
        module.matrices("forces")
    read = loadmat(export(bare, "matlab", tmp_path / "a.mat", at_speed=1.0).files[0], simplify_cells=True)
    assert list(read["linear"]["inputs"]) == list("XYZKMN")
    assert np.array_equal(read["linear"]["B"], module.B)


def test_what_is_left_is_damping_by_its_tangent(tmp_path: Path) -> None:
    """By the forces of the trim, the kept vehicle moves as the whole one does, to first order in the velocity."""
    vehicle, linear = vehicle_of("whole"), linearised(vehicle_of("whole"), 0.5)
    kept = export(vehicle, "state-space", tmp_path / "a.py", at_speed=0.5).kept.vehicle
    x = trim_of(linear)
    for j in range(6):
        for h in (0.0, 1e-3, -1e-3):
            other = x + h * np.eye(12)[6 + j]
            away = rate(kept, other, linear.forces, linear.rest) - rate(vehicle, other, linear.forces, linear.rest)
            assert np.abs(away).max() <= 10.0 * h * h + 1e-12  # |nu| nu is h^2 times its coefficient


# -- the .mat file


def with_posterior() -> Vehicle:
    vehicle = load_vehicle("lauv")
    names = ("X_u", "X_uu", "N_r", "delay")
    mean = [*(vehicle.coefficient(name) for name in names[:3]), 0.1]
    root = np.random.default_rng(2).standard_normal((4, 4))
    posterior = Posterior.from_covariance(names, mean, root @ root.T * 1e-3, [10.0] * 4)
    return vehicle.model_copy(update={"posterior": posterior})


def test_a_mat_file_comes_back(tmp_path: Path) -> None:
    vehicle = with_posterior()
    path = export(vehicle, "matlab", tmp_path / "a.mat", at_speed=1.5).files[0]
    read = loadmat(path, simplify_cells=True)
    assert read["heading"].startswith("towtank: matlab 5\nvehicle: lauv\nsource: ")
    assert np.array_equal(read["model"]["M"], vehicle.mass_matrix)
    assert np.array_equal(read["model"]["MA"], vehicle.added_mass_matrix)
    assert read["model"]["Dn"][0, 0] == -vehicle.coefficient("X_uu")
    assert read["coefficients"]["X_udot"] == vehicle.coefficient("X_udot")
    assert read["units"]["X_udot"] == "kg"
    assert set(read["std"]) == set(read["coefficients"])
    posterior = vehicle.posterior
    assert posterior is not None
    assert list(read["posterior"]["names"]) == list(posterior.names)
    assert np.array_equal(read["posterior"]["covariance"], posterior.covariance)
    assert np.array_equal(read["posterior"]["mean"], posterior.mean)
    linear = linearised(vehicle, 1.5)
    assert np.array_equal(read["linear"]["A"], linear.A)
    assert list(read["linear"]["states"]) == list(STATES)
    assert read["linear"]["speed"] == 1.5
    assert read["command_delay"] == vehicle.command_delay


@pytest.mark.parametrize("name", NAMES)
def test_a_mat_file_has_every_thruster(name: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    read = loadmat(export(vehicle, "matlab", tmp_path / "a.mat").files[0])
    assert read["thrusters"].shape == (1, len(vehicle.thrusters))
    for each, cell in zip(vehicle.thrusters, read["thrusters"][0], strict=True):
        [[entry]] = cell
        assert entry["name"][0] == each.name
        assert np.array_equal(entry["position"].ravel(), each.position)
        [[curve]] = entry["curve"]
        assert curve["kind"][0] in ("branches", "polynomial", "table", "quadratic")
        limits = () if each.curve.limits is None else each.curve.limits
        assert np.array_equal(curve["limits"].ravel(), limits)
    assert read["posterior"]["covariance"][0, 0].shape == (0, 0)
    assert float(read["linear"]["speed"][0, 0][0, 0]) == 0.0


def test_a_mat_file_has_the_same_bytes_each_time(tmp_path: Path) -> None:
    first, second = (export("vlbv300", "matlab", tmp_path / f"{k}.mat").files[0] for k in "ab")
    assert first.read_bytes() == second.read_bytes()
    head = first.read_bytes()[:128]
    assert head[:116].rstrip() == b"MATLAB 5.0 MAT-file, a vehicle model written by towtank"
    assert head[124:] in (b"\x00\x01IM", b"\x01\x00MI")


@pytest.mark.skipif(OCTAVE is None, reason="no GNU Octave")
def test_octave_reads_a_mat_file(tmp_path: Path) -> None:
    export(vehicle_of("whole"), "matlab", tmp_path / "a.mat", at_speed=0.5)
    script = (
        "s = load('a.mat'); printf('%d %s %.17g %s', numel(s.thrusters), s.thrusters{4}.curve.kind,"
        " s.linear.A(7, 7), s.linear.inputs{2});"
    )
    run = subprocess.run(
        [str(OCTAVE), "--norc", "--quiet", "--eval", script], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    count, kind, number, name = run.stdout.split()
    assert (int(count), kind, name) == (6, "table", "force_ahead_2")
    assert float(number) == linearised(vehicle_of("whole"), 0.5).A[6, 6]
