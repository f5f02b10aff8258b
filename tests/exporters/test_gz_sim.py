"""Gazebo: what is in the SDF moves as the vehicle does, and the file comes back as it went."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from tests.app.commands import command
from tests.exporters.gazebo import Gazebo
from tests.exporters.whole import random_states, whole_vehicle

from towtank import InputError, export, forward_dynamics, import_vehicle, load_vehicle
from towtank.exporters.frames import turned_vector
from towtank.exporters.simulators.gz_sim import bilinear_of_added_mass
from towtank.vehicle import (
    Coefficient,
    Restoring,
    RigidBody,
    Vehicle,
    VehicleWarning,
    catalog_names,
    configuration_matrix,
    force_range,
)

NAMES = ("rexrov", "bluerov2_heavy", "lauv", "whole")


def vehicle_of(name: str) -> Vehicle:
    return whole_vehicle() if name == "whole" else load_vehicle(name)


def light() -> Vehicle:
    """A vehicle whose added mass is below its own, full, so that engines without that tag can have it."""
    vehicle = vehicle_of("whole")
    values = {
        name: each.model_copy(update={"value": 0.05 * each.value}) if name.endswith("dot") else each
        for name, each in vehicle.hydrodynamics.items()
    }
    return vehicle.model_copy(update={"hydrodynamics": values})


def downwards(eta: np.ndarray) -> np.ndarray:
    """Gravity's direction in the body frame (FLU)."""
    phi, theta = eta[:, 3], eta[:, 4]
    down = np.stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)], axis=1)
    return turned_vector(down)


def disagreement(found: Gazebo, vehicle: Vehicle) -> float:
    """The largest difference of acceleration from the vehicle's, as a share of the largest on that axis."""
    eta, nu, tau = random_states(vehicle, 10_000)
    expected = turned_vector(forward_dynamics(vehicle, eta, nu, tau))
    away = found.acceleration(downwards(eta), turned_vector(nu), turned_vector(tau)) - expected
    return float((np.abs(away).max(axis=0) / np.abs(expected).max(axis=0)).max())


@pytest.mark.parametrize("name", NAMES)
def test_the_file_moves_as_the_vehicle_that_the_export_says_it_keeps(name: str, tmp_path: Path) -> None:
    done = export(vehicle_of(name), "gz-sim", tmp_path / "m")
    gazebo = Gazebo(tmp_path / "m" / "model.sdf")
    assert disagreement(gazebo, done.kept.vehicle) < 1e-11
    np.testing.assert_allclose(Gazebo(tmp_path / "m" / "world.sdf").spatial, gazebo.spatial, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("name", ["rexrov", "bluerov2_heavy", "lauv"])
def test_what_gazebo_can_say_is_said_without_error(name: str, tmp_path: Path) -> None:
    done = export(vehicle_of(name), "gz-sim", tmp_path / "m")
    assert disagreement(Gazebo(tmp_path / "m" / "model.sdf"), vehicle_of(name)) < 1e-10
    assert done.heading.error.endswith("none")


def test_what_it_cannot_say_is_missing_and_measured(tmp_path: Path) -> None:
    done = export(vehicle_of("whole"), "gz-sim", tmp_path / "m")
    text = "\n".join(done.heading.missing)
    for name in ("X_0", "inflow_loss", "curves of the thrusters", "lag of the thrusters"):
        assert name in text
    assert done.error[0] > 0.4  # X_0 alone


def test_thrusters_push_where_the_vehicle_s_do_within_their_range(tmp_path: Path) -> None:
    vehicle = vehicle_of("whole")
    done = export(vehicle, "gz-sim", tmp_path / "m")
    forces = np.random.default_rng(1).uniform(-20.0, 20.0, (50, len(vehicle.thrusters)))
    expected = turned_vector(forces @ configuration_matrix(vehicle).T)
    np.testing.assert_allclose(Gazebo(done.files[0]).wrench(forces), expected, rtol=0.0, atol=1e-12)
    text = done.files[0].read_text()
    low, high = force_range(vehicle.thrusters[0].curve)
    assert f"<min_thrust_cmd>{float(low)!r}</min_thrust_cmd>" in text
    assert f"<max_thrust_cmd>{float(high)!r}</max_thrust_cmd>" in text
    assert text.count("<max_thrust_cmd>1000.0</max_thrust_cmd>") == 1  # the one without end


def test_the_bilinear_terms_are_the_coriolis_forces_of_any_added_mass() -> None:
    chance = np.random.default_rng(4)
    for _ in range(20):
        M = chance.standard_normal((6, 6))
        M = M + M.T
        nu = chance.standard_normal(6)
        p, h = np.split(M @ nu, 2)
        expected = np.concatenate([np.cross(p, nu[3:]), np.cross(p, nu[:3]) + np.cross(h, nu[3:])])
        found = np.einsum("ijk,j,k->i", bilinear_of_added_mass(M), nu, nu)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13)
        assert abs(found @ nu) < 1e-13


