"""Directional forgetting: what a block of rows excites is forgotten and replaced, what it leaves alone is kept.

Subspace of information forgetting (Lai and Bernstein, SIFt-RLS, arXiv:2404.10844) on blocks of k rows, weighted within
the block as exponential forgetting weights them. A block B is set beside what that forgetting would take away, and
beside what noise on the regressors alone would bring:

    M = share (1 - lambda^k) R + 9 (sqrt(k') + sqrt(n))^2 diag(noise^2),   k' = (1 - lambda^k) / (1 - lambda)
    B^T B w = mu M w,        excited: the directions w with mu >= 1, S = span of them
    R+ = R - (1 - lambda^k) R S (S^T R S)^-1 S^T R + (the part of B^T B in S)

The paper takes the rows themselves for directions of theta, which ties it to the units. Here both are related by M, as
Kulhavy (1987) does by R for single rows: along an x that no row of B moves, x^T R x stays what it was. The
noise of k' rows has singular values up to sqrt(k') + sqrt(n) of its standard deviation. Where every direction is
excited this is exponential forgetting, exactly; where none is, the block leaves no trace.

For recursive least squares rows gather in a block of one memory, 1 / (1 - lambda) of them. Reading takes the block so
far as if it were complete, so that an estimate is never older than its last row. R never falls below the information of
a block that passed, so that the gain is bounded without persistent excitation.

State, flat: kept triangle [T z; 0 rho] (n + 1)^2 with R = T^T T, block triangle (n + 1)^2, scratch n + 1, lambda,
share, rows in a block, rows so far, noise n, scratch of a commit, change of the rows (n + 1)^2.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.least_squares import qr_absorb

__all__ = [
    "block_length",
    "commit_scratch",
    "directional_run",
    "directional_start",
    "directional_update",
    "directional_view",
    "forget_excited",
]

_SURE = 3.0  # amplitudes of noise that a direction must exceed
_ROUNDING = 1e-9  # of a column's size, so that M can always be inverted
_ORTHOGONAL = 1e-15
_SWEEPS = 30


@kernel
def block_length(forgetting: float) -> int:
    """Return how many rows make a block: one memory 1 / (1 - lambda)."""
    return max(1, int(0.5 + 1.0 / (1.0 - forgetting))) if forgetting < 1.0 else 1


@kernel
def commit_scratch(n: int) -> int:
    """Return the length of the scratch that `forget_excited` needs."""
    return 4 * n * n + 2 * (n + 1) ** 2 + 2 * n + 1


@kernel
def _measure_into(
    A: Array, kept: Array, fresh: Array, n: int, taken: float, noise: Array, floor: float, row: Array
) -> None:
    """Write the triangle A (n * n,) of M: a share of the kept information, the noise, and as much as rounding."""
    m = n + 1
    for i in range(n * n):
        A[i] = 0.0
    scale = math.sqrt(taken)
    for i in range(n):
        for j in range(n):
            row[j] = scale * kept[i * m + j] if j >= i else 0.0
        qr_absorb(A, row, n)
    for i in range(n):
        size = 0.0
        for j in range(i + 1):
            size += kept[j * m + i] ** 2 + fresh[j * m + i] ** 2
        least = _ROUNDING * math.sqrt(size) if size > 0.0 else 1.0
        for j in range(n):
            row[j] = 0.0
        row[i] = math.sqrt(least * least + floor * noise[i] * noise[i])
        qr_absorb(A, row, n)


@kernel
def _orthogonalise(X: Array, V: Array, n: int) -> None:
    """Turn the columns of X (n * n,) until they are orthogonal, V (n * n,) alike: one-sided Jacobi."""
    for _ in range(_SWEEPS):
        turned = False
        for p in range(n - 1):
            for q in range(p + 1, n):
                a, b, c = 0.0, 0.0, 0.0
                for i in range(n):
                    a += X[i * n + p] ** 2
                    b += X[i * n + q] ** 2
                    c += X[i * n + p] * X[i * n + q]
                if c == 0.0 or math.fabs(c) <= _ORTHOGONAL * math.sqrt(a * b):
                    continue
                turned = True
                zeta = (b - a) / (2.0 * c)
                t = math.copysign(1.0, zeta) / (math.fabs(zeta) + math.sqrt(1.0 + zeta * zeta))
                cosine = 1.0 / math.sqrt(1.0 + t * t)
                sine = cosine * t
                for i in range(n):
                    x, y = X[i * n + p], X[i * n + q]
                    X[i * n + p], X[i * n + q] = cosine * x - sine * y, sine * x + cosine * y
                    x, y = V[i * n + p], V[i * n + q]
                    V[i * n + p], V[i * n + q] = cosine * x - sine * y, sine * x + cosine * y
        if not turned:
            return


@kernel
def forget_excited(
    kept: Array,
    fresh: Array,
    n: int,
    forgetting: float,
    rows: float,
    share: float,
    noise: Array,
    work: Array,
    F: Array,
) -> int:
    """Forget in `kept` what the block `fresh` of `rows` rows excites, and absorb the block there.

    Args:
        kept, fresh: triangles [T z; 0 rho], flat (n + 1)^2; `kept` is changed.
        forgetting: lambda per row. share: of what would be forgotten that a direction must bring.
        noise: standard deviation of the noise on each regressor (n,).
        work: scratch, `commit_scratch(n)`.
        F: (n + 1)^2, becomes the change of the kept rows: each row z of the past counts as z (I - F).

    Returns:
        How many directions were excited; where 0 nothing was changed.
    """
    m, nn = n + 1, n * n
    left = forgetting**rows
    weight = (1.0 - left) / (1.0 - forgetting) if forgetting < 1.0 else rows
    A, X, V, W = work[:nn], work[nn : 2 * nn], work[2 * nn : 3 * nn], work[3 * nn : 4 * nn]
    Q, D = work[4 * nn : 4 * nn + m * m], work[4 * nn + m * m : 4 * nn + 2 * m * m]
    row, w = work[4 * nn + 2 * m * m : 4 * nn + 2 * m * m + m], work[4 * nn + 2 * m * m + m :]
    _measure_into(
        A, kept, fresh, n, share * (1.0 - left), noise, (_SURE * (math.sqrt(weight) + math.sqrt(n))) ** 2, row
    )
    for i in range(n):
        for j in range(n):
            V[i * n + j] = 1.0 if i == j else 0.0
            x = fresh[i * m + j] if j >= i else 0.0
            for k in range(j):
                x -= X[i * n + k] * A[k * n + j]
            X[i * n + j] = x / A[j * n + j]
    _orthogonalise(X, V, n)
    excited = 0
    size = 0
    for i in range(m * m):
        F[i] = 0.0
    for c in range(n):
        mu = 0.0
        for i in range(n):
            mu += X[i * n + c] ** 2
        if not mu >= 1.0:
            continue
        for l in range(m):  # the block's rows along this direction, kept in D for later
            t = 0.0
            for i in range(min(l + 1, n)):
                t += X[i * n + c] * fresh[i * m + l]
            D[excited * m + l] = t / math.sqrt(mu)
        excited += 1
        for back in range(n):
            i = n - 1 - back
            t = V[i * n + c]
            for j in range(i + 1, n):
                t -= A[i * n + j] * w[j]
            w[i] = t / A[i * n + i]
        before, after = 0.0, 0.0
        for i in range(n):
            t = 0.0
            for j in range(i, n):
                t += kept[i * m + j] * w[j]
            Q[size * n + i] = t
            before += t * t
        for _ in range(2):  # twice is enough
            for k in range(size):
                t = 0.0
                for i in range(n):
                    t += Q[k * n + i] * Q[size * n + i]
                for i in range(n):
                    Q[size * n + i] -= t * Q[k * n + i]
                    w[i] -= t * W[k * n + i]
        for i in range(n):
            after += Q[size * n + i] ** 2
        if not after > 1e-18 * before or after == 0.0:
            continue  # nothing is known along it yet, so nothing can be forgotten
        scale = 1.0 / math.sqrt(after)
        for i in range(n):
            Q[size * n + i] *= scale
            W[size * n + i] = scale * w[i]
        size += 1
    if excited == 0:
        return 0
    change = 1.0 - math.sqrt(left)
    for k in range(size):  # F = (1 - sqrt(lambda^k)) W Q^T [T z]
        for l in range(m):
            t = 0.0
            for i in range(min(l + 1, n)):
                t += Q[k * n + i] * kept[i * m + l]
            row[l] = change * t
        for i in range(n):
            for l in range(m):
                F[i * m + l] += W[k * n + i] * row[l]
    for i in range(n):  # [T z] (I - F), then the block, back to a triangle
        for l in range(m):
            t = kept[i * m + l] if l >= i else 0.0
            for j in range(i, n):
                t -= kept[i * m + j] * F[j * m + l]
            Q[i * m + l] = t
    rho = kept[m * m - 1]
    _discount_residual(kept, F, w, n, change)
    for i in range(m * m):
        kept[i] = 0.0
    kept[m * m - 1] = math.sqrt(left * rho * rho + fresh[m * m - 1] ** 2)
    for i in range(n):
        for l in range(m):
            row[l] = Q[i * m + l]
        qr_absorb(kept, row, m)
    for c in range(excited):
        for l in range(m):
            row[l] = D[c * m + l]
        qr_absorb(kept, row, m)
    return excited


@kernel
def _discount_residual(kept: Array, F: Array, theta: Array, n: int, change: float) -> None:
    """Let F take its share of each row's residual too; coefficients that nothing is known of count as 0."""
    m = n + 1
    for back in range(n):
        i = n - 1 - back
        t, size = kept[i * m + n], 0.0
        for j in range(i + 1, n):
            t -= kept[i * m + j] * theta[j]
        for j in range(i + 1):
            size += kept[j * m + i] ** 2
        d = kept[i * m + i]
        theta[i] = t / d if d * d > 1e-20 * size else 0.0
        F[i * m + n] -= change * theta[i]
    F[m * m - 1] += change


