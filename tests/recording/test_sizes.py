"""Speeds and steps of time that no underwater vehicle has, in logs that agree with themselves."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.recording import Recording
from towtank.recording.consistency import inconsistencies
from towtank.recording.consistency.sizes import impossible_sizes

T = np.arange(0.0, 60.0, 0.05)
X = 0.8 * T + 0.2 * np.sin(T)
U = 0.8 + 0.2 * np.cos(T)


def of(t: np.ndarray, **columns: np.ndarray) -> Recording:
    return Recording.from_table(t, columns)


def test_a_log_in_metres_and_seconds_is_not_doubted() -> None:
    random = np.random.default_rng(1)
    assert impossible_sizes(of(T, x=X, u=U)) == []
    assert impossible_sizes(of(T, x=X + 50.0 * (random.random(T.size) < 0.1))) == []  # a marker that jumps
    assert impossible_sizes(of(T, x=100.0 * random.standard_normal(T.size) * (T > 40.0))) == []
    assert impossible_sizes(of(T[:10], x=1e6 * X[:10])) == []  # too little to tell
    assert impossible_sizes(of(np.arange(40.0), z=np.arange(40.0) % 7)) == []  # once a second


@pytest.mark.parametrize("columns", [{"u": 1e3 * U}, {"x": 1e3 * X}, {"x": 1e3 * X, "u": 1e3 * U}])
def test_millimetres_throughout_are_seen(columns: dict[str, np.ndarray]) -> None:
    said = [finding.text for finding in inconsistencies(of(T, **columns))]
    assert len(said) == 1
    assert said[0].endswith("half of the time, which no underwater vehicle does: millimetres, not metres? "
                            "(scale = 0.001 in the mapping)")  # fmt: skip


def test_an_attitude_that_is_noise_alone_is_seen() -> None:
    random = np.random.default_rng(2)
    told = impossible_sizes(of(T, psi=0.3 * random.standard_normal(T.size), phi=9.0 * random.standard_normal(T.size)))
    assert [names for names, _ in told] == ["phi"]
    assert impossible_sizes(of(T, psi=np.angle(np.exp(1j * T)))) == []  # turns, and wraps


@pytest.mark.parametrize(("factor", "said"), [(1e3, "every 50 s: milliseconds"), (1e-3, "every 50 µs: seconds")])
def test_times_in_another_unit_are_seen(factor: float, said: str) -> None:
    factor = factor if factor > 1.0 else 0.8e-3
    text = impossible_sizes(of(factor * T, psi=0.1 * np.sin(T)))
    assert text[0][0] == "t"
    assert said.replace("50 µs", "40 µs") in text[0][1]
