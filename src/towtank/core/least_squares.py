"""Recursive least squares as square root of the information (QR, Givens rotations).

It minimises sum_i lambda^(k-i) (y_i - phi_i theta)^2 + (theta - theta0)^T P0^-1 (theta - theta0), the paper's (33)-(37)
with forgetting, and keeps R with R^T R = P^-1, which never loses definiteness.

Forgetting here is exponential: all directions alike, excited or not (`core.forgetting` is gentler). It pauses while a
variance exceeds 1e12 (a direction that has not been excited for long): P stays finite through any rest, and what comes
after it is learned as if fresh.

The state is flat and holds its own scratch, so that a call from Python passes three arguments and allocates nothing:
[R z; 0 rho] row-major (n + 1)^2, scratch n + 1, forgetting factor lambda; rho^2 = sum of residuals^2.

Filtered regressors, exact in discrete time.

For x_dot = Phi theta the paper filters both sides with 1/(s + a), its (41)-(46). Over one sample interval

    x[k+1] - x[k] = sum_j theta_j int phi_j dt

is exact; passing both sides through the SAME recursion f[k+1] = exp(-a h) f[k] + increment[k] keeps it exact for every
a, every input and any start. The one error left is the quadrature of phi_j over one interval:

    held       a command between two digital updates: h phi
    hermite    a smooth function with one-sided slopes known: h (f0 + f1) / 2 + h^2 (f0' - f1') / 12, error O(h^5)
    cubic      a smooth function from four samples at equal spacing, causal: error O(h^5)
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel

__all__ = [
    "accumulate_into",
    "cubic_increment",
    "filter_increments",
    "hermite_increment",
    "qr_absorb",
    "qr_covariance",
    "qr_run",
    "qr_solve",
    "qr_start",
    "qr_update",
]

_LARGEST = 1e12  # variance beyond which nothing more is forgotten


@kernel
def qr_start(theta0: Array, P0: float, forgetting: float) -> Array:
    """Return the QR state for a prior theta0 (n,) with covariance P0 I and the forgetting factor lambda in (0, 1]."""
    n = theta0.shape[0]
    state = np.zeros((n + 1) * (n + 2) + 1)
    state[-1] = forgetting
    weight = 1.0 / math.sqrt(P0)
    for i in range(n):
        state[i * (n + 1) + i] = weight
        state[i * (n + 1) + n] = weight * theta0[i]
    return state


@inlined_kernel
def qr_absorb(state: Array, row: Array, m: int) -> None:
    """Rotate `row` (m,) = [phi, y] into the triangle `state` (m * m,) by Givens rotations; `row` is destroyed."""
    for i in range(m):
        b = row[i]
        if b == 0.0:
            continue
        a = state[i * m + i]
        r = math.sqrt(a * a + b * b)
        c, s = a / r, b / r
        state[i * m + i] = r
        for j in range(i + 1, m):
            t = state[i * m + j]
            state[i * m + j] = c * t + s * row[j]
            row[j] = c * row[j] - s * t


@inlined_kernel
def _qr_step(state: Array, phi: Array, y: float, n: int) -> bool:
    """Absorb one observation of n unknowns; False (and nothing changed) where a number is not finite."""
    size = (n + 1) * (n + 1)
    row = state[size : size + n + 1]
    finite = math.isfinite(y)
    for i in range(n):
        row[i] = phi[i]
        finite = finite and math.isfinite(phi[i])
    if not finite:
        return False
    row[n] = y
    forgetting = state[size + n + 1]
    if forgetting < 1.0:
        for i in range(n):
            if state[i * (n + 2)] < 1.0 / math.sqrt(_LARGEST):
                forgetting = 1.0
    if forgetting < 1.0:
        scale = math.sqrt(forgetting)
        for i in range(size):
            state[i] *= scale
    qr_absorb(state, row, n + 1)
    return True


@kernel
def qr_update(state: Array, phi: Array, y: float) -> int:
    """Absorb one observation y = phi theta.

    Returns 1; 0 (and nothing changed) where a number is not finite; -1 where phi has not the length of the state.
    """
    n = phi.shape[0]
    if (n + 1) * (n + 2) + 1 != state.shape[0]:
        return -1
    return 1 if _qr_step(state, phi, y, n) else 0


@kernel
def qr_run(state: Array, Phi: Array, y: Array) -> int:
    """Absorb all rows of Phi (k, n), y (k,) in turn; return how many were used."""
    used = 0
    for k in range(Phi.shape[0]):
        if _qr_step(state, Phi[k], y[k], Phi.shape[1]):
            used += 1
    return used


@kernel
def qr_solve(state: Array, n: int) -> Array:
    """Return theta (n,); NaN where the triangle is singular."""
    theta = np.empty(n)
    for back in range(n):
        i = n - 1 - back
        t = state[i * (n + 1) + n]
        for j in range(i + 1, n):
            t -= state[i * (n + 1) + j] * theta[j]
        d = state[i * (n + 1) + i]
        theta[i] = t / d if d != 0.0 else math.nan
    return theta


@kernel
def qr_covariance(state: Array, n: int) -> Array:
    """Return P (n, n) = (R^T R)^-1; infinite where the triangle is singular."""
    inverse = np.zeros((n, n))
    for c in range(n):
        for back in range(c + 1):
            i = c - back
            t = 1.0 if i == c else 0.0
            for j in range(i + 1, c + 1):
                t -= state[i * (n + 1) + j] * inverse[j, c]
            d = state[i * (n + 1) + i]
            inverse[i, c] = t / d if d != 0.0 else math.inf
    out = np.zeros((n, n))
    for i in range(n):
        for j in range(i, n):
            t = 0.0
            for k in range(j, n):
                t += inverse[i, k] * inverse[j, k]
            out[i, j] = t
            out[j, i] = t
    return out


@inlined_kernel
def hermite_increment(f0: float, f1: float, slope0: float, slope1: float, h: float) -> float:
    """Integral over [0, h] of the cubic with values f0, f1 and one-sided slopes slope0, slope1 at its ends."""
    return 0.5 * h * (f0 + f1) + h * h / 12.0 * (slope0 - slope1)


@inlined_kernel
def cubic_increment(f_2: float, f_1: float, f0: float, f1: float, h: float) -> float:
    """Integral over [0, h] of the cubic through samples at -2h, -h, 0, h (Adams-Moulton, fourth order)."""
    return h * (9.0 * f1 + 19.0 * f0 - 5.0 * f_1 + f_2) / 24.0


@inlined_kernel
def accumulate_into(filtered: Array, increment: Array, decay: float, n: int) -> None:
    """filtered = decay filtered + increment for the first `n` places; decay = exp(-a h)."""
    for i in range(n):
        filtered[i] = decay * filtered[i] + increment[i]


@kernel
def filter_increments(increments: Array, dt: Array, a: float) -> Array:
    """Filter increments (n, m) over intervals dt (n,) [s] with the constant a [1/s]; returns (n, m)."""
    out = increments.copy()
    for k in range(1, increments.shape[0]):
        decay = math.exp(-a * dt[k])
        for j in range(increments.shape[1]):
            out[k, j] += decay * out[k - 1, j]
    return out
