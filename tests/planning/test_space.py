"""The water there is: its texts, its walls, and whether a vehicle has room in it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.planning.space import Space, radius_of
from towtank.vehicle import load_vehicle


def test_a_tank_is_a_box_below_the_surface():
    space = Space.from_text("5x4x2.5")
    assert space.size == (5.0, 4.0, 2.5)
    np.testing.assert_array_equal(space.lower, [-2.5, -2.0, 0.0])
    np.testing.assert_array_equal(space.upper, [2.5, 2.0, 2.5])
    np.testing.assert_array_equal(space.eta0, [0.0, 0.0, 1.25, 0.0, 0.0, 0.0])


def test_spaces_around_the_text_and_a_unit_behind_it_are_read():
    assert Space.from_text(" 5 X 5 x 2.5 m ").size == (5.0, 5.0, 2.5)


def test_a_start_is_a_place_in_the_tank():
    np.testing.assert_array_equal(Space.from_text("5x5x2.5", start="-1, 0.5, 1").eta0[:3], [-1.0, 0.5, 1.0])


def test_the_clearance_is_the_distance_of_the_sphere_to_the_nearest_wall():
    space = Space.from_text("5x5x2.5")
    places = np.array([[0.0, 0.0, 1.25], [2.0, 0.0, 1.25], [0.0, -2.4, 1.25], [0.0, 0.0, 0.2], [np.nan, 0.0, 1.0]])
    np.testing.assert_allclose(space.clearance(places, 0.3), [0.95, 0.2, -0.2, -0.1, np.nan])


@pytest.mark.parametrize("text", ["", "5x5", "5x5x2.5x1", "5,5,2.5", "axbxc", "5x5x-2", "infx5x5", "nanx5x5", "5x5x"])
def test_a_text_that_is_no_size_gets_one_line(text):
    with pytest.raises(InputError, match=r'^space: found ".*", expected three numbers, as "5x5x2\.5"') as error:
        Space.from_text(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"size": (5.0, 0.0, 2.5)}, "size of 0 m along y"),
        ({"size": (5.0, math.inf, 2.5)}, "three finite numbers"),
        ({"margin": -0.1}, "margin"),
        ({"margin": 1.3}, "margin"),
        ({"tilt": 0.0}, "tilt"),
        ({"tilt": math.nan}, "tilt"),
        ({"speed": 0.0}, "speed"),
        ({"turn": math.inf}, "turn"),
        ({"start": (0.0, 0.0, 2.6)}, "start"),
        ({"start": (0.0, math.nan, 1.0)}, "start"),
    ],
)
def test_a_number_out_of_range_is_named(changes, words):
    with pytest.raises(InputError, match=words):
        Space(**{"size": (5.0, 5.0, 2.5), **changes})


def test_a_start_that_is_no_place_gets_one_line():
    with pytest.raises(InputError, match=r'^start: found "0,0", expected three numbers'):
        Space.from_text("5x5x2.5", start="0,0")


@pytest.mark.parametrize("name", ["vlbv300", "bluerov2_heavy"])
def test_every_thruster_is_within_the_radius(name):
    vehicle = load_vehicle(name)
    radius = radius_of(vehicle)
    assert all(math.hypot(*thruster.position) < radius for thruster in vehicle.thrusters)
    assert radius < 0.5
    assert Space.from_text("5x5x2.5").require_room(vehicle) == radius


def test_a_vehicle_of_three_metres_has_no_room_in_a_tank_of_two():
    vehicle = load_vehicle("vlbv300")
    first, *others = vehicle.thrusters
    first = first.model_copy(update={"position": (-1.45, 0.0, 0.0)})
    long = vehicle.model_copy(update={"thrusters": (first, *others)})
    with pytest.raises(InputError, match=r"is 3 m across and needs 3\.8 m along x .* found 2 m") as error:
        Space.from_text("2x2x2").require_room(long)
    assert "\n" not in str(error.value)


def test_a_start_too_close_to_a_wall_for_the_vehicle_is_refused():
    with pytest.raises(InputError, match="begin nearer to the middle"):
        Space.from_text("5x5x2.5", start="0,0,0.4").require_room("vlbv300")
