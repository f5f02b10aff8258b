"""The integral of held, delayed, lagged commands, beside a quadrature that knows nothing of the closed form."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.zero_order_hold import (
    force_integral_into,
    forces_now_into,
    hold_force,
    mean_forces_into,
    new_zero_order_hold,
)

FINE = 1e-4  # s


def lagged(n: int, stamps: np.ndarray, values: np.ndarray, T: float) -> np.ndarray:
    """Force (n,) on the fine grid of a command held from the grid's places `stamps` on, at rest on the first before."""
    held = values[np.clip(np.searchsorted(stamps, np.arange(n), side="right") - 1, 0, None)]
    if T == 0.0:
        return held
    out = np.empty(n)
    out[0] = values[0]
    keep = np.exp(-FINE / T)
    for k in range(1, n):
        out[k] = held[k - 1] + (out[k - 1] - held[k - 1]) * keep
    return out


@pytest.mark.parametrize("delay", [0, 373, 3100])
@pytest.mark.parametrize("lag", [0.0, 0.004, 0.2, 30.0])
def test_integrals_equal_quadrature_at_irregular_times(delay: int, lag: float) -> None:
    rng = np.random.default_rng(5)
    n = 40_000
    stamps = np.sort(rng.choice(n, 60, replace=False))
    values = rng.normal(size=60)
    ends = np.unique(np.append(0, rng.choice(n, 90, replace=False)))
    force = lagged(n + 1, stamps + delay, values, lag)
    held = new_zero_order_hold(1, np.array([lag]), delay * FINE)
    out = np.empty(1)
    found, event = [], 0
    for end in ends:
        while event < 60 and stamps[event] <= end:
            hold_force(held, stamps[event] * FINE, values[event : event + 1])
            event += 1
        if not force_integral_into(held, end * FINE, out):
            out[:] = np.nan
        found.append(out[0])
    for k in range(1, len(ends)):
        if ends[k - 1] < stamps[0]:
            continue  # no command had come yet
        part = force[ends[k - 1] : ends[k] + 1]
        exact = part[:-1].sum() * FINE if lag == 0.0 else np.trapezoid(part, dx=FINE)
        assert found[k] == pytest.approx(exact, abs=1e-11 + (3e-5 * FINE / lag if lag else 0.0))


def test_several_thrusters_keep_their_own_lags() -> None:
    held = new_zero_order_hold(3, np.array([0.0, 0.1, 0.5]), 0.0)
    out = np.empty(3)
    hold_force(held, 0.0, np.zeros(3))
    force_integral_into(held, 0.0, out)
    hold_force(held, 0.0, np.array([1.0, 2.0, 3.0]))  # at the same time: the last one counts
    force_integral_into(held, 0.2, out)
    exact = [0.2, 2.0 * (0.2 - 0.1 * (1 - np.exp(-2.0))), 3.0 * (0.2 - 0.5 * (1 - np.exp(-0.4)))]
    assert np.allclose(out, exact, rtol=1e-13)
    assert np.allclose(held.force, [1.0, 2.0 * (1 - np.exp(-2.0)), 3.0 * (1 - np.exp(-0.4))], rtol=1e-13)


def test_nothing_is_known_before_the_first_command_and_the_first_holds_backwards() -> None:
    held = new_zero_order_hold(1, np.zeros(1), 0.1)
    out = np.empty(1)
    assert not force_integral_into(held, 0.0, out)
    hold_force(held, 0.0, np.array([5.0]))
    assert force_integral_into(held, 0.05, out)
    assert out[0] == pytest.approx(0.25)


def test_the_ring_overflows_without_losing_the_present() -> None:
    held = new_zero_order_hold(1, np.zeros(1), 0.0)
    out = np.empty(1)
    hold_force(held, 0.0, np.zeros(1))
    force_integral_into(held, 0.0, out)
    for k in range(5000):
        hold_force(held, 1e-3 * k, np.array([float(k)]))
    force_integral_into(held, 4.5, out)
    force_integral_into(held, 4.6, out)
    assert out[0] == pytest.approx(np.arange(4500, 4600).sum() * 1e-3, rel=1e-9)
    assert held.times.shape == (1024,)


def test_a_command_that_is_not_finite_or_out_of_order_is_passed_over() -> None:
    held = new_zero_order_hold(2, np.zeros(2), 0.0)
    out = np.empty(2)
    hold_force(held, 0.0, np.array([1.0, 1.0]))
    hold_force(held, 1.0, np.array([np.nan, 7.0]))
    hold_force(held, 1.0, np.array([7.0, np.inf]))
    hold_force(held, -1.0, np.array([7.0, 7.0]))
    force_integral_into(held, 0.0, out)
    force_integral_into(held, 2.0, out)
    assert np.allclose(out, 2.0)


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_a_command_at_no_time_is_passed_over(time: float) -> None:
    held = new_zero_order_hold(1, np.zeros(1), 0.0)
    out = np.empty(1)
    hold_force(held, time, np.array([1.0]))
    hold_force(held, 0.0, np.array([2.0]))
    force_integral_into(held, 0.0, out)
    hold_force(held, 1.0, np.array([3.0]))
    force_integral_into(held, 2.0, out)
    assert out[0] == pytest.approx(5.0)


def test_the_clock_never_runs_backwards() -> None:
    held = new_zero_order_hold(1, np.zeros(1), 0.0)
    out = np.empty(1)
    hold_force(held, 0.0, np.ones(1))
    force_integral_into(held, 0.0, out)
    total = 0.0
    for end in (1.0, 0.4, 1.5):  # a late sample has nothing to integrate, and takes nothing back
        force_integral_into(held, end, out)
        total += out[0]
    assert total == pytest.approx(1.5)


@pytest.mark.parametrize("t", [0.31, 0.47, 0.93])
def test_the_force_of_now_answers_to_delay_and_lag_as_its_differences_do(t: float) -> None:
    def now(delay: float, lag: float) -> np.ndarray:
        held = new_zero_order_hold(2, np.array([lag, 0.0]), delay)
        for k, value in enumerate(([0.0, 0.0], [3.0, 1.0], [-2.0, 4.0], [5.0, -1.0])):
            hold_force(held, 0.2 * k, np.array(value))
        out = np.zeros((3, 2))
        mean_forces_into(held, 0.0, out)
        mean_forces_into(held, t - 1e-4, out)
        mean_forces_into(held, t, out)
        forces_now_into(held, out)
        np.testing.assert_array_equal(out[0], held.force)
        return out

    delay, lag, h = 0.05, 0.12, 1e-5
    found = now(delay, lag)
    np.testing.assert_allclose(found[1], (now(delay + h, lag)[0] - now(delay - h, lag)[0]) / (2.0 * h), rtol=1e-3)
    by_lag = (now(delay, lag * (1.0 + h))[0] - now(delay, lag * (1.0 - h))[0]) / (2.0 * h)
    np.testing.assert_allclose(found[2], by_lag, rtol=1e-6)


def test_a_force_without_a_lag_answers_to_its_delay_over_a_step() -> None:
    """A recorded wrench that rises by 3 N/s: each second of delay takes 3 N from the force of now."""
    held, out = new_zero_order_hold(1, np.zeros(1), 0.05), np.zeros((3, 1))
    for k in range(20):
        hold_force(held, 0.02 * k, np.array([3.0 * 0.02 * k]))
    mean_forces_into(held, 0.0, out)
    for k in range(1, 15):
        mean_forces_into(held, 0.02 * k, out)
    forces_now_into(held, out)
    assert out[1, 0] == pytest.approx(-3.0)
