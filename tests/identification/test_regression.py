"""One battery for recursive least squares, however it forgets."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import RecursiveLeastSquares

N = 4
TRUTH = np.array([2.0, -3.0, 0.5, 40.0])
Make = Callable[[], RecursiveLeastSquares]
ALL: dict[str, Make] = {
    "no forgetting": lambda: RecursiveLeastSquares(N),
    "exponential": lambda: RecursiveLeastSquares(N, forgetting=0.995, scheme="exponential"),
    "directional": lambda: RecursiveLeastSquares(N, forgetting=0.995),
    "directional noise": lambda: RecursiveLeastSquares(N, forgetting=0.98, noise=1e-3),
}
every = pytest.mark.parametrize("make", ALL.values(), ids=ALL.keys())


def data(k: int = 400, noise: float = 0.1, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    Phi = rng.normal(size=(k, N)) * [1.0, 0.3, 5.0, 0.1]
    return Phi, Phi @ TRUTH + noise * rng.normal(size=k)


@every
def test_many_at_once_equal_one_by_one(make: Make) -> None:
    Phi, y = data()
    single, many, parts = make(), make(), make()
    for row, value in zip(Phi, y, strict=True):
        assert single.update(row, value)
    assert many.run(Phi, y) == len(y)
    for part in np.array_split(np.arange(len(y)), 7):
        parts.run(Phi[part], y[part])
    assert np.allclose(single.theta, many.theta, rtol=1e-12, atol=0)
    assert np.allclose(parts.theta, many.theta, rtol=1e-12, atol=0)


@every
def test_no_aliasing_with_inputs_or_outputs(make: Make) -> None:
    Phi, y = data()
    kept = Phi.copy(), y.copy()
    estimator, other = make(), make()
    row = np.empty(N)
    for k in range(len(y)):
        row[:] = Phi[k]
        estimator.update(row, float(y[k]))
        row[:] = 1e9  # the caller's buffer belongs to the caller
    other.run(Phi, y)
    assert np.array_equal(Phi, kept[0])
    assert np.array_equal(y, kept[1])
    before = estimator.theta
    before[:] = 7.0
    assert np.allclose(estimator.theta, other.theta, rtol=1e-12, atol=0)


@every
def test_a_pickle_goes_on_as_the_original(make: Make) -> None:
    Phi, y = data()
    estimator = make()
    estimator.run(Phi[:200], y[:200])
    copy = pickle.loads(pickle.dumps(estimator))
    for one in (estimator, copy):
        one.run(Phi[200:], y[200:])
    assert np.array_equal(estimator.theta, copy.theta)


@every
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_skipped_and_counted(make: Make, bad: float) -> None:
    Phi, y = data(60)
    clean, dirty = make(), make()
    clean.run(Phi, y)
    half = Phi[30].copy()
    half[2] = bad
    dirty.run(Phi[:30], y[:30])
    assert not dirty.update(half, 1.0)
    assert not dirty.update(Phi[30], bad)
    assert dirty.run(np.vstack([half, Phi[30:]]), np.append(0.0, y[30:])) == 30
    assert dirty.skipped == 3
    assert np.allclose(dirty.theta, clean.theta, rtol=1e-12, atol=0)


@every
def test_wrong_shapes_are_refused_and_change_nothing(make: Make) -> None:
    Phi, y = data(50)
    estimator = make()
    estimator.run(Phi, y)
    before = estimator.theta
    with pytest.raises(InputError, match=r"expected \(4,\)"):
        estimator.update(np.ones(3), 1.0)
    with pytest.raises(InputError, match=r"expected \(4,\)"):
        estimator.update(np.ones((1, 4)), 1.0)
    with pytest.raises(InputError, match=r"expected \(k, 4\)"):
        estimator.run(np.ones((5, 3)), np.ones(5))
    with pytest.raises(InputError, match=r"expected \(k, 4\)"):
        estimator.run(np.ones((5, 4)), np.ones(4))
    assert np.array_equal(estimator.theta, before)


@every
def test_lists_integers_and_views_are_taken(make: Make) -> None:
    a, b = make(), make()
    a.update([1, 2, 3, 4], 5)  # type: ignore[arg-type]
    b.update(np.array([[1.0, 9.0], [2.0, 9.0], [3.0, 9.0], [4.0, 9.0]])[:, 0], 5.0)
    assert np.allclose(a.theta, b.theta, rtol=1e-14, atol=0)


def test_recursive_equals_batch() -> None:
    Phi, y = data(2000)
    rls = RecursiveLeastSquares(N, P0=1e6, theta0=np.ones(N))
    rls.run(Phi, y)
    information = Phi.T @ Phi + 1e-6 * np.eye(N)
    exact = np.linalg.solve(information, Phi.T @ y + 1e-6)
    assert np.abs(rls.theta / exact - 1.0).max() < 1e-10
    assert np.allclose(rls.P, np.linalg.inv(information), rtol=1e-9)
    square = np.sum((y - Phi @ exact) ** 2) + 1e-6 * np.sum((exact - 1.0) ** 2)
    assert rls.residual_sum == pytest.approx(float(square), rel=1e-9)


def test_recursive_without_a_prior_to_speak_of_equals_ordinary_batch() -> None:
    Phi, y = data(2000)
    rls = RecursiveLeastSquares(N, P0=1e12)
    rls.run(Phi, y)
    assert np.abs(rls.theta / np.linalg.lstsq(Phi, y, rcond=None)[0] - 1.0).max() < 1e-10
    assert np.allclose(rls.P, np.linalg.inv(Phi.T @ Phi), rtol=1e-9)


def test_forgetting_is_weighted_least_squares() -> None:
    Phi, y = data(300)
    rls = RecursiveLeastSquares(N, forgetting=0.98, scheme="exponential", P0=1e10)
    rls.run(Phi, y)
    weight = np.sqrt(0.98 ** np.arange(len(y))[::-1])
    exact = np.linalg.lstsq(Phi * weight[:, None], y * weight, rcond=None)[0]
    assert np.abs(rls.theta / exact - 1.0).max() < 1e-7


def test_without_forgetting_every_scheme_is_ordinary_least_squares() -> None:
    Phi, y = data(300)
    plain, named = RecursiveLeastSquares(N), RecursiveLeastSquares(N, scheme="exponential")
    plain.run(Phi, y)
    named.run(Phi, y)
    assert np.array_equal(plain.theta, named.theta)
    assert np.array_equal(plain.P, named.P)
    assert plain.residual_sum == named.residual_sum


def test_the_default_forgets_what_moves_and_keeps_what_rests() -> None:
    """Half of the unknowns change while the other half is never moved again, but for what old rows say of both."""
    rng = np.random.default_rng(5)
    Phi, y = data(1000, noise=0.0)
    rls = RecursiveLeastSquares(N, forgetting=0.99)
    rls.run(Phi, y)
    changed = np.array([3.0, 1.0, 0.5, 40.0])
    moved = rng.normal(size=(5000, N)) * [1.0, 0.3, 0.0, 0.0]
    rls.run(moved, moved @ changed)
    assert np.abs(rls.theta[:2] - changed[:2]).max() < 1e-9
    assert np.abs(rls.theta[3] / changed[3] - 1.0) < 0.01
    wound = RecursiveLeastSquares(N, forgetting=0.99, scheme="exponential")
    wound.run(Phi, y)
    noise = 1e-3 * rng.normal(size=(5000, N))
    before = rls.theta, wound.theta
    for each in (rls, wound):
        each.run(noise, 1e-3 * rng.normal(size=5000))
    assert np.array_equal(rls.theta, before[0])
    assert np.abs(wound.theta / before[1] - 1.0).max() > 0.5


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: RecursiveLeastSquares(0),
        lambda: RecursiveLeastSquares(2, forgetting=0.0),
        lambda: RecursiveLeastSquares(2, forgetting=1.1),
        lambda: RecursiveLeastSquares(2, forgetting=np.nan),
        lambda: RecursiveLeastSquares(2, P0=0.0),
        lambda: RecursiveLeastSquares(2, P0=np.inf),
        lambda: RecursiveLeastSquares(2, theta0=[1.0]),
        lambda: RecursiveLeastSquares(2, scheme="windup"),  # type: ignore[arg-type]
        lambda: RecursiveLeastSquares(2, share=0.0),
        lambda: RecursiveLeastSquares(2, share=1.0),
        lambda: RecursiveLeastSquares(2, noise=-1.0),
        lambda: RecursiveLeastSquares(2, noise=[1.0, 2.0, 3.0]),
        lambda: RecursiveLeastSquares(2, noise=np.nan),
    ],
)
def test_settings_out_of_range_are_refused(wrong: Callable[[], object]) -> None:
    with pytest.raises(InputError):
        wrong()
