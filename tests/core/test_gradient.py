"""The normalised gradient estimator: never further away for gamma < 2, there in the end if all is excited."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from towtank.core.gradient import gradient_run, gradient_update

from .proof import proof, sized, vectors

TRUTH = np.array([1.0, -2.0, 0.5])


@proof
@given(vectors(3), vectors(3), st.floats(0.001, 1.999), st.floats(1e-6, 10.0))
def test_no_step_leads_away_from_the_truth(start: np.ndarray, phi: np.ndarray, gamma: float, alpha: float) -> None:
    theta = start.copy()
    assert gradient_update(theta, phi, float(phi @ TRUTH), gamma, alpha)
    assert np.linalg.norm(theta - TRUTH) <= np.linalg.norm(start - TRUTH) * (1.0 + 1e-12)


@proof
@given(vectors(3), vectors(3), st.floats(-10, 10), st.floats(0.001, 3.0), st.floats(1e-3, 10.0))
def test_one_step_against_the_written_rule(
    start: np.ndarray, phi: np.ndarray, y: float, gamma: float, alpha: float
) -> None:
    theta = start.copy()
    gradient_update(theta, phi, y, gamma, alpha)
    expected = start + gamma * phi * (y - phi @ start) / (alpha + phi @ phi)
    assert np.abs(theta - expected).max() < 1e-12 * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("gamma", [0.1, 1.0, 1.9])
@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e3])
def test_converges_when_all_directions_are_excited_at_any_scale(gamma: float, scale: float) -> None:
    k = sized(20_000, 3_000)
    Phi = scale * np.random.default_rng(0).normal(size=(k, 3))
    theta = np.zeros(3)
    assert gradient_run(theta, Phi, Phi @ TRUTH, gamma, 1e-6 * scale**2) == k
    assert np.abs(theta - TRUTH).max() < 1e-10


def test_without_excitation_it_stays_put_in_that_direction() -> None:
    Phi = np.random.default_rng(0).normal(size=(2000, 3)) * [1.0, 1.0, 0.0]
    theta = np.array([0.0, 0.0, 7.0])
    gradient_run(theta, Phi, Phi @ TRUTH, 1.0, 1e-6)
    assert np.abs(theta[:2] - TRUTH[:2]).max() < 1e-10
    assert theta[2] == 7.0


def test_two_is_the_limit() -> None:
    """Just above gamma = 2 the error grows: the bound is sharp, so the rule is the one whose bound is 2."""
    Phi = np.random.default_rng(0).normal(size=(2000, 3))
    theta = np.zeros(3)
    gradient_run(theta, Phi, Phi @ TRUTH, 2.1, 1e-9)
    assert np.linalg.norm(theta - TRUTH) > 1e3


def test_noise_does_not_drive_it_away() -> None:
    rng = np.random.default_rng(1)
    k = sized(200_000, 5_000)
    Phi = rng.normal(size=(k, 3))
    theta = np.zeros(3)
    gradient_run(theta, Phi, Phi @ TRUTH + 0.1 * rng.normal(size=k), 1.9, 1e-3)
    assert np.abs(theta - TRUTH).max() < 10.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite_change_nothing(bad: float) -> None:
    theta = np.array([1.0, 2.0, 3.0])
    for place in range(4):
        row = np.ones(4)
        row[place] = bad
        assert not gradient_update(theta, row[:3].copy(), row[3], 0.5, 1e-6)
    assert theta.tolist() == [1.0, 2.0, 3.0]


def test_silence_changes_nothing() -> None:
    theta = np.array([1.0, 2.0, 3.0])
    for alpha in (0.0, 1.0):
        gradient_update(theta, np.zeros(3), 1.0, 0.5, alpha)
    assert theta.tolist() == [1.0, 2.0, 3.0]


def test_run_is_a_loop_of_update() -> None:
    rng = np.random.default_rng(3)
    Phi, y = rng.normal(size=(50, 3)), rng.normal(size=50)
    Phi[7, 1], y[20] = np.nan, np.inf
    together, one_by_one = np.zeros(3), np.zeros(3)
    used = gradient_run(together, Phi, y, 0.7, 0.1)
    assert used == sum(gradient_update(one_by_one, phi, v, 0.7, 0.1) for phi, v in zip(Phi, y, strict=True)) == 48
    assert np.array_equal(together, one_by_one)
