"""Recursive least squares with directional forgetting: what the data leaves alone is kept.

Rows gather in a block of one memory, 1 / (1 - lambda) of them, which then goes through `subspace_forgetting`. Reading
takes the block so far as if it were complete, so that an estimate is never older than its last row. R never falls below
the information of a block that passed, so that the gain is bounded without persistent excitation.

State, flat: kept triangle [T z; 0 rho] (n + 1)^2 with R = T^T T, block triangle (n + 1)^2, scratch n + 1, lambda,
share, rows in a block, rows so far, noise n, scratch of a commit, change of the rows (n + 1)^2.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.least_squares import qr_absorb
from towtank.core.subspace_forgetting import block_length, commit_scratch, forget_excited

__all__ = ["directional_run", "directional_start", "directional_update", "directional_view"]


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
