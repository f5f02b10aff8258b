"""The C header: the same numbers as the package, from several compilers, in double and in float."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.exporters.compiled import COMPILERS, STRICT, Compiled, built, has
from tests.exporters.whole import random_commands, random_states, whole_vehicle

from towtank import InputError, export, forward_dynamics, inverse_dynamics, load_vehicle, simulate, thruster_wrench
from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.exporters.programs.c99 import FIELDS, prefix_of
from towtank.vehicle import COEFFICIENTS, Vehicle, allocate, index

pytestmark = pytest.mark.skipif(not has("gcc"), reason="no C compiler")
NAMES = ("rexrov", "bluerov2_heavy", "lauv", "vlbv300", "whole")
MANY = 20_000


@cache
def vehicle_of(name: str) -> Vehicle:
    return whole_vehicle() if name == "whole" else load_vehicle(name)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, bool], Compiled]:
    made = {}
    for name in NAMES:
        for single in (False, True):
            library = built(vehicle_of(name), tmp_path_factory.mktemp(name), single=single, level="-O1")
            made[name, single] = Compiled(library, single=single)
    return made


def relative(found: Array, expected: Array) -> float:
    """The largest error of a row, as a share of the row's largest number of those alike (forces, moments)."""
    worst = 0.0
    for part in (slice(0, 3), slice(3, 6)):
        scale = np.abs(expected[:, part]).max(axis=1, keepdims=True) + np.abs(expected).mean()
        worst = max(worst, float(np.max(np.abs(found[:, part] - expected[:, part]) / scale)))
    return worst


@pytest.mark.parametrize(("single", "bound"), [(False, 1e-12), (True, 1e-4)])
@pytest.mark.parametrize("name", NAMES)
def test_dynamics_are_those_of_the_package(
    compiled: dict[tuple[str, bool], Compiled], name: str, single: bool, bound: float
) -> None:
    vehicle, library = vehicle_of(name), compiled[name, single]
    eta, nu, tau = random_states(vehicle, MANY)
    q = quaternions_from_eulers(np.ascontiguousarray(eta[:, 3:]))
    expected = forward_dynamics(vehicle, eta, nu, tau)
    assert relative(library.call("forward", [q, nu, tau], 6)[0], expected) <= bound
    wrench = inverse_dynamics(vehicle, eta, nu, tau / 10.0)
    assert relative(library.call("inverse", [q, nu, tau / 10.0], 6)[0], wrench) <= bound


@pytest.mark.parametrize("name", NAMES)
def test_thrusters_are_those_of_the_package(compiled: dict[tuple[str, bool], Compiled], name: str) -> None:
    vehicle, library = vehicle_of(name), compiled[name, False]
    commands = random_commands(vehicle, 5000)
    for voltage in (None, 14.2):
        found = library.call("wrenches", [commands, voltage or 0.0], 6)[0]
        expected = thruster_wrench(vehicle, commands, voltage)
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("name", NAMES)
def test_allocation_is_that_of_the_package(compiled: dict[tuple[str, bool], Compiled], name: str) -> None:
    vehicle, library = vehicle_of(name), compiled[name, False]
    chance = np.random.default_rng(5)
    full = np.abs(thruster_wrench(vehicle, random_commands(vehicle, 500))).max(axis=0)
    wrenches = chance.uniform(-1.5, 1.5, (1500, 6)) * full
    wrenches[0] = 0.0
    for voltage in (None, 14.2):
        found = library.call("allocations", [wrenches, voltage or 0.0], len(vehicle.thrusters))[0]
        forces = [thruster_wrench(vehicle, each, voltage) for each in (found, allocate(vehicle, wrenches, voltage))]
        assert np.abs(forces[0] - forces[1]).max() <= 1e-9 * np.abs(forces[1]).max()


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_that_of_the_simulator(compiled: dict[tuple[str, bool], Compiled], name: str) -> None:
    vehicle, library = vehicle_of(name).model_copy(update={"command_delay": 0.0}), compiled[name, False]
    current, dt = (0.3, -0.2, 0.1), 0.02
    commands = np.repeat(random_commands(vehicle, 20, seed=2), 50, axis=0)
    run = simulate(vehicle, commands=commands, dt=dt, current=current)
    x = np.zeros(13)
    x[3], x[7:10] = 1.0, -np.array(current)
    states = library.call("run_commands", [x, commands, np.array(current), dt], 13)[0]
    for k, axis in enumerate("xyz"):
        assert np.abs(states[:, k] - run[axis].values[1:]).max() <= 1e-9
    for k, axis in enumerate("pqr"):
        assert np.abs(states[:, 10 + k] - run[axis].values[1:]).max() <= 1e-9


