"""Sensors: rates, noise, bias, jumps and dropouts as stated; an accelerometer feels what physics says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from towtank.core.attitude import rotation_from_euler
from towtank.errors import InputError
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, Perfect, Together, WaterTrack, simulate, stream
from towtank.simulation.sensors.mocap import intervals

from .vessels import table, vessel

LONG: dict[str, Any] = {"duration": 400.0, "dt": 0.05}
POSE = ("x", "y", "z", "phi", "theta", "psi")


def at_rest(sensors: Any, seed: int = 1) -> Recording:
    return simulate(vessel(), sensors=sensors, seed=seed, **LONG)


def test_mocap_noise() -> None:
    run = at_rest(Mocap(noise_mm=5.0, noise_mrad=2.0, jump_fraction=0.0))
    values = table(run, POSE)
    np.testing.assert_allclose(values[:, :3].std(axis=0), 5e-3, rtol=0.05)
    np.testing.assert_allclose(values[:, 3:].std(axis=0), 2e-3, rtol=0.05)
    correlation = np.corrcoef(values.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.05
    assert set(run.names).isdisjoint("uvwpqr")


def test_mocap_jumps() -> None:
    run = at_rest(Mocap(noise_mm=0.0, noise_mrad=0.0, jump_fraction=0.2))
    offsets = np.linalg.norm(table(run, "xyz"), axis=1)
    hidden = offsets > 0.0
    assert hidden.mean() == pytest.approx(0.2, abs=0.05)
    assert offsets[hidden].min() > 0.0099
    assert offsets.max() < 0.0501
    assert not table(run, ("phi", "theta", "psi")).any()
    lengths = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], hidden, [0]]))))[::2] * 0.05
    assert lengths.max() <= 1.1  # two may touch
    assert np.median(lengths) == pytest.approx(0.3, abs=0.11)


def test_fraction_covered_by_intervals() -> None:
    t = np.arange(0.0, 20000.0, 0.01)
    which = intervals(t, 0.014, (0.1, 0.5), stream(1, "test"))
    assert (which >= 0).mean() == pytest.approx(0.014, rel=0.1)
    assert (intervals(t[:100], 0.0, (0.1, 0.5), stream(1, "test")) == -1).all()


def test_mocap_dropouts() -> None:
    run = at_rest(Mocap(dropout_fraction=0.1))
    lost = np.isnan(table(run, POSE))
    assert (lost.all(axis=1) == lost.any(axis=1)).all()
    assert lost[:, 0].mean() == pytest.approx(0.1, abs=0.04)


def test_rates_of_the_ins() -> None:
    run = simulate(vessel(), duration=10.0, sensors="ins")
    counts = {name: len(run[name]) for name in ("p", "ax", "u", "z", "phi")}
    assert counts == {"p": 1001, "ax": 1001, "u": 81, "z": 101, "phi": 501}
    assert "x" not in run
    grid = run["u"].t / 0.01
    np.testing.assert_allclose(grid, np.round(grid), atol=1e-9)
    np.testing.assert_allclose(run["u"].t, np.arange(81) / 8.0, atol=0.0051)
    assert len(simulate(vessel(), duration=10.0, dt=0.1, sensors="mocap")["x"]) == 101  # at most one a step


def test_ins_noise_and_bias() -> None:
    sensors = Ins(gyro_bias=0.02, accelerometer_bias=0.3)
    names = ("p", "q", "r", "ax", "ay", "az")
    settings: dict[str, Any] = {"sensors": sensors, "duration": 30.0, "dt": 0.05}
    runs = [table(simulate(vessel(), seed=seed, **settings), names) for seed in range(40)]
    true = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.81])
    biases = np.array([run.mean(axis=0) for run in runs]) - true
    np.testing.assert_allclose(np.sqrt((biases**2).mean(axis=0)), [0.02] * 3 + [0.3] * 3, rtol=0.4)
    np.testing.assert_allclose(runs[0].std(axis=0), [2e-3] * 3 + [0.02] * 3, rtol=0.1)
    rest = at_rest(Ins(attitude_noise_mrad=1.0, heading_noise_mrad=4.0))
    found = [rest[name].values.std() for name in ("u", "z", "phi", "psi")]
    np.testing.assert_allclose(found, [5e-3, 5e-3, 1e-3, 4e-3], rtol=0.1)


def test_streams_do_not_touch_each_other() -> None:
    plain = simulate(vessel(), duration=5.0, sensors=Ins(), seed=2)
    other = simulate(vessel(), duration=5.0, sensors=Ins(dvl_rate=5.0, depth_noise=1.0, gyro_bias=1.0), seed=2)
    for name in ("phi", "psi", "ax", "az"):
        assert plain[name] == other[name]
    assert plain["z"] != other["z"]
    with_jumps, without = (
        simulate(vessel(), duration=5.0, sensors=Mocap(jump_fraction=f, noise_mrad=3.0), seed=2) for f in (0.9, 0.0)
    )
    assert with_jumps["psi"] == without["psi"]
    assert stream(1, "a", "b").random() != stream(1, "b", "a").random()


def test_velocity_through_the_water_is_that_over_ground_less_the_current() -> None:
    current = np.array([0.3, -0.2, 0.05])
    start = {"eta0": (0.0, 0.0, 2.0, 0.2, -0.1, 1.0), "nu0": (0.5, 0.1, 0.0, 0.0, 0.1, 0.3)}
    both = Together((Perfect(), WaterTrack(rate=10.0, noise=0.0)))
    run = simulate(vessel(), current=current, sensors=both, duration=5.0, **start)
    assert len(run["u_w"]) == 51
    rows = np.searchsorted(run["u"].t, run["u_w"].t)
    ground, angles = table(run, "uvw")[rows], table(run, ("phi", "theta", "psi"))[rows]
    water = np.array([rotation_from_euler(*each).T @ current for each in angles])
    np.testing.assert_allclose(table(run, ("u_w", "v_w", "w_w")), ground - water, atol=1e-14)


def test_water_track_noise_and_axes() -> None:
    run = at_rest(WaterTrack(rate=10.0, noise=0.02))
    values = table(run, ("u_w", "v_w", "w_w"))
    np.testing.assert_allclose(values.std(axis=0), 0.02, rtol=0.05)
    assert np.abs(np.corrcoef(values.T) - np.eye(3)).max() < 0.05
    pitot = at_rest(WaterTrack(rate=10.0, noise=0.02, axes=("u_w",)))
    assert {"v_w", "w_w"}.isdisjoint(pitot.names)
    assert np.array_equal(pitot["u_w"].values, run["u_w"].values)


def test_a_water_track_beside_the_ins_changes_none_of_its_channels() -> None:
    alone, both = (simulate(vessel(), sensors=name, seed=4, **LONG) for name in ("ins", "ins-water"))
    assert set(both.names) - set(alone.names) == {"u_w", "v_w", "w_w"}
    assert all(both[name] == alone[name] for name in alone.names)
    with pytest.raises(InputError, match='"z" is measured by 2 of them'):
        at_rest(Together((Perfect(), Ins())))


def test_specific_force_at_rest_is_minus_gravity() -> None:
    run = simulate(vessel(), duration=1.0, sensors=Perfect(accelerometer=True))
    np.testing.assert_allclose(table(run, ("ax", "ay", "az")), np.tile([0.0, 0.0, -9.81], (101, 1)), atol=1e-12)


def test_specific_force_in_free_fall_is_zero() -> None:
    """A dense body without added mass, drag and buoyancy falls freely."""
    stone = vessel(hydrodynamics={}, buoyancy={"force": 0.0})
    run = simulate(stone, duration=1.0, eta0=(0, 0, 0, 0.5, 0.4, 1.0), nu0=(1, 0, 0, 0.3, 0.2, 1.0),
                   sensors=Perfect(accelerometer=True))  # fmt: skip
    np.testing.assert_allclose(table(run, ("ax", "ay", "az")), 0.0, atol=1e-10)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2)])
def test_a_dvl_shows_how_fast_its_place_goes_that_a_camera_tracks(place: tuple[float, float, float]) -> None:
    settings: dict[str, Any] = {"wrench": np.tile([5.0, 2.0, 1.0, 0.3, 0.2, 1.0], (3000, 1)), "dt": 0.001}
    dvl = Ins(dvl_rate=1000.0, attitude_rate=1000.0, dvl_noise=0.0, attitude_noise_mrad=0.0, heading_noise_mrad=0.0,
              dvl_place=place)  # fmt: skip
    camera = Mocap(rate=1000.0, noise_mm=0.0, noise_mrad=0.0, jump_fraction=0.0, place=place)
    seen, tracked = (
        simulate(vessel(), sensors=each, nu0=(0.5, 0.2, 0.1, 0.1, 0.2, 0.3), **settings) for each in (dvl, camera)
    )
    speed = np.gradient(table(tracked, "xyz"), 0.001, axis=0)
    angles, shown = table(seen, ("phi", "theta", "psi")), table(seen, "uvw")
    for k in range(10, 3000, 150):
        np.testing.assert_allclose(rotation_from_euler(*angles[k]) @ shown[k], speed[k], atol=1e-5)
    origin = simulate(vessel(), sensors=Perfect(), nu0=(0.5, 0.2, 0.1, 0.1, 0.2, 0.3), **settings)
    assert np.linalg.norm(table(tracked, "xyz") - table(origin, "xyz"), axis=1) == pytest.approx(np.linalg.norm(place))


def _imu_at(place: tuple[float, float, float]) -> Ins:
    quiet = dict.fromkeys(("gyro_noise", "gyro_bias", "accelerometer_noise", "accelerometer_bias"), 0.0)
    return Ins(imu_rate=1000.0, imu_place=place, **quiet)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2)])
def test_specific_force_is_the_inertial_acceleration_of_the_place_less_gravity(
    place: tuple[float, float, float],
) -> None:
    def wrench(t: np.ndarray) -> np.ndarray:
        return np.stack([8 * np.sin(t), 5 * np.cos(2 * t), 4 * np.sin(3 * t), 0.3 * np.sin(t), 0 * t, np.cos(t)], -1)

    run, imu = (
        simulate(vessel(), wrench=wrench, duration=3.0, dt=0.001, current=(0.3, 0.2, -0.1), eta0=np.full(6, 0.3),
                 nu0=(0.5, 0.2, 0.1, 0.1, 0.2, 0.3), sensors=sensors)
        for sensors in (Perfect(accelerometer=True), _imu_at(place))
    )  # fmt: skip
    angles, felt = table(run, ("phi", "theta", "psi")), table(imu, ("ax", "ay", "az"))
    position = np.stack([x + rotation_from_euler(*q) @ place for x, q in zip(table(run, "xyz"), angles, strict=True)])
    acceleration = np.diff(position, n=2, axis=0) / 0.001**2
    for k in range(0, len(acceleration), 100):
        expected = rotation_from_euler(*angles[k + 1]).T @ (acceleration[k] - [0.0, 0.0, 9.81])
        np.testing.assert_allclose(felt[k + 1], expected, atol=2e-5)
    if place == (0.0, 0.0, 0.0):
        np.testing.assert_array_equal(felt, table(run, ("ax", "ay", "az")))


def test_ornstein_uhlenbeck_statistics() -> None:
    push = OrnsteinUhlenbeck(std=(0.5, 1.0, 2.0, 0.0, 0.1, 0.2), time_constant=2.0)
    force = push.sample(400_000, 0.05, seed=7)
    np.testing.assert_allclose(force.std(axis=0), push.deviations, rtol=0.03)
    np.testing.assert_allclose(force.mean(axis=0), 0.0, atol=0.05 * push.deviations.max())
    for lag in (10, 40, 80):
        after = np.mean(force[:-lag, 0] * force[lag:, 0]) / 0.25
        assert after == pytest.approx(np.exp(-lag * 0.05 / 2.0), abs=0.03)
    first = np.array([push.sample(1, 0.05, seed=k)[0, 1] for k in range(400)])
    assert first.std() == pytest.approx(1.0, rel=0.1)  # stationary from the start
    np.testing.assert_array_equal(push.sample(100, 0.05, 7), force[:100])
    assert OrnsteinUhlenbeck(0.3, axes=("Y",)).deviations.tolist() == [0, 0.3, 0, 0, 0, 0]


@pytest.mark.parametrize(
    "make, complaint",
    [
        (lambda: Mocap(rate=0.0), "Mocap: rate: found 0.0, expected a number above 0"),
        (lambda: Mocap(noise_mm=-1.0), "noise_mm"),
        (lambda: Mocap(jump_fraction=1.0), "less than 1"),
        (lambda: Mocap(jump_s=(0.5, 0.1)), "jump_s"),
        (lambda: Ins(dvl_rate=float("nan")), "dvl_rate"),
        (lambda: Ins(gyro_noise=-0.1), "gyro_noise"),
        (lambda: Ins(imu_place=(0.1, float("nan"), 0.0)), "imu_place"),
        (lambda: Ins(dvl_place=(0.1, 0.0)), "Ins: dvl_place: found .*, expected three numbers"),  # type: ignore[arg-type]
        (lambda: Mocap(place=(float("inf"), 0.0, 0.0)), "place"),
        (lambda: WaterTrack(rate=0.0), "WaterTrack: rate"),
        (lambda: WaterTrack(noise=-0.1), "noise"),
        (lambda: WaterTrack(axes=()), "axes: found"),
        (lambda: WaterTrack(axes=("u",)), "expected one or more of u_w v_w w_w, each once"),
        (lambda: OrnsteinUhlenbeck(-1.0), "std"),
        (lambda: OrnsteinUhlenbeck(time_constant=0.0), "time constant"),
        (lambda: OrnsteinUhlenbeck(axes=("W",)), 'unknown axis "W"'),
    ],
)
def test_wrong_settings_are_named(make: Any, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        make()