@inlined_kernel
def _settings(n: int) -> int:
    """Return where lambda stands in the state."""
    return 2 * (n + 1) ** 2 + n + 1


@kernel
def _state_length(n: int) -> int:
    return _settings(n) + 4 + n + commit_scratch(n) + (n + 1) ** 2


@kernel
def directional_start(theta0: Array, P0: float, forgetting: float, share: float, noise: Array) -> Array:
    """Return the state for a prior theta0 (n,) with covariance P0 I; `share`, `noise` (n,) as in `forget_excited`."""
    n = theta0.shape[0]
    m = n + 1
    state = np.zeros(_state_length(n))
    weight = 1.0 / math.sqrt(P0)
    for i in range(n):
        state[i * m + i] = weight
        state[i * m + n] = weight * theta0[i]
    place = _settings(n)
    state[place], state[place + 1], state[place + 2] = forgetting, share, float(block_length(forgetting))
    for i in range(n):
        state[place + 4 + i] = noise[i]
    return state


@inlined_kernel
def _commit(state: Array, n: int) -> int:
    m = n + 1
    place = _settings(n)
    work = state[place + 4 + n :]
    end = commit_scratch(n)
    excited = forget_excited(
        state[: m * m],
        state[m * m : 2 * m * m],
        n,
        state[place],
        state[place + 3],
        state[place + 1],
        state[place + 4 : place + 4 + n],
        work[:end],
        work[end:],
    )
    for i in range(m * m, 2 * m * m):
        state[i] = 0.0
    state[place + 3] = 0.0
    return excited


