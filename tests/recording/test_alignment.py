"""One grid from channels of many rates: nothing bridged, nothing invented, everything counted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.pace import within

from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.recording import Channel, Recording, align, gap_limit, sampling_rate, standard_channel
from towtank.recording.frames.conversion import wrap_angle
from towtank.recording.standard import QUATERNION, STANDARD

T = np.arange(1001) / 100.0


def record(*channels: Channel) -> Recording:
    return Recording({channel.name: channel for channel in channels})


def test_samples_on_the_grid_pass_unchanged() -> None:
    for start in (0.0, 12.345, 1.7e9):
        rng = np.random.default_rng(5)
        columns = {name: rng.normal(size=T.size) for name in ("x", "u", "r", "ax", "X", "cmd_a", "voltage")}
        grid = align(Recording.from_table(start + T, columns))
        assert grid.rate == pytest.approx(100.0)
        assert np.allclose(grid.t, start + T, rtol=0, atol=1e-6)
        assert np.allclose(grid.pose[:, 0], columns["x"], atol=1e-12)
        assert np.allclose(grid.velocity[:, 5], columns["r"], atol=1e-12)
        assert np.allclose(grid.acceleration[:, 0], columns["ax"], atol=1e-12)
        assert np.array_equal(grid.wrench[:, 0], columns["X"])
        assert np.isnan(grid.wrench[:, 1]).all()
        assert np.array_equal(grid.commands[:, 0], columns["cmd_a"])
        assert np.allclose(grid.voltage, columns["voltage"])
        assert grid.fresh[:, 0].all()
        assert not grid.fresh[:, 1].any()
        assert np.array_equal(grid.command_means()[:, 0], columns["cmd_a"][:-1])
        assert np.array_equal(grid.wrench_means()[:, 0], columns["X"][:-1])
        assert not grid.repairs
        with pytest.raises(ValueError):
            grid.pose[0, 0] = 1.0


def test_no_gap_is_bridged_and_no_end_passed() -> None:
    keep = (T < 3.0) | (T > 4.0)
    u = standard_channel("u", T[keep], np.sin(T[keep]))
    v = standard_channel("v", T[200:500], np.ones(300))
    grid = align(record(u, v))
    inside = (grid.t > 2.995) & (grid.t < 4.005)
    assert np.isnan(grid.velocity[inside, 0]).all()
    assert np.allclose(grid.velocity[~inside, 0], np.sin(grid.t[~inside]))
    known = (grid.t > 1.995) & (grid.t < 4.995)
    assert np.array_equal(~np.isnan(grid.velocity[:, 1]), known)
    assert grid.repairs.gaps == 1
    assert "1.02 s of gaps in u" in grid.repairs.summary
    bridged = align(record(u, v), gap=2.0)
    assert not np.isnan(bridged.velocity[:, 0]).any()
    assert bridged.repairs.gaps == 0


def test_a_short_hole_is_bridged_on_a_line() -> None:
    keep = np.ones(T.size, dtype=bool)
    keep[500:510] = False
    grid = align(Recording.from_table(T, {"u": np.where(keep, 3 * T, np.nan)}))
    assert np.allclose(grid.velocity[:, 0], 3 * T)
    assert not grid.fresh[500:510, 6].any()
    assert grid.fresh[keep, 6].all()


def test_slow_channels_are_fresh_only_at_their_samples() -> None:
    dvl = standard_channel("u", T[::20], T[::20])
    gyro = standard_channel("r", T, np.cos(T))
    grid = align(record(dvl, gyro))
    assert np.allclose(grid.velocity[:, 0], T)
    assert np.array_equal(np.flatnonzero(grid.fresh[:, 6]), np.arange(0, 1001, 20))


def test_rate_is_that_of_the_fastest_motion_capped() -> None:
    fast = standard_channel("ax", np.arange(5000) / 1000, np.zeros(5000))
    command = standard_channel("cmd_a", np.arange(50) / 10, np.zeros(50))
    assert align(record(fast, command)).rate == 200.0
    assert align(record(fast, command), rate=50.0).rate == 50.0
    assert align(record(standard_channel("u", T[::4], T[::4]), command)).rate == 25.0
    with pytest.raises(InputError, match=r"found a rate of -1.0 Hz"):
        align(record(fast), rate=-1.0)


def test_rates_of_printed_jittery_and_bursty_stamps() -> None:
    assert sampling_rate(np.round(np.arange(3000) / 30, 4)) == pytest.approx(30.0, rel=1e-4)
    jitter = np.arange(3000) / 100 + np.random.default_rng(6).normal(size=3000) * 5e-4
    assert sampling_rate(jitter) == pytest.approx(100.0, rel=0.01)
    bursts = (np.arange(300)[:, None] / 10 + np.arange(10) * 1e-4).ravel()
    assert sampling_rate(bursts) == pytest.approx(100.0, rel=0.01)
    assert gap_limit(T) == 0.15
    assert gap_limit(np.arange(10) / 5) == pytest.approx(0.6)


def test_commands_are_held_from_their_own_stamps() -> None:
    run = record(
        standard_channel("u", T, T),
        standard_channel("cmd_b", [0.255, 5.0], [7.0, 8.0]),
        standard_channel("cmd_a", [0.0, 1.0], [1.0, 2.0]),
    )
    grid = align(run, commands=("a", "cmd_b"))
    assert grid.thrusters == ("a", "b")
    assert np.array_equal(grid.commands[:, 0], np.where(grid.t < 1.0 - 1e-9, 1.0, 2.0))
    assert np.isnan(grid.commands[:26, 1]).all()
    assert np.array_equal(grid.commands[26:, 1], np.where(grid.t[26:] < 5.0 - 1e-9, 7.0, 8.0))
    means = grid.command_means(0.005)
    assert means.shape == (1000, 2)
    assert means[100, 0] == pytest.approx(1.5)
    assert align(run).thrusters == ("b", "a")
    assert align(run, commands=()).command_means().shape == (1000, 0)
    with pytest.raises(InputError, match=r'no channel "cmd_bb"; did you mean "cmd_b"\?; found cmd_b, cmd_a'):
        align(run, commands=("bb",))


def test_wrapped_angles_are_unwrapped_before_interpolation() -> None:
    psi = 1.5 * T[::10]
    grid = align(record(standard_channel("psi", T[::10], wrap_angle(psi)), standard_channel("r", T, T)))
    assert np.allclose(grid.pose[:, 5], 1.5 * T, atol=1e-12)
    assert not grid.tilt_known.any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_euler_angles_and_quaternions_of_any_sign_align_alike(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(0.2, 1.5, 3)
    t = T[::5]
    euler = np.column_stack([0.8 * np.sin(a * t), 1.1 * np.sin(b * t), 4 * c * t])
    q = quaternions_from_eulers(euler) * rng.choice([-1.0, 1.0], t.size)[:, None]
    gyro = standard_channel("p", T, T)
    from_q = align(record(*(standard_channel(n, t, q[:, i]) for i, n in enumerate(QUATERNION)), gyro))
    wrapped = wrap_angle(euler)
    from_e = align(
        record(*(standard_channel(n, t, wrapped[:, i]) for i, n in enumerate(("phi", "theta", "psi"))), gyro)
    )
    assert np.allclose(from_q.pose[:, 3:], from_e.pose[:, 3:], atol=1e-9)
    assert np.allclose(from_q.pose[::5, 3:], euler, atol=1e-9)
    fine = np.column_stack([0.8 * np.sin(a * T), 1.1 * np.sin(b * T), 4 * c * T])
    assert np.allclose(from_q.pose[:, 3:], fine, atol=0.02)
    assert from_q.attitude_known.all()
    steps = np.einsum("ij,ij->i", from_q.quaternion[1:], from_q.quaternion[:-1])
    assert (steps > 0).all()


def test_a_lost_track_is_a_gap_in_the_attitude() -> None:
    q = quaternions_from_eulers(np.column_stack([0 * T, 0 * T, T]))
    q[300:400] = 0.0
    grid = align(Recording.from_table(T, {n: q[:, i] for i, n in enumerate(QUATERNION)}))
    assert np.isnan(grid.pose[300:400, 3:]).all()
    assert np.allclose(grid.pose[400:, 5], T[400:])
    assert grid.repairs.nan == 100
    assert grid.repairs.gaps == 1


def test_angles_of_several_rates_are_taken_one_by_one() -> None:
    run = record(
        standard_channel("phi", T, 0.1 * T),
        standard_channel("theta", T, 0.0 * T),
        standard_channel("psi", T[::10], wrap_angle(2 * T[::10])),
    )
    grid = align(run)
    assert np.allclose(grid.pose[:, 3], 0.1 * T)
    assert np.allclose(grid.pose[:, 5], 2 * T)


def test_spikes_are_taken_out_and_counted() -> None:
    u = np.sin(T)
    bad = u.copy()
    bad[[100, 400]] += 3.0
    psi = wrap_angle(2 * T)
    psi[157] = 0.3
    run = Recording.from_table(T, {"u": bad, "psi": psi, "cmd_a": bad, "X": bad})
    grid = align(run)
    assert np.allclose(grid.velocity[:, 0], u, atol=1e-4)
    assert np.allclose(grid.pose[:, 5], 2 * T, atol=1e-9)
    assert grid.repairs.spikes == 3
    assert "2 spikes in u" in grid.repairs.details
    assert not grid.fresh[100, 6]
    assert grid.commands[100, 0] == bad[100]
    assert grid.wrench[100, 0] == bad[100]
    assert align(run, spikes=False).velocity[100, 0] == bad[100]


def test_unusable_recordings() -> None:
    with pytest.raises(InputError, match="no motion in it"):
        align(record(standard_channel("cmd_a", T, T)))
    with pytest.raises(InputError, match="found 3 samples of motion, expected at least 4"):
        align(record(standard_channel("u", T[:3], T[:3])))
    jump = np.where(T < 5, T, T + 5e5)
    with pytest.raises(InputError, match="clocks disagree or jump"):
        align(record(standard_channel("u", jump, T)))


def test_nan_inside_a_channel_is_missing() -> None:
    values = np.sin(T)
    values[::50] = np.nan
    grid = align(record(standard_channel("u", T, values)))
    assert grid.repairs.nan == 21
    assert np.isnan(grid.velocity[[0, -1], 0]).all() or len(grid) == 999
    assert np.nanmax(np.abs(grid.velocity[:, 0] - np.sin(grid.t))) < 1e-4


def test_ten_minutes_of_thirty_channels_take_well_under_a_second_of_computing() -> None:
    n = 60_000
    t = np.arange(n) / 100
    walk = np.cumsum(np.random.default_rng(7).normal(size=n)) * 1e-3
    columns = {name: walk for name in STANDARD if name not in QUATERNION}
    columns |= {f"cmd_{i}": walk for i in range(8)}
    run = Recording.from_table(t, columns)
    align(run.window(0, 1))
    with within(0.8):
        grid = align(run)
    assert len(grid) == n
