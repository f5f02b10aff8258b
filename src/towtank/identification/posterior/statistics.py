"""Fisher information of several coefficients, and the likeliest point that keeps linear bounds.

Functions of A take a symmetric matrix (n, n) in relative coordinates (1 is 100 % of a coefficient), singular or not.
Which directions are null is judged on A scaled to a unit diagonal, so that no choice of units matters.

The likeliest point minimises (x - x0)^T C^-1 (x - x0) subject to G x >= h. With C = S S^T and x = x0 + S y this is
least-distance programming, min |y| subject to G S y >= h - G x0, solved by non-negative least squares (Lawson and
Hanson, Solving Least Squares Problems, 1974, chapter 23). C may be singular: what has no variance does not move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array

__all__ = ["deviations", "information_of_data", "long_run", "relative"]

_NULL = 1e-12  # eigenvalue, per row, of the matrix with unit diagonal
_DARK = 1e-12  # information of a deviation of a million times the value: rounding, no more
_TOUCHED = 1e-6  # square of the component that a null direction must have for a coefficient to be lost in it
_SINGULAR = 1e-13
_UNREACHABLE = 1e-9
_SLOWEST = 0.97  # largest correlation of neighbouring blocks that is taken out beforehand


def relative(information: Array, size: Array, prior: Array | None = None) -> Array:
    """Return information (n, n), with that of a prior, in units of `size` (n,); what is not finite counts as none."""
    total = _finite(information) if prior is None else _finite(information) + _finite(prior)
    scaled = total * np.outer(size, size)
    scaled = 0.5 * (scaled + scaled.T)
    dark = ~(np.diag(scaled) > _DARK)
    scaled[dark] = 0.0
    scaled[:, dark] = 0.0
    return np.asarray(scaled)


def information_of_data(covariance: Array, before: Array) -> Array:
    """Return the information (n, n) that a covariance holds beyond that known before; what is less than none is none.

    It is inverted at a unit diagonal, so that one number of which nothing at all is known does not drown the others.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled = covariance / np.outer(size, size)
    inverse = np.linalg.pinv(0.5 * (scaled + scaled.T), rcond=_NULL, hermitian=True)
    more = inverse / np.outer(size, size) - before
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _finite(matrix: Array) -> Array:
    out = np.array(matrix, dtype=np.float64)
    bad = ~np.isfinite(np.diag(out)) | (~np.isfinite(out)).all(axis=1)
    out[bad] = 0.0
    out[:, bad] = 0.0
    return np.where(np.isfinite(out), out, 0.0)


def alone(A: Array) -> Array:
    """Return the deviation (n,) of each coefficient if all others were known; inf where there is no information."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(np.diag(A)))


def deviations(A: Array) -> Array:
    """Return the deviation (n,) of each coefficient with all others unknown; inf where nothing fixes it."""
    known = np.flatnonzero(np.diag(A) > 0.0)
    out = np.full(A.shape[0], np.inf)
    if not known.size:
        return out
    scale, values, vectors = _spectrum(A[np.ix_(known, known)])
    null = values <= _NULL * known.size
    variance = (vectors**2 / np.maximum(values, _NULL * known.size)).sum(axis=1) / scale**2
    lost = (vectors[:, null] ** 2).sum(axis=1) > _TOUCHED
    out[known] = np.where(lost, np.inf, np.sqrt(variance))
    return out


def _spectrum(A: Array) -> tuple[Array, Array, Array]:
    """Return the roots of the diagonal, and eigenvalues and eigenvectors of A scaled to a unit diagonal."""
    scale = np.sqrt(np.diag(A))
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale))
    return scale, values, vectors


def correlations(A: Array) -> Array:
    """Return the correlations (n, n) of the estimates; where A is singular, those in the limit of a tiny prior."""
    known = np.flatnonzero(np.diag(A) > 0.0)
    out = np.zeros(A.shape)
    if known.size:
        _, values, vectors = _spectrum(A[np.ix_(known, known)])
        C = (vectors / np.maximum(values, _NULL * known.size)) @ vectors.T
        size = np.sqrt(np.diag(C))
        out[np.ix_(known, known)] = C / np.outer(size, size)
    return out


def pair(A: Array, i: int, j: int) -> Array:
    """Return the information (2, 2) on two coefficients that is left with all others unknown."""
    both = [i, j]
    rest = [k for k in range(A.shape[0]) if k not in both and A[k, k] > 0.0]
    inner = A[np.ix_(both, both)]
    if not rest:
        return inner
    scale, values, vectors = _spectrum(A[np.ix_(rest, rest)])
    used = values > _NULL * len(rest)
    half = (A[np.ix_(both, rest)] / scale) @ (vectors[:, used] / np.sqrt(values[used]))
    left = inner - half @ half.T
    # what rounding leaves of a difference of equal numbers is nothing
    size = np.maximum(np.diag(left), 0.0)
    size[size <= _NULL * len(rest) * np.diag(inner)] = 0.0
    limit = np.sqrt(size[0] * size[1])
    cross = float(np.clip(left[0, 1], -limit, limit))
    return np.array([[size[0], cross], [cross, size[1]]])


def along(A: Array, direction: Array) -> float:
    """Return the deviation of a common change along a direction (n,), all else known; inf where nothing fixes it."""
    known = float(direction @ A @ direction)
    least = _NULL * float((direction**2) @ np.diag(A)) * A.shape[0]
    return 1.0 / np.sqrt(known) if known > least else float("inf")


def weakest(A: Array, among: Sequence[int], share: float = 0.3) -> list[int]:
    """Return those of `among` that take part in the direction that is known least, in order."""
    _, _, vectors = _spectrum(A[np.ix_(among, among)])
    size = np.abs(vectors[:, 0])
    return [k for k, part in zip(among, size, strict=True) if part >= share * size.max()]


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
