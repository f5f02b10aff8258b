"""Autocorrelation by hand and with gaps, and a test of whiteness that cries wolf as often as it says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.validation.autocorrelation import autocorrelation, portmanteau


def by_hand(x: np.ndarray, lag: int) -> float:
    """Mean product of all pairs that are there, over the mean square."""
    centred = x - np.nanmean(x)
    products = centred[lag:] * centred[:-lag]
    return float(np.nanmean(products) / np.nanmean(centred**2))


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_by_hand(missing: float) -> None:
    rng = np.random.default_rng(1)
    x = np.cumsum(rng.standard_normal(300))
    x[rng.random(300) < missing] = np.nan
    found = autocorrelation([(x, 0.1)], 0.1, 25)
    assert np.allclose(found.lag, 0.1 * np.arange(1, 26))
    assert np.allclose(found.value, [by_hand(x, k) for k in range(1, 26)])
    assert found.pairs[2] == np.count_nonzero(~np.isnan(x[3:] * x[:-3]))


@given(
    pieces=st.lists(st.lists(st.floats(-10, 10) | st.just(np.nan), min_size=1, max_size=30), min_size=1, max_size=5),
    count=st.integers(1, 12),
)
@settings(max_examples=60, deadline=None)
def test_pairs_never_reach_across_parts(pieces: list[list[float]], count: int) -> None:
    parts = [(np.array(piece, dtype=np.float64), 0.5) for piece in pieces]
    found = autocorrelation(parts, 0.5, count)
    for k in range(1, count + 1):
        pairs = sum(int(np.count_nonzero(~np.isnan(x[k:] * x[:-k]))) for x, _ in parts if x.size > k)
        assert found.pairs[k - 1] == pairs
        assert np.isnan(found.value[k - 1]) == (pairs == 0)


def test_irregular_samples_fall_into_the_nearest_slot() -> None:
    x = np.full(3000, np.nan)
    rows = np.cumsum(np.tile([3, 3, 4], 290))
    x[rows] = np.random.default_rng(2).standard_normal(rows.size)
    found = autocorrelation([(x, 0.01)], 0.03, 10)
    assert found.pairs.sum() > 8 * rows.size
    test = portmanteau([(x, 0.01)], 0.03)
    assert test is not None
    assert test.p > 0.01


def loud_at_times(rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
    return x * np.repeat(rng.choice([0.2, 1.0, 3.0], x.size // 40 + 1), 40)[: x.size]


@pytest.mark.parametrize("kind", ["whole", "gaps", "irregular", "loud at times", "outliers"])
def test_false_alarms_are_as_rare_as_they_should_be(kind: str) -> None:
    alarms = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        x = rng.standard_normal(400)
        if kind == "gaps":
            x[100:180] = np.nan
        elif kind == "irregular":
            x[rng.random(400) < 0.5] = np.nan
        elif kind == "loud at times":
            x = loud_at_times(rng, x)
        elif kind == "outliers":
            x = rng.standard_t(3, 400)
        test = portmanteau([(x, 0.1)], 0.1)
        assert test is not None
        alarms += test.p < 0.05
    assert 4 <= alarms <= 36  # 20 expected, binomial 99.9 %


def test_colour_is_found() -> None:
    rng = np.random.default_rng(3)
    x = rng.standard_normal(400)
    x[1:] += 0.6 * x[:-1]
    test = portmanteau([(x, 0.1)], 0.1)
    assert test is not None
    assert test.p < 1e-4
    assert test.lags == 20


def test_too_little_to_say() -> None:
    assert portmanteau([(np.zeros(10), 0.1)], 0.1) is None
    still = portmanteau([(np.zeros(100), 0.1)], 0.1)
    assert still is not None
    assert still.p == 1.0
