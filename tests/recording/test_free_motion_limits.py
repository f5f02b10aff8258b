"""The limits by which a stretch of a dive counts or not, each from both of its sides."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.recording import Channel, Recording, standard_channel
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE, free_motion, usual_interval
from towtank.vehicle import load_vehicle

T = np.arange(2001) / 20.0
ROV = load_vehicle("bluerov2")


def dive(commands: np.ndarray = T, **columns: np.ndarray) -> Recording:
    """A level run of 100 s at 3 m, commands at their own times."""
    own = {"z": np.full(T.size, 3.0), "phi": 0.1 * np.sin(T), "theta": 0.1 * np.cos(T), "r": np.sin(T)}
    run = Recording.from_table(T, {**own, **columns})
    pwm = standard_channel("cmd_1", commands, 1500.0 + 100.0 * np.sign(np.sin(commands)))
    return Recording({**run.channels, "cmd_1": pwm}, attributes=dict([DEPTH_BELOW_SURFACE]))


def cuts(run: Recording) -> list[tuple[str, float, float]]:
    return [(each.kind, round(each.start, 1), round(each.end, 1)) for each in free_motion(run, ROV).left_out]


def while_between(start: float, end: float, inside: float, outside: float) -> np.ndarray:
    return np.where((start <= T) & (end > T), inside, outside)


@pytest.mark.parametrize("depth, up", [(0.09, True), (0.11, False)])
def test_ten_centimetres_is_the_surface(depth, up):
    assert cuts(dive(z=while_between(20.0, 30.0, depth, 3.0))) == ([("surface", 20.0, 30.0)] if up else [])


@pytest.mark.parametrize("depth, end", [(0.14, 40.0), (0.16, 30.0)])
def test_fifteen_centimetres_is_under_water_again(depth, end):
    z = np.where(T < 20.0, 3.0, np.where(T < 30.0, 0.05, np.where(T < 40.0, depth, 3.0)))
    assert cuts(dive(z=z)) == [("surface", 20.0, end)]


def test_between_the_two_depths_counts_what_was_sure_last_and_before_anything_was_sure_it_is_under_water():
    z = np.where(T < 10.0, 0.12, np.where(T < 90.0, 3.0, 0.05))
    assert cuts(dive(z=z)) == [("surface", 90.0, 100.0)]


@pytest.mark.parametrize("seconds, up", [(0.9, False), (1.1, True)])
def test_a_second_at_the_surface_counts(seconds, up):
    assert bool(cuts(dive(z=while_between(20.0, 20.0 + seconds, 0.05, 3.0)))) is up


def test_two_surfacings_less_than_a_second_apart_are_one():
    near, far = (
        np.minimum(while_between(20.0, 30.0, 0.05, 3.0), while_between(30.0 + pause, 50.0, 0.05, 3.0))
        for pause in (0.9, 1.1)
    )
    assert cuts(dive(z=near)) == [("surface", 20.0, 50.0)]
    assert cuts(dive(z=far))[0][:2] == ("surface", 20.0)
    assert cuts(dive(z=far)) != [("surface", 20.0, 50.0)]


@pytest.mark.parametrize(("first", "start"), [(1.9, 0.0), (6.0, 6.0), (15.0, 15.0)])
def test_a_first_depth_tells_of_no_more_than_two_seconds_before_it(first: float, start: float) -> None:
    z = while_between(0.0, 20.0, 0.05, 3.0)
    z[first - 1e-9 > T] = np.nan
    assert cuts(dive(z=z)) == [("surface", start, 20.0)]


@pytest.mark.parametrize("seconds", [1.9, 2.1])
def test_a_depth_holds_for_two_seconds(seconds):
    z = while_between(20.0, 30.0, 0.05, 3.0)
    z[(30.0 - seconds < T) & (T < 60.0)] = np.nan  # lost, so that nobody knows
    ((kind, start, end),) = cuts(dive(z=z))
    assert (kind, start) == ("surface", 20.0)
    assert end == pytest.approx(30.0 - seconds + 2.0, abs=0.11)


@pytest.mark.parametrize("degrees, over", [(115.0, False), (125.0, True), (180.0, True)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("quaternion", [False, True])
def test_more_than_120_degrees_is_upside_down(degrees, over, axis, quaternion):
    angles = np.zeros((T.size, 3))
    angles[:, axis] = while_between(40.0, 50.0, np.deg2rad(degrees), 0.05)
    if quaternion:
        columns = dict(zip(("qw", "qx", "qy", "qz"), quaternions_from_eulers(angles).T, strict=True))
        run = dive(**columns).without("phi", "theta")
    else:
        run = dive(phi=angles[:, 0], theta=angles[:, 1])
    assert cuts(run) == ([("upside down", 40.0, 50.0)] if over else [])


@pytest.mark.parametrize("seconds, lies", [(4.8, False), (5.2, True)])
def test_one_that_turns_over_for_less_than_five_seconds_tumbles(seconds, lies):
    assert bool(cuts(dive(phi=while_between(40.0, 40.0 + seconds, np.pi, 0.0)))) is lies


@pytest.mark.parametrize("share, cut", [(0.45, True), (0.55, False)])
def test_over_for_most_of_the_time_is_how_the_sensor_is_mounted(share, cut):
    assert bool(cuts(dive(phi=while_between(0.0, 100.0 * share, np.pi, 0.0)))) is cut


@pytest.mark.parametrize("down, over", [(-9.8, False), (9.8, True)])
def test_gravity_tells_it_where_no_attitude_is_measured(down, over):
    columns = {"ax": 0.1 * np.sin(9.0 * T), "ay": np.zeros(T.size), "az": while_between(40.0, 50.0, down, -9.8)}
    run = dive(**columns).without("phi", "theta")
    found = cuts(run)
    assert len(found) == over
    if over:
        assert found[0][1] == pytest.approx(40.0, abs=0.7)
        assert found[0][2] == pytest.approx(50.0, abs=0.7)


@pytest.mark.parametrize("wait, cut", [(0.4, []), (0.6, [("no commands", 0.0, 0.6)])])
def test_half_a_second_before_the_first_command_does_not_matter(wait, cut):
    assert cuts(dive(T[wait <= T])) == cut


@pytest.mark.parametrize("wait, cut", [(0.4, []), (0.7, [("no commands", 99.3, 100.0)])])
def test_half_a_second_after_the_last_command_does_not_matter(wait, cut):
    found = cuts(dive(T[100.0 - wait >= T]))
    assert [each[0] for each in found] == [each[0] for each in cut]
    if found:
        assert found[0][1:] == (pytest.approx(99.35, abs=0.11), 100.0)


@pytest.mark.parametrize("silence, cut", [(1.9, False), (2.1, True)])
def test_two_seconds_without_a_command_are_none(silence, cut):
    found = cuts(dive(T[(T <= 50.0) | (50.0 + silence < T)]))
    assert bool(found) is cut
    if cut:
        assert found[0][:2] == ("no commands", pytest.approx(50.05, abs=0.06))


def test_slow_commands_may_be_silent_for_ten_of_their_intervals():
    slow = np.arange(0.0, 100.5, 0.5)
    for silence, cut in ((4.5, False), (5.5, True)):
        kept = slow[(slow <= 50.0) | (slow >= 50.0 + silence)]
        assert bool(cuts(dive(kept))) is cut


def test_intervals_are_usual_where_they_are_steady():
    assert usual_interval(0.5 * np.arange(20)) == 0.5
    assert usual_interval(0.5 * np.arange(19)) is None
    uneven = np.cumsum(np.where(np.arange(100) % 10 == 0, 1.2, 0.5))  # a tenth more than twice as long
    assert usual_interval(uneven) is None
    assert usual_interval(np.cumsum(np.where(np.arange(100) % 10 == 0, 0.9, 0.5))) == pytest.approx(0.5)


@pytest.mark.parametrize("left, kept", [(4.8, 1), (5.2, 2)])
def test_what_is_left_for_less_than_five_seconds_is_not_kept(left, kept):
    run = dive().replace(
        [Channel("armed", np.array([0.0, 60.0, 80.0, 80.0 + left]), np.array([1.0, 0.0, 1.0, 0.0]), "1")]
    )
    assert len(free_motion(run, ROV).kept) == kept
