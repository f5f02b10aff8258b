"""Bounded-gain forgetting: the less is known beside the best that ever was, the less is forgotten.

    lambda_k = 1 - (1 - lambda) (1 - max_i P_ii / (bound min P_ii))+,   min over all that was so far

No variance outgrows `bound` times its smallest by forgetting. Slotine and Li (Applied Nonlinear Control, 1991, 8.7)
bound the norm of P; taken relative to each variance's own smallest, the bound needs no units. All directions
forget alike: one at rest holds the others up, and what comes while the gain is at its bound is still learned, noise
too.

State, flat: that of `least_squares` (QR or covariance), then smallest variances n, scratch n * n, lambda, bound.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.least_squares import covariance_start, covariance_step, qr_start, qr_step

__all__ = [
    "bounded_covariance_run",
    "bounded_covariance_start",
    "bounded_covariance_update",
    "bounded_factor",
    "bounded_qr_run",
    "bounded_qr_start",
    "bounded_qr_update",
]


@kernel
def bounded_factor(triangle: Array, n: int, forgetting: float, bound: float, least: Array, inverse: Array) -> float:
    """Return the factor for the next row, from the triangle [T z; 0 rho], flat (n + 1)^2.

    `least` (n,), the smallest variances, is kept up to date. A column without a pivot has no variance and no say.
    `inverse` (n * n,) is scratch.
    """
    m = n + 1
    growth = 0.0
    for i in range(n):
        for j in range(n):
            inverse[i * n + j] = 0.0
    for back in range(n):
        i = n - 1 - back
        d = triangle[i * m + i]
        if d == 0.0:
            continue
        inverse[i * n + i] = 1.0 / d
        total = inverse[i * n + i] ** 2
        for c in range(i + 1, n):
            t = 0.0
            for j in range(i + 1, c + 1):
                t -= triangle[i * m + j] * inverse[j * n + c]
            inverse[i * n + c] = t / d
            total += inverse[i * n + c] ** 2
        least[i] = min(least[i], total)
        growth = max(growth, total / (bound * least[i]))
    return 1.0 - (1.0 - forgetting) * max(0.0, 1.0 - growth)


@kernel
def bounded_qr_start(theta0: Array, P0: float, forgetting: float, bound: float) -> Array:
    """Return the state in QR form for a prior theta0 (n,) with covariance P0 I; see the module."""
    return _with_bound(qr_start(theta0, P0, forgetting), theta0.shape[0], P0, forgetting, bound)


@kernel
def bounded_covariance_start(theta0: Array, P0: float, forgetting: float, bound: float) -> Array:
    """Return the state in covariance form for a prior theta0 (n,) with covariance P0 I; see the module."""
    return _with_bound(covariance_start(theta0, P0, forgetting), theta0.shape[0], P0, forgetting, bound)


@inlined_kernel
def _with_bound(start: Array, n: int, P0: float, forgetting: float, bound: float) -> Array:
    size = start.shape[0]
    state = np.zeros(size + n + n * n + 2)
    state[:size] = start
    state[size : size + n] = P0
    state[-2], state[-1] = forgetting, bound
    return state


@inlined_kernel
def _qr_bounded(state: Array, phi: Array, y: float, n: int) -> bool:
    size = (n + 1) * (n + 2) + 1
    least, inverse = state[size : size + n], state[size + n : size + n + n * n]
    state[size - 1] = bounded_factor(state[: (n + 1) ** 2], n, state[-2], state[-1], least, inverse)
    return qr_step(state[:size], phi, y, n)


@inlined_kernel
def _covariance_bounded(state: Array, phi: Array, y: float, n: int) -> bool:
    size = n * (n + 2) + 2
    growth = 0.0
    for i in range(n):
        variance = state[n + i * (n + 1)]
        state[size + i] = min(state[size + i], variance)
        growth = max(growth, variance / (state[-1] * state[size + i]))
    state[size - 1] = 1.0 - (1.0 - state[-2]) * max(0.0, 1.0 - growth)
    return covariance_step(state[:size], phi, y, n)


@kernel
def bounded_qr_update(state: Array, phi: Array, y: float) -> int:
    """Absorb one observation; 1, 0 where a number is not finite, -1 where phi has not the length of the state."""
    n = phi.shape[0]
    if (n + 1) * (n + 2) + 1 + n + n * n + 2 != state.shape[0]:
        return -1
    return 1 if _qr_bounded(state, phi, y, n) else 0


@kernel
def bounded_covariance_update(state: Array, phi: Array, y: float) -> int:
    """Absorb one observation; 1, 0 where a number is not finite, -1 where phi has not the length of the state."""
    n = phi.shape[0]
    if n * (n + 2) + 2 + n + n * n + 2 != state.shape[0]:
        return -1
    return 1 if _covariance_bounded(state, phi, y, n) else 0


@kernel
def bounded_qr_run(state: Array, Phi: Array, y: Array) -> int:
    """Absorb all rows of Phi (k, n), y (k,) in turn; return how many were used."""
    used = 0
    for k in range(Phi.shape[0]):
        if _qr_bounded(state, Phi[k], y[k], Phi.shape[1]):
            used += 1
    return used


@kernel
def bounded_covariance_run(state: Array, Phi: Array, y: Array) -> int:
    """Absorb all rows of Phi (k, n), y (k,) in turn; return how many were used."""
    used = 0
    for k in range(Phi.shape[0]):
        if _covariance_bounded(state, Phi[k], y[k], Phi.shape[1]):
            used += 1
    return used
