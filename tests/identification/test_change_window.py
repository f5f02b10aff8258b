"""What an increment of samples says of a change, against exact Bayes factors of a linear model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from towtank.core.arrays import Array
from towtank.identification.changes.evidence import (
    InformationIncrement,
    Overdispersion,
    increment_between,
    of_changes,
)
from towtank.identification.changes.hypotheses import Known, likeness

N, ROWS = 3, 12


def _linear(
    seed: int, *, overdispersion: float = 1.0, known: float = 1.0
) -> tuple[Array, Array, Array, Array, Array, InformationIncrement]:
    """Return theta0, P0, steps, rows H, y with unit noise, and the increment of a filter that was widened by steps."""
    random = np.random.default_rng(seed)
    theta0 = random.standard_normal(N)
    root = 0.1 * random.standard_normal((N, N))
    P0 = known * (root @ root.T + 1e-3 * np.eye(N))
    steps = np.array([0.5, 1.0, 0.3])
    H = random.standard_normal((ROWS, N)) * np.array([1.0, 2.0, 0.1])
    truth = random.multivariate_normal(theta0, P0)
    y = H @ truth + np.sqrt(overdispersion) * random.standard_normal(ROWS)
    before = P0 + np.diag(steps**2)
    P = np.linalg.inv(np.linalg.inv(before) + H.T @ H)
    theta = P @ (np.linalg.solve(before, theta0) + H.T @ y)
    return theta0, P0, steps, H, y, increment_between(theta0, P0, steps, theta, P)


@pytest.mark.parametrize("seed", range(5))
def test_information_and_score_are_those_of_the_samples_alone(seed: int) -> None:
    theta0, _, _, H, y, increment = _linear(seed)
    np.testing.assert_allclose(increment.information, H.T @ H, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(increment.score, H.T @ (y - H @ theta0), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_evidence_is_the_exact_marginal_likelihood(seed: int) -> None:
    theta0, P0, steps, H, y, increment = _linear(seed)
    none = multivariate_normal(H @ theta0, H @ P0 @ H.T + np.eye(ROWS)).logpdf(y)
    ways = (np.array([1, 0, 0]), np.array([0, 1, 1]), np.ones(3))
    found = of_changes([increment, increment], [taken * steps for taken in ways], 1.0)
    np.testing.assert_array_equal(found[0], found[1])
    for taken, of_change in zip(ways, found[0], strict=True):
        some = P0 + np.diag((taken * steps) ** 2)
        exact = multivariate_normal(H @ theta0, H @ some @ H.T + np.eye(ROWS)).logpdf(y) - none
        assert of_change == pytest.approx(exact, abs=1e-6)
        assert exact <= increment.most(steps) + 1e-9  # what decides whether a increment is worth weighing
    mean, C = np.array([0.3, -0.2, 0.1]), 0.01 * np.eye(N)
    exact = multivariate_normal(H @ (theta0 + mean), H @ C @ H.T + np.eye(ROWS)).logpdf(y) - none
    assert increment.evidence(C, mean) - increment.evidence(P0) == pytest.approx(exact, abs=1e-6)


def test_where_nothing_changes_the_bayes_factor_keeps_villes_bound() -> None:
    steps = np.array([0.5, 1.0, 0.3])
    factors = of_changes([_linear(seed)[-1] for seed in range(2000)], [steps], 1.0)[:, 0]
    assert np.mean(np.exp(0.5 * factors)) <= 1.0  # the mean of the factor itself is 1, of its root less
    for bound in (2.0, 5.0, 10.0):
        assert np.mean(factors >= np.log(bound)) <= 1.0 / bound


@pytest.mark.parametrize("overdispersion", [1.0, 4.0, 20.0])
def test_overdispersion_is_what_increments_err_more_than_they_say(overdispersion: float) -> None:
    found = Overdispersion()
    for seed in range(400):
        *_, increment = _linear(seed, overdispersion=overdispersion, known=1e-4)
        found.learn(increment, np.array([0.5, 1.0, 0.3]))
    assert found.known
    assert found.factor == pytest.approx(overdispersion, rel=0.25)
    again = Overdispersion()
    again.restore(found.numbers)
    assert again.factor == found.factor


def test_changes_are_weighed_by_increments_as_they_count() -> None:
    steps = np.array([0.5, 0.0, 0.3])
    *_, increment = _linear(7)
    found = of_changes([increment], [steps], 3.0)
    np.testing.assert_allclose(found, of_changes([increment.tempered(3.0)], [steps], 1.0), rtol=1e-9)


def test_overdispersion_does_not_hide_one_change() -> None:
    found = Overdispersion()
    for seed in range(100):
        found.learn(_linear(seed)[-1], np.array([0.5, 1.0, 0.3]))
    before = found.factor
    theta0, P0, steps, _, _, increment = _linear(0)
    shock = InformationIncrement(
        theta0, P0, increment.information, increment.score + increment.information @ np.array([3.0, 0.0, 0.0])
    )
    found.learn(shock, steps)
    assert found.factor < before + 0.2


def test_increments_without_samples_say_nothing() -> None:
    P0 = np.diag([0.01, 0.0, 0.04])
    steps = np.array([0.1, 0.2, 0.0])
    increment = increment_between(np.zeros(3), P0, steps, np.zeros(3), P0 + np.diag(steps**2))
    assert np.abs(increment.information).max() < 1e-6 / 0.01**2
    assert of_changes([increment], [steps], 1.0)[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert increment.usual(steps) == pytest.approx(0.0, abs=1e-6)


def test_the_right_configuration_is_the_likeliest_and_none_where_none_fits() -> None:
    theta0, P0, steps, H, _, _ = _linear(3)
    before = P0 + np.diag(steps**2)
    known = [Known(name, theta0 + way, 1e-4 * np.eye(N)) for name, way in
             (("a", np.array([1.0, 0.0, 0.0])), ("b", np.array([0.0, 1.0, 0.0])))]  # fmt: skip
    for way, expected in ((np.array([0.0, 1.0, 0.0]), 1), (np.array([-1.0, 1.0, 0.0]), 2)):
        y = H @ (theta0 + way)
        P = np.linalg.inv(np.linalg.inv(before) + 25.0 * H.T @ H)
        theta = P @ (np.linalg.solve(before, theta0) + 25.0 * H.T @ y)
        increment = increment_between(theta0, P0, steps, theta, P)
        shares = likeness(increment, known, increment.evidence(before))
        assert shares.sum() == pytest.approx(1.0)
        assert int(np.argmax(shares)) == expected
        assert shares[expected] > 0.95
