"""From the information of one axis to its coefficients, with a covariance that honours coloured residuals.

Least squares takes Theta from the QR triangle; with instruments Z it solves Z^T P Theta = Z^T Y from the block sums.
Either way Cov(Theta) = A^-1 S A^-T with A = Z^T P and S the long-run covariance of the scores z e, a prewhitened
Bartlett sum over blocks of time (Newey and West, 1987): the filter 1/(s + a) and slow disturbances make neighbouring
residuals alike, and the plain formula would promise several times too much. Physical values by division, their
covariance by the delta method: M = 1/Theta_n, c = Theta_c/Theta_n, J as in the covariance of a ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.axes import C_FORCE, C_LHS, C_MASS, N_COLUMNS

__all__ = ["AxisInformation", "AxisSolution", "long_run", "merge_information", "solve_axis"]

_SPAN = 2.0  # s, least span over which residuals are taken to be alike
_STILL = 1e-9  # m/s or rad/s: an axis that moved less was not excited, its numbers are rounding
_SLOWEST = 0.97  # largest correlation of neighbouring blocks that is taken out beforehand


@dataclass(frozen=True)
class AxisInformation:
    """What the samples say about one axis.

    Attributes:
        triangle: square root of the information (6, 6), R^T R = sum z z^T, z = [4 columns, force, left-hand side].
        blocks: sums of instrument x row over blocks of time (b, 6, 6).
        block_length: length of a block [s].
        rows: number of samples absorbed, those forgotten discounted.
        systematic: relative error that no averaging removes (low-passes take the mean of the square for its square).
        a: filter constant [1/s].
        commanded, forced: integrals of the squared commanded and whole force.
    """

    triangle: Array
    blocks: Array
    block_length: float
    rows: float
    a: float
    commanded: float = 0.0
    forced: float = 0.0
    systematic: float = 0.0

    @property
    def commanded_share(self) -> float:
        """Root-mean-square of the commanded force over that of the whole force, 0 .. about 1."""
        return float(np.sqrt(self.commanded / self.forced)) if self.forced > 0.0 else 0.0


@dataclass(frozen=True)
class AxisSolution:
    """Estimate of one axis; the order is linear, quadratic, restoring, constant, mass.

    Attributes:
        values: (5,), held coefficients at their held value.
        covariance: (5, 5), zero where held.
        free: (5,) True where estimated.
        residual: standard deviation of the filtered residual, in the units of the velocity.
        residual_sum: sum of squared filtered residuals.
        rows: samples used.
        condition: condition number of the regressors, each scaled to unit size.
        excitation: smallest eigenvalue of their mean outer product: 0 not excited, 1/n.. perfectly.
        correlation: (5, 5) of the estimates.
        block_residuals: sums of squared residuals (b,) over the blocks of time, for least squares.
        explained: share of the filtered left-hand side's square that the regression explains.
    """

    values: Array
    covariance: Array
    free: tuple[bool, ...]
    residual: float
    residual_sum: float
    rows: float
    condition: float
    excitation: float
    correlation: Array
    block_residuals: Array
    explained: float

    @property
    def std(self) -> Array:
        """Standard deviations (5,)."""
        return np.sqrt(np.diag(self.covariance))


def merge_information(parts: Sequence[AxisInformation]) -> AxisInformation:
    """Return the information of several stretches of data taken together."""
    stacked = np.vstack([part.triangle for part in parts])
    return AxisInformation(
        triangle=np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64),
        blocks=np.concatenate([part.blocks for part in parts]),
        block_length=max(part.block_length for part in parts),
        rows=sum(part.rows for part in parts),
        a=parts[0].a,
        commanded=sum(part.commanded for part in parts),
        forced=sum(part.forced for part in parts),
        systematic=max(part.systematic for part in parts),
    )


def solve_axis(
    information: AxisInformation, free: Sequence[bool], known: Array, *, instruments: bool = False
) -> AxisSolution | None:
    """Solve one axis for its free coefficients; None where the data does not determine them at all.

    Args:
        free: (5,) linear, quadratic, restoring, constant, mass.
        known: (5,) values of the held ones.
        instruments: use the block sums' instruments rather than least squares.
    """
    known = np.asarray(known, dtype=np.float64)
    regressors, target = _regression(free, known)
    if regressors.shape[1] == 0:
        return None
    R = information.triangle @ regressors
    scale = np.linalg.norm(R, axis=0)
    moved = float(np.linalg.norm(information.triangle[:, C_LHS]))
    if not np.all(scale > 0.0) or information.rows <= regressors.shape[1] or moved <= _STILL * information.rows**0.5:
        return None
    T = regressors / scale
    singular = np.linalg.svd(R / scale, compute_uv=False)
    if singular[-1] < 1e-12 * singular[0]:
        return None
    summed = information.blocks.sum(axis=0)
    if instruments:
        A = T.T @ summed @ T
        try:
            theta = np.linalg.solve(A, T.T @ summed @ target)
        except np.linalg.LinAlgError:
            return None
    else:
        A = T.T @ information.triangle.T @ information.triangle @ T
        theta = np.linalg.lstsq(R / scale, information.triangle @ target, rcond=None)[0]
    error = target - T @ theta  # residual of a row z is z . error
    residual_sum = float(np.sum((information.triangle @ error) ** 2))
    covariance = _covariance(information, A, T, error, residual_sum, len(theta))
    theta = theta / scale
    covariance = covariance / np.outer(scale, scale)
    values, covariance = _physical(theta, covariance, free, known)
    covariance += np.diag((information.systematic * values) ** 2 * np.asarray(free, dtype=np.float64))
    std = np.sqrt(np.diag(covariance))
    safe = np.where(std > 0.0, std, 1.0)
    return AxisSolution(
        values=values,
        covariance=covariance,
        free=tuple(bool(flag) for flag in free),
        residual=float(np.sqrt(residual_sum / information.rows)),
        residual_sum=residual_sum,
        rows=information.rows,
        condition=float(singular[0] / singular[-1]),
        excitation=float(singular[-1] ** 2 / len(theta)),
        correlation=covariance / np.outer(safe, safe),
        block_residuals=np.einsum("i,bij,j->b", error, information.blocks, error),
        explained=1.0 - residual_sum / max(float(np.sum((information.triangle @ target) ** 2)), 1e-300),
    )


def _regression(free: Sequence[bool], known: Array) -> tuple[Array, Array]:
    """Return (T, t): the regressors are z T and the target z t, held coefficients moved where they belong."""
    identity = np.eye(N_COLUMNS)
    columns = [identity[c] for c in range(4) if free[c]]
    force = identity[C_FORCE] + sum((known[c] * identity[c] for c in range(4) if not free[c]), np.zeros(N_COLUMNS))
    if free[C_MASS]:
        return np.array([*columns, force]).T, identity[C_LHS]
    if not columns:
        return np.zeros((N_COLUMNS, 0)), identity[C_LHS]
    return np.array(columns).T, known[C_MASS] * identity[C_LHS] - force


def _covariance(
    information: AxisInformation, A: Array, T: Array, error: Array, residual_sum: float, unknowns: int
) -> Array:
    """Return the covariance of theta (scaled): the larger, per coefficient, of the long-run and the plain one."""
    filled = information.blocks[np.any(information.blocks != 0.0, axis=(1, 2))]
    scores = filled @ error @ T  # (b, n)
    count = len(scores)
    inverse = np.linalg.inv(A)
    plain = (
        residual_sum
        / max(information.rows - unknowns, 1.0)
        * inverse
        @ (T.T @ information.triangle.T @ information.triangle @ T)
        @ inverse.T
    )
    if count < 2 * unknowns + 2:
        return plain
    S = long_run(scores, round(max(_SPAN, 2.0 / information.a) / information.block_length))
    honest = inverse @ S @ inverse.T * count / (count - unknowns)
    variance, least = np.diag(honest).copy(), np.diag(plain)
    grow = np.sqrt(np.maximum(1.0, least / np.where(variance > 0.0, variance, np.inf)))
    return np.where(variance.min() > 0.0, honest * np.outer(grow, grow), plain)


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


def _physical(theta: Array, covariance: Array, free: Sequence[bool], known: Array) -> tuple[Array, Array]:
    """Return values (5,) and covariance (5, 5) of the physical coefficients by the delta method."""
    places = [c for c in range(5) if free[c]]
    values = known.copy()
    J = np.zeros((5, len(places)))
    if free[C_MASS]:
        inverse_mass = theta[-1]
        for j, c in enumerate(places[:-1]):
            values[c] = theta[j] / inverse_mass
            J[c, j] = 1.0 / inverse_mass
            J[c, -1] = -theta[j] / inverse_mass**2
        values[C_MASS] = 1.0 / inverse_mass
        J[C_MASS, -1] = -1.0 / inverse_mass**2
    else:
        values[places] = theta
        J[places, range(len(places))] = 1.0
    return values, J @ covariance @ J.T
