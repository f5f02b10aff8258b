"""The helm: where the vehicle is in the tank, what is wrong with how it moves, and when sticks are renewed."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from towtank.core.attitude import quaternion_from_euler, rotation_from_quaternion
from towtank.live.driving.helm import Helm
from towtank.planning import Guard, Space, drawn_around
from towtank.planning.braking import PERIOD
from towtank.vehicle import load_vehicle

HEAVY = load_vehicle("bluerov2_heavy")
SPACE = Space.from_text("9x8x5")


def helm(limit: float = 1.0) -> Helm:
    found = Helm(Guard.of(HEAVY, SPACE, drawn_around(HEAVY, 1, 0.3)), limit)
    found.anchor(0.0, np.zeros(6))
    return found


def moving(found: Helm, place: np.ndarray, *, velocity: tuple[float, ...] = (0.0,) * 6, tilt: float = 0.0) -> str:
    """What is wrong with a state of the vehicle."""
    q = quaternion_from_euler(tilt, 0.0, 0.0)
    found._place = 0.0, np.append(place, np.zeros(3))
    found._observer = SimpleNamespace(state=np.array([*place, *q, *velocity]))  # type: ignore[assignment]
    return found.fault()


def test_what_moves_as_nothing_guarded_does_is_a_fault() -> None:
    found = helm()
    space = found.guard.space
    middle = 0.5 * (space.lower + space.upper)
    diagonal = np.array([2.0, -1.0, 2.0]) / 3.0
    for limit, fast in ((1.99, False), (2.01, True)):
        for velocity in (
            (*(limit * space.speed * diagonal), 0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0, *(limit * space.turn * diagonal)),
        ):
            assert ("moves as nothing guarded does" in moving(found, middle, velocity=velocity)) is fast
    assert moving(found, middle, tilt=1.19 * space.tilt) == ""
    assert "moves as nothing guarded does (0.0 m/s, 0.0 rad/s)" in moving(found, middle, tilt=1.21 * space.tilt)
    assert moving(found, middle) == ""


def test_two_centimetres_from_a_wall_it_is_at_it() -> None:
    found = helm()
    space, radius = found.guard.space, found.guard.radius
    middle = 0.5 * (space.lower + space.upper)
    clear = float(space.clearance(middle, radius))
    for axis in range(3):
        place = middle.copy()
        place[axis] = space.lower[axis]
        assert moving(found, place) == "the vehicle is at a wall"
    assert clear > 0.1


def test_the_pose_of_the_switch_is_the_plans_start_whatever_way_it_points() -> None:
    found = Helm(Guard.of(HEAVY, SPACE, drawn_around(HEAVY, 1, 0.3)))
    found.see(0.0, np.zeros(6))
    assert found.fault() == ""
    assert not found.bent
    assert found.walls == "not known yet"
    heading = 2.0
    found.anchor(5.0, np.array([10.0, -3.0, 1.0, 0.0, 0.0, heading]))
    ahead = 0.5 * np.array([math.cos(heading), math.sin(heading)])
    right = 0.2 * np.array([-math.sin(heading), math.cos(heading)])
    found.see(5.1, np.array([*(np.array([10.0, -3.0]) + ahead + right), 1.3, 0.01, -0.02, heading + 0.1 + math.tau]))
    assert found._place is not None
    start = found.guard.space.eta0
    assert found._place[1][:3] == pytest.approx(start[:3] + np.array([0.5, 0.2, 0.3]))
    assert found._place[1][3:] == pytest.approx([0.01, -0.02, 0.1])


@pytest.mark.parametrize("seconds, metres, jumped", [(0.1, 0.35, False), (0.1, 1.2, True), (5.0, 3.5, True)])
def test_a_pose_that_jumps_is_a_fault_until_it_is_switched_on_again(
    seconds: float, metres: float, jumped: bool
) -> None:
    found = helm()
    found.see(1.0, np.zeros(6))
    found.see(1.0 + seconds, np.array([metres, 0.0, 0.0, 0.0, 0.0, 0.0]))
    said = found.fault()
    assert said.startswith(f"the pose jumped by {metres:.1f} m; switch off") is jumped
    found.rest()
    assert (found._fault != "") is jumped
    found.anchor(9.0, np.zeros(6))
    assert found.fault() == ""


def test_how_far_a_pose_may_move_goes_with_the_time_up_to_a_second() -> None:
    speed = SPACE.speed
    for seconds, allowed in ((0.5, 0.4 + speed), (1.0, 0.4 + 2.0 * speed), (4.0, 0.4 + 2.0 * speed)):
        for off, jumped in ((-0.02, False), (0.02, True)):
            found = helm()
            found.see(0.0, np.zeros(6))
            found.see(seconds, np.array([0.0, allowed + off, 0.0, 0.0, 0.0, 0.0]))
            assert (found._fault != "") is jumped, (seconds, off)


def test_thrusters_that_do_not_follow_for_a_quarter_of_a_second_are_a_fault() -> None:
    found = helm()
    told = np.full(8, 1500.0)
    found.hear(0.0, told)  # nothing was told yet
    for k in range(20):
        t = 0.05 * k
        found._told.append((t, told))
        found.hear(t, told + np.where(np.arange(8) == 3, 119.0 if k < 5 else -125.0, 0.0))
        assert (found._follows != "") is (k >= 11), k  # first apart at 0.25 s
    assert found.fault() == "the thrusters do not follow: 125 us beside what they are told"
    found.rest()
    assert found.fault() == ""
    assert not found._told


def test_what_was_told_within_half_a_second_may_be_what_is_given() -> None:
    found = helm()
    for k in range(40):
        found._told.append((0.05 * k, np.full(8, 1500.0 + 150.0 * (k >= 20))))
        late = 0.45 if k < 30 else 0.75
        given = np.full(8, 1500.0 + 150.0 * (0.05 * k - late >= 1.0))
        found.hear(0.05 * k, given)
    assert math.isnan(found._unlike) or found._unlike > 1.4
    assert len(found._told) <= 12


def test_sticks_are_renewed_every_period_and_nothing_is_driven_without_a_segment() -> None:
    found = helm()
    found.see(0.0, np.zeros(6))
    wrench = np.zeros((50, 6))
    wrench[:, 0] = np.linspace(0.0, 5.0, 50)
    assert found.sticks(0.0, None, 0.0) is None
    assert found.sticks(0.0, wrench, 50 * PERIOD) is None
    assert not found.prepare(wrench)
    assert found.prepare(wrench)
    before = found.sticks(1.0, wrench, -0.5)
    assert before is not None
    assert before.tolist() == [0.0] * 6
    assert len(found._told) == 1
    times = 1.0 + 0.2 * PERIOD * np.arange(1, 51)
    given = [found.sticks(t, wrench, t - 1.0) for t in times]
    assert all(each is not None for each in given)
    assert len(found._told) == 11
    different = sum(not np.array_equal(a, b) for a, b in itertools.pairwise(given))  # type: ignore[arg-type]
    assert 9 <= different <= 11
    assert given[-1][0] > 0.0  # type: ignore[index]


def test_half_of_what_is_wanted_is_given_where_that_is_the_limit() -> None:
    wrench = np.zeros((50, 6))
    wrench[:, 0] = 8.0
    whole, half = helm(), helm(0.5)
    for found in (whole, half):
        found.prepare(wrench)
    forces = [found.sticks_of.forces(found._plan[10]) for found in (whole, half)]
    assert np.abs(forces[1]).sum() == pytest.approx(0.5 * np.abs(forces[0]).sum(), rel=0.1)


def test_far_from_walls_the_guard_bends_nothing_and_at_one_it_does() -> None:
    found = helm()
    found.see(0.0, np.zeros(6))
    wanted = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert found._guarded(0.0, wanted) is wanted
    assert not found.bent
    space = found.guard.space
    near = space.eta0.copy()
    near[0] = space.upper[0] - found.guard.radius - 0.05
    fast = np.array([*near[:3], 1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    found._observer = SimpleNamespace(state=fast, clock=np.zeros(1))  # type: ignore[assignment]
    given = found._guarded(0.0, np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert found.bent
    assert given[0] < 0.5


@pytest.mark.parametrize("late, moved", [(0.1, 0.1), (5.0, 0.3), (-1.0, 0.0)])
def test_a_pose_is_carried_on_to_now_by_at_most_three_tenths(late: float, moved: float) -> None:
    found = helm()
    q = np.array(quaternion_from_euler(0.2, -0.1, 1.0))
    velocity, turn = np.array([0.3, -0.1, 0.05]), np.array([0.2, 0.1, -0.3])
    state = np.concatenate([[1.0, 2.0, 3.0], q, velocity, turn])
    found._observer = SimpleNamespace(state=state.copy(), clock=np.array([7.0]))  # type: ignore[assignment]
    ahead = found._ahead(7.0 + late)
    R = rotation_from_quaternion(q)
    assert ahead[:3] == pytest.approx(np.array([1.0, 2.0, 3.0]) + moved * R @ velocity)
    angle = moved * np.linalg.norm(turn)
    axis = turn / np.linalg.norm(turn)
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turned = R @ (np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)
    assert rotation_from_quaternion(ahead[3:7]) == pytest.approx(turned, abs=2e-4)
    assert np.linalg.norm(ahead[3:7]) == pytest.approx(1.0)
    assert ahead[7:].tolist() == state[7:].tolist()
