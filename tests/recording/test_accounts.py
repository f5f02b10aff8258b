"""Two accounts of one motion: of an exact motion both say the same, cell by cell."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.recording import Recording
from towtank.recording.consistency.accounts import Pair, of_depth, of_heading, of_rates, of_velocity, of_wrench
from towtank.recording.consistency.tracks import held_track, pose_track, speed_track

from .test_consistency import motion

RATE = 50.0
T, EXACT = motion(60.0, RATE)
POSE, SPEED, TURN = ("x", "y", "z", "phi", "theta", "psi"), tuple("uvw"), tuple("pqr")


def run(*names: str, **changes: Array) -> Recording:
    return Recording.from_table(T, {**{name: EXACT[name] for name in names}, **changes})


def off(pair: Pair | None, derived: Array | None = None) -> float:
    """By how much the two accounts differ, of the size of the motion."""
    assert pair is not None
    other = pair.derived if derived is None else derived
    known = np.isfinite(other) & np.isfinite(pair.measured)
    assert known.mean() > 0.9
    return float(np.abs(other - pair.measured)[known].max() / np.abs(pair.measured[known]).max())


def test_velocity_is_the_derivative_of_the_position_along_the_body() -> None:
    pair = of_velocity(run(*POSE, *SPEED))
    assert off(pair) < 0.01
    assert pair is not None
    assert (pair.names, pair.source, pair.own_clock, pair.level) == (SPEED, "the position", False, True)
    assert pair.floor.tolist() == [0.01] * 3


def test_along_the_worlds_axes_it_is_one_of_two_others() -> None:
    north = of_velocity(run(*POSE, u=EXACT["vn"], v=EXACT["ve"], w=EXACT["vd"]))
    assert north is not None
    assert off(north, north.others["in the world's frame (north, east, down)"]) < 0.01
    east = of_velocity(run(*POSE, u=EXACT["ve"], v=EXACT["vn"], w=-EXACT["vd"]))
    assert east is not None
    assert off(east, east.others["in the world's frame (east, north, up)"]) < 0.01
    assert off(east) > 0.5


def test_two_of_three_speeds_are_compared_and_no_other_frame() -> None:
    pair = of_velocity(run(*POSE, "u", "w"))
    assert off(pair) < 0.01
    assert pair is not None
    assert (pair.names, pair.level, pair.others) == (("u", "w"), False, {})


def test_what_floats_level_is_compared_with_the_heading_alone() -> None:
    course = (EXACT["vn"] + 1j * EXACT["ve"]) * np.exp(-1j * EXACT["psi"])
    pair = of_velocity(run("x", "y", "psi", u=course.real, v=course.imag))
    assert off(pair) < 0.01
    assert pair is not None
    assert (pair.names, pair.level) == (("u", "v"), True)
    assert of_velocity(run("x", "y", u=course.real, v=course.imag)) is None
    assert of_velocity(run("x", "psi", u=course.real, v=course.imag)) is None
    assert of_velocity(run("x", "y", "psi")) is None


def test_the_depth_is_compared_where_no_other_position_is() -> None:
    pair = of_depth(run("z", "phi", "theta", "psi", *SPEED))
    assert off(pair) < 0.01
    assert pair is not None
    assert (pair.names, pair.source, pair.own_clock) == (("the vertical part of u v w",), "the depth", False)
    assert of_depth(run("y", "z", "phi", "theta", "psi", *SPEED)) is None
    assert of_depth(run("z", "phi", "theta", "psi", "u", "v")) is None
    assert of_depth(run("z", *SPEED)) is None


@pytest.mark.parametrize("quaternion", [False, True])
def test_rates_are_the_derivative_of_the_attitude(quaternion: bool) -> None:
    q = quaternions_from_eulers(np.column_stack([EXACT[name] for name in POSE[3:]]))
    q[::7] *= -1.0  # either sign is the same attitude
    named = dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))
    pair = of_rates(run(*TURN, **named) if quaternion else run(*TURN, *POSE[3:]))
    assert off(pair) < 0.01
    assert pair is not None
    assert (pair.names, pair.own_clock) == (TURN, False)
    assert of_rates(run("p", "psi")) is None
    assert of_rates(run("phi", "theta", "psi")) is None


def test_r_is_the_derivative_of_the_heading_where_that_is_all() -> None:
    r = np.gradient(EXACT["psi"], T)
    wrapped = np.angle(np.exp(1j * (EXACT["psi"] + 3.0)))
    pair = of_heading(run(psi=wrapped, r=r))
    assert off(pair) < 0.01
    assert pair is not None
    assert (pair.names, pair.source, pair.own_clock) == (("r",), "the heading", False)
    assert of_heading(run("phi", "theta", "psi", r=r)) is None
    assert of_heading(run("psi")) is None


def test_stamps_of_their_own_are_told() -> None:
    speeds = Recording.from_table(T[::4] + 0.01, {name: EXACT[name][::4] for name in "uvw"})
    pair = of_velocity(run(*POSE).replace(speeds.channels))
    assert pair is not None
    assert pair.own_clock


def test_a_wrench_is_that_of_the_commands_which_hold() -> None:
    wrench = np.zeros((T.size, 6))
    wrench[:, 0], wrench[:, 5] = 20.0 * np.sign(np.sin(T)), 4.0 * np.sign(np.sin(2.0 * T))
    pair = of_wrench(run("u", X=wrench[:, 0], N=wrench[:, 5]), T, wrench)
    assert off(pair) < 1e-9
    assert pair is not None
    assert pair.names == ("X", "N")
    largest = float(np.nanstd(pair.derived[..., 0]))
    assert pair.floor == pytest.approx([0.05 * largest, 0.3 * 0.05 * largest])
    assert of_wrench(run("u"), T, wrench) is None


@pytest.mark.parametrize("step, dt, lags, window", [(0.02, 0.05, 10, 9), (0.1, 0.05, 10, 13), (0.4, 0.1, 5, 25)])
def test_cells_are_as_long_as_the_slowest_channel_asks_for(step: float, dt: float, lags: int, window: int) -> None:
    t = step * np.arange(round(600.0 / step))
    psi = np.sin(0.2 * t)
    pair = of_heading(Recording.from_table(t, {"psi": psi, "r": 0.2 * np.cos(0.2 * t)}))
    assert pair is not None
    cells = pair.cells
    assert (cells.dt, cells.step, cells.lags) == (pytest.approx(dt), pytest.approx(step), lags)
    assert cells.window.size == window
    assert cells.window.sum() == pytest.approx(1.0)
    assert cells.window == pytest.approx(cells.window[::-1])
    margin = lags + window // 2
    assert cells.core == min(max(int(t[-1] / dt) // 12, 60), 600)
    assert len(cells.edges) == min(32, int(t[-1] / dt) // cells.core)
    assert cells.edges.shape[1] == cells.core + 2 * margin + 1
    assert np.diff(cells.edges, axis=1) == pytest.approx(dt)
    assert cells.edges[0, margin] == pytest.approx(0.0)
    assert cells.edges[-1, -1 - margin] == pytest.approx(t[-1])
    assert cells.middle == pytest.approx(0.5 * (cells.edges[:, 0] + cells.edges[:, -1]))


def test_too_little_time_in_common_is_none() -> None:
    early, late = T[T < 20.0], T[T >= 19.0]
    psi = Recording.from_table(early, {"psi": np.sin(early)})
    assert of_heading(psi.replace(Recording.from_table(late, {"r": np.cos(late)}).channels)) is None
    assert of_heading(run("psi", r=EXACT["r"])) is not None
    short = T[T < 17.0]
    assert of_heading(Recording.from_table(short, {"psi": np.sin(short), "r": np.cos(short)})) is None
    enough = T[T < 19.0]
    assert of_heading(Recording.from_table(enough, {"psi": np.sin(enough), "r": np.cos(enough)})) is not None


def test_a_marker_that_jumps_makes_no_speed() -> None:
    x = EXACT["x"] + np.where(T > 30.0, 5.0, 0.0)
    pair, calm = of_velocity(run(*POSE, *SPEED, x=x)), of_velocity(run(*POSE, *SPEED))
    assert pair is not None
    assert calm is not None
    usual = float(np.nanquantile(np.abs(calm.derived[..., 0]), 0.95))
    assert np.nanmax(np.abs(pair.derived)) < 8.0 * usual
    assert np.nanmax(np.abs(pair.derived)) > 2.0 * usual


def test_the_means_of_tracks_leave_gaps_out() -> None:
    keep = (T < 20.0) | (T > 24.0)
    cut = Recording.from_table(T[keep], {"psi": EXACT["psi"][keep], "r": EXACT["r"][keep]})
    pose, speed = pose_track(cut, "psi"), speed_track(cut, "r")
    assert pose is not None
    assert speed is not None
    times = np.array([-1.0, 10.0, 19.0, 22.0, 25.0, 61.0])
    for track in (pose, speed):
        assert np.isfinite(track.at(times)).tolist() == [False, True, True, False, True, False]
    assert pose.at(np.array([10.0])) == pytest.approx(np.interp(10.0, T, EXACT["psi"]))
    assert np.diff(speed.at(np.array([2.0, 12.0]))) == pytest.approx(
        np.trapezoid(EXACT["r"][(T >= 2.0) & (T <= 12.0)], dx=1.0 / RATE), abs=1e-6
    )


def test_repeats_are_no_samples_of_a_track_and_what_holds_has_no_gap() -> None:
    held = np.repeat(EXACT["r"][::5], 5)
    track = speed_track(run(r=held), "r")
    assert track is not None
    assert track.t.tolist() == T[::5].tolist()
    assert track.step == pytest.approx(0.1)
    few = np.where(np.arange(T.size) % 5 == 0, np.roll(EXACT["r"], 1), EXACT["r"])
    some = speed_track(run(r=few), "r")
    assert some is not None
    assert some.t.size == T.size
    assert speed_track(run("psi"), "r") is None
    assert speed_track(Recording.from_table(T[:19], {"r": EXACT["r"][:19]}), "r") is None
    assert speed_track(Recording.from_table(T[:20], {"r": EXACT["r"][:20]}), "r") is not None
    keep = (T < 20.0) | (T > 24.0)
    steady = held_track(T[keep], np.full(keep.sum(), 2.0))
    assert steady is not None
    assert np.diff(steady.at(np.array([19.0, 23.0]))) == pytest.approx([8.0])
    assert held_track(T[:19], T[:19]) is None


def test_a_quaternion_that_repeats_counts_when_it_changes() -> None:
    q = quaternions_from_eulers(np.column_stack([EXACT[name] for name in POSE[3:]]))
    held = np.repeat(q[::5], 5, axis=0)
    pair = of_rates(run(*TURN, **dict(zip(("qw", "qx", "qy", "qz"), held.T, strict=True))))
    assert pair is not None
    assert pair.cells.step == pytest.approx(0.1)
    one = q.copy()
    one[:, 3] = np.repeat(q[::5, 3], 5)  # one component alone repeats
    still = of_rates(run(*TURN, **dict(zip(("qw", "qx", "qy", "qz"), one.T, strict=True))))
    assert still is not None
    assert still.cells.step == pytest.approx(0.02)


def test_smoothing_keeps_a_line() -> None:
    pair = of_heading(run("psi", "r"))
    assert pair is not None
    line = np.arange(float(pair.cells.edges.shape[1] - 1))[None, :, None] + np.zeros((2, 1, 3))
    half = pair.cells.window.size // 2
    assert pair.cells.smooth(line) == pytest.approx(line[:, half:-half])
