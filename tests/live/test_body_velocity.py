"""Velocities of a stream turned into the body, with the attitude and the rates known last."""

from __future__ import annotations

import math

import numpy as np
import pytest

from towtank.core.attitude import quaternion_from_euler, rotation_from_quaternion
from towtank.live.links.source import Sample
from towtank.live.pipeline.frames import BodyVelocity

ANGLES = {"phi": 0.3, "theta": -0.4, "psi": 2.0}
Q = quaternion_from_euler(*ANGLES.values())
R = rotation_from_quaternion(np.array(Q))
WORLD = {"vn": 0.5, "ve": -0.7, "vd": 0.2}


def sample(t: float, received: float = 0.0, **values: float) -> Sample:
    return Sample("test", "all", t, received, tuple(values), tuple(values.values()))


def told(found: Sample) -> dict[str, float]:
    return dict(zip(found.names, found.values, strict=True))


@pytest.mark.parametrize("attitude", [ANGLES, dict(zip(("qw", "qx", "qy", "qz"), 0.9 * np.array(Q), strict=True))])
def test_velocity_in_the_world_is_turned_by_the_attitude(attitude: dict[str, float]) -> None:
    body = BodyVelocity()
    found = told(body.of(sample(1.0, **attitude, **WORLD)))
    expected = R.T @ np.array(list(WORLD.values()))
    assert [found[name] for name in "uvw"] == pytest.approx(expected.tolist())
    assert not {"vn", "ve", "vd"} & found.keys()
    assert body.unturned == 0


def test_without_an_attitude_or_with_an_old_one_it_is_not_known() -> None:
    body = BodyVelocity()
    assert math.isnan(told(body.of(sample(1.0, **WORLD)))["u"])
    body.of(sample(1.0, **ANGLES))
    assert not math.isnan(told(body.of(sample(1.29, **WORLD)))["u"])
    assert math.isnan(told(body.of(sample(1.31, **WORLD)))["u"])
    assert math.isnan(told(body.of(sample(0.69, **WORLD)))["u"])
    body.of(sample(math.nan, 5.0, **ANGLES))  # without a stamp: as of its receipt
    assert not math.isnan(told(body.of(sample(5.1, **WORLD)))["u"])
    assert body.unturned == 3


def test_an_attitude_that_is_none_is_passed_over() -> None:
    body = BodyVelocity()
    body.of(sample(1.0, qw=0.1, qx=0.1, qy=0.1, qz=0.1))
    body.of(sample(1.0, phi=math.nan, theta=0.0, psi=0.0))
    body.of(sample(1.0, phi=0.0, theta=0.0))
    assert math.isnan(told(body.of(sample(1.0, **WORLD)))["u"])


def test_between_two_attitudes_it_goes_on_turning() -> None:
    body, rates = BodyVelocity(), {"p": 0.3, "q": -0.2, "r": 0.8}
    body.of(sample(1.0, **ANGLES, **rates))
    body.of(sample(1.0, p=math.nan, q=0.0, r=0.0))  # not believed
    found = told(body.of(sample(1.02, **WORLD)))
    still = R.T @ np.array(list(WORLD.values()))
    expected = still - 0.02 * np.cross(list(rates.values()), still)
    assert [found[name] for name in "uvw"] == pytest.approx(expected.tolist())


def test_a_sensor_off_the_origin_is_swept_around() -> None:
    body, rates, place = BodyVelocity(), {"p": 0.3, "q": -0.2, "r": 0.8}, (0.4, 0.1, -0.2)
    body.of(sample(1.0, **rates))
    found = told(body.of(sample(1.0, u=1.0, v=2.0, w=3.0, x=4.0), place))
    expected = np.array([1.0, 2.0, 3.0]) - np.cross(list(rates.values()), place)
    assert [found[name] for name in "uvwx"] == pytest.approx([*expected, 4.0])
    same = sample(1.0, u=1.0, v=2.0, w=3.0)
    assert body.of(same) is same
    other = sample(1.0, x=1.0)
    assert body.of(other, place) is other
