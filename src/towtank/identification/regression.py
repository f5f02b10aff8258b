"""Linear regression y = phi theta as data comes in: three estimators behind one contract.

    RecursiveLeastSquares   the paper's (36)-(37), in square-root (QR) or symmetric covariance form, with forgetting
    NormalizedGradient      its cheaper sibling, no covariance
    BatchLeastSquares       (35) by orthogonal factorisation, kept as one triangle so that memory stays bounded

`update` takes one observation, `run` many, with the same result; `theta` and `P` are fresh copies. An observation with
a number that is not finite is skipped and counted.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from towtank.core import gradient
from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.recursions import (
    RECURSIONS,
    Form,
    Scheme,
    recursion_of,
    regressor_noise,
    require_scheme,
)

__all__ = ["BatchLeastSquares", "NormalizedGradient", "RecursiveLeastSquares", "RegressionEstimator"]

_FLOAT64 = np.dtype(np.float64)


@runtime_checkable
class RegressionEstimator(Protocol):
    """What every estimator of y = phi theta offers."""

    @property
    def theta(self) -> Array:
        """The estimate (n,)."""

    def update(self, phi: Array, y: float) -> bool:
        """Absorb one observation; False where it was skipped because a number is not finite."""

    def run(self, Phi: ArrayLike, y: ArrayLike) -> int:
        """Absorb rows Phi (k, n) and y (k,) in turn; return how many were used."""


def _row(phi: Any, n: int) -> Array:
    row = np.ascontiguousarray(phi, dtype=np.float64)
    if row.shape != (n,):
        raise InputError(f"phi has shape {row.shape}, expected ({n},): one number per unknown")
    return row


def _rows(Phi: ArrayLike, y: ArrayLike, n: int) -> tuple[Array, Array]:
    rows = np.ascontiguousarray(Phi, dtype=np.float64)
    values = np.ascontiguousarray(y, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != n or values.shape != rows.shape[:1]:
        raise InputError(f"Phi has shape {rows.shape} and y {values.shape}, expected (k, {n}) and (k,)")
    return rows, values


def _start(n: int, theta0: ArrayLike | None) -> Array:
    if n < 1:
        raise InputError(f"n is {n}, expected the number of unknowns, 1 or more")
    return np.zeros(n) if theta0 is None else _row(theta0, n).copy()


class RecursiveLeastSquares:
    """Recursive least squares with a prior and forgetting.

    Args:
        n: number of unknowns.
        form: "qr" (square root of the information, the default) or "covariance". Directional forgetting needs the
            square root and keeps it in either form.
        forgetting: lambda in (0, 1]; 1 never forgets.
        scheme: what is forgotten where lambda is below 1. "directional" (the default): only directions in which the
            last 1 / (1 - lambda) rows bring at least `share` of what would be forgotten; rest and hover change nothing.
            "bounded-gain": less and less as a variance nears `bound` times its least. "exponential": every direction,
            the textbook's; it winds up where nothing moves.
        share: for "directional", above 0 and below 1.
        noise: for "directional", standard deviation of the noise on the regressors, one number or one for each; what
            does not rise above three times its level is taken for noise.
        bound: for "bounded-gain", how many times its least a variance may grow.
        P0: variance of the prior around `theta0`; between 1e6 and 1e12 where nothing is known.
        theta0: prior mean (n,), zero if omitted.
    """

    __slots__ = ("_kernel", "_name", "_state", "n", "skipped")

    def __init__(
        self,
        n: int,
        *,
        form: Form = "qr",
        forgetting: float = 1.0,
        scheme: Scheme = "directional",
        share: float = 0.1,
        noise: ArrayLike = 0.0,
        bound: float = 100.0,
        P0: float = 1e8,
        theta0: ArrayLike | None = None,
    ) -> None:
        start = _start(n, theta0)
        if not 0.0 < forgetting <= 1.0:
            raise InputError(f"forgetting is {forgetting}, expected a factor in (0, 1]")
        if not 0.0 < P0 < np.inf:
            raise InputError(f"P0 is {P0}, expected a positive variance, such as 1e8 where nothing is known")
        if form not in ("qr", "covariance"):
            raise InputError(f'form is "{form}", expected "qr" or "covariance"')
        require_scheme(scheme, share, bound)
        levels = regressor_noise(noise, n)
        self.n = n
        self.skipped = 0
        self._name, self._state = recursion_of(form, scheme, start, P0, forgetting, share, levels, bound)
        self._kernel = RECURSIONS[self._name].update

    def update(self, phi: Array, y: float) -> bool:
        """Absorb one observation y = phi theta; False where it was skipped because a number is not finite."""
        if type(phi) is not np.ndarray or phi.dtype is not _FLOAT64 or phi.ndim != 1:
            phi = _row(phi, self.n)
        used = self._kernel(self._state, phi, y)
        if used == 1:
            return True
        if used < 0:
            _row(phi, self.n)
        self.skipped += 1
        return False

    def run(self, Phi: ArrayLike, y: ArrayLike) -> int:
        """Absorb rows Phi (k, n) and y (k,) in turn; return how many were used."""
        rows, values = _rows(Phi, y, self.n)
        used = RECURSIONS[self._name].run(self._state, rows, values)
        self.skipped += len(values) - used
        return used

    @property
    def theta(self) -> Array:
        """The estimate (n,)."""
        recursion = RECURSIONS[self._name]
        return recursion.theta(recursion.view(self._state, self.n), self.n)

    @property
    def P(self) -> Array:
        """Covariance (n, n) for residuals of unit variance: the inverse of the information absorbed so far."""
        recursion = RECURSIONS[self._name]
        return recursion.P(recursion.view(self._state, self.n), self.n)

    @property
    def residual_sum(self) -> float:
        """Weighted sum of squared residuals, the prior's included."""
        recursion = RECURSIONS[self._name]
        return recursion.residual_sum(recursion.view(self._state, self.n), self.n)


