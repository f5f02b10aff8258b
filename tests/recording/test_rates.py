"""Rates in the wrong unit are told by the attitude beside them, and mended; those in the right one are left alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.recording import Recording, standard_channel
from towtank.recording.consistency import inconsistencies
from towtank.recording.consistency.rates import rate_scales, with_rates_in_radians

DEGREES = 180.0 / np.pi
RATES, ANGLES = ("p", "q", "r"), ("phi", "theta", "psi")


def run_of(
    seconds: float = 40.0,
    *,
    scales: Sequence[float] = (1.0, 1.0, 1.0),
    rates: tuple[float, float] = (100.0, 50.0),
    size: float = 0.3,
    noise: tuple[float, float] = (3e-3, 3e-3),
    late: float = 0.0,
    seed: int = 0,
) -> Recording:
    """A body that turns: gyro and attitude at these rates [Hz], with noise [rad/s, rad]; `late` [s] the attitude."""
    rng = np.random.default_rng(seed)
    omega, phase = 2.0 * np.pi * rng.uniform(0.05, 0.5, (3, 6)), rng.uniform(0.0, 6.28, (3, 6))
    each = size * np.array([0.5, 0.5, 1.0])[:, None] / np.sqrt(3.0) / omega

    def angles(t: np.ndarray) -> np.ndarray:
        return (each[..., None] * np.sin(omega[..., None] * t + phase[..., None])).sum(1)

    def turning(t: np.ndarray) -> np.ndarray:
        return ((each * omega)[..., None] * np.cos(omega[..., None] * t + phase[..., None])).sum(1)

    t, own = (np.arange(round(seconds * rate)) / rate for rate in rates)
    (phi, theta, _), (f, g, h) = angles(t), turning(t)
    body = np.stack(
        [
            f - np.sin(theta) * h,
            np.cos(phi) * g + np.cos(theta) * np.sin(phi) * h,
            np.cos(theta) * np.cos(phi) * h - np.sin(phi) * g,
        ]
    )
    measured = np.array(scales)[:, None] * (body + noise[0] * rng.normal(size=body.shape))
    seen = angles(own - late) + noise[1] * rng.normal(size=(3, own.size))
    return Recording(
        {name: standard_channel(name, t, x) for name, x in zip(RATES, measured, strict=True)}
        | {name: standard_channel(name, own, x) for name, x in zip(ANGLES, seen, strict=True)}
    )


def factors(run: Recording) -> list[float]:
    """By what each rate was multiplied."""
    mended = with_rates_in_radians(run)
    return [float(mended[name].values[0] / run[name].values[0]) for name in RATES if name in run]


@pytest.mark.parametrize("seconds", [8.0, 40.0])
@pytest.mark.parametrize("wrong, to", [(DEGREES, 1.0 / DEGREES), (1.0 / DEGREES, DEGREES)])
def test_degrees_and_radians_are_told_apart(seconds: float, wrong: float, to: float) -> None:
    run = run_of(seconds, scales=[wrong] * 3)
    assert factors(run) == pytest.approx([to] * 3)
    [note] = with_rates_in_radians(run).notes
    assert note.startswith("p q r were ")
    assert f"multiplied by {to:.6g}" in note
    told = float(note.split(": ")[1].split(" ± ")[0].split()[-1])
    assert told == pytest.approx(wrong, rel=0.03)


def test_one_column_without_its_scale_is_mended_alone() -> None:
    assert factors(run_of(scales=[1.0, 1.0, DEGREES])) == pytest.approx([1.0, 1.0, 1.0 / DEGREES])


def test_an_axis_at_rest_follows_the_others() -> None:
    run = run_of(scales=[DEGREES] * 3)
    still = {name: run[name].with_values(1e-3 * DEGREES * np.random.default_rng(1).normal(size=4000)) for name in "pq"}
    level = {name: run[name].with_values(np.zeros(2000)) for name in ("phi", "theta")}
    assert factors(run.replace({**still, **level})) == pytest.approx([1.0 / DEGREES] * 3)


@pytest.mark.parametrize("angle, rate", [("phi", "p"), ("theta", "q"), ("psi", "r")])
def test_a_single_angle_will_do(angle: str, rate: str) -> None:
    run = run_of(scales=[DEGREES] * 3)
    alone = Recording({name: run[name] for name in (angle, rate)})
    assert with_rates_in_radians(alone)[rate].values[0] == pytest.approx(run[rate].values[0] / DEGREES)


def test_the_deviation_of_a_scale_is_that_of_its_errors() -> None:
    found = [rate_scales(run_of(seed=k, noise=(3e-3, 1e-2))) for k in range(30)]
    assert all(len(each) == 3 for each in found)
    beyond = [abs(x.scale - 1.0) / x.std for each in found for x in each]
    assert np.mean(np.array(beyond) < 3.0) > 0.7  # noise makes a scale too small or too large, on top of its deviation
    assert max(abs(x.scale - 1.0) for each in found for x in each) < 0.2


@pytest.mark.parametrize("seconds", [2.0, 5.0, 10.0, 60.0])
@pytest.mark.parametrize("rates", [(200.0, 100.0), (50.0, 10.0), (10.0, 4.0), (10.0, 50.0)])
@pytest.mark.parametrize("noise", [(0.0, 0.0), (3e-3, 3e-3), (0.1, 1e-3), (3e-3, 0.1)])
def test_no_sound_recording_is_mended(seconds: float, rates: tuple[float, float], noise: tuple[float, float]) -> None:
    for seed, size in enumerate((0.0, 1e-3, 0.03, 0.3, 1.0)):
        run = run_of(seconds, rates=rates, noise=noise, size=size, seed=seed, late=0.1 * seed)
        assert with_rates_in_radians(run) is run


@pytest.mark.parametrize("sensors", ["perfect", "mocap", "ins", "ins-water"])
def test_no_simulated_recording_is_mended(sensors: str) -> None:
    vehicle = tt.load_vehicle("bluerov2_heavy")
    rng = np.random.default_rng(5)
    for seconds in (3.0, 30.0):
        wrench = 4.0 * np.repeat(rng.normal(size=(round(seconds), 6)), 100, axis=0) * [1, 1, 1, 0.1, 0.1, 0.2]
        run = tt.simulate(vehicle, wrench=wrench, dt=0.01, sensors=sensors, seed=3)
        assert with_rates_in_radians(run) is run
        gap = run.with_channels(
            standard_channel(c.name, c.t[(c.t % 3.0) > 0.7], c.values[(c.t % 3.0) > 0.7]) for c in run.channels.values()
        )
        assert with_rates_in_radians(gap) is gap


def test_a_damaged_message_does_not_hide_the_unit() -> None:
    run = run_of(scales=[DEGREES] * 3)
    values = run["r"].values.copy()
    values[[700, 2500]] = 1e9
    assert factors(run.replace([run["r"].with_values(values)])) == pytest.approx([1.0 / DEGREES] * 3)


def test_a_sign_is_told_by_a_single_angle() -> None:
    run = run_of(30.0, scales=[1.0, -1.0, 1.0], size=0.1)
    [finding] = inconsistencies(Recording({name: run[name] for name in ("q", "theta")}))
    assert finding.what == "q"
    assert "times what the attitude does: its sign" in finding.text


def test_another_scale_is_said_with_its_deviation() -> None:
    [finding] = inconsistencies(run_of(40.0, scales=[1.0, 1.0, 17.0]))
    assert finding.what == "r"
    assert "r is 17 times what the attitude does" in finding.text
    told, std = finding.text.split("; found ")[1].split(" ± ")
    assert float(told) == pytest.approx(17.0, rel=0.02)
    assert 0.0 < float(std) < 0.5


def test_rates_that_no_vehicle_turns_at_are_doubted_without_an_attitude() -> None:
    run = run_of(scales=[DEGREES] * 3)
    [finding] = inconsistencies(Recording({name: run[name] for name in RATES}))
    assert "degrees, not radians?" in finding.text
    assert inconsistencies(Recording({name: run_of()[name] for name in RATES})) == ()


def test_a_file_in_degrees_is_read_in_radians(tmp_path: Path) -> None:
    log = tmp_path / "gyro.csv"
    right = run_of(20.0, rates=(50.0, 50.0))
    wrong = right.replace([right[name].with_values(DEGREES * right[name].values) for name in RATES])
    wrong.write(log)
    read = tt.read(log)
    np.testing.assert_allclose(read["r"].values, right["r"].values, rtol=1e-9)
    assert any("were in degrees per second" in note for note in read.notes)


@pytest.mark.parametrize(
    "name",
    [
        "ardusub_samples/2023-04-18_11-03-34.tlog",
        "ardusub_samples/small.tlog",
        "ardusub_samples/small.BIN",
        "bluerov2_dvl_sea_2026/orig/00000029_filtered.BIN",
        "bluerov2_dvl_sea_2026/run_20hz.csv",
    ],
)
def test_no_real_recording_is_mended(data: Path, name: str) -> None:
    log = data / name
    if not log.exists():
        pytest.skip(f"{log} is not there")
    run = tt.read(log)
    assert not any("times what the attitude does" in note for note in run.notes)
    assert all(abs(each.scale - 1.0) < 0.1 or abs(each.scale - 1.0) < 2.0 * each.std for each in rate_scales(run))
