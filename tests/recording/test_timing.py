"""Rates, gaps and what lies between samples."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.recording import standard_channel
from towtank.recording.grids.timing import (
    common_samples,
    find_gaps,
    interpolation_weights,
    is_sparse,
    median_step,
    sampling_rate,
)


def test_a_rate_that_is_nearly_whole_is_whole_and_no_other() -> None:
    assert sampling_rate(np.arange(50) / (20.0 * (1.0 + 5e-7))) == 20.0
    assert sampling_rate(np.arange(50) / 20.5) == pytest.approx(20.5, rel=1e-12)
    assert sampling_rate(np.arange(50) / (20.0 * (1.0 + 3e-6))) == pytest.approx(20.0 * (1.0 + 3e-6), rel=1e-9)
    assert sampling_rate(np.arange(50) * 10.0) == pytest.approx(0.1)


def test_a_rate_is_of_the_usual_steps_and_of_bursts_their_mean() -> None:
    t = np.arange(100) / 10.0
    assert sampling_rate(np.delete(t, slice(40, 60))) == 10.0
    bursts = np.concatenate([k * 0.14 + np.array([0.0, 0.001, 0.002, 0.003]) for k in range(50)])
    assert sampling_rate(bursts) == pytest.approx(4.0 / 0.14, rel=0.02)
    assert np.isnan(sampling_rate(t[:1]))
    assert sampling_rate(np.array([0.0, 0.25])) == 4.0
    assert (median_step(t[:2]), np.isnan(median_step(t[:1]))) == (pytest.approx(0.1), True)


def test_a_gap_begins_behind_the_sample_before_it() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.5, 0.6, 0.91, 1.0, 1.1])
    assert find_gaps(t).tolist() == [4]
    assert find_gaps(t, 0.2).tolist() == [2, 4]
    assert find_gaps(t, 0.3).tolist() == [4]
    assert find_gaps(t[:1]).size == 0


def test_at_a_sample_and_beside_it_the_sample_counts_and_in_a_gap_nothing() -> None:
    t, x = np.array([0.0, 1.0, 2.0, 9.0, 10.0]), np.array([0.0, 10.0, 20.0, 90.0, 100.0])
    at = np.array(
        [-1e-5, 0.25, 1.0 - 5e-5, 1.0 + 5e-5, 1.0 + 2e-4, 2.0, 2.0 + 5e-5, 2.0 + 2e-4, 5.0, 9.0 - 5e-5, 10.0, 10.1]
    )
    weights = interpolation_weights(t, at)
    found = weights.linear(x)
    expected = [0.0, 2.5, 10.0, 10.0, 10.002, 20.0, 20.0, np.nan, np.nan, 90.0, 100.0, np.nan]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(weights.linear(np.column_stack([x, -x]))[:, 1], [-each for each in expected], atol=1e-9)
    wide = interpolation_weights(t, at, gap=7.0).linear(x)
    np.testing.assert_allclose(wide[7:9], [20.002, 50.0], atol=1e-9)
    one = interpolation_weights(np.array([1e9]), np.array([1e9, 1e9 + 1e-3]))
    assert (one.known.tolist(), one.weight.tolist()) == ([True, False], [0.0, 0.0])


def test_rotations_between_samples_take_the_shortest_arc() -> None:
    t = np.array([0.0, 1.0, 2.0, 3.0, 9.0])
    angle = np.array([0.2, 0.6, 0.0, 0.0, 0.0])
    q = np.column_stack([np.cos(angle / 2.0), np.zeros(5), np.zeros(5), np.sin(angle / 2.0)])
    q[1] *= -1.0
    found = interpolation_weights(t, np.array([0.25, 1.0, 5.0])).rotation(q)
    turned = 2.0 * np.arctan2(found[:, 3], found[:, 0])
    assert turned[0] == pytest.approx(0.3)
    assert abs(np.tan(turned[1] / 2.0)) == pytest.approx(np.tan(0.3))
    assert np.isnan(found[2]).all()


def test_a_grid_is_sparse_beyond_a_million_cells_and_twenty_for_each_sample() -> None:
    t = np.arange(100_000.0)
    assert not is_sparse([t], 29.9)
    assert is_sparse([t], 30.1)
    assert not is_sparse([t, t + 1.0], 49.9)
    assert is_sparse([t, np.empty(0)], 30.1)
    assert not is_sparse([np.empty(0)], 1e9)


def test_samples_in_common_are_those_of_one_time_with_all_values() -> None:
    a = standard_channel("u", [0.0, 1.0, 2.0, 3.0], [1.0, 2.0, np.nan, 4.0])
    b = standard_channel("v", [1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0])
    t, values = common_samples([a, b])
    assert (t.tolist(), values.tolist()) == ([1.0, 3.0], [[2.0, 5.0], [4.0, 7.0]])
    t, values = common_samples([a, a])
    assert t.tolist() == [0.0, 1.0, 3.0]
