"""By which channels an axis is known, and speeds from as much of a pose as there is."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.recording import Recording, standard_channel
from towtank.recording.axes import CHANNELS_OF, axes_shown, judged_by, known_by, known_text
from towtank.recording.frames import pose_rates
from towtank.recording.frames.pose_rates import velocity_of_pose
from towtank.recording.frames.rotations import rotate
from towtank.recording.standard import MEASURED


def run_of(**rates: float) -> Recording:
    channels = {}
    for name, rate in rates.items():
        t = np.arange(round(20.0 * rate)) / rate
        channels[name] = standard_channel(name, t, np.sin(t))
    return Recording(channels)


def test_a_barometer_a_compass_and_an_accelerometer_tell_of_motion() -> None:
    known = known_by(run_of(z=10.0, psi=5.0, ax=100.0))
    assert [each.text for each in known] == [
        "surge by acceleration, 100 Hz",
        "sway by no channel of its own",
        "heave by depth, 10 Hz",
        "roll by no channel of its own",
        "pitch by no channel of its own",
        "yaw by heading, 5 Hz",
    ]


def test_what_is_nearest_to_the_speed_comes_first() -> None:
    heave = known_by(run_of(az=100.0, z=10.0, w=8.0))[2]
    assert heave.text == "heave by speed, 8 Hz, and depth, 10 Hz, and acceleration, 100 Hz"


def test_what_is_known_in_one_line() -> None:
    words = known_text(known_by(run_of(z=10.0, r=100.0, p=100.0, q=100.0)))
    assert words.startswith("heave by depth, 10 Hz; roll by rate, 100 Hz; ")
    assert words.endswith("; no channel tells of surge and sway")


def test_a_quaternion_tells_of_all_three_angles() -> None:
    known = known_by(run_of(qw=50.0, qx=50.0, qy=50.0, qz=50.0))
    assert [each.text for each in known[3:]] == [
        "roll by roll angle, 50 Hz",
        "pitch by pitch angle, 50 Hz",
        "yaw by heading, 50 Hz",
    ]


def test_of_several_recordings_the_fastest_counts() -> None:
    assert known_by(run_of(z=10.0), run_of(z=20.0, r=50.0))[2].text == "heave by depth, 20 Hz"


def test_every_measured_channel_tells_of_one_axis() -> None:
    told = [name for channels in CHANNELS_OF.values() for name in channels]
    assert sorted(told) == sorted(MEASURED)
    assert axes_shown({"z", "psi"}) == (False, False, True, False, False, True)


def test_a_prediction_is_judged_by_the_speed_else_by_the_pose() -> None:
    assert judged_by(["p", "q", "r", "z", "psi"]) == ("z", "p", "q", "r")
    assert judged_by(["x", "y", "z", "phi", "theta", "psi"]) == ("x", "y", "z", "phi", "theta", "psi")


@pytest.fixture
def tilted() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose, its rate and the body velocity (n, 6) that makes it, tilted by up to 0.6 rad."""
    rng = np.random.default_rng(3)
    angles = rng.uniform(-0.6, 0.6, (200, 3))
    nu = rng.normal(size=(200, 6))
    phi, theta = angles[:, 0], angles[:, 1]
    p, q, r = nu[:, 3:].T
    turning = q * np.sin(phi) + r * np.cos(phi)
    rate = np.column_stack(
        [
            rotate(quaternions_from_eulers(angles), nu[:, :3]),
            p + turning * np.tan(theta),
            q * np.cos(phi) - r * np.sin(phi),
            turning / np.cos(theta),
        ]
    )
    return np.column_stack([rng.normal(size=(200, 3)), angles]), rate, nu


def test_a_whole_pose_tells_all_six_speeds(tilted: tuple[np.ndarray, ...]) -> None:
    pose, rate, nu = tilted
    np.testing.assert_allclose(velocity_of_pose(pose, rate, np.full_like(nu, np.nan)), nu, atol=1e-12)


def test_a_depth_tells_heave_with_the_speeds_beside_it(tilted: tuple[np.ndarray, ...]) -> None:
    pose, rate, nu = tilted
    missing = np.full_like(nu, np.nan)
    missing[:, :2] = nu[:, :2]
    pose[:, :2] = np.nan
    found = velocity_of_pose(pose, rate, missing)
    np.testing.assert_allclose(found[:, 2], nu[:, 2], atol=1e-12)
    assert np.isnan(found[:, :2]).all()


def test_what_is_measured_at_all_is_asked_of_the_whole(
    tilted: tuple[np.ndarray, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A speed that is missing for a while is unknown there, in blocks of any length; it is not nought."""
    pose, rate, nu = tilted
    pose[:, :2], missing = np.nan, np.full_like(nu, np.nan)
    missing[120:, :2] = nu[120:, :2]
    whole = velocity_of_pose(pose, rate, missing)
    assert np.isnan(whole[:120, 2]).all()
    monkeypatch.setattr(pose_rates, "_BLOCK", 7)
    np.testing.assert_array_equal(velocity_of_pose(pose, rate, missing), whole)
    assert velocity_of_pose(pose[:0], rate[:0], missing[:0]).shape == (0, 6)


def test_a_heading_alone_tells_yaw_and_nothing_else() -> None:
    pose = np.full((5, 6), np.nan)
    pose[:, 5] = 0.3
    found = velocity_of_pose(pose, np.full((5, 6), 0.2), np.full((5, 6), np.nan))
    np.testing.assert_allclose(found[:, 5], 0.2)
    assert np.isnan(found[:, :5]).all()


def test_a_place_without_a_heading_tells_no_speed_and_one_without_depth_no_heave(
    tilted: tuple[np.ndarray, ...],
) -> None:
    pose, rate, nu = tilted
    for missing, told in (
        ((5,), [2, 3, 4]),
        ((0,), [2, 3, 4, 5]),
        ((1,), [2, 3, 4, 5]),
        ((2,), [3, 4, 5]),
        ((3,), [0, 1, 2, 4, 5]),
    ):
        part = pose.copy()
        part[:, missing] = np.nan
        found = velocity_of_pose(part, rate, nu)
        assert np.flatnonzero(np.isfinite(found).all(axis=0)).tolist() == told, missing
        assert np.isfinite(found).any(axis=0).sum() == len(told)


def test_what_lies_on_its_side_tells_no_heave_by_its_depth() -> None:
    tilt = np.radians([0.0, 78.0, 79.0, 101.0, 170.0])
    pose = np.full((5, 6), np.nan)
    pose[:, 2], pose[:, 3] = 1.0, tilt
    found = velocity_of_pose(pose, np.full((5, 6), 0.2), np.full((5, 6), np.nan))[:, 2]
    assert np.isfinite(found).tolist() == [True, True, False, False, False]
    np.testing.assert_allclose(found[:2], 0.2 / np.cos(tilt[:2]))