@inlined_kernel
def _directional_step(state: Array, phi: Array, y: float, n: int) -> bool:
    m = n + 1
    place = _settings(n)
    row = state[2 * m * m : place]
    finite = math.isfinite(y)
    for i in range(n):
        row[i] = phi[i]
        finite = finite and math.isfinite(phi[i])
    if not finite:
        return False
    row[n] = y
    scale = math.sqrt(state[place])
    for i in range(m * m, 2 * m * m):
        state[i] *= scale
    qr_absorb(state[m * m : 2 * m * m], row, m)
    state[place + 3] += 1.0
    if state[place + 3] >= state[place + 2]:
        _commit(state, n)
    return True


@kernel
def directional_update(state: Array, phi: Array, y: float) -> int:
    """Absorb one observation y = phi theta.

    Returns 1; 0 (and nothing changed) where a number is not finite; -1 where phi has not the length of the state.
    """
    n = phi.shape[0]
    if _state_length(n) != state.shape[0]:
        return -1
    return 1 if _directional_step(state, phi, y, n) else 0


@kernel
def directional_run(state: Array, Phi: Array, y: Array) -> int:
    """Absorb all rows of Phi (k, n), y (k,) in turn; return how many were used."""
    used = 0
    for k in range(Phi.shape[0]):
        if _directional_step(state, Phi[k], y[k], Phi.shape[1]):
            used += 1
    return used


@kernel
def directional_view(state: Array, n: int) -> Array:
    """Return the triangle [T z; 0 rho] (n + 1)^2 with the block so far taken in; the state stays as it is."""
    m = n + 1
    if state[_settings(n) + 3] == 0.0:
        return state[: m * m].copy()
    copy = state.copy()
    _commit(copy, n)
    return copy[: m * m].copy()
