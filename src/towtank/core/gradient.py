"""The normalised gradient estimator: theta += gamma phi (y - phi theta) / (alpha + phi^T phi).

Stable for 0 < gamma < 2 whatever the regressor's scale (Ioannou and Sun, Robust Adaptive Control, section 4.3); it
needs persistence of excitation to converge and gives no covariance. State: theta (n,).
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel

__all__ = ["gradient_run", "gradient_update"]


@kernel
def gradient_update(state: Array, phi: Array, y: float, gamma: float, alpha: float) -> bool:
    """Absorb one observation; False (and nothing changed) where a number is not finite."""
    n = phi.shape[0]
    error = y
    norm = alpha
    for i in range(n):
        error -= phi[i] * state[i]
        norm += phi[i] * phi[i]
    if not (math.isfinite(error) and math.isfinite(norm)) or norm <= 0.0:
        return False
    for i in range(n):
        state[i] += gamma * phi[i] * error / norm
    return True


@kernel
def gradient_run(state: Array, Phi: Array, y: Array, gamma: float, alpha: float) -> int:
    """Absorb all rows of Phi (k, n), y (k,) in turn; return how many were used."""
    used = 0
    for k in range(Phi.shape[0]):
        if gradient_update(state, Phi[k], y[k], gamma, alpha):
            used += 1
    return used
