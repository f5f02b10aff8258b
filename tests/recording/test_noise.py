"""The parts of which a noise level is made, against plain arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.recording.noise import (
    NoiseLevel,
    _blocks,
    _differences,
    _noise_told_by,
    _outliers,
    _resolution,
    _runs,
    fresh_samples,
    noise_level,
    noise_of_rows,
    quantum_of,
    robust_size,
)

Rng = np.random.Generator


@pytest.fixture
def rng() -> Rng:
    return np.random.default_rng(7)


@pytest.mark.parametrize("off", [0.37, 0.0])
def test_the_ends_of_drawn_lines_are_found_where_they_lie(off: float, rng: Rng) -> None:
    """Lines of 7.3 samples: their ends lie between samples, and are where two lines meet."""
    t = np.arange(800) / 100.0
    knots = (np.arange(1, 108) * 7.3 + off) / 100.0
    heights = np.where(np.arange(knots.size) % 2, 1.0, -1.0) * rng.uniform(1.0, 2.0, knots.size)
    found_t, found = fresh_samples(t, np.interp(t, knots, heights))
    inside = (knots > t[10]) & (knots < t[-10])
    near = np.abs(found_t[:, None] - knots[None, inside]).argmin(axis=0)
    np.testing.assert_allclose(found_t[near], knots[inside], atol=1.1e-3)  # one beside a sample may be taken for it
    assert np.mean(np.abs(found_t[near] - knots[inside]) < 1e-8) > 0.75
    assert np.mean(np.abs(found[near] - heights[inside]) < 1e-6) > 0.75
    assert abs(found_t.size - inside.sum()) <= 4


def test_ends_at_which_a_line_goes_straight_on_are_put_back(rng: Rng) -> None:
    t = np.arange(800) / 100.0
    knots = np.arange(0.0, 8.0, 0.08)
    heights = rng.normal(size=knots.size)
    heights[40] = 0.5 * (heights[39] + heights[41])  # no bend there
    heights[61:63] = heights[60] + (heights[63] - heights[60]) * np.array([1.0, 2.0]) / 3.0
    found_t, found = fresh_samples(t, np.interp(t, knots, heights))
    for k in (40, 61, 62):
        at = int(np.abs(found_t - knots[k]).argmin())
        assert found_t[at] == pytest.approx(knots[k], abs=1e-6)
        assert found[at] == pytest.approx(heights[k], abs=1e-6)


def test_what_is_drawn_in_few_or_in_no_lines_is_left_as_it_is(rng: Rng) -> None:
    t = np.arange(400) / 100.0
    for x in (rng.normal(size=400), np.interp(t, np.arange(8) / 2.0, rng.normal(size=8)), 3.0 * t):
        assert fresh_samples(t, x)[0] is t
    short = np.interp(t[:59], np.arange(0.0, 0.6, 0.04), rng.normal(size=15))
    assert fresh_samples(t[:59], short)[0].size == 59


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_differences_have_unit_weights_and_take_out_polynomials(order: int, rng: Rng) -> None:
    t = np.arange(200) / 50.0
    x = rng.normal(size=200)
    weights = np.array([1.0])
    for _ in range(order):
        weights = np.convolve(weights, [1.0, -1.0])
    plain = np.convolve(x, weights, mode="valid") / np.linalg.norm(weights)
    np.testing.assert_allclose(np.abs(_differences(t, x, order, 1.0)), np.abs(plain), atol=1e-12)
    uneven = np.sort(t + rng.uniform(-0.009, 0.009, 200))
    polynomial = sum((k + 1.0) * uneven**k for k in range(order))
    assert np.abs(_differences(uneven, polynomial, order, 1.0)).max() < 1e-9
    white = _differences(np.cumsum(rng.uniform(0.01, 0.03, 20_000)), rng.normal(size=20_000), order, 1.0)
    assert white.std() == pytest.approx(1.0, abs=0.03)


def test_differences_do_not_cross_a_gap() -> None:
    t = np.delete(np.arange(100) / 10.0, slice(40, 60))
    x = np.where(t > 5.0, 100.0, 0.0)
    assert np.abs(_differences(t, x, 2, 0.3)).max() == 0.0
    assert _differences(t, x, 2, 0.3).size == 38 + 38
    assert np.abs(_differences(t, x, 2, 9.0)).max() > 1.0
    assert _differences(t[:2], x[:2], 2, 0.3).size == 0
    assert _differences(t[:3], x[:3], 2, 0.3).size == 1


def test_the_size_of_the_bulk_knows_nothing_of_outliers(rng: Rng) -> None:
    d = rng.normal(size=50_000)
    assert robust_size(3.0 * d) == pytest.approx(3.0, rel=0.01)
    d[:2000] = 100.0
    assert robust_size(3.0 * d) == pytest.approx(3.0, rel=0.1)
    assert robust_size(np.zeros(50)) == 0.0


def test_runs_of_flags_are_told_by_their_ends() -> None:
    flags = np.array([1, 1, 0, 1, 0, 0, 1, 1, 1], dtype=np.bool_)
    first, last = _runs(flags)
    assert (first.tolist(), last.tolist()) == ([0, 3, 6], [1, 3, 8])
    assert _runs(np.zeros(3, dtype=np.bool_))[0].size == 0


def test_the_last_digit_is_the_least_that_a_lines_steps_change() -> None:
    steps = np.array([0.1, 0.1, 0.1 + 1e-3, 0.1 - 4e-3, 0.1])
    assert _resolution(steps, 10.0) == pytest.approx(1e-3)
    assert _resolution(np.full(9, 0.1), 10.0) == pytest.approx(1e-8)
    assert _resolution(np.zeros(9), 0.0) == 0.0


@pytest.mark.parametrize("quantum", [0.02, 1.0])
def test_a_quantum_shows_up_to_thirty_of_it_and_through_rounding(quantum: float, rng: Rng) -> None:
    counts = np.cumsum(rng.integers(-20, 21, 4000)).astype(np.float64)
    assert quantum_of(np.diff(quantum * counts)) == pytest.approx(quantum, rel=1e-9)
    assert quantum_of(np.array([0.0, 1.0, 0.0])) == 0.0
    assert quantum_of(rng.normal(size=4000)) == 0.0


def test_an_offset_is_counted_where_it_comes_and_goes_within_a_second() -> None:
    t = np.arange(500) / 50.0
    x = np.zeros(500)
    x[100] = 1.0
    x[200:210] = -2.0
    x[300:] += 5.0  # a step that stays
    assert _outliers(t, x, 0.01, 0.2) == 11
    assert _outliers(t, x, 1.0, 0.2) == 0
    assert _outliers(t[:5], x[:5], 0.01, 0.2) == 0
    x[400:460] += 3.0  # for more than a second
    assert _outliers(t, x, 0.01, 0.2) == 11


def test_of_a_long_channel_blocks_from_end_to_end_count(rng: Rng) -> None:
    t = np.arange(200_000) / 100.0
    some, same = _blocks(t, 2.0 * t)
    assert (some.size, some[0], some[-1]) == (60_000, t[0], t[-1])
    np.testing.assert_array_equal(same, 2.0 * some)
    assert (np.diff(some) > 0.011).sum() == 29
    assert _blocks(t[:60_000], t[:60_000])[0].size == 60_000
    assert noise_level(t, rng.normal(size=t.size)).samples == 60_000


def test_repeats_do_not_count_twice_and_a_level_without_a_rate_is_taken_as_it_is() -> None:
    level = NoiseLevel(0.1, 10.0, 0.0, 0.0, 100)
    assert [level.of_each(rate) for rate in (40.0, 10.0, 5.0, 0.0)] == pytest.approx([0.2, 0.1, 0.1, 0.1])
    assert NoiseLevel(0.1, 0.0, 0.0, 0.0, 100).of_each(40.0) == 0.1
    assert (level.white, level.dead) == (True, False)


def test_what_a_smoothed_sensor_shows_is_not_believed() -> None:
    typical, least = [0.5] * 18, [0.01] * 18

    def shown(*levels: tuple[float, float, bool]) -> list[float]:
        told = {k: (NoiseLevel(std, 10.0, 0.0, q, 100, white), 10.0) for k, (std, q, white) in enumerate(levels)}
        return _noise_told_by(told, typical, least)[:4].tolist()

    assert shown((0.2, 0.0, True), (0.3, 0.0, True), (0.001, 0.0, True)) == [0.2, 0.3, 0.01, 0.5]
    assert shown((0.2, 0.0, False), (0.3, 0.0, True), (0.7, 0.0, True)) == [0.5, 0.3, 0.7, 0.5]
    assert shown((0.2, 0.0, False), (0.3, 0.1, True), (0.7, 0.0, True)) == [0.5, 0.5, 0.7, 0.5]
    assert shown((0.2, 0.04, True), (0.3, 0.0, True), (0.7, 0.0, True)) == [0.2, 0.3, 0.7, 0.5]
    assert shown((0.2, 0.041, True), (0.3, 0.0, True), (0.7, 0.0, True)) == [0.5, 0.3, 0.7, 0.5]
    assert shown((0.2, 0.0, True), (np.nan, 0.0, True), (0.0, 0.0, True)) == [0.2, 0.5, 0.5, 0.5]


def test_rows_show_their_noise_from_thirty_of_a_column_on(rng: Rng) -> None:
    t = np.arange(400) / 20.0
    values = np.full((400, 18), np.nan)
    values[:, 0] = 0.3 * rng.normal(size=400)
    values[:29, 3] = rng.normal(size=29)
    typical, least = np.full(18, 9.0), np.full(18, 1e-6)
    noise = noise_of_rows(t, values, typical.tolist(), least.tolist())
    assert noise[0] == pytest.approx(0.3, rel=0.15)
    assert noise[1:].tolist() == [9.0] * 17
    values[300:, 0] *= 10.0
    assert noise_of_rows(t, values, typical.tolist(), least.tolist(), 100)[0] == pytest.approx(3.0, rel=0.25)
    np.testing.assert_array_equal(
        noise_of_rows(t, values, typical.tolist(), least.tolist(), 1000),
        noise_of_rows(t, values, typical.tolist(), least.tolist()),
    )
