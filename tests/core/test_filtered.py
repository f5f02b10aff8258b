"""Filtered regressors: the identity holds to rounding for every filter; only the quadrature has an order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from towtank.core.least_squares import accumulate_into, cubic_increment, filter_increments, hermite_increment

from .proof import proof, seeds


@proof
@given(seeds, st.floats(0.0, 50.0))
def test_filter_is_the_weighted_sum_of_increments(seed: int, a: float) -> None:
    """f[k] = sum_i exp(-a (t_k - t_i)) increment[i], at irregular times; the increments themselves stay."""
    rng = np.random.default_rng(seed)
    dt, increments = rng.uniform(0.001, 0.1, 30), rng.normal(size=(30, 3))
    before = increments.copy()
    t = np.cumsum(dt)
    weights = np.tril(np.exp(-a * np.abs(t[:, None] - t[None, :])))
    assert np.abs(filter_increments(increments, dt, a) - weights @ increments).max() < 1e-12
    assert np.array_equal(increments, before)


@proof
@given(seeds, st.floats(0.0, 50.0), st.floats(-3.0, 3.0), st.floats(0.01, 0.5))
def test_the_identity_is_exact_for_every_filter_and_every_sampling(
    seed: int, a: float, start: float, pace: float
) -> None:
    """x_dot = 2 cos(t) - 3 t^2 + 0.5 u with u held: x filtered equals the filtered regressors times (2, -3, 0.5)."""
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 1.9, 60) * pace)])
    u = rng.normal(size=60)
    dt = np.diff(t)
    theta = np.array([2.0, -3.0, 0.5])
    phi = np.column_stack([np.diff(np.sin(t)), np.diff(t**3) / 3.0, u * dt])
    x = start + np.concatenate([[0.0], np.cumsum(phi @ theta)])
    left = filter_increments(np.diff(x)[:, None], dt, a)[:, 0]
    right = filter_increments(phi, dt, a) @ theta
    assert np.abs(left - right).max() < 1e-13 * (1.0 + np.abs(x).max())


def test_it_is_the_filter_of_the_paper() -> None:
    """As the samples get dense, f -> int exp(-a (t - s)) phi(s) ds, its (43), with error of order h."""
    a, end = 2.0, 3.0
    exact = (np.cos(end) * a + np.sin(end) - a * np.exp(-a * end)) / (a**2 + 1.0)  # phi = cos
    errors = []
    for n in (1000, 2000):
        t = np.linspace(0.0, end, n + 1)
        f = filter_increments(np.diff(np.sin(t))[:, None], np.diff(t), a)[-1, 0]
        errors.append(abs(f - exact))
    assert errors[0] < 3e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.05)


def test_least_squares_on_filtered_rows_finds_the_truth_from_any_start() -> None:
    rng = np.random.default_rng(0)
    h, x, theta = 0.05, [1.7], np.array([-0.8, 0.3])
    u = np.repeat(rng.normal(size=40), 5)
    phi = []
    for held in u:  # x_dot = theta0 x + theta1 u, solved exactly over each hold; int x from the equation itself
        x.append(np.exp(theta[0] * h) * x[-1] + (np.exp(theta[0] * h) - 1.0) / theta[0] * theta[1] * held)
        phi.append([(x[-1] - x[-2] - theta[1] * held * h) / theta[0], held * h])
    for a in (0.1, 1.0, 10.0):
        dt = np.full(len(u), h)
        rows = filter_increments(np.array(phi), dt, a)
        left = filter_increments(np.diff(x)[:, None], dt, a)[:, 0]
        assert np.abs(np.linalg.lstsq(rows, left, rcond=None)[0] - theta).max() < 1e-10


def test_streaming_is_the_same_recursion() -> None:
    rng = np.random.default_rng(1)
    increments, a, h = rng.normal(size=(20, 4)), 0.7, 0.1
    expected = filter_increments(increments, np.full(20, h), a)
    filtered = np.zeros(5)
    for k, increment in enumerate(increments):
        accumulate_into(filtered, increment, float(np.exp(-a * h)), 4)
        assert np.abs(filtered[:4] - expected[k]).max() < 1e-14
    assert filtered[4] == 0.0


@proof
@given(st.tuples(*[st.floats(-3, 3)] * 4), st.floats(0.01, 2.0), st.floats(-2.0, 2.0))
def test_both_quadratures_are_exact_for_cubics(c: tuple[float, ...], h: float, t0: float) -> None:
    f = np.polynomial.Polynomial(c)
    exact = f.integ()(t0 + h) - f.integ()(t0)
    scale = 1.0 + sum(abs(x) for x in c) * (abs(t0) + 2 * h + 1) ** 4
    slope = f.deriv()
    hermite = hermite_increment(f(t0), f(t0 + h), slope(t0), slope(t0 + h), h)
    cubic = cubic_increment(f(t0 - 2 * h), f(t0 - h), f(t0), f(t0 + h), h)
    assert abs(hermite - exact) < 1e-14 * scale
    assert abs(cubic - exact) < 1e-14 * scale


STEPS = 0.1 / 2.0 ** np.arange(4)


def order(errors: list[float]) -> float:
    return float(np.polyfit(np.log(STEPS), np.log(errors), 1)[0])


def test_order_five_per_interval() -> None:
    t = 0.4
    f, slope, integral = np.exp, np.exp, np.exp
    exact = [integral(t + h) - integral(t) for h in STEPS]
    hermite = [hermite_increment(f(t), f(t + h), slope(t), slope(t + h), h) for h in STEPS]
    cubic = [cubic_increment(f(t - 2 * h), f(t - h), f(t), f(t + h), h) for h in STEPS]
    assert order(np.abs(np.subtract(hermite, exact)).tolist()) == pytest.approx(5.0, abs=0.1)
    assert order(np.abs(np.subtract(cubic, exact)).tolist()) == pytest.approx(5.0, abs=0.1)
    # The leading errors: h^5/720 f'''' of the Hermite form, 19/720 h^5 f'''' of the cubic one.
    h = STEPS[-1]
    assert (hermite[-1] - exact[-1]) / (h**5 * f(t)) == pytest.approx(-1 / 720, rel=0.1)
    assert abs(cubic[-1] - exact[-1]) / (h**5 * f(t)) == pytest.approx(19 / 720, rel=0.1)


def test_order_four_over_a_whole_motion() -> None:
    errors = []
    for h in STEPS:
        t = np.arange(round(2.0 / h) + 1) * h
        f, slope = np.sin(3 * t), 3 * np.cos(3 * t)
        total = sum(hermite_increment(f[k], f[k + 1], slope[k], slope[k + 1], h) for k in range(len(t) - 1))
        errors.append(abs(total - (1 - np.cos(6.0)) / 3))
    assert order(errors) == pytest.approx(4.0, abs=0.1)
