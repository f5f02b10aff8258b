"""One scalar measurement in the joint filter, in a form that keeps the covariance symmetric to the last bit.

With g = P H^T and S = H g + R the update is dx += g nu / S, P -= g g^T with g / sqrt(S). An innovation beyond the cap
counts as if its sensor were so much worse: S grows until the innovation is at the cap (Huber). Errors wait in dx until
they are put into the state.

A coefficient that rests is left as it is: its gain is zero, and P -= g g^T / S leaves out the block of those that rest.
The rest of P still counts with their uncertainty (Schmidt's consider states), so that it stays true.
"""

from __future__ import annotations

import math

from towtank.core.arrays import kernel
from towtank.identification.joint_state import C_LIKELIHOOD, C_SINCE, O_BIASES, O_HUBER, JointState
from towtank.identification.transition import N_FIXED, turn_by

__all__ = ["inject", "innovate", "scalar_update"]

_CLIPPED = 25.0  # times S that an innovation^2 counts for at most where it tells of the motion's roughness


@kernel
def innovate(state: JointState, column: int, residual: float) -> float:
    """Fill g = P H^T for the row in `state.h`; return S with the column's noise, its capped or not."""
    P, h, g = state.P, state.h, state.g
    size = g.shape[0]
    for j in range(size):
        g[j] = 0.0
    for k in range(size):
        a = h[k]
        if a != 0.0:
            for j in range(size):
                g[j] += a * P[k, j]
    S = state.noise[column] ** 2
    for k in range(size):
        S += h[k] * g[k]
    return float(S)


@kernel
def scalar_update(state: JointState, column: int, residual: float) -> None:
    """Update by one number whose residual at dx = 0 is `residual` and whose H stands in `state.h`; clears H."""
    P, h, g, dx = state.P, state.h, state.g, state.dx
    size = g.shape[0]
    S = innovate(state, column, residual)
    nu = residual
    for k in range(size):
        if h[k] != 0.0:
            nu -= h[k] * dx[k]
            h[k] = 0.0
    if not S > 0.0:
        return
    R = state.noise[column] ** 2
    if S < 5.0 * R:
        state.stats[column, 0] += 1.0
        state.stats[column, 1] += nu * nu - (S - R)
    state.stats[column, 2] += nu * nu / S
    state.stats[column, 4] += 1.0
    since = state.clock[C_SINCE]
    state.stats[column, 5] += since * (min(nu * nu, _CLIPPED * S) - S) / (S * S)
    state.stats[column, 6] += since * since / (S * S)
    away = math.fabs(nu) / math.sqrt(S)
    cap = state.options[O_HUBER]
    if away > cap:
        state.clock[C_LIKELIHOOD] -= 0.5 * (math.log(S) + cap * (2.0 * away - cap))
        S *= away / cap
    else:
        state.clock[C_LIKELIHOOD] -= 0.5 * (math.log(S) + away * away)
    gain = nu / S
    awake = state.awake
    for j in range(size):
        dx[j] += awake[j] * g[j] * gain
    root = 1.0 / math.sqrt(S)
    for i in range(size):
        g[i] *= root
    for c in range(state.theta.shape[0]):
        i = N_FIXED + c
        if P[i, i] > 0.0:
            state.gained[c] += g[i] * g[i] / P[i, i]
    for i in range(size):
        a = g[i]
        if a != 0.0 and awake[i] > 0.0:
            for j in range(size):
                P[i, j] -= a * g[j]
    for c in range(state.theta.shape[0]):
        i = N_FIXED + c
        if awake[i] == 0.0:
            for j in range(size):
                if awake[j] > 0.0:
                    P[i, j] = P[j, i]


@kernel
def inject(state: JointState) -> None:
    """Put the errors found so far into the state."""
    dx, x = state.dx, state.x
    n = state.theta.shape[0]
    for i in range(3):
        x[i] += dx[i]
        state.current[i] += dx[18 + i]
    for i in range(6):
        x[7 + i] += dx[6 + i]
        state.force[i] += dx[12 + i]
    turn_by(x, dx[3], dx[4], dx[5])
    for k in range(n):
        state.theta[k] += dx[N_FIXED + k]
    if state.options[O_BIASES] > 0.0:
        for i in range(6):
            state.bias[i] += dx[N_FIXED + n + i]
    for j in range(dx.shape[0]):
        dx[j] = 0.0
