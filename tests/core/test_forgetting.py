"""Forgetting that does not wind up: the schemes against an independent NumPy version, their identities and bounds."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from towtank.core.forgetting import (
    block_length,
    commit_scratch,
    directional_run,
    directional_start,
    directional_update,
    directional_view,
    forget_excited,
)
from towtank.core.least_squares import qr_covariance, qr_run, qr_solve, qr_start

from .proof import proof, seeds, sized

TRUTH = np.array([2.0, -3.0, 0.5])


def reference(
    Phi: np.ndarray, y: np.ndarray, P0: float, forgetting: float, share: float, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directional forgetting as the formulas say it, on information matrices: theta and R."""
    n = Phi.shape[1]
    R, z = np.eye(n) / P0, np.zeros(n)
    length = round(1.0 / (1.0 - forgetting))
    for start in range(0, len(y), length):
        rows, values = Phi[start : start + length], y[start : start + length]
        k = len(values)
        weight = forgetting ** np.arange(k - 1, -1, -1.0)
        B, b = (rows * weight[:, None]).T @ rows, (rows * weight[:, None]).T @ values
        effective = weight.sum()
        M = share * (1.0 - forgetting**k) * R + 9.0 * (effective**0.5 + n**0.5) ** 2 * np.diag(noise**2)
        mu, W = scipy.linalg.eigh(B, M)
        W = W[:, mu >= 1.0]
        if W.shape[1] == 0:
            continue
        theta = np.linalg.solve(R, z)
        R = R - (1.0 - forgetting**k) * R @ W @ np.linalg.solve(W.T @ R @ W, W.T @ R)
        # the block's rows along the excited directions: U^T B^(1/2) with U the left vectors of B^(1/2) W
        size, axes = np.linalg.eigh(B)
        half = axes * np.sqrt(np.maximum(size, 0.0)) @ axes.T
        U = half @ W / np.linalg.norm(half @ W, axis=0)
        own = np.linalg.lstsq(B, b, rcond=None)[0]
        R, z = R + half @ U @ U.T @ half, R @ theta + half @ U @ U.T @ half @ own
    return np.linalg.solve(R, z), R


