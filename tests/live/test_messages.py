"""Messages for Foxglove and for recordings: what they say, and when they are said."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from towtank.core.attitude import euler_from_quaternion
from towtank.live.recording.messages import (
    POSE,
    VELOCITY,
    WRENCHES,
    Kept,
    Message,
    coefficients,
    pose,
    prediction,
    vector,
)

NAN = math.nan


def content(found: Message | None) -> dict[str, Any]:
    assert found is not None
    told: dict[str, Any] = json.loads(found.text)
    return told


def learnt(t: float = 2.0) -> Any:
    each = SimpleNamespace(name="X_u", value=-10.0, std=2.0, unit="kg/s", identified=True)
    unsure = SimpleNamespace(name="Y_v", value=1.0, std=math.inf, unit="kg/s", identified=False)
    return SimpleNamespace(t=t, delay=NAN, estimate=SimpleNamespace(coefficients=(each, unsure)))


def test_a_pose_has_its_moment_in_seconds_and_nanoseconds() -> None:
    found = pose(12.25, 1000.0, (1.0, 2.0, 3.0, 0.1, -0.2, 0.3))
    told = content(found)
    assert found is not None
    assert (found.form, found.t) == (POSE, 12.25)
    assert told["timestamp"] == {"sec": 1012, "nsec": 250_000_000}
    assert told["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    q = told["pose"]["orientation"]
    assert euler_from_quaternion(q["w"], q["x"], q["y"], q["z"]) == pytest.approx((0.1, -0.2, 0.3))
    assert pose(0.0, 0.0, (1.0, 2.0, NAN, 0.0, 0.0, 0.0)) is None


def test_what_is_not_known_of_a_vector_is_null_and_of_nothing_there_is_no_message() -> None:
    told = content(vector(VELOCITY, 1.5, (0.1, NAN, 0.3, NAN, NAN, 0.6)))
    assert told == {"t": 1.5, "u": 0.1, "v": None, "w": 0.3, "p": None, "q": None, "r": 0.6}
    assert list(content(vector(WRENCHES, 1.5, (1.0,) * 6))) == ["t", "X", "Y", "Z", "K", "M", "N"]
    assert vector(VELOCITY, 1.5, (NAN,) * 6) is None


def test_measured_stands_beside_predicted() -> None:
    told = content(prediction(3.0, (1.0, NAN, 3.0, 4.0, 5.0, 6.0), (9.0,) * 6))
    assert told["t"] == 3.0
    assert told["measured"] == {"u": 1.0, "v": None, "w": 3.0, "p": 4.0, "q": 5.0, "r": 6.0}
    assert set(told["predicted"].values()) == {9.0}


def test_coefficients_have_an_interval_of_95_percent() -> None:
    told = content(coefficients(learnt()))
    assert (told["t"], told["delay_s"]) == (2.0, None)
    found = told["X_u"]
    assert (found["value"], found["std"], found["unit"], found["identified"]) == (-10.0, 2.0, "kg/s", True)
    assert found["low"] == pytest.approx(-10.0 - 1.96 * 2.0, abs=1e-3)
    assert found["high"] == pytest.approx(-10.0 + 1.96 * 2.0, abs=1e-3)
    assert (told["Y_v"]["std"], told["Y_v"]["low"], told["Y_v"]["identified"]) == (None, None, False)
    assert coefficients(learnt(-math.inf)) is None


def test_poses_are_kept_ten_times_a_second_and_coefficients_once() -> None:
    kept: list[Message] = []
    listener = Kept(kept.append, lambda: learnt(), 1.7e9)
    place = np.zeros(6)
    for k in range(129):
        listener.see(k / 64.0, {"pose": place} if k != 7 else {"velocity": place})
    topics = [each.form.topic for each in kept]
    assert topics.count(POSE.topic) == 19  # one of seven, and the seventh had none
    assert len(topics) - topics.count(POSE.topic) == 3
    listener.see(0.5, {"pose": place})  # a clock that went back
    assert len(kept) == len(topics) + 2
    listener.see(0.7, {"pose": np.full(6, NAN)})
    listener.see(0.71, {"pose": place})
    assert len(kept) == len(topics) + 3
