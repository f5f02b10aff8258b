"""The likeliest point that keeps linear bounds, what correlated scores add up to, and what windows contradict.

The likeliest point minimises (x - x0)^T C^-1 (x - x0) subject to G x >= h. With C = S S^T and x = x0 + S y this is
least-distance programming, min |y| subject to G S y >= h - G x0, solved by non-negative least squares (Lawson and
Hanson, Solving Least Squares Problems, 1974, chapter 23). C may be singular: what has no variance does not move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array

__all__ = ["NearestPoint", "Reading", "conditional_covariance", "long_run", "nearest_point", "square_root", "widened"]

_SINGULAR = 1e-13
_UNREACHABLE = 1e-9
_DISAGREE = 100.0  # times the variance, at most
_TOLD = 1e-6  # of the prior's information: below, the data tell nothing
_ALONE = 0.3  # of a direction's information, that is the least that others could contradict
_SLOWEST = 0.97  # largest correlation of neighbouring blocks that is taken out beforehand


@dataclass(frozen=True)
class NearestPoint:
    """x (n,), the multipliers (m,) of the bounds (0 where a bound does not press), and whether all bounds can be kept.

    x - x0 = C G^T multipliers. Where the bounds cannot be kept, x is x0.
    """

    x: Array
    multipliers: Array
    reachable: bool


class Reading(NamedTuple):
    """What a pass knew at some time: mean (n,) and covariance (n, n) of theta.

    t: time since the beginning [s], recordings one after the other.
    """

    t: float
    theta: Array
    covariance: Array


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


def widened(readings: Sequence[Reading]) -> tuple[Array, float]:
    """Return the covariance (n, n) after the last window, widened by what windows contradict each other, and by what.

    In the coordinates x in which the prior is of unit covariance, window k adds the information L_k = P_k^-1 -
    P_(k-1)^-1, and has a view of its own, eta_k = P_k^-1 x_k - P_(k-1)^-1 x_(k-1), so that s_k = eta_k - L_k x is how
    it alone would pull the final x. If the model is right s_k has the covariance L_k, less L_k^2 / (1 + sum L_k) for
    what the window has told the final x itself. Where it is not, windows pull farther: along each eigenvector u_j of
    sum L_k, of eigenvalue l_j, by a factor f_j^2, and the data are worth l_j / f_j^2 there (White 1982; the middle of
    the sandwich, in its principal axes). What one window tells alone nothing contradicts; so no f_j^2 is below what all
    directions have in common, each by the share that data have in it (Wedderburn 1974), nor below 1.
    What the data do not tell stays with the prior, and what they tell together stays together: a covariance whose
    deviations were scaled one by one would know the common scale of force from nothing.

    Args:
        readings: before the first window and after each.

    Returns:
        The covariance, and the factor f that all have in common.
    """
    n, last = readings[-1].theta.size, readings[-1].covariance
    try:
        whole = np.asarray(np.linalg.cholesky(readings[0].covariance), dtype=np.float64)
        views = [_in_units_of(whole, reading) for reading in readings]
    except np.linalg.LinAlgError:
        return last, 1.0
    information = views[-1][0]
    size, axes = np.linalg.eigh(information - views[0][0])
    x = np.linalg.solve(information, views[-1][1])
    told = size > _TOLD
    size = np.maximum(size, _TOLD)
    did, should = np.zeros(n), np.zeros(n)
    for (before, own_before), (after, own_after) in pairwise(views):
        new = np.maximum(np.einsum("ij,ij->j", axes, (after - before) @ axes), 0.0)
        did += (axes.T @ (own_after - own_before - (after - before) @ x)) ** 2
        should += np.maximum(new - new**2 / (1.0 + size), 0.0)
    weight = np.where(told, 1.0 / (1.0 + size), 0.0)
    common = min(max(float(weight @ did) / max(float(weight @ should), _TOLD), 1.0), _DISAGREE)
    ratio = np.where(told, np.clip(did / np.maximum(should, _ALONE * size), common, _DISAGREE), 1.0)
    root = whole @ axes / np.sqrt(1.0 + size / ratio)
    return np.asarray(root @ root.T), math.sqrt(common)


def _in_units_of(root: Array, reading: Reading) -> tuple[Array, Array]:
    """Return information (n, n) and information times mean (n,) in the coordinates x of theta = root x."""
    from scipy.linalg import solve_triangular  # slow to import

    own, flags = np.linalg.cholesky(reading.covariance), {"lower": True, "check_finite": False}
    factor: Array = np.asarray(solve_triangular(own, root, **flags), dtype=np.float64)
    information = factor.T @ factor
    return information, information @ solve_triangular(root, reading.theta, **flags)
