"""Recursive least squares equals the batch solution, and survives whatever a log may contain."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.least_squares import qr_covariance, qr_run, qr_solve, qr_start, qr_update

from .proof import sized


def residual_sum(state: np.ndarray, n: int) -> float:
    return float(state[(n + 1) ** 2 - 1] ** 2)


def data(n: int, k: int, seed: int = 0, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    Phi = rng.normal(size=(k, n)) * np.linspace(1.0, 3.0, n)
    return Phi, Phi @ np.linspace(-2.0, 5.0, n) + noise * rng.normal(size=k)


def batch(
    Phi: np.ndarray, y: np.ndarray, theta0: np.ndarray, P0: float, forgetting: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """theta, P and residual sum of weighted least squares by orthogonal factorisation; the prior is n more rows."""
    k, n = Phi.shape
    weights = np.sqrt(forgetting ** np.arange(k - 1, -1, -1.0))
    prior = np.sqrt(forgetting**k / P0)
    rows = np.vstack([prior * np.eye(n), weights[:, None] * Phi])
    values = np.concatenate([prior * theta0, weights * y])
    theta = np.linalg.lstsq(rows, values, rcond=None)[0]
    R = np.linalg.qr(rows, mode="r")
    return theta, np.linalg.inv(R) @ np.linalg.inv(R).T, float(((values - rows @ theta) ** 2).sum())


@pytest.mark.parametrize("n", [1, 2, 6, 12])
@pytest.mark.parametrize("forgetting", [1.0, 0.99])
@pytest.mark.parametrize("P0", [1.0, 1e4])
def test_equals_batch_with_prior(n: int, forgetting: float, P0: float) -> None:
    Phi, y = data(n, sized(500, 150), seed=n)
    theta0 = np.linspace(1.0, -1.0, n)
    state = qr_start(theta0, P0, forgetting)
    assert qr_run(state, Phi, y) == len(y)
    theta, P, residual = batch(Phi, y, theta0, P0, forgetting)
    assert np.abs(qr_solve(state, n) - theta).max() < 1e-10
    assert np.abs(qr_covariance(state, n) - P).max() < 1e-10 * np.abs(P).max()
    assert residual_sum(state, n) == pytest.approx(residual, rel=1e-10)


@pytest.mark.parametrize("P0", [1e8, 1e12])
@pytest.mark.parametrize("n", [2, 6, 12])
def test_qr_equals_batch_where_nothing_is_known(n: int, P0: float) -> None:
    Phi, y = data(n, sized(500, 150), seed=n)
    state = qr_start(np.zeros(n), P0, 1.0)
    qr_run(state, Phi, y)
    theta, P, residual = batch(Phi, y, np.zeros(n), P0, 1.0)
    assert np.abs(qr_solve(state, n) - theta).max() < 1e-10
    assert np.abs(qr_covariance(state, n) - P).max() < 1e-10 * np.abs(P).max()
    assert residual_sum(state, n) == pytest.approx(residual, rel=1e-10)


@pytest.mark.parametrize("forgetting", [1.0, 0.98])
def test_run_is_a_loop_of_update(forgetting: float) -> None:
    n = 3
    Phi, y = data(n, 100)
    together, one_by_one = (qr_start(np.zeros(n), 1e4, forgetting) for _ in range(2))
    inputs = Phi.copy(), y.copy()
    qr_run(together, Phi, y)
    for phi, value in zip(Phi, y, strict=True):
        assert qr_update(one_by_one, phi, value) == 1
    assert np.array_equal(inputs[0], Phi)
    assert np.array_equal(inputs[1], y)
    assert np.abs(qr_solve(together, n) - qr_solve(one_by_one, n)).max() < 1e-13
    assert np.abs(qr_covariance(together, n) - qr_covariance(one_by_one, n)).max() < 1e-13
    assert residual_sum(together, n) == pytest.approx(residual_sum(one_by_one, n), rel=1e-13)


@pytest.mark.parametrize("forgetting", [1.0, 0.98])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite_change_nothing(forgetting: float, bad: float) -> None:
    n = 3
    Phi, y = data(n, 60)
    state = qr_start(np.zeros(n), 1e4, forgetting)
    qr_run(state, Phi, y)
    before = qr_solve(state, n), qr_covariance(state, n), residual_sum(state, n)
    for place in range(n + 1):
        row = np.append(Phi[0], y[0])
        row[place] = bad
        with np.errstate(invalid="ignore"):  # plain Python warns of inf times 0; compiled code does not
            assert qr_update(state, row[:n].copy(), row[n]) == 0
        assert np.array_equal(qr_solve(state, n), before[0])
        assert np.array_equal(qr_covariance(state, n), before[1])
        assert residual_sum(state, n) == before[2]
    # In the midst of others they are as if they had not been there.
    dirty, values = np.repeat(Phi, 2, axis=0), np.repeat(y, 2)
    dirty[1::4, 0] = bad
    values[3::4] = bad
    seen, clean = qr_start(np.zeros(n), 1e4, forgetting), qr_start(np.zeros(n), 1e4, forgetting)
    with np.errstate(invalid="ignore"):
        assert qr_run(seen, dirty, values) == len(y)
    qr_run(clean, Phi, y)
    assert np.array_equal(qr_solve(seen, n), qr_solve(clean, n))
    assert np.array_equal(qr_covariance(seen, n), qr_covariance(clean, n))


def test_wrong_length_is_refused_and_changes_nothing() -> None:
    n = 3
    Phi, y = data(n, 10)
    state = qr_start(np.zeros(n), 1e4, 1.0)
    qr_run(state, Phi, y)
    before = state.copy()
    for wrong in (1, 2, 4, 9):
        assert qr_update(state, np.ones(wrong), 1.0) == -1
    assert np.array_equal(state, before)


@pytest.mark.parametrize("forgetting", [1.0, 0.999, 0.99, 0.95])
@pytest.mark.parametrize("rest", [[0.0, 0.0], [0.0, 1.0]], ids=["silence", "bollard pull"])
def test_a_long_rest_keeps_everything_finite(forgetting: float, rest: list[float]) -> None:
    """80,000 samples (13 minutes at 100 Hz) of nothing, or of thrust without motion; then it learns as before."""
    n, k = 2, sized(80_000, 8_000)
    forgetting **= 80_000 / k  # the same forgetting over the whole rest
    truth = np.linspace(-2.0, 5.0, n)
    Phi, y = data(n, 200, noise=0.0)
    state = qr_start(np.zeros(n), 1e8, forgetting)
    qr_run(state, Phi, y)
    learned = qr_solve(state, n)
    resting = np.tile(rest, (k, 1))
    with np.errstate(over="ignore", invalid="ignore"):
        qr_run(state, resting, resting @ truth)
        assert np.isfinite(state).all()
        assert np.isfinite(qr_covariance(state, n)).all()
    assert np.abs(qr_solve(state, n) - learned).max() < 1e-6
    turns = 1 if forgetting == 1.0 else int(np.ceil(np.log(1e-9) / np.log(forgetting) / len(y)))
    again = np.tile(Phi, (turns, 1))
    assert qr_run(state, again, again @ (2.0 * truth)) == len(again)
    if forgetting < 1.0:
        assert np.abs(qr_solve(state, n) - 2.0 * truth).max() < 1e-6
    assert np.isfinite(qr_covariance(state, n)).all()


@pytest.mark.parametrize("n", [2, 6])
@pytest.mark.parametrize("forgetting", [1.0, 0.9999])
def test_covariance_stays_symmetric_and_positive_definite(n: int, forgetting: float) -> None:
    k = sized(1_000_000, 4_000)
    rng = np.random.default_rng(1)
    Phi = rng.normal(size=(k, n))
    Phi[:, -1] = Phi[:, 0] + 0.02 * Phi[:, -1]  # two unknowns that hardly differ
    theta = np.linspace(-2.0, 5.0, n)
    state = qr_start(np.zeros(n), 1e8, forgetting)
    qr_run(state, Phi, Phi @ theta + 0.01 * rng.normal(size=k))
    P = qr_covariance(state, n)
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0
    std = 0.01 * np.sqrt(np.diag(P))
    assert (np.abs(qr_solve(state, n) - theta) < 5.0 * std).all()
    exact = np.linalg.inv((Phi * (forgetting ** np.arange(k - 1, -1, -1.0))[:, None]).T @ Phi)
    assert np.abs(P - exact).max() < 1e-6 * np.abs(exact).max()


def test_covariance_is_honest() -> None:
    """Over many noisy data sets the scatter of theta is sigma^2 P."""
    n, k, sigma, trials = 2, 40, 0.3, sized(3000, 500)
    rng = np.random.default_rng(2)
    Phi = rng.normal(size=(k, n))
    found = np.empty((trials, n))
    for i in range(trials):
        state = qr_start(np.zeros(n), 1e8, 1.0)
        qr_run(state, Phi, Phi @ [1.0, -2.0] + sigma * rng.normal(size=k))
        found[i] = qr_solve(state, n)
    expected = sigma**2 * qr_covariance(state, n)
    scatter = np.cov(found.T)
    assert np.abs(scatter - expected).max() < 5.0 / np.sqrt(trials) * np.abs(expected).max()


def test_forgetting_follows_a_change() -> None:
    n = 2
    Phi, _ = data(n, 600)
    y = np.concatenate([Phi[:300] @ [1.0, 2.0], Phi[300:] @ [3.0, -1.0]])
    state = qr_start(np.zeros(n), 1e6, 0.9)
    qr_run(state, Phi, y)
    assert np.abs(qr_solve(state, n) - [3.0, -1.0]).max() < 1e-8


def test_where_the_triangle_is_singular_the_answer_says_so() -> None:
    state = np.zeros(3 * 4 + 1)
    state[-1] = 1.0
    assert np.isnan(qr_solve(state, 2)).all()
    with np.errstate(invalid="ignore"):
        assert np.isinf(np.diag(qr_covariance(state, 2))).all()
