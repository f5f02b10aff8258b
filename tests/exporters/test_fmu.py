"""Functional mock-up units of both standards: the simulator's motion, parameters to be tuned, bad input refused."""

from __future__ import annotations

import math
import platform
import zipfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.exporters.compiled import has
from tests.exporters.master import DISCARD, ERROR, OK, Unit, described
from tests.exporters.whole import random_commands, whole_vehicle

from towtank import InputError, export, load_vehicle, simulate
from towtank.core.arrays import Array
from towtank.exporters.programs.c99 import FIELDS
from towtank.recording import Recording
from towtank.vehicle import Vehicle

pytestmark = pytest.mark.skipif(not has("gcc") or platform.system() != "Linux", reason="no C compiler for Linux")
CURRENT, DT = (0.3, -0.2, 0.1), 0.01
MOTION = (*("x", "y", "z", "phi", "theta", "psi"), *("u", "v", "w", "p", "q", "r"))
VERSIONS = ("2.0", "3.0")


@pytest.fixture(params=VERSIONS)
def version(request: pytest.FixtureRequest) -> str:
    return str(request.param)


Units = Callable[[str], Unit]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """The file of a vehicle for a version of the standard, compiled once."""

    @cache
    def of_vehicle(name: str, version: str) -> Path:
        folder = tmp_path_factory.mktemp("exported")
        return export(vehicle_of(name), "fmu", folder / "a.fmu", target_version=version).files[0]

    return of_vehicle


@pytest.fixture
def unit_of(exported: Callable[[str, str], Path], version: str, tmp_path: Path) -> Units:
    """What loads a vehicle by its name as a unit of its own."""
    return lambda name: Unit(exported(name, version), tmp_path)


@pytest.fixture
def unit(unit_of: Units) -> Iterator[Unit]:
    made = unit_of("whole")
    yield made
    made.close()


def vehicle_of(name: str) -> Vehicle:
    return whole() if name == "whole" else load_vehicle(name)


def whole() -> Vehicle:
    return whole_vehicle().model_copy(update={"command_delay": 0.0})