@pytest.mark.parametrize("engine", ["bullet", "mujoco"])
def test_engines_without_the_tag_get_added_mass_by_the_plugin(engine: str, tmp_path: Path) -> None:
    done = export(light(), "gz-sim", tmp_path / "m", options={"engine": engine})
    gazebo = Gazebo(done.files[0])
    assert not gazebo.coriolis
    assert not np.any(gazebo.added)
    assert disagreement(gazebo, done.kept.vehicle) < 1e-11
    assert f"gz-physics-{engine}" in done.files[2].read_text()
    assert any("one step late" in line for line in done.heading.missing)


def test_added_mass_that_would_diverge_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"diverges .* found 1\.384 times .* use the engine dart"):
        export("bluerov2_heavy", "gz-sim", tmp_path / "m", options={"engine": "bullet"})
    with pytest.raises(InputError, match='--engine: found "brt"'):
        export("lauv", "gz-sim", tmp_path / "m", options={"engine": "brt"})
    assert not (tmp_path / "m").exists()


@pytest.mark.parametrize("inertia", [(1e-6, 1.0, 1.0), (0.2, 0.3, 0.9)])
def test_an_inertia_that_gazebo_does_not_load_is_refused(inertia: tuple[float, float, float], tmp_path: Path) -> None:
    vehicle = load_vehicle("bluerov2_heavy")
    hollow = vehicle.model_copy(update={"rigid_body": RigidBody(mass=13.5, inertia=inertia)})
    with pytest.raises(InputError, match="none above the sum of the others"):
        export(hollow, "gz-sim", tmp_path / "m")


def test_every_vehicle_of_the_catalog_goes_into_gazebo(tmp_path: Path) -> None:
    refused = []
    for name in catalog_names():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VehicleWarning)
            try:
                export(name, "gz-sim", tmp_path / name)
            except InputError as error:
                refused.append((name, str(error)))
    assert refused == []


def test_channels_for_ardupilot_are_lines_through_the_curves(tmp_path: Path) -> None:
    done = export("bluerov2_heavy", "gz-sim", tmp_path / "m", options={"with-ardupilot": True})
    text = done.files[0].read_text()
    assert text.count("<control channel=") == 8
    assert "imu_sensor" in text
    assert "Imu" in done.files[2].read_text()
    assert any("ArduPilot's channels" in line for line in done.heading.missing)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("target", ["gz-sim", "urdf-hydrodynamics"])
def test_export_import_export_gives_the_same_bytes(name: str, target: str, tmp_path: Path) -> None:
    vehicle = vehicle_of(name)
    learned = {
        key: each.model_copy(update={"std": abs(each.value) / 7.0}) for key, each in vehicle.hydrodynamics.items()
    }
    measured = {"W_minus_B": Coefficient(value=vehicle.weight_minus_buoyancy, std=0.31)}
    vehicle = vehicle.model_copy(
        update={
            "hydrodynamics": type(vehicle.hydrodynamics)(learned),
            "restoring": Restoring.model_validate(vehicle.restoring.model_dump(exclude_none=True) | measured),
        }
    )
    first = export(vehicle, target, tmp_path / "one").files
    found = import_vehicle(next(each for each in first if each.suffix in (".sdf", ".urdf")))
    second = export(found.vehicle, target, tmp_path / "two").files
    assert found.left == ()
    assert [place.name for place in first] == [place.name for place in second]
    for place in second:
        assert place.read_bytes() == (tmp_path / "one" / place.name).read_bytes(), place.name


def test_the_world_can_be_imported_as_the_model(tmp_path: Path) -> None:
    files = export("lauv", "gz-sim", tmp_path / "m").files
    assert import_vehicle(files[0]).vehicle == import_vehicle(files[2]).vehicle


def test_the_command_says_what_it_read_and_what_is_doubtful(tmp_path: Path) -> None:
    export("bluerov2_heavy", "gz-sim", tmp_path / "m")
    ran = command("import", tmp_path / "m" / "model.sdf", "-o", tmp_path / "back.toml")
    assert ran.code == 0
    assert "no damping" not in ran.err
    back = load_vehicle(tmp_path / "back.toml")
    assert back.provenance.source.startswith("exported by towtank from bluerov2_heavy (catalog), sha256 ")
    assert back.coefficient("Z_wdot") == -18.68
    assert [each.name for each in back.thrusters] == [each.name for each in vehicle_of("bluerov2_heavy").thrusters]