def data(n: int, k: int, seed: int, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    mix = rng.normal(size=(n, n))
    Phi = rng.normal(size=(k, n)) @ mix
    return Phi, Phi @ np.linspace(-2.0, 5.0, n) + noise * rng.normal(size=k)


@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_directional_is_what_its_formulas_say(n: int, noise: float, seed: int) -> None:
    """Stretches in which only some directions move, and a block that is not full at the end."""
    rng = np.random.default_rng(seed)
    Phi, y = data(n, 490, seed)
    for start in range(0, 490, 70):
        lame = rng.normal(size=(n, max(1, n - 1)))
        Phi[start : start + 35] = Phi[start : start + 35] @ (lame @ np.linalg.pinv(lame)) * rng.choice([1.0, 0.02])
    Phi += noise * rng.normal(size=Phi.shape)
    y = Phi @ np.linspace(-2.0, 5.0, n) + 0.1 * rng.normal(size=len(y))
    levels = np.full(n, noise)
    state = directional_start(np.zeros(n), 1e2, 0.95, 0.1, levels)
    directional_run(state, Phi, y)
    view = directional_view(state, n)
    theta, R = reference(Phi, y, 1e2, 0.95, 0.1, levels)
    T = np.triu(view.reshape(n + 1, n + 1))[:n, :n]
    assert np.abs(T.T @ T - R).max() < 1e-7 * np.abs(R).max()
    assert np.abs(qr_solve(view, n) - theta).max() <= 1e-6 * np.abs(theta).max()


@proof
@given(seed=seeds, n=st.integers(1, 5), forgetting=st.sampled_from([0.9, 0.97, 0.99]))
def test_where_everything_is_excited_directional_is_exponential(seed: int, n: int, forgetting: float) -> None:
    """At every reading once a block and its part are rich: same theta, same P, same residual sum."""
    length = block_length(forgetting)
    rng = np.random.default_rng(seed)
    Phi = np.linalg.qr(rng.normal(size=(n, n)))[0][np.arange(4 * length) % n] * rng.uniform(0.9, 1.1, (4 * length, 1))
    y = Phi @ np.linspace(-2.0, 5.0, n) + 0.1 * rng.normal(size=len(Phi))
    one, other = (
        directional_start(np.zeros(n), 1e2, forgetting, 0.01, np.zeros(n)),
        qr_start(np.zeros(n), 1e2, forgetting),
    )
    for start in range(0, len(y), length):
        directional_run(one, Phi[start : start + length], y[start : start + length])
        qr_run(other, Phi[start : start + length], y[start : start + length])
        view = directional_view(one, n)
        assert np.allclose(qr_solve(view, n), qr_solve(other, n), rtol=1e-9, atol=1e-9)
        assert np.allclose(qr_covariance(view, n), qr_covariance(other, n), rtol=1e-9, atol=1e-12)
        assert abs(view[-1]) == pytest.approx(abs(other[(n + 1) ** 2 - 1]), rel=1e-9)


@proof
@given(seed=seeds)
def test_information_is_bounded_below_at_rest_and_above_in_motion(seed: int) -> None:
    """R along a direction that no row moves stays as it was; nowhere does R exceed what one memory holds n times."""
    rng = np.random.default_rng(seed)
    n, forgetting = 3, 0.95
    Phi, y = data(n, 100, seed % 1000)
    state = directional_start(np.zeros(n), 1e4, forgetting, 0.1, np.zeros(n))
    directional_run(state, Phi, y)
    before = directional_view(state, n)
    T = np.triu(before.reshape(n + 1, n + 1))[:n, :n]
    rest = np.linalg.qr(rng.normal(size=(n, n)))[0]
    moved = rng.normal(size=(400, 2)) @ rest[:, :2].T * rng.uniform(0.5, 2.0)
    directional_run(state, moved, moved @ np.linspace(-2.0, 5.0, n))
    after = directional_view(state, n)
    A = np.triu(after.reshape(n + 1, n + 1))[:n, :n]
    still = rest[:, 2]
    assert np.linalg.norm(A @ still) == pytest.approx(np.linalg.norm(T @ still), rel=1e-6)
    assert np.linalg.eigvalsh(A.T @ A).min() > 0.0
    largest = max(np.sum(Phi**2, axis=1).max(), np.sum(moved**2, axis=1).max())
    assert np.linalg.eigvalsh(A.T @ A).max() <= n * (1e-4 + largest / (1.0 - forgetting))


def test_what_is_below_the_noise_leaves_no_trace() -> None:
    rng = np.random.default_rng(0)
    Phi, y = data(3, 1000, 0)
    state = directional_start(np.zeros(3), 1e8, 0.99, 0.1, np.full(3, 0.05))
    directional_run(state, Phi, y)
    before = directional_view(state, 3)
    hover = 0.05 * rng.normal(size=(20_000, 3))
    directional_run(state, hover, rng.normal(size=20_000))
    assert np.array_equal(directional_view(state, 3), before)


@pytest.mark.parametrize("forgetting", [0.9, 0.995])
def test_eighty_thousand_zeros_change_nothing(forgetting: float) -> None:
    k = sized(80_000, 8_000)
    Phi, y = data(3, 3000, 1)
    state = directional_start(np.zeros(3), 1e8, forgetting, 0.1, np.zeros(3))
    directional_run(state, Phi, y)
    before = directional_view(state, 3)
    assert directional_run(state, np.zeros((k, 3)), np.zeros(k)) == k
    after = directional_view(state, 3)
    assert np.allclose(qr_solve(after, 3), qr_solve(before, 3), rtol=1e-12, atol=0.0)
    assert np.allclose(qr_covariance(after, 3), qr_covariance(before, 3), rtol=1e-9, atol=0.0)


def test_wrong_lengths_and_numbers_change_nothing() -> None:
    Phi, y = data(3, 50, 4)
    state = directional_start(np.zeros(3), 1e4, 0.9, 0.1, np.zeros(3))
    for row, value in zip(Phi, y, strict=True):
        assert directional_update(state, row, value) == 1
    before = directional_view(state, 3)
    assert directional_update(state, np.ones(2), 1.0) == -1
    with np.errstate(invalid="ignore"):
        assert directional_update(state, np.array([1.0, np.nan, 0.0]), 1.0) == 0
        assert directional_update(state, np.ones(3), np.inf) == 0
    assert np.allclose(directional_view(state, 3), before, rtol=1e-12)


@proof
@given(seed=seeds, n=st.integers(2, 5))
def test_past_rows_change_as_the_information_does(seed: int, n: int) -> None:
    """Sums of row products z^T z, turned by (I - F), are what forgetting leaves, the block's rows apart."""
    rng = np.random.default_rng(seed)
    m = n + 1
    past, block = rng.normal(size=(40, m)), rng.normal(size=(20, m))
    block[:, : n - 1] *= 1e-6  # one direction is excited
    kept, fresh = (np.triu(np.linalg.qr(rows, mode="r")).ravel() for rows in (past, block))
    F = np.empty(m * m)
    before = kept.copy()
    assert forget_excited(kept, fresh, n, 0.95, 20.0, 0.1, np.zeros(n), np.zeros(commit_scratch(n)), F) == 1
    change = np.eye(m) - F.reshape(m, m)
    T, B, left = (np.triu(each.reshape(m, m)) for each in (kept, fresh, before))
    turned = change.T @ (left.T @ left) @ change
    rest = T.T @ T - turned  # what the block brought: rank one, and its own residual
    assert np.allclose(rest[:n, :n], (B.T @ B)[:n, :n], atol=1e-4 * np.abs(B).max() ** 2)
    assert np.allclose(turned, turned.T)
