"""Frames and lever arm: identities and known cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.core.attitude import eulers_from_quaternions, quaternions_from_eulers
from towtank.errors import InputError
from towtank.recording import Recording, marker_to_origin, standard_channel, to_ned_frd
from towtank.recording.frames.conversion import (
    convert_body_vector,
    convert_euler,
    convert_quaternion,
    convert_world_vector,
    wrap_angle,
)
from towtank.recording.frames.lever_arm import origin_position, origin_velocity
from towtank.recording.frames.rotations import (
    align_signs,
    conjugate,
    interpolate_rotation,
    multiply,
    normalised,
    rotate,
)
from towtank.recording.standard import EULER, QUATERNION

T = np.arange(5) / 10.0
ANGLE = st.floats(-3.1, 3.1)
EULERS = st.tuples(ANGLE, st.floats(-1.5, 1.5), ANGLE)
FRAMES = [("FRD", "NED"), ("FLU", "NED"), ("FRD", "ENU"), ("FLU", "ENU")]


def quaternion(*euler: float) -> np.ndarray:
    return quaternions_from_eulers(np.array([euler]))[0]


def unit(rng: np.random.Generator, n: int) -> np.ndarray:
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_rotations_agree_with_each_other() -> None:
    rng = np.random.default_rng(1)
    a, b, v = unit(rng, 20), unit(rng, 20), rng.normal(size=(20, 3))
    assert np.allclose(rotate(multiply(a, b), v), rotate(a, rotate(b, v)), atol=1e-14)
    assert np.allclose(rotate(conjugate(a), rotate(a, v)), v, atol=1e-14)
    assert np.allclose(rotate(quaternion(0.0, 0.0, np.pi / 2), np.array([1.0, 0.0, 0.0])), [0, 1, 0])
    middle = interpolate_rotation(a, b, np.full(20, 0.5))
    back = interpolate_rotation(a, middle, np.full(20, 2.0))
    assert np.allclose(np.abs(np.einsum("ij,ij->i", back, b)), 1.0, atol=1e-12)
    assert np.allclose(interpolate_rotation(a, -a, np.full(20, 0.3)), a)


def test_signs_align_and_lost_tracks_are_no_rotation() -> None:
    q = align_signs(np.array([[1.0, 0, 0, 0], [-1, 0, 0, 0], [-0.99, 0.1, 0, 0], [1, 0, 0, 0]]))
    assert (np.einsum("ij,ij->i", q[1:], q[:-1]) > 0).all()
    assert np.isnan(normalised(np.zeros((1, 4)))).all()


def test_vectors_go_and_come_back() -> None:
    v = np.random.default_rng(2).normal(size=(7, 3))
    assert np.array_equal(convert_world_vector(convert_world_vector(v)), v)
    assert np.array_equal(convert_body_vector(convert_body_vector(v)), v)
    assert np.array_equal(convert_world_vector(np.array([1.0, 2.0, 3.0])), [2, 1, -3])


@settings(max_examples=50, deadline=None)
@given(EULERS)
def test_attitude_carries_body_vectors_to_the_same_place(euler: tuple[float, float, float]) -> None:
    q = quaternion(*euler)
    v = np.array([0.3, -1.2, 2.0])
    converted = convert_quaternion(q, body="FLU", world="ENU")
    assert np.allclose(rotate(converted, convert_body_vector(v)), convert_world_vector(rotate(q, v)), atol=1e-12)
    for body, world in FRAMES:
        once = convert_quaternion(q, body=body, world=world)
        twice = convert_quaternion(once, body=body, world=world)
        assert abs(abs(twice @ q) - 1.0) < 1e-12


@settings(max_examples=50, deadline=None)
@given(EULERS, st.sampled_from(FRAMES))
def test_euler_angles_and_quaternions_convert_alike(euler: tuple[float, float, float], frames: tuple[str, str]) -> None:
    body, world = frames
    q = convert_quaternion(quaternion(*euler), body=body, world=world)
    angles = [
        float(convert_euler(np.array(a), name, body=body, world=world)) for name, a in zip(EULER, euler, strict=True)
    ]
    assert abs(abs(quaternion(*angles) @ q) - 1.0) < 1e-10
    found = eulers_from_quaternions(q[None])[0]
    assert np.allclose(wrap_angle(found - angles), 0.0, atol=1e-6)


def test_known_case_east_facing_robot() -> None:
    """In ENU/FLU the identity faces east with its left to the north: in NED/FRD level, heading 90 degrees."""
    q = convert_quaternion(np.array([1.0, 0.0, 0.0, 0.0]), body="FLU", world="ENU")
    assert np.allclose(eulers_from_quaternions(q[None])[0], [0.0, 0.0, np.pi / 2])


def test_a_recording_is_converted_channel_by_channel() -> None:
    columns = {
        name: np.full(5, float(i))
        for i, name in enumerate(
            [
                "x",
                "y",
                "z",
                "phi",
                "theta",
                "psi",
                "u",
                "v",
                "w",
                "p",
                "q",
                "r",
                "ax",
                "ay",
                "az",
                "X",
                "Y",
                "Z",
                "K",
                "M",
                "N",
                "cmd_a",
                "voltage",
            ],
            1,
        )
    }
    run = to_ned_frd(Recording.from_table(T, columns), body="FLU", world="ENU")
    value = {name: float(run[name].values[0]) for name in run}
    assert [value[k] for k in "xyz"] == [2, 1, -3]
    assert [value[k] for k in EULER] == [4, -5, np.pi / 2 - 6]
    assert [value[k] for k in "uvwpqr"] == [7, -8, -9, 10, -11, -12]
    assert [value[k] for k in ("ax", "ay", "az")] == [13, -14, -15]
    assert [value[k] for k in "XYZKMN"] == [16, -17, -18, 19, -20, -21]
    assert (value["cmd_a"], value["voltage"]) == (22, 23)
    assert "converted from ENU and FLU to NED and FRD" in run.notes
    assert run.names == tuple(columns)


def test_quaternion_channels_are_converted_and_the_identity_stays() -> None:
    q = dict(zip(QUATERNION, np.tile(quaternion(0.1, 0.2, 0.3), (5, 1)).T, strict=True))
    run = Recording.from_table(T, q)
    assert to_ned_frd(run) == run
    done = to_ned_frd(run, body="FLU", world="ENU")
    found = np.array([done[name].values[0] for name in QUATERNION])
    assert np.allclose(eulers_from_quaternions(found[None])[0], [0.1, -0.2, np.pi / 2 - 0.3])


def test_an_east_position_alone_becomes_y() -> None:
    run = to_ned_frd(Recording.from_table(T, {"x": T}), world="ENU")
    assert run.names == ("y",)


def test_doubtful_frames_are_noted() -> None:
    upside_down = to_ned_frd(Recording.from_table(T, {"phi": 0.1 * T, "az": np.full(5, 9.8)}), body="FLU")
    assert any("upside down" in note for note in upside_down.notes)
    assert not any('"az"' in note for note in upside_down.notes)
    assert any('"az" is mostly positive' in note for note in to_ned_frd(Recording.from_table(T, {"az": T + 9})).notes)


def test_a_turning_body_carries_its_marker_around() -> None:
    """The origin stands still while the body yaws: the marker circles, the origin found from it does not."""
    t = np.arange(200) / 100.0
    arm, rate, home = np.array([0.4, -0.1, 0.2]), 0.7, np.array([3.0, -2.0, 5.0])
    psi = rate * t
    q = quaternions_from_eulers(np.column_stack([0 * t, 0 * t, psi]))
    marker = home + rotate(q, arm)
    speed = np.cross([0.0, 0.0, rate], arm)
    assert np.allclose(origin_position(marker, q, arm), home, atol=1e-14)
    assert np.allclose(origin_velocity(np.tile(speed, (200, 1)), np.array([0.0, 0.0, rate]), arm), 0.0, atol=1e-15)

    columns = {"x": marker[:, 0], "y": marker[:, 1], "z": marker[:, 2], "phi": 0 * t, "theta": 0 * t, "psi": psi}
    columns |= {"u": 0 * t + speed[0], "v": 0 * t + speed[1], "w": 0 * t, "p": 0 * t, "q": 0 * t, "r": 0 * t + rate}
    run = Recording.from_table(t, columns)
    moved = marker_to_origin(run, arm)
    for i, name in enumerate("xyz"):
        assert np.allclose(moved[name].values, home[i], atol=1e-12)
    for name in "uvw":
        assert np.allclose(moved[name].values, 0.0, atol=1e-12)
    only = marker_to_origin(run, arm, ["position"])
    assert only["u"] == run["u"]

    slow = run.replace([standard_channel(name, t[::7], columns[name][::7]) for name in EULER])
    moved = marker_to_origin(slow, arm, ["position"])
    assert np.allclose(moved["x"].values, home[0], atol=1e-12)
    assert len(moved["x"]) == 197
    assert any("3 samples of the marker left out" in note or "9 samples" in note for note in moved.notes)


def test_the_marker_needs_attitude_and_rates() -> None:
    with pytest.raises(InputError, match="needs the attitude; phi, theta, psi not recorded"):
        marker_to_origin(Recording.from_table(T, {"x": T}), [0.1, 0.0, 0.0])
    with pytest.raises(InputError, match="needs p, q and r"):
        marker_to_origin(Recording.from_table(T, {"u": T, "r": T}), [0.1, 0.0, 0.0])
    run = Recording.from_table(T, {"z": 0 * T, "phi": 0 * T, "theta": 0 * T + 0.5})
    assert np.allclose(marker_to_origin(run, [1.0, 0.0, 0.0])["z"].values, np.sin(0.5))
    far = run.replace([standard_channel("z", T + 50, T)])
    with pytest.raises(InputError, match="never measured at the same time"):
        marker_to_origin(far, [1.0, 0.0, 0.0])
    untouched = Recording.from_table(T, {"r": T})
    assert marker_to_origin(untouched, [1.0, 0.0, 0.0]) == untouched