def held(vehicle: Vehicle, steps: int) -> Array:
    return np.repeat(random_commands(vehicle, steps // 40, seed=4), 40, axis=0)


def flown(unit: Unit, vehicle: Vehicle, commands: Array, h: float = DT) -> Array:
    """Return the motion after every step."""
    names = [f"cmd_{each.name}" for each in vehicle.thrusters]
    out = []
    for k, row in enumerate(commands):
        assert unit.set(dict(zip(names, row.tolist(), strict=True))) == OK
        assert unit.step(k * h, h) == OK
        out.append(unit.get(MOTION))
    return np.array(out)


def of(run: Recording) -> Array:
    return np.column_stack([run[name].values[1:] for name in MOTION])


@pytest.mark.parametrize("name", ["whole", "bluerov2_heavy", "rexrov"])
def test_it_moves_as_the_simulator_does(name: str, unit_of: Units) -> None:
    vehicle, unit = vehicle_of(name), unit_of(name)
    commands = held(vehicle, 1000)
    start = {"z_0": 3.0, "phi_0": 0.2, "psi_0": -1.0, "u_0": 0.4, "r_0": 0.3}
    water = dict(zip(("current_north", "current_east", "current_down"), CURRENT, strict=True))
    assert unit.start({**start, **water}) == OK
    run = simulate(
        vehicle,
        commands=commands,
        dt=DT,
        delay=0.0,
        current=CURRENT,
        eta0=[0, 0, 3.0, 0.2, 0, -1.0],
        nu0=[0.4, 0, 0, 0, 0, 0.3],
    )
    found, expected = flown(unit, vehicle, commands), of(run)
    away = found - expected
    away[:, 3:6] = np.angle(np.exp(1j * away[:, 3:6]))  # angles go round
    assert np.abs(away).max() <= 1e-9
    unit.close()


def test_a_wrench_moves_it_and_long_steps_are_cut(unit_of: Units) -> None:
    vehicle, unit = vehicle_of("seamor"), unit_of("seamor")
    tau = {"X": 20.0, "Y": -5.0, "Z": 3.0, "K": 0.1, "M": -0.2, "N": 1.0}
    assert unit.start({**tau, "step": 0.02}) == OK
    run = simulate(vehicle, wrench=np.tile(list(tau.values()), (100, 1)), dt=0.02)
    for k in range(20):
        assert unit.step(0.1 * k, 0.1) == OK  # five steps each
    assert np.abs(np.array(unit.get(MOTION)) - of(run)[-1]).max() <= 1e-9
    unit.close()


def test_every_coefficient_can_be_tuned(unit: Unit) -> None:
    said = unit.description
    assert [name for name, kind in said.kinds.items() if kind == "parameter tunable"] == list(FIELDS)
    assert all(said.units[name] in said.known_units for name in said.units)
    vehicle = whole()
    commands = held(vehicle, 200)
    assert unit.start({}) == OK
    first = flown(unit, vehicle, commands)
    unit.reset()
    assert unit.start({"X_uu": -30.0, "Y_uv": 3.0, "I_z": 1.5, "N_0": 0.5}) == OK
    tuned = flown(unit, vehicle, commands)
    assert np.abs(tuned - first).max() > 1e-2
    body = vehicle.rigid_body
    inertia = [list(row) for row in body.tensor]
    inertia[2][2] = 1.5
    other = vehicle.with_coefficients({"X_uu": -30.0, "Y_uv": 3.0, "N_0": 0.5}).model_copy(
        update={"rigid_body": body.model_copy(update={"inertia": tuple(tuple(row) for row in inertia)})}
    )
    expected = of(simulate(other, commands=commands, dt=DT, delay=0.0))
    away = tuned - expected
    away[:, 3:6] = np.angle(np.exp(1j * away[:, 3:6]))
    assert np.abs(away).max() <= 1e-9


def test_starts_are_the_vehicle(unit: Unit) -> None:
    vehicle, starts = whole(), unit.description.starts
    assert starts["X_udot"] == vehicle.coefficient("X_udot")
    assert starts["m"] == vehicle.rigid_body.mass
    assert starts["cmd_ahead_2"] == 1500.0
    assert "force_ahead_2" not in starts


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_input_that_is_no_number_is_discarded(unit: Unit, bad: float) -> None:
    assert unit.start({"X": 5.0}) == OK
    assert unit.step(0.0, DT) == OK
    before = unit.get([*MOTION, "X"])
    assert unit.set({"Y": 1.0, "X": bad}) == DISCARD
    assert len(unit.said) == 1
    assert "not finite" in unit.said[0]
    assert unit.get([*MOTION, "X"]) == before
    assert unit.get(["Y"]) == [0.0]
    assert unit.step(DT, DT) == OK


def test_motion_without_bounds_takes_the_step_back(unit: Unit) -> None:
    assert unit.start({"step": 10.0, "X_uu": 1e6, "u_0": 50.0}) == OK
    before = unit.get(MOTION)
    statuses = [unit.step(10.0 * k, 10.0) for k in range(6)]
    assert DISCARD in statuses
    assert all(math.isfinite(each) for each in unit.get(MOTION))
    if statuses[0] == DISCARD:
        assert unit.get(MOTION) == before
    assert "not finite" in unit.said[-1]


def test_parameters_without_a_motion_are_refused(unit: Unit) -> None:
    assert unit.start({"m": -50.0}) == ERROR
    assert "not positive definite" in unit.said[-1]
    assert unit.set({"x": 1.0}) == ERROR


def test_a_state_can_be_saved_and_taken_back(unit: Unit) -> None:
    vehicle = whole()
    commands = held(vehicle, 80)
    assert unit.start({}) == OK
    flown(unit, vehicle, commands[:40])
    state = unit.save()
    first = flown(unit, vehicle, commands[40:])
    unit.restore(state)
    assert np.array_equal(flown(unit, vehicle, commands[40:]), first)


def test_the_same_model_gives_the_same_bytes(version: str, tmp_path: Path) -> None:
    pair = [export("lauv", "fmu", tmp_path / f"{k}.fmu", target_version=version).files[0] for k in "ab"]
    assert pair[0].read_bytes() == pair[1].read_bytes()
    with zipfile.ZipFile(pair[0]) as archive:
        names = set(archive.namelist())
        assert b"X_udot = -1.0 kg" in archive.read("modelDescription.xml")
    assert {"modelDescription.xml", "sources/fmu.c", "sources/model.h"} < names
    assert described(pair[0]).identifier == "lauv"


def test_sources_alone_where_there_is_no_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    done = export("lauv", "fmu", tmp_path / "a.fmu")
    assert "no C compiler" in done.heading.missing[0]
    with zipfile.ZipFile(done.files[0]) as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())


def test_an_unknown_version_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--target-version.*2\.0 or 3\.0"):
        export("lauv", "fmu", tmp_path / "a.fmu", target_version="1.0")
