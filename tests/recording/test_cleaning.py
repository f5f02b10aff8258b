"""Spikes are found, and what only looks like one is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.recording import Recording, dead_channels, find_spikes
from towtank.recording.frames.conversion import wrap_angle

N = 2000
T = np.arange(N) / 100.0
RNG = np.random.default_rng(4)
NOISE = 0.002 * RNG.normal(size=N)
MOTION = 0.5 * np.sin(0.9 * T) + 0.2 * np.sin(2.3 * T)
AT = [3, 100, 102, 700, 1500, 1996]


def spiked(x: np.ndarray, height: float) -> np.ndarray:
    out = x.copy()
    out[AT] += height * np.array([1, -1, 1, -1, 1, 1])
    return out


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_isolated_outliers_are_found_and_nothing_else(noise: float) -> None:
    assert find_spikes(T, spiked(MOTION + noise * NOISE, 0.6)).tolist() == AT


def test_irregular_times() -> None:
    t = np.sort(RNG.uniform(0, 20, N)) + np.arange(N) * 1e-6
    x = 0.5 * np.sin(0.9 * t) + NOISE
    assert find_spikes(t, spiked(x, 2.0)).tolist() == AT


def test_a_heading_that_wraps() -> None:
    psi = wrap_angle(2.0 * T + NOISE)
    assert not find_spikes(T, psi, "angle").size
    assert find_spikes(T, wrap_angle(spiked(psi, 1.5)), "angle").tolist() == AT


def test_attitudes_of_either_sign() -> None:
    q = quaternions_from_eulers(np.column_stack([MOTION, 0.3 * MOTION, 2 * T])) * RNG.choice([-1.0, 1.0], N)[:, None]
    assert not find_spikes(T, q, "quaternion").size
    bad = q.copy()
    bad[AT] = quaternions_from_eulers(np.tile([[1.5, 1.0, 0.2]], (len(AT), 1)))
    assert find_spikes(T, bad, "quaternion").tolist() == AT


def telegraph(period: int) -> np.ndarray:
    return np.where((np.arange(N) // period) % 2 == 0, 1.0, -1.0)


def plateau(length: int) -> np.ndarray:
    x = NOISE.copy()
    for start in range(100, N - 100, 300):
        x[start : start + length] += 0.03
    return x


def triangle_after_rest() -> np.ndarray:
    x = np.zeros(N)
    x[1000:1003] = [1.0, 2.0, 3.0]
    x[1003:1005] = [2.0, 1.0]
    return x


def shaking_after_rest() -> np.ndarray:
    x = NOISE.copy()
    x[1000:1006] += 0.5 * np.array([1, -1, 1, -1, 1, -1])
    return x


LEGITIMATE = {
    "shaking for 0.06 s": shaking_after_rest(),
    "constant": np.full(N, 3.7),
    "zero": np.zeros(N),
    "steps": telegraph(100),
    "fast steps": telegraph(2),
    "steps with noise": telegraph(50) + NOISE,
    "velocity under a square wave": np.cumsum(telegraph(25)) * 0.01,
    "relaxation under a telegraph": np.convolve(telegraph(40), np.exp(-np.arange(400) / 30) / 30)[:N],
    "occlusion of 0.1 s": plateau(10),
    "occlusion of 0.5 s": plateau(50),
    "plateau of two samples": plateau(2),
    "coarse quantiser": np.round(MOTION, 2),
    "flicker of one bit": np.where(RNG.random(N) < 0.05, 0.01, 0.0),
    "held slow sensor": np.repeat(MOTION[::20], 20),
    "white noise": RNG.normal(size=N),
    "triangle after rest": triangle_after_rest(),
    "start from rest": np.where(T < 10, 0.0, 1 - np.exp(-(T - 10))),
    "chirp": np.sin(2 * np.pi * T**2 / 4),
}


@pytest.mark.parametrize("name", LEGITIMATE)
def test_what_is_no_spike_stays(name: str) -> None:
    assert not find_spikes(T, LEGITIMATE[name]).size


def test_a_channel_full_of_outliers_is_left_alone() -> None:
    x = NOISE + np.where(np.arange(N) % 20 == 0, 1.0, 0.0)
    assert not find_spikes(T, x).size


def test_neighbours_over_a_gap_are_none() -> None:
    t = T.copy()
    t[700:] += 10.0
    t[701:] += 10.0
    x = NOISE.copy()
    x[700] = 5.0
    assert not find_spikes(t, x).size


def test_short_channels() -> None:
    for n in range(5):
        assert not find_spikes(T[:n], NOISE[:n]).size


def test_dead_sensors() -> None:
    alive = {"p": NOISE, "q": MOTION + RNG.normal(size=N) * 0.01}
    assert dead_channels(Recording.from_table(T, {**alive, "r": np.zeros(N)})) == ("r",)
    died = np.where(T < 8, MOTION + RNG.normal(size=N) * 0.01, 0.123)
    assert dead_channels(Recording.from_table(T, {**alive, "r": died})) == ("r",)


def test_a_sensor_that_dies_as_a_whole_is_dead() -> None:
    noisy = {name: MOTION + RNG.normal(size=N) * 0.01 for name in ("x", "y", "z")}
    dead = {name: np.where(T < 8, x, 0.123) for name, x in noisy.items()}
    assert dead_channels(Recording.from_table(T, dead)) == ("x", "y", "z")
    assert dead_channels(Recording.from_table(T, {**dead, "z": noisy["z"]})) == ("x", "y")
    assert dead_channels(Recording.from_table(T, {"z": dead["z"]})) == ()  # a depth that is held, for all one can tell


def test_what_stands_still_for_good_reason_is_not_dead() -> None:
    smooth = {"u": MOTION, "v": 0 * T, "w": 0 * T, "p": 0 * T, "q": 0 * T, "r": MOTION, "z": 0 * T + 5, "x": MOTION}
    assert dead_channels(Recording.from_table(T, smooth)) == ()
    depth = {"z": 0 * T + 5, "cmd_a": 0 * T, "ax": NOISE, "ay": NOISE[::-1], "voltage": 0 * T + 16}
    assert dead_channels(Recording.from_table(T, depth)) == ()
    stopped = np.where(T < 8, MOTION, 0.0)
    assert dead_channels(Recording.from_table(T, {"p": NOISE, "r": stopped})) == ()
