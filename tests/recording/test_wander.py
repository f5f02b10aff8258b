"""How far speeds wander off their pose: white noise comes back as it was put in, what a filter did shows."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from towtank.core.attitude import quaternions_from_eulers
from towtank.recording import Recording
from towtank.recording.consistency.accounts import of_heading, of_rates, of_velocity
from towtank.recording.consistency.wander import noise_of_smooth_speeds, smooth_speeds, wander_of
from towtank.recording.standard import MEASURED

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from pushed_box import STEP, mean_over

RATE, SECONDS = 1.0 / STEP, 200.0
U, V, P, Q, R = (MEASURED.index(name) for name in "uvpqr")
Columns = dict[str, np.ndarray]


def boat(seed: int = 0, *, place: float = 2e-3, angle: float = 5e-4) -> tuple[np.ndarray, Columns]:
    """Times, and columns of a boat that turns to and fro at random: pose with white noise, exact speeds."""
    rng = np.random.default_rng(seed)
    dt = 1.0 / RATE / 10.0
    t = np.arange(0.0, SECONDS, dt)
    r, u, v = (
        sum(
            size * np.sin(w * t + phase)
            for w, phase in zip(rng.uniform(0.3, 2.5, 8), rng.uniform(0, 6, 8), strict=True)
        )
        for size in (0.08, 0.06, 0.02)
    )
    psi = np.cumsum(r) * dt
    x, y = np.cumsum(u * np.cos(psi) - v * np.sin(psi)) * dt, np.cumsum(u * np.sin(psi) + v * np.cos(psi)) * dt
    out = {name: each[::10].copy() for name, each in {"x": x, "y": y, "psi": psi, "u": u, "v": v, "r": r}.items()}
    for name, noise in (("x", place), ("y", place), ("psi", angle)):
        out[name] += noise * rng.normal(size=out[name].size)
    return t[::10], out


def recorded(t: np.ndarray, columns: Columns, without: str = "") -> Recording:
    return Recording.from_table(t, {name: x for name, x in columns.items() if name not in without.split()})


def wander_of_speeds(recording: Recording) -> np.ndarray:
    """The noise (18,) that poses speak for, NaN where none does."""
    out = np.full(len(MEASURED), np.nan)
    for pair in (make(recording) for make in (of_velocity, of_rates, of_heading)):
        for name, noise in wander_of(pair, recording).items() if pair is not None else ():
            out[MEASURED.index(name)] = noise
    return out


@pytest.mark.parametrize(("column", "noise"), [("u", 0.03), ("v", 0.03), ("r", 0.02)])
def test_white_noise_of_a_speed_comes_back(column: str, noise: float) -> None:
    found = []
    for seed in range(5):
        t, columns = boat(seed, place=1e-3)
        columns[column] += noise * np.random.default_rng(seed + 10).normal(size=t.size)
        found.append(wander_of_speeds(recorded(t, columns))[MEASURED.index(column)])
    assert np.mean(found) == pytest.approx(noise, rel=0.25)


def test_of_three_rates_each_has_its_own() -> None:
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    rng = np.random.default_rng(3)
    zero = np.zeros(t.size)
    columns = {
        "phi": zero,
        "theta": 0.1 * np.sin(2.0 * t),
        "psi": zero,
        "p": zero,
        "q": 0.2 * np.cos(2.0 * t),
        "r": zero,
    }
    columns = {name: x + 1e-4 * rng.normal(size=t.size) for name, x in columns.items()}
    columns["q"] += 0.02 * rng.normal(size=t.size)
    found = wander_of_speeds(recorded(t, columns))
    assert found[Q] == pytest.approx(0.02, rel=0.25)
    assert max(found[P], found[R]) < 1e-3


def test_a_bias_a_scale_and_a_lag_are_no_noise() -> None:
    t, columns = boat()
    late = {"r": 0.03 + 1.05 * columns["r"], "u": 0.05 + 0.95 * columns["u"], "v": columns["v"]}
    pose = recorded(t, columns, without="u v r")
    found = wander_of_speeds(pose.replace(recorded(t + 0.12, late).channels))
    for column, name in ((R, "r"), (U, "u")):
        assert found[column] < 0.1 * np.std(columns[name])


def test_a_lag_in_the_rows_of_the_pose_is_noise_for_nothing_else_allows_for_it() -> None:
    """As a low-pass filter of first order leaves it; of one device learning finds no latency."""
    t, columns = boat()
    kept = np.exp(-STEP / 0.3)
    columns["r"] = lfilter([1.0 - kept], [1.0, -kept], columns["r"])
    columns["v"] = np.interp(t - 0.12, t, columns["v"])
    found = wander_of_speeds(recorded(t, columns))
    for column, name in ((R, "r"), (V, "v")):
        assert found[column] > 0.5 * np.std(columns[name])


@pytest.mark.parametrize("seconds", [0.6, 1.2])
def test_a_rate_that_was_smoothed_is_as_noisy_as_its_errors_that_go_together(seconds: float) -> None:
    """They last for about as long as the mean is taken over, and so many samples count as one."""
    t, columns = boat()
    smooth = mean_over(columns["r"], seconds)
    errors = float(np.std(columns["r"] - smooth))
    columns["r"] = smooth
    found = wander_of_speeds(recorded(t, columns))[R]
    assert errors < found < 1.2 * errors * np.sqrt(seconds * RATE)
    noise = noise_of_smooth_speeds([recorded(t, columns)])
    assert noise[R] == 2.0 * found
    assert not np.delete(noise, R).any()


def test_numbers_of_one_sensor_count_alike() -> None:
    t, columns = boat()
    columns = {**columns, "u": mean_over(columns["u"], 1.2), "v": mean_over(columns["v"], 1.2)}
    recording = recorded(t, columns)
    (found,) = smooth_speeds([recording])
    assert found.names == ("u", "v")
    assert found.source == "the position"
    assert found.noise == np.nanmax(wander_of_speeds(recording)[[U, V]])
    assert noise_of_smooth_speeds([recording])[U] == noise_of_smooth_speeds([recording])[V] == 2.0 * found.noise


def test_an_attitude_of_quaternions_that_shows_no_noise_has_that_of_a_usual_sensor_too() -> None:
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    rng = np.random.default_rng(5)
    angles = np.column_stack([0.1 * np.sin(2.0 * t), 0.1 * np.cos(1.7 * t), 0.3 * np.sin(1.1 * t)])
    q = quaternions_from_eulers(angles + 1e-5 * rng.normal(size=angles.shape))
    rates = np.gradient(angles, t, axis=0)
    columns = dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))
    columns |= {name: mean_over(x, 1.2) for name, x in zip("pqr", rates.T, strict=True)}
    noise = noise_of_smooth_speeds([recorded(t, columns)])
    np.testing.assert_array_equal(noise[3:6], 2e-3)
    assert (noise[9:12] > 0.01).all()


def test_what_the_pose_hides_counts_as_much_as_it_could_be_where_another_sensor_was_smoothed() -> None:
    t, columns = boat(place=0.02)
    columns = {**columns, "u": mean_over(columns["u"], 0.3), "v": mean_over(columns["v"], 0.3)}
    assert not smooth_speeds([recorded(t, columns)])
    rate = {**columns, "r": mean_over(columns["r"], 1.2)}
    place, heading = smooth_speeds([recorded(t, rate)])
    assert (place.names, heading.names) == (("u", "v"), ("r",))
    assert 0.02 < place.noise < 0.2
    honest = {**rate, "u": rate["u"] + 0.01 * np.random.default_rng(1).normal(size=t.size)}
    assert [each.names for each in smooth_speeds([recorded(t, honest)])] == [("v",), ("r",)]


def test_a_pose_that_shows_no_noise_beside_smoothed_speeds_has_that_of_a_usual_sensor() -> None:
    t, columns = boat(angle=1e-5)
    smooth = {**columns, "r": mean_over(columns["r"], 1.2)}
    noise = noise_of_smooth_speeds([recorded(t, smooth)])
    assert noise[MEASURED.index("psi")] == 2e-3
    assert noise[MEASURED.index("x")] == 0.0  # 2 mm are its own
    assert not noise_of_smooth_speeds([recorded(t, columns)]).any()


def test_the_largest_of_all_recordings_counts() -> None:
    t, columns = boat()
    right, little, much = (recorded(t, {**columns, "r": mean_over(columns["r"], each)}) for each in (0.0, 0.6, 1.2))
    less, most = (noise_of_smooth_speeds([each])[R] for each in (little, much))
    assert most > less > 0.0
    assert noise_of_smooth_speeds([right])[R] == 0.0
    for order in ([right, little, much], [much, right, little]):
        assert noise_of_smooth_speeds(order)[R] == most


def test_what_one_recording_tells_of_a_column_is_not_lost_to_another_that_tells_of_fewer() -> None:
    t, columns = boat()
    both = recorded(t, {**columns, "u": mean_over(columns["u"], 0.6), "v": mean_over(columns["v"], 0.6)})
    one = recorded(t, {**columns, "u": mean_over(columns["u"], 2.4)}, without="v")
    noise = noise_of_smooth_speeds([both, one])
    assert noise[U] == noise[V] == noise_of_smooth_speeds([one])[U] > noise_of_smooth_speeds([both])[U]


def test_a_gyro_that_shows_noise_of_its_own_is_believed_beside_a_heading_that_wanders() -> None:
    t, columns = boat()
    rng = np.random.default_rng(1)
    columns["psi"] = columns["psi"] + np.cumsum(0.01 * rng.normal(size=t.size))
    columns["r"] = columns["r"] + 1e-3 * rng.normal(size=t.size)
    turning = recorded(t, columns, without="x y u v")
    assert wander_of_speeds(turning)[R] > 0.02
    assert not noise_of_smooth_speeds([turning]).any()


@pytest.mark.parametrize("walk", [0.003, 0.01])
def test_a_gyro_that_shows_none_is_believed_beside_a_heading_that_wanders_evenly_on(walk: float) -> None:
    """Beside a whole attitude, of whose heading the filter asks whether it is off; unless the rate differs far more
    because it was smoothed: then its errors go together, and no longer than that."""
    t, columns = boat()
    columns["psi"] = columns["psi"] + np.cumsum(walk * np.random.default_rng(1).normal(size=t.size))
    columns |= {name: 5e-4 * np.random.default_rng(2).normal(size=t.size) for name in ("phi", "theta")}
    turning = recorded(t, columns, without="x y u v")
    assert wander_of_speeds(turning)[R] > 0.02
    assert not smooth_speeds([turning])
    assert smooth_speeds([turning.without("phi", "theta")])
    smooth = recorded(t, {**columns, "r": mean_over(columns["r"], 2.4)}, without="x y u v")
    assert smooth_speeds([smooth])


def test_where_the_pose_hides_it_or_is_not_there_nothing_is_said() -> None:
    t, columns = boat(place=1.0)  # fixes of a satellite receiver
    columns["u"] = mean_over(columns["u"], 1.2)
    assert wander_of_speeds(recorded(t, columns))[U] == 0.0
    assert np.isnan(wander_of_speeds(recorded(t, columns, without="psi"))).all()
    short = slice(0, round(3.0 * RATE))
    assert np.isnan(wander_of_speeds(recorded(t[short], {name: x[short] for name, x in columns.items()}))).all()


def test_gaps_and_a_pose_at_times_of_its_own_change_little() -> None:
    t, columns = boat()
    columns["r"] = mean_over(columns["r"], 1.2)
    whole = wander_of_speeds(recorded(t, columns))[R]
    kept = np.ones(t.size, dtype=bool)
    kept[1200:1500] = False
    columns["psi"] = np.where(kept & (np.arange(t.size) % 2 == 0), columns["psi"], np.nan)
    assert wander_of_speeds(recorded(t, columns))[R] == pytest.approx(whole, rel=0.25)