class NormalizedGradient:
    """theta += gamma phi (y - phi theta) / (alpha + phi phi); stable for 0 < gamma < 2.

    Args:
        n: number of unknowns.
        gamma: step, 0 < gamma < 2.
        alpha: regularisation of the norm, > 0, in the units of phi^2.
        theta0: start (n,), zero if omitted.
    """

    __slots__ = ("_state", "alpha", "gamma", "n", "skipped")

    def __init__(self, n: int, *, gamma: float = 0.5, alpha: float = 1e-6, theta0: ArrayLike | None = None) -> None:
        if not 0.0 < gamma < 2.0:
            raise InputError(f"gamma is {gamma}, expected a step in (0, 2): beyond it the estimator is unstable")
        if not alpha >= 0.0:
            raise InputError(f"alpha is {alpha}, expected a number >= 0")
        self._state = _start(n, theta0)
        self.n = n
        self.gamma = gamma
        self.alpha = alpha
        self.skipped = 0

    def update(self, phi: Array, y: float) -> bool:
        """Absorb one observation y = phi theta; False where it was skipped because a number is not finite."""
        used = gradient.gradient_update(self._state, _row(phi, self.n), y, self.gamma, self.alpha)
        self.skipped += not used
        return used

    def run(self, Phi: ArrayLike, y: ArrayLike) -> int:
        """Absorb rows Phi (k, n) and y (k,) in turn; return how many were used."""
        rows, values = _rows(Phi, y, self.n)
        used = gradient.gradient_run(self._state, rows, values, self.gamma, self.alpha)
        self.skipped += len(values) - used
        return used

    @property
    def theta(self) -> Array:
        """The estimate (n,)."""
        return self._state.copy()


class BatchLeastSquares:
    """Ordinary least squares over everything seen, solved when asked; minimum norm where not determined."""

    __slots__ = ("_filled", "_rows", "_triangle", "n", "skipped")
    _BLOCK = 4096

    def __init__(self, n: int) -> None:
        _start(n, None)
        self.n = n
        self.skipped = 0
        self._triangle = np.zeros((n + 1, n + 1))
        self._rows = np.empty((self._BLOCK, n + 1))
        self._filled = 0

    def update(self, phi: Array, y: float) -> bool:
        """Absorb one observation y = phi theta; False where it was skipped because a number is not finite."""
        return self.run(_row(phi, self.n)[None], np.array([y])) == 1

    def run(self, Phi: ArrayLike, y: ArrayLike) -> int:
        """Absorb rows Phi (k, n) and y (k,) in turn; return how many were used."""
        rows, values = _rows(Phi, y, self.n)
        data = np.column_stack([rows, values])
        finite = np.isfinite(data).all(axis=1)
        data = data[finite]
        self.skipped += int((~finite).sum())
        for start in range(0, len(data), self._BLOCK):
            block = data[start : start + self._BLOCK]
            if self._filled + len(block) > self._BLOCK:
                self._compress()
            self._rows[self._filled : self._filled + len(block)] = block
            self._filled += len(block)
        return len(data)

    def _compress(self) -> None:
        stacked = np.vstack([self._triangle, self._rows[: self._filled]])
        self._triangle = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)
        self._filled = 0

    @property
    def theta(self) -> Array:
        """The estimate (n,), of minimum norm where the data does not determine it."""
        self._compress()
        found = np.linalg.lstsq(self._triangle[:, : self.n], self._triangle[:, self.n], rcond=None)[0]
        return np.asarray(found, dtype=np.float64)

    @property
    def P(self) -> Array:
        """(Phi^T Phi)^+ (n, n), the covariance for residuals of unit variance."""
        self._compress()
        R = self._triangle[:, : self.n]
        return np.asarray(np.linalg.pinv(R.T @ R, hermitian=True), dtype=np.float64)
