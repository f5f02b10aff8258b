"""Recursive least squares for y = phi theta as data comes in, the paper's (36)-(37) in square-root (QR) form.

`update` takes one observation, `run` many, with the same result; `theta` and `P` are fresh copies. An observation with
a number that is not finite is skipped and counted.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.core.forgetting import directional_run, directional_start, directional_update, directional_view
from towtank.core.least_squares import qr_covariance, qr_run, qr_solve, qr_start, qr_update
from towtank.errors import InputError

__all__ = ["RecursiveLeastSquares"]

Scheme = Literal["directional", "exponential"]
_FLOAT64 = np.dtype(np.float64)


def require_scheme(scheme: str) -> None:
    """Raise InputError unless the scheme of forgetting is known."""
    if scheme not in get_args(Scheme):
        known = ", ".join(f'"{name}"' for name in get_args(Scheme))
        raise InputError(f'scheme: found "{scheme}", expected one of {known}')


def _regressor_noise(noise: ArrayLike, n: int) -> Array:
    """Return the standard deviation of the noise on each regressor (n,). Raises InputError."""
    given = np.asarray(noise, dtype=np.float64)
    if given.shape not in ((), (n,)) or not (np.isfinite(given).all() and (given >= 0.0).all()):
        raise InputError(
            f"noise: found {given.tolist()}, expected a standard deviation of the regressors or {n} of them"
        )
    return np.ascontiguousarray(np.broadcast_to(given, (n,)), dtype=np.float64)


def _row(phi: Any, n: int) -> Array:
    row = np.ascontiguousarray(phi, dtype=np.float64)
    if row.shape != (n,):
        raise InputError(f"phi has shape {row.shape}, expected ({n},): one number per unknown")
    return row


class RecursiveLeastSquares:
    """Recursive least squares with a prior and forgetting.

    Args:
        n: number of unknowns.
        forgetting: lambda in (0, 1]; 1 never forgets.
        scheme: what is forgotten where lambda is below 1. "directional" (the default): only directions in which the
            last 1 / (1 - lambda) rows bring at least `share` of what would be forgotten; rest and hover change nothing.
            "exponential": every direction, the textbook's; it winds up where nothing moves.
        share: for "directional", above 0 and below 1.
        noise: for "directional", standard deviation of the noise on the regressors, one number or one for each; what
            does not rise above three times its level is taken for noise.
        P0: variance of the prior around `theta0`; between 1e6 and 1e12 where nothing is known.
        theta0: prior mean (n,), zero if omitted.

    Raises:
        InputError: a setting is out of range.
    """

    __slots__ = ("_absorb", "_directional", "_state", "n", "skipped")

    def __init__(
        self,
        n: int,
        *,
        forgetting: float = 1.0,
        scheme: Scheme = "directional",
        share: float = 0.1,
        noise: ArrayLike = 0.0,
        P0: float = 1e8,
        theta0: ArrayLike | None = None,
    ) -> None:
        if n < 1:
            raise InputError(f"n is {n}, expected the number of unknowns, 1 or more")
        start = np.zeros(n) if theta0 is None else _row(theta0, n).copy()
        if not 0.0 < forgetting <= 1.0:
            raise InputError(f"forgetting is {forgetting}, expected a factor in (0, 1]")
        if not 0.0 < P0 < np.inf:
            raise InputError(f"P0 is {P0}, expected a positive variance, such as 1e8 where nothing is known")
        require_scheme(scheme)
        if not 0.0 < share < 1.0:
            raise InputError(f"share: found {share}, expected a share of what is forgotten, above 0 and below 1")
        deviation = _regressor_noise(noise, n)
        self.n = n
        self.skipped = 0
        self._directional = scheme == "directional" and forgetting < 1.0
        if self._directional:
            self._state, self._absorb = directional_start(start, P0, forgetting, share, deviation), directional_update
        else:
            self._state, self._absorb = qr_start(start, P0, forgetting), qr_update

    def update(self, phi: Array, y: float) -> bool:
        """Absorb one observation y = phi theta; False where it was skipped because a number is not finite."""
        if type(phi) is not np.ndarray or phi.dtype is not _FLOAT64 or phi.ndim != 1:
            phi = _row(phi, self.n)
        used = self._absorb(self._state, phi, y)
        if used == 1:
            return True
        if used < 0:
            _row(phi, self.n)
        self.skipped += 1
        return False

    def run(self, Phi: ArrayLike, y: ArrayLike) -> int:
        """Absorb rows Phi (k, n) and y (k,) in turn; return how many were used."""
        rows = np.ascontiguousarray(Phi, dtype=np.float64)
        values = np.ascontiguousarray(y, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.n or values.shape != rows.shape[:1]:
            raise InputError(f"Phi has shape {rows.shape} and y {values.shape}, expected (k, {self.n}) and (k,)")
        used = (directional_run if self._directional else qr_run)(self._state, rows, values)
        self.skipped += len(values) - used
        return used

    @property
    def theta(self) -> Array:
        """The estimate (n,)."""
        return qr_solve(self._triangle, self.n)

    @property
    def P(self) -> Array:
        """Covariance (n, n) for residuals of unit variance: the inverse of the information absorbed so far."""
        return qr_covariance(self._triangle, self.n)

    @property
    def residual_sum(self) -> float:
        """Weighted sum of squared residuals, the prior's included."""
        return float(self._triangle[(self.n + 1) ** 2 - 1] ** 2)

    @property
    def _triangle(self) -> Array:
        """[R z; 0 rho] in one row, with what every row so far tells."""
        return directional_view(self._state, self.n) if self._directional else self._state
