"""Linear regression y = phi theta as data comes in: three estimators behind one contract.

    RecursiveLeastSquares   the paper's (36)-(37), in square-root (QR) or symmetric covariance form, with forgetting
    NormalizedGradient      its cheaper sibling, no covariance
    BatchLeastSquares       (35) by orthogonal factorisation, kept as one triangle so that memory stays bounded

`update` takes one observation, `run` many, with the same result; `theta` and `P` are fresh copies. An observation with
a number that is not finite is skipped and counted.

The forms and forgetting schemes of recursive least squares, each as its kernels behind one record.

exponential   every direction alike: what is at rest is forgotten too, and noise takes its place (wind-up)
directional   only where the data excites; the default
bounded-gain  less and less as variances grow beyond the least that they ever were

Forgetting in the paper's chain: how a row enters the information of one axis, by scheme.

For directional forgetting held coefficients are folded into the force, so that only directions of free ones count: a
direction that nobody asks for, and that is hardly excited, would keep the past of all others alive. Block sums of row
products change with the information: a past row z counts as z (I - F) from then on. While a directional block fills,
`triangle` holds it unforgotten, for the running model; the estimate is read from `directional_information`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from towtank.core import bounded_gain, gradient, least_squares
from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.bounded_gain import bounded_factor
from towtank.core.forgetting import (
    block_length,
    commit_scratch,
    directional_run,
    directional_start,
    directional_update,
    directional_view,
    forget_excited,
)
from towtank.core.least_squares import qr_absorb
from towtank.errors import InputError
from towtank.identification.least_squares.state import BOUNDED_GAIN, DIRECTIONAL, PaperState
from towtank.identification.model.terms import C_FORCE, C_LHS, N_COLUMNS

__all__ = [
    "BatchLeastSquares",
    "NormalizedGradient",
    "Recursion",
    "RecursiveLeastSquares",
    "RegressionEstimator",
    "Scheme",
    "absorb_row",
    "directional_information",
    "forget_blocks",
    "require_scheme",
]

Form = Literal["qr", "covariance"]
Scheme = Literal["directional", "bounded-gain", "exponential"]
_FLOAT64 = np.dtype(np.float64)
_N = N_COLUMNS - 1  # unknowns' columns
_SIZE = N_COLUMNS * N_COLUMNS


@dataclass(frozen=True)
class Recursion:
    """Kernels that share one layout of the state; all take what `view` returns but `update` and `run`."""

    update: Callable[[Array, Array, float], int]
    run: Callable[[Array, Array, Array], int]
    view: Callable[[Array, int], Array]
    theta: Callable[[Array, int], Array]
    P: Callable[[Array, int], Array]
    residual_sum: Callable[[Array, int], float]


def _as_it_is(state: Array, n: int) -> Array:
    return state


def _covariance_theta(state: Array, n: int) -> Array:
    return state[:n].copy()


def _covariance_P(state: Array, n: int) -> Array:
    return state[n : n + n * n].reshape(n, n).copy()


def _covariance_residual(state: Array, n: int) -> float:
    return float(state[n + n * n])


def _qr_residual(state: Array, n: int) -> float:
    return float(state[(n + 1) ** 2 - 1] ** 2)


_QR = (least_squares.qr_solve, least_squares.qr_covariance, _qr_residual)


_COVARIANCE = (_covariance_theta, _covariance_P, _covariance_residual)


RECURSIONS: dict[str, Recursion] = {
    "qr": Recursion(least_squares.qr_update, least_squares.qr_run, _as_it_is, *_QR),
    "covariance": Recursion(least_squares.covariance_update, least_squares.covariance_run, _as_it_is, *_COVARIANCE),
    "bounded qr": Recursion(bounded_gain.bounded_qr_update, bounded_gain.bounded_qr_run, _as_it_is, *_QR),
    "bounded covariance": Recursion(
        bounded_gain.bounded_covariance_update, bounded_gain.bounded_covariance_run, _as_it_is, *_COVARIANCE
    ),
    "directional": Recursion(directional_update, directional_run, directional_view, *_QR),
}


def require_scheme(scheme: str, share: float = 0.1, bound: float = 100.0) -> None:
    """Raise InputError unless scheme and settings are within their range."""
    if scheme not in get_args(Scheme):
        known = ", ".join(f'"{name}"' for name in get_args(Scheme))
        raise InputError(f'scheme: found "{scheme}", expected one of {known}')
    if not 0.0 < share < 1.0:
        raise InputError(f"share: found {share}, expected a share of what is forgotten, above 0 and below 1")
    if not 1.0 < bound < np.inf:
        raise InputError(f"bound: found {bound}, expected how many times a variance may grow, above 1")


def regressor_noise(noise: ArrayLike, n: int) -> Array:
    """Return the standard deviation of the noise on each regressor (n,). Raises InputError."""
    given = np.asarray(noise, dtype=np.float64)
    if given.shape not in ((), (n,)) or not (np.isfinite(given).all() and (given >= 0.0).all()):
        raise InputError(
            f"noise: found {given.tolist()}, expected a standard deviation of the regressors or {n} of them"
        )
    return np.ascontiguousarray(np.broadcast_to(given, (n,)), dtype=np.float64)


def recursion_of(
    form: Form, scheme: Scheme, theta0: Array, P0: float, forgetting: float, share: float, noise: Array, bound: float
) -> tuple[str, Array]:
    """Return the name of the recursion in `RECURSIONS` and its state; all checks are done before."""
    if scheme == "exponential" or forgetting == 1.0:
        start = least_squares.qr_start if form == "qr" else least_squares.covariance_start
        return form, start(theta0, P0, forgetting)
    if scheme == "directional":
        return "directional", directional_start(theta0, P0, forgetting, share, noise)
    begin = bounded_gain.bounded_qr_start if form == "qr" else bounded_gain.bounded_covariance_start
    return f"bounded {form}", begin(theta0, P0, forgetting, bound)


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


@kernel
def _sandwich(blocks: Array, count: int, F: Array) -> None:
    """Change block sums (b, 36), the first `count`, to those of rows z (I - F)."""
    for i in range(_SIZE):
        F[i] = -F[i]
    for i in range(N_COLUMNS):
        F[i * N_COLUMNS + i] += 1.0
    half = np.empty(_SIZE)
    for b in range(count):
        for i in range(N_COLUMNS):
            for j in range(N_COLUMNS):
                t = 0.0
                for k in range(N_COLUMNS):
                    t += blocks[b, i * N_COLUMNS + k] * F[k * N_COLUMNS + j]
                half[i * N_COLUMNS + j] = t
        for i in range(N_COLUMNS):
            for j in range(N_COLUMNS):
                t = 0.0
                for k in range(N_COLUMNS):
                    t += F[k * N_COLUMNS + i] * half[k * N_COLUMNS + j]
                blocks[b, i * N_COLUMNS + j] = t


@kernel
def _commit(
    forgetting: float,
    share: float,
    kept: Array,
    fresh: Array,
    sums: Array,
    count: Array,
    blocks: Array,
    block: int,
    work: Array,
) -> None:
    """Take a directional block into `kept` (36,) and `blocks` (b, 36); count (2,): rows in it, rows not forgotten."""
    end = commit_scratch(_N)
    F, quiet = work[end : end + _SIZE], work[end + _SIZE : end + _SIZE + _N]
    for i in range(_N):
        quiet[i] = 0.0
    if forget_excited(kept, fresh, _N, forgetting, count[0], share, quiet, work[:end], F) == 0:
        return
    _sandwich(blocks, block + 1, F)
    for i in range(_SIZE):
        blocks[block, i] += sums[i]
    left = forgetting ** count[0]
    count[1] = left * count[1] + (1.0 - left) / (1.0 - forgetting)


@inlined_kernel
def _fold(state: PaperState, axis: int, z: Array) -> None:
    """Move the columns of held coefficients into the force, and with a held inertia that to the left-hand side."""
    for c in range(C_FORCE):
        if state.free[axis, c] <= 0.0:
            z[C_FORCE] += state.known[axis, c] * z[c]
            z[c] = 0.0
    if state.free[axis, C_FORCE] <= 0.0:
        z[C_LHS] -= z[C_FORCE] / state.known[axis, C_FORCE]
        z[C_FORCE] = 0.0


@inlined_kernel
def _directional_row(state: PaperState, axis: int, g: Array, z: Array, block: int) -> None:
    forgetting = state.settings[1]
    fresh, sums, count = state.fresh[axis], state.fresh_sums[axis], state.counted[axis]
    _fold(state, axis, g)
    _fold(state, axis, z)
    scale = math.sqrt(forgetting)
    row = state.forgetting_work[-N_COLUMNS:]
    for i in range(N_COLUMNS):
        row[i] = z[i]
        for j in range(N_COLUMNS):
            sums[i * N_COLUMNS + j] = forgetting * sums[i * N_COLUMNS + j] + g[i] * z[j]
            fresh[i * N_COLUMNS + j] *= scale
    qr_absorb(fresh, row, N_COLUMNS)
    qr_absorb(state.triangle[axis], z, N_COLUMNS)
    count[0] += 1.0
    if count[0] < block_length(forgetting):
        return
    _commit(
        forgetting,
        state.settings[7],
        state.kept[axis],
        fresh,
        sums,
        count,
        state.blocks[axis],
        block,
        state.forgetting_work,
    )
    count[0] = 0.0
    for i in range(_SIZE):
        state.triangle[axis, i] = state.kept[axis, i]
        fresh[i] = 0.0
        sums[i] = 0.0


@kernel
def absorb_row(state: PaperState, axis: int, g: Array, z: Array, block: int) -> None:
    """Absorb the row z (6,) of one axis with its instruments g (6,), in the block of time `block`; both are changed."""
    forgetting = state.settings[1]
    if forgetting < 1.0 and state.settings[6] == DIRECTIONAL:
        _directional_row(state, axis, g, z, block)
        return
    for i in range(N_COLUMNS):
        for j in range(N_COLUMNS):
            state.blocks[axis, block, i * N_COLUMNS + j] += g[i] * z[j]
    if forgetting < 1.0:
        if state.settings[6] == BOUNDED_GAIN:
            inverse = state.forgetting_work[: _N * _N]
            forgetting = bounded_factor(
                state.triangle[axis], _N, forgetting, state.settings[8], state.least[axis], inverse
            )
            for b in range(block + 1):
                for i in range(_SIZE):
                    state.blocks[axis, b, i] *= forgetting
        scale = math.sqrt(forgetting)
        for i in range(_SIZE):
            state.triangle[axis, i] *= scale
    state.counted[axis, 1] = forgetting * state.counted[axis, 1] + 1.0
    qr_absorb(state.triangle[axis], z, N_COLUMNS)


@inlined_kernel
def forget_blocks(state: PaperState, block: int) -> None:
    """Discount all block sums by one row, where forgetting is exponential."""
    forgetting = state.settings[1]
    if forgetting < 1.0 and state.settings[6] != DIRECTIONAL and state.settings[6] != BOUNDED_GAIN:
        for axis in range(6):
            for b in range(block + 1):
                for i in range(_SIZE):
                    state.blocks[axis, b, i] *= forgetting


@kernel
def directional_information(state: PaperState, axis: int) -> tuple[Array, Array, float]:
    """Return triangle (36,), block sums (256, 36) and rows not forgotten of one axis, the block so far taken in.

    The state stays as it is.
    """
    kept, blocks, count = state.kept[axis].copy(), state.blocks[axis].copy(), state.counted[axis].copy()
    if count[0] > 0.0:
        _commit(
            state.settings[1],
            state.settings[7],
            kept,
            state.fresh[axis],
            state.fresh_sums[axis],
            count,
            blocks,
            int(state.clock[0]),
            np.empty(state.forgetting_work.shape[0]),
        )
    return kept, blocks, count[1]
