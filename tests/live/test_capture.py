"""Motion capture: the makers' own libraries read servers of ours, and bodies come out in NED and FRD."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from towtank.core.attitude import rotation_from_euler
from towtank.errors import InputError
from towtank.live import Raw, Sample, Source
from towtank.live.links.mocap.natnet import NatnetSource
from towtank.live.links.mocap.qtm import QtmSource
from towtank.live.links.mocap.tracked_body import TrackedBody, capture_address, quaternion_of_matrix
from towtank.recording.mapping import ColumnMapping

from .capture_servers import Pose, natnet_server, qtm_server
from .mavlink_peer import free_port

N = 40
SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # ENU to NED and back
FLIP = np.diag([1.0, -1.0, -1.0])  # FLU to FRD and back
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y up to z up


def motion() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions (n, 3) in NED and angles (n, 3) of a body that turns while it rises."""
    k = np.arange(N)
    xyz = np.column_stack([0.5 + 0.01 * k, 1.0 - 0.02 * k, 2.0 - 0.015 * k])
    return xyz, np.column_stack([0.3 * np.sin(0.2 * k), 0.2 * np.cos(0.1 * k), 0.05 * k - 1.0])


def as_seen(turned: bool = False, hidden: Sequence[int] = ()) -> list[Pose]:
    """Return the same in ENU and FLU, or with y up."""
    found: list[Pose] = []
    for k, (place, angles) in enumerate(zip(*motion(), strict=True)):
        position, rotation = SWAP @ place, SWAP @ rotation_from_euler(*angles) @ FLIP
        if turned:
            position, rotation = UPRIGHT.T @ position, UPRIGHT.T @ rotation @ UPRIGHT
        found.append((position.tolist(), rotation, k not in hidden))
    return found


def taken(source: Source, count: int) -> tuple[list[Sample], list[Raw]]:
    """Open a source and read until so many frames have come."""
    samples: list[Sample] = []
    raw: list[Raw] = []
    source.open()
    end = time.monotonic() + 30.0
    while len(raw) < count and time.monotonic() < end:
        for each in source.read(0.1):
            if isinstance(each, Raw):
                raw.append(each)
            else:
                samples.append(each)
    return samples, raw


def column(samples: Sequence[Sample], name: str) -> NDArray[np.float64]:
    return np.array([dict(zip(each.names, each.values, strict=True))[name] for each in samples])


def judge(samples: Sequence[Sample], rows: Sequence[int]) -> None:
    """Hold samples against the motion at some rows; floats of 32 bits on the wire."""
    xyz, angles = motion()
    for i, name in enumerate("xyz"):
        np.testing.assert_allclose(column(samples, name), xyz[rows, i], atol=1e-5)
    q = np.column_stack([column(samples, name) for name in ("qw", "qx", "qy", "qz")])
    for turn, row in zip(q, rows, strict=True):
        w, x, y, z = turn
        heading = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z))))
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        np.testing.assert_allclose([roll, pitch, heading], angles[row], atol=1e-5)


def test_qualisys_by_its_own_library() -> None:
    hidden, still = (7, 8, 20), ([9.0, 9.0, 9.0], np.eye(3), True)
    frames = [[still, pose] for pose in as_seen(hidden=hidden)]
    with qtm_server(["wand", "auv"], frames, period=0.005) as port:
        source = QtmSource(f"qtm:127.0.0.1:{port}/auv")
        samples, raw = taken(source, N)
        assert source.state().bad == 0
        assert any("hidden in 3 of 40" in line for line in source.state().said)
        assert 'body "auv"' in source.state().said
        source.close()
        source.close()
    rows = [k for k in range(N) if k not in hidden]
    judge(samples, rows)
    assert len(raw) == N
    np.testing.assert_allclose([each.t for each in samples], 0.005 * np.array(rows), atol=1e-6)


def test_qualisys_that_goes_away_is_asked_again() -> None:
    poses = [[pose] for pose in as_seen()]
    with qtm_server(["auv"], poses[:5], period=0.001, answers_after=0.3) as port:
        source = QtmSource(f"qtm:127.0.0.1:{port}")
        first, _ = taken(source, 5)
        end = time.monotonic() + 30.0
        again: list[Sample] = []
        while len(again) < 5 and time.monotonic() < end:  # the server ends each connection after its frames
            again += [each for each in source.read(0.05) if isinstance(each, Sample)]  # and answers later than that
        source.close()
    assert len(first) == len(again) == 5


def test_qualisys_with_a_damaged_frame_goes_on_after_it() -> None:
    source = QtmSource("qtm:127.0.0.1")

    class Cut:
        data = b"\0" * 16
        timestamp = 0

        def get_6d(self) -> None:
            return None

    out: list[Sample | Raw] = []
    source._take(0.0, Cut(), out)
    assert source.state().bad == 1
    assert [type(each) for each in out] == [Raw]


