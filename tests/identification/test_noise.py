"""The noise of a channel is found from its samples alone, whatever moves, jumps, repeats or is rounded beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.recording import Recording, load_mapping, read_csv
from towtank.recording.noise import fresh_samples, noise_level, noise_levels, quantum_of
from towtank.simulation import simulate
from towtank.simulation.manoeuvres import paper_commands, square_orders
from towtank.simulation.sensors.ins import Ins
from towtank.simulation.sensors.mocap import Mocap
from towtank.simulation.sensors.sensor import Sensors
from towtank.vehicle import load_vehicle

N = 3000
T = np.arange(N) / 100.0
MOTION = 0.5 * np.sin(0.9 * T) + 0.2 * np.sin(2.3 * T)


def white(seed: int, n: int = N) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n)


def square_wave(sensors: Sensors, seed: int, seconds: float = 30.0) -> Recording:
    vehicle = load_vehicle("vlbv300")
    commands = paper_commands(vehicle, square_orders(0.01 * np.arange(100.0 * seconds), 30.0))
    return simulate(vehicle, commands=commands, dt=0.01, sensors=sensors, seed=seed)


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_on_motion(seed: int) -> None:
    level = noise_level(T, MOTION + 0.003 * white(seed))
    assert level.std == pytest.approx(0.003, rel=0.06)
    assert level.white
    assert not level.dead
    assert (level.rate, level.quantum, level.share_of_outliers, level.samples) == (100.0, 0.0, 0.0, N)


def test_it_scales_with_the_unit_and_ignores_offset_and_drift() -> None:
    x = MOTION + 0.003 * white(1)
    base = noise_level(T, x).std
    assert noise_level(T, 1e-6 * x).std == pytest.approx(1e-6 * base, rel=1e-9)
    assert noise_level(T, 1e6 * x).std == pytest.approx(1e6 * base, rel=1e-9)
    assert noise_level(T, x + 1000.0 + 3.0 * T).std == pytest.approx(base, rel=1e-3)


def test_irregular_times_do_not_count_as_noise() -> None:
    t = T + np.random.default_rng(5).uniform(0.0, 0.008, N)
    fast = 2.0 * np.sin(2.0 * t)
    assert noise_level(t, fast + 0.002 * white(2)).std == pytest.approx(0.002, rel=0.08)
    assert noise_level(t, fast).std < 2e-5


def test_an_angle_that_wraps() -> None:
    psi = np.angle(np.exp(1j * (2.0 * T + 0.002 * white(3))))
    assert noise_level(T, psi, "angle").std == pytest.approx(0.002, rel=0.06)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("millimetres", [1.0, 5.0])
def test_motion_capture_with_occlusions(millimetres: float, seed: int) -> None:
    levels = noise_levels(square_wave(Mocap(noise_mm=millimetres), seed))
    assert list(levels) == ["x", "y", "z", "phi", "theta", "psi"]
    for name, level in levels.items():
        assert level.std == pytest.approx(1e-3 * (millimetres if name in "xyz" else 1.0), rel=0.1), name
        assert level.white


def test_the_time_on_a_false_offset_is_counted() -> None:
    found = [noise_levels(square_wave(Mocap(noise_mm=1.0), seed))["x"].share_of_outliers for seed in range(4)]
    assert 0.004 < np.mean(found) < 0.025  # 1.4 % of the time, of which those along x stand out
    spiked = MOTION + 0.001 * white(4)
    spiked[[300, 900, 901, 2000]] += 0.2
    assert noise_level(T, spiked).share_of_outliers == pytest.approx(4 / N)


@pytest.mark.parametrize("seed", range(3))
def test_inertial_sensors_each_at_its_rate(seed: int) -> None:
    levels = noise_levels(square_wave(Ins(), seed, seconds=60.0))
    expected = {"p": 2e-3, "q": 2e-3, "r": 2e-3, "ax": 0.02, "ay": 0.02, "az": 0.02, "phi": 2e-3, "psi": 5e-3}
    for name, std in expected.items():
        assert levels[name].std == pytest.approx(std, rel=0.1), name
    # 8 or 10 samples a second, in motion: a fifth is what can be had
    for name in ("u", "v", "w", "z"):
        assert levels[name].std == pytest.approx(5e-3, rel=0.2), name
    assert (levels["u"].rate, levels["z"].rate, levels["p"].rate) == (8.0, 10.0, 100.0)


def test_without_noise_there_is_none() -> None:
    for name, level in noise_levels(simulate(load_vehicle("vlbv300"), duration=5.0, wrench=None)).items():
        assert level.std < 1e-9, name


def test_a_coarse_depth_sensor() -> None:
    depth = np.round(2.0 + 0.3 * np.sin(0.5 * T) + 0.005 * white(6), 2)
    level = noise_level(T, depth)
    assert level.quantum == pytest.approx(0.01)
    assert level.std == pytest.approx(np.hypot(0.005, 0.01 / np.sqrt(12.0)), rel=0.12)


@pytest.mark.parametrize("quantum", [0.01, 0.0010642])
def test_a_stair_has_at_least_the_noise_of_rounding(quantum: float) -> None:
    stair = quantum * np.round((2.0 + 0.03 * T) / quantum)
    level = noise_level(T, stair)
    assert level.std == pytest.approx(quantum / np.sqrt(12.0), rel=1e-6)
    assert not level.white


def test_a_gyro_in_whole_numbers() -> None:
    counts = np.round(MOTION / 0.00106 + 2.0 * white(7))
    level = noise_level(T, np.round(0.0010642 * counts, 5))
    assert level.std == pytest.approx(0.0010642 * np.hypot(2.0, 12.0**-0.5), rel=0.08)


def test_repeated_samples_are_no_news() -> None:
    slow = 0.004 * white(8, N // 5) + MOTION[::5]
    level = noise_level(T, np.repeat(slow, 5))
    assert level.std == pytest.approx(0.004, rel=0.12)
    assert (level.rate, level.samples) == (20.0, N // 5)
    assert level.of_each(100.0) == pytest.approx(level.std * np.sqrt(5.0))
    assert level.of_each(20.0) == level.std


@pytest.mark.parametrize("step", [0.08, 0.092])
@pytest.mark.parametrize("decimals", [4, 12])
def test_lines_drawn_between_samples_are_no_news(step: float, decimals: int) -> None:
    knots = np.arange(0.0, 30.0, step)
    x = np.interp(T, knots, 0.5 * np.sin(0.9 * knots) + 0.004 * white(9, knots.size))
    level = noise_level(T, np.round(x, decimals))
    assert level.std == pytest.approx(0.004, rel=0.15)
    assert level.rate == pytest.approx(1.0 / step, rel=0.05)


def test_gaps_are_not_crossed() -> None:
    keep = (T % 3.0) < 2.0
    assert noise_level(T[keep], (40.0 * T + 0.003 * white(10))[keep]).std == pytest.approx(0.003, rel=0.08)


def test_missing_values_and_dead_or_short_channels() -> None:
    x = 0.003 * white(11)
    x[::7] = np.nan
    assert noise_level(T, x).std == pytest.approx(0.003, rel=0.08)
    dead = noise_level(T, np.full(N, 3.25))
    assert (dead.std, dead.dead, dead.white) == (0.0, True, False)
    for few in (0, 1, 2, 5):
        level = noise_level(T[:few], white(12)[:few])
        assert np.isnan(level.std)
        assert not level.white
    assert np.isnan(noise_level(T, np.full(N, np.nan)).std)


def test_a_smoothed_channel_is_not_called_white() -> None:
    smooth = np.convolve(white(13, N + 39), np.hanning(40) / np.hanning(40).sum(), "valid")
    assert not noise_level(T, smooth).white


def test_a_long_log_is_sampled_in_blocks() -> None:
    n = 300_000  # one hour and more
    level = noise_level(0.01 * np.arange(float(n)), 0.002 * white(14, n))
    assert level.std == pytest.approx(0.002, rel=0.02)
    assert level.samples < n
    assert level.rate == 100.0


def test_an_attitude_in_quaternions_is_told_in_angles() -> None:
    angles = np.column_stack([0.2 * MOTION, 0.1 * MOTION, 2.0 * T]) + 0.002 * white(15, 3 * N).reshape(N, 3)
    q = quaternions_from_eulers(angles)
    columns = {name: q[:, j] for j, name in enumerate(("qw", "qx", "qy", "qz"))}
    levels = noise_levels(Recording.from_table(T, columns))
    assert list(levels) == ["phi", "theta", "psi"]
    for level in levels.values():
        assert level.std == pytest.approx(0.002, rel=0.08)


def test_a_quantum_is_only_told_where_it_shows() -> None:
    assert quantum_of(np.round(white(16), 1)) == pytest.approx(0.1)
    assert quantum_of(np.round(white(17), 4)) == 0.0
    assert quantum_of(white(18)) == 0.0
    assert quantum_of(np.zeros(5)) == 0.0


def test_fresh_channels_pass_untouched() -> None:
    coarse = [
        np.round(MOTION / q + share * white(20)) * q for q in (0.01, 0.002) for share in (0.0, 0.3, 1.0, 1.5, 3.0)
    ]
    for x in (MOTION, MOTION + 0.01 * white(19), *coarse):
        t, kept = fresh_samples(T, x, quantum_of(np.diff(x)))
        assert t.size == N
        assert np.array_equal(kept, x)


def test_arrays_of_two_lengths_are_refused() -> None:
    with pytest.raises(InputError, match="one length"):
        noise_level(T, white(0)[:-1])


def test_real_gyros_and_pressure(data: Path, tmp_path: Path) -> None:
    found = sorted(data.glob("bluerov_pool_2016/all_3_*.csv"))
    if not found:
        pytest.skip(f"no bluerov_pool_2016/all_3_*.csv in {data}")
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]\n[columns]\np = "gyro_p"\nq = "gyro_q"\n'
        'r = "gyro_r"\naz = "acc_z"\nz = { from = "pressure_rel_Pa", scale = 1.0197e-4 }\n'
    )
    levels = noise_levels(read_csv(found[0], load_mapping(mapping)))
    for name in "pqr":  # thrusters shake the frame
        assert 0.005 < levels[name].std < 0.05
    assert 0.2 < levels["az"].std < 1.0
    # the pressure came ten times a second and was drawn into lines
    assert 0.003 < levels["z"].std < 0.03
    assert 9.0 < levels["z"].rate < 13.0