def test_angles_and_quaternions_are_one_attitude(compiled: dict[tuple[str, bool], Compiled]) -> None:
    euler = random_states(vehicle_of("lauv"), 1000).eta[:, 3:]
    q, back = compiled["lauv", False].call("quaternions", [euler], 4, 3)
    assert np.abs(q - quaternions_from_eulers(np.ascontiguousarray(euler))).max() <= 1e-15
    assert np.abs(back - euler).max() <= 1e-9


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_the_self_test_passes_as_it_is(compiled: dict[tuple[str, bool], Compiled], name: str, single: bool) -> None:
    assert compiled[name, single].wrong == 0


def test_the_self_test_finds_a_wrong_number(tmp_path: Path) -> None:
    vehicle = vehicle_of("bluerov2_heavy")
    built(vehicle, tmp_path, level="-O0")
    text = (tmp_path / "model.h").read_text()
    (tmp_path / "model.h").write_text(text.replace("p.X_uu = -141.0;", "p.X_uu = -141.001;"))
    command = ["gcc", "-std=c99", "-DWITH_THRUSTERS", "-fPIC", "-shared", "driver.c", "-o", "wrong.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert Compiled(tmp_path / "wrong.so").wrong > 0


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_compiler_takes_it_without_a_warning(compiler: str, single: bool, tmp_path: Path) -> None:
    if not has(compiler):
        pytest.skip(f"no {compiler}")
    for name in ("whole", "seamor"):
        folder = tmp_path / name
        folder.mkdir()
        assert Compiled(built(vehicle_of(name), folder, compiler, single=single), single=single).wrong == 0
    bare = vehicle_of("lauv").model_copy(update={"thrusters": ()})
    assert Compiled(built(bare, tmp_path, compiler, single=single), single=single).wrong == 0


def test_it_is_clean_under_sanitizers(tmp_path: Path) -> None:
    vehicle = vehicle_of("whole")
    built(vehicle, tmp_path, level="-O0")
    (tmp_path / "main.c").write_text('#include "model.h"\nint main(void) { return m_self_test(); }\n')
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
    command = ["gcc", "-std=c99", *STRICT, *sanitize, "main.c", "-o", "main", "-lm"]
    made = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if made.returncode:
        pytest.skip(f"no sanitizers: {made.stderr.splitlines()[-1]}")
    run = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""


def test_every_coefficient_is_a_field() -> None:
    once = {name for name in COEFFICIENTS if index(name)[0] != "mass" or index(name)[1] <= index(name)[2]}
    assert once < set(FIELDS)


def test_files_are_the_same_each_time_and_open_with_the_model(tmp_path: Path) -> None:
    first, second = (export("vlbv300", "c", tmp_path / f"{k}.h").files[0] for k in "ab")
    assert first.read_bytes() == second.read_bytes()
    head = first.read_text().splitlines()
    assert head[:3] == ["/*", " * towtank: c c99", " * vehicle: vlbv300"]
    assert any(line.startswith(" *   X_udot = ") for line in head)


def test_a_name_cannot_end_the_comment(tmp_path: Path) -> None:
    written = export(vehicle_of("whole"), "c", tmp_path / "a.h").files[0].read_text()
    assert written.index("*/") > written.index("largest error of the wrench")
    assert prefix_of(vehicle_of("whole")) == "whole_vehicle_1"


def test_what_cannot_be_exported_is_said_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'--to: found "cc"; did you mean "c"'):
        export("lauv", "cc")
    with pytest.raises(InputError, match="--target-version"):
        export("lauv", "c", tmp_path / "a.h", target_version="c89")
    with pytest.raises(InputError, match="--engine: this is no option of the target c"):
        export("lauv", "c", tmp_path / "a.h", options={"engine": "dart"})
    with pytest.raises(InputError, match=r"ends in \.h"):
        export("lauv", "c", tmp_path / "a.txt")
    heavy = vehicle_of("lauv").with_coefficients({"X_udot": 20.0})
    with pytest.raises(InputError, match="not positive definite"):
        export(heavy, "c", tmp_path / "a.h")
    assert list(tmp_path.iterdir()) == []