def test_optitrack_y_up_by_the_library() -> None:
    poses = as_seen(turned=True, hidden=(3,))
    frames: list[dict[int, Pose]] = [{4: ([0.0, 0.0, 0.0], np.eye(3), True), 11: pose} for pose in poses]
    with natnet_server({"wand": 4, "auv": 11}, frames, damaged=lambda k: k == 10) as port:
        source = NatnetSource(f"natnet:127.0.0.1:{port}/auv")
        samples, raw = taken(source, N - 1)
        assert source.state().bad == 1
        assert source.state().senders == ("Motive 127.0.0.1",)
        source.close()
        source.close()
    rows = [k for k in range(N) if k not in (3, 10)]
    judge(samples, rows)
    assert len(raw) == N - 1
    np.testing.assert_allclose([each.t for each in samples], 0.01 * np.array(rows), atol=1e-9)


def test_of_several_bodies_the_one_that_is_named_is_followed() -> None:
    still: Pose = ([9.0, 9.0, 9.0], np.eye(3), True)
    frames: list[dict[int, Pose]] = [{11: still, 4: pose, 2: still} for pose in as_seen(turned=True)[:5]]
    with natnet_server({"wand": 11, "auv": 4, "rod": 2}, frames) as port:
        source = NatnetSource(f"natnet:127.0.0.1:{port}/auv")
        samples, _ = taken(source, 5)
        source.close()
    assert len(samples) == 5
    judge(samples, range(5))


def test_mapping_states_the_frames_and_the_marker() -> None:
    mapping = ColumnMapping.model_validate({"world": "NED", "body": "FRD", "marker": {"position": [0.1, 0.0, -0.2]}})
    body = TrackedBody(mapping)
    rotation = rotation_from_euler(0.3, -0.2, 1.1)
    place = np.array([1.0, 2.0, 3.0])
    known = body.channels((place + rotation @ [0.1, 0.0, -0.2]).tolist(), quaternion_of_matrix(rotation.T.ravel()))
    np.testing.assert_allclose([known[name] for name in "xyz"], place, atol=1e-12)
    assert "NED" in body.convention
    assert "may say otherwise" not in body.convention
    assert "ENU" in TrackedBody(ColumnMapping.model_validate({"columns": {"x": "y"}})).convention


def test_quaternion_of_every_attitude() -> None:
    for angles in itertools.product((-3.1, -1.5, 0.0, 0.4, math.pi), (-1.5, 0.0, 1.2), (-3.0, 0.0, 2.0, math.pi)):
        rotation = rotation_from_euler(*angles)
        w, x, y, z = quaternion_of_matrix(rotation.T.ravel().tolist())
        again = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        np.testing.assert_allclose(again, rotation, atol=1e-12)
    assert all(map(math.isnan, quaternion_of_matrix([math.nan] * 9)))
    assert (
        all(map(math.isnan, quaternion_of_matrix([0.0] * 9)))
        or abs(math.hypot(*quaternion_of_matrix([0.0] * 9)) - 1.0) > 0.1
    )


@pytest.mark.parametrize(
    "text, expected",
    [
        ("qtm:10.0.0.2", ("10.0.0.2", 22223, "", {})),
        ("qtm:lab:4000/my auv", ("lab", 4000, "my auv", {})),
        ("qtm:[::1]:4000/a?up=y", ("::1", 4000, "a", {"up": "y"})),
    ],
)
def test_addresses(text: str, expected: tuple[str, int, str, dict[str, str]]) -> None:
    assert capture_address(text, "qtm:", 22223) == expected


@pytest.mark.parametrize("text", ["qtm:", "qtm:host:port", "qtm:host:0", "qtm:host?up"])
def test_wrong_addresses(text: str) -> None:
    with pytest.raises(InputError, match="expected qtm:HOST"):
        capture_address(text, "qtm:", 22223)


def test_nobody_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="does not answer"):
        QtmSource(f"qtm:127.0.0.1:{free_port()}").open()
    monkeypatch.setattr("towtank.live.links.mocap.natnet._ANSWER", 0.3)
    with pytest.raises(InputError, match="no NatNet server"):
        NatnetSource(f"natnet:127.0.0.1:{free_port()}").open()
    with pytest.raises(InputError, match="up=y"):
        QtmSource("qtm:127.0.0.1?up=x")


def test_body_that_is_not_there_is_named() -> None:
    with qtm_server(["auv", "wand"], []) as port:
        with pytest.raises(InputError, match='no rigid body "auw"; did you mean "auv"'):
            QtmSource(f"qtm:127.0.0.1:{port}/auw").open()
        with pytest.raises(InputError, match="2 rigid bodies"):
            QtmSource(f"qtm:127.0.0.1:{port}").open()
    with natnet_server({"auv": 1, "wand": 2}, []) as port, pytest.raises(InputError, match="2 rigid bodies"):
        NatnetSource(f"natnet:127.0.0.1:{port}").open()


def test_library_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for source in (QtmSource("qtm:127.0.0.1"), NatnetSource("natnet:127.0.0.1")):
        with pytest.raises(InputError, match=r"towtank\[mocap\]"):
            source.open()
