"""The likeliest point that keeps linear bounds, and what correlated scores add up to.

The likeliest point minimises (x - x0)^T C^-1 (x - x0) subject to G x >= h. With C = S S^T and x = x0 + S y this is
least-distance programming, min |y| subject to G S y >= h - G x0, solved by non-negative least squares (Lawson and
Hanson, Solving Least Squares Problems, 1974, chapter 23). C may be singular: what has no variance does not move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array

__all__ = ["NearestPoint", "conditional_covariance", "long_run", "nearest_point", "square_root"]

_SINGULAR = 1e-13
_UNREACHABLE = 1e-9
_SLOWEST = 0.97  # largest correlation of neighbouring blocks that is taken out beforehand


@dataclass(frozen=True)
class NearestPoint:
    """x (n,), the multipliers (m,) of the bounds (0 where a bound does not press), and whether all bounds can be kept.

    x - x0 = C G^T multipliers. Where the bounds cannot be kept, x is x0.
    """

    x: Array
    multipliers: Array
    reachable: bool


def square_root(covariance: Array) -> Array:
    """Return S (n, n) with S S^T = C for a positive semidefinite C, by its eigenvalues at unit diagonal."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    values = np.where(values > _SINGULAR * max(values.size, 1), values, 0.0)
    return np.asarray(scale[:, None] * vectors * np.sqrt(values))


def nearest_point(x0: Array, root: Array, G: Array, h: Array) -> NearestPoint:
    """Return the likeliest x (n,) with G x >= h.

    Args:
        x0: (n,). root: S (n, n) of the covariance. G: (m, n). h: (m,).
    """
    from scipy.optimize import nnls  # slow to import, seldom needed

    none = np.zeros(h.size)
    lack = h - G @ x0
    if not (lack > 0.0).any():
        return NearestPoint(x0.copy(), none, True)
    A = G @ root
    size = np.linalg.norm(A, axis=1)
    still = size <= _SINGULAR * np.linalg.norm(G, axis=1) * max(float(np.linalg.norm(root)), 1e-300)
    if (still & (lack > 0.0)).any():
        return NearestPoint(x0.copy(), none, False)
    use = np.flatnonzero(~still)
    rows, need = A[use] / size[use, None], lack[use] / size[use]
    unit = float(np.abs(need).max())
    E = np.vstack([rows.T, need / unit])
    target = np.zeros(E.shape[0])
    target[-1] = 1.0
    try:
        u, misfit = nnls(E, target, maxiter=50 * E.shape[1] + 100)
    except RuntimeError:  # no convergence
        misfit = 0.0
    if misfit < _UNREACHABLE:
        return NearestPoint(x0.copy(), none, False)
    left = target - E @ u
    multipliers = none.copy()
    multipliers[use] = unit * u / left[-1] / size[use]
    return NearestPoint(x0 + root @ (A.T @ multipliers), multipliers, True)


def conditional_covariance(covariance: Array, G: Array) -> Array:
    """Return the covariance (n, n) that is left where G x (m,) is known exactly."""
    if not G.size:
        return covariance
    both = G @ covariance
    inner = both @ G.T
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    inverse = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-9, hermitian=True) / np.outer(scale, scale)
    left = covariance - both.T @ inverse @ both
    return np.asarray(0.5 * (left + left.T))


def long_run(scores: Array, lags: int) -> Array:
    """Return the long-run covariance (n, n), times the number of blocks, of scores (b, n) that are alike in time.

    A first-order recursion takes the slow part out first (Andrews and Monahan, 1992): a Bartlett sum alone would miss
    half of a disturbance that lasts as long as the sum.
    """
    size = np.sqrt(np.mean(scores**2, axis=0))
    unit = scores / np.where(size > 0.0, size, 1.0)
    rho = float(np.clip(np.sum(unit[1:] * unit[:-1]) / max(np.sum(unit**2), 1e-300), 0.0, _SLOWEST))
    rest = scores.copy()
    rest[1:] -= rho * scores[:-1]
    S = rest.T @ rest
    lags = min(lags, len(scores) // 4)
    for lag in range(1, lags + 1):
        product = rest[lag:].T @ rest[:-lag]
        S += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    return S / (1.0 - rho) ** 2
