"""ArduSub's frames: what each motor does, and thrusters brought into their order and sense."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.vehicle import configuration_matrix, load_vehicle
from towtank.vehicle.thrusters.ardusub import FRAMES, by_frame, frame_named

CATALOG = [("bluerov2", "VECTORED"), ("bluerov2_heavy", "VECTORED_6DOF"), ("bluerov2_heavy_wu", "VECTORED_6DOF")]


@pytest.mark.parametrize("frame", FRAMES.values(), ids=lambda frame: frame.name)
def test_each_axis_that_a_frame_drives_can_be_driven_alone(frame: object) -> None:
    wrench = frame.wrench  # type: ignore[attr-defined]
    # the mixer sends each stick times its factors; together the motors must push that way more than any other
    for axis in np.flatnonzero(np.abs(wrench).sum(axis=1) > 0.0):
        made = wrench @ wrench[axis]
        assert made[axis] > 0.0


@pytest.mark.parametrize(("name", "frame"), CATALOG)
def test_the_catalog_pushes_as_ardusub_means_it(name: str, frame: str) -> None:
    vehicle, table = load_vehicle(name), frame_named(frame)
    assert table is not None
    assert by_frame(vehicle, frame) == (vehicle, "")
    B = configuration_matrix(vehicle)
    clear = np.abs(B) > 0.5 * np.abs(B).max(axis=1, keepdims=True)
    told = (table.wrench != 0.0) & clear
    np.testing.assert_array_equal(np.sign(B[told]), table.wrench[told])


@pytest.mark.parametrize(("name", "frame"), CATALOG[:2])
def test_the_sense_of_the_sources_is_turned_and_told(name: str, frame: str) -> None:
    published, vehicle = load_vehicle(f"{name}_as_published"), load_vehicle(name)
    np.testing.assert_allclose(configuration_matrix(published), -configuration_matrix(vehicle), atol=1e-12)
    assert published.hydrodynamics == vehicle.hydrodynamics
    turned, said = by_frame(published, frame)
    np.testing.assert_allclose(configuration_matrix(turned), configuration_matrix(vehicle), atol=1e-12)
    assert f"the log's frame is {frame}" in said
    assert "push the other way than the file says" in said


def test_another_order_is_brought_into_that_of_the_motors() -> None:
    vehicle = load_vehicle("bluerov2")
    mixed = vehicle.model_copy(update={"thrusters": tuple(vehicle.thrusters[k] for k in (2, 0, 1, 5, 3, 4))})
    found, said = by_frame(mixed, "VECTORED")
    np.testing.assert_allclose(configuration_matrix(found), configuration_matrix(vehicle), atol=1e-12)
    assert [thruster.name for thruster in found.thrusters] == [thruster.name for thruster in mixed.thrusters]
    assert "drive other thrusters" in said


def test_another_vehicle_is_left_alone() -> None:
    for name in ("blueboat", "bluerov_2016", "bluerov2_heavy"):
        vehicle = load_vehicle(name)
        assert by_frame(vehicle, "VECTORED") == (vehicle, "")
    assert by_frame(load_vehicle("bluerov2"), "CUSTOM")[1] == ""


def test_the_boat_of_the_recordings_is_the_boat_with_its_outputs_as_they_were() -> None:
    boat, recorded = load_vehicle("blueboat"), load_vehicle("blueboat_2024")
    assert boat.hydrodynamics == recorded.hydrodynamics
    assert [t.position[1] for t in boat.thrusters] == [-t.position[1] for t in recorded.thrusters]
    assert configuration_matrix(boat)[5, 0] > 0.0  # more on the left throttle turns to starboard
