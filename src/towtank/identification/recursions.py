"""The forms and forgetting schemes of recursive least squares, each as its kernels behind one record.

exponential   every direction alike: what is at rest is forgotten too, and noise takes its place (wind-up)
directional   only where the data excites; the default
bounded-gain  less and less as variances grow beyond the least that they ever were
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from towtank.core import bounded_gain, directional, least_squares
from towtank.core.arrays import Array
from towtank.errors import InputError

__all__ = ["RECURSIONS", "Form", "Recursion", "Scheme", "recursion_of", "regressor_noise", "require_scheme"]

Form = Literal["qr", "covariance"]
Scheme = Literal["directional", "bounded-gain", "exponential"]


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
    "directional": Recursion(
        directional.directional_update, directional.directional_run, directional.directional_view, *_QR
    ),
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
        return "directional", directional.directional_start(theta0, P0, forgetting, share, noise)
    begin = bounded_gain.bounded_qr_start if form == "qr" else bounded_gain.bounded_covariance_start
    return f"bounded {form}", begin(theta0, P0, forgetting, bound)
