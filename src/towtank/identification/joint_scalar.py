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

__all__ = ["count_speed", "inject", "innovate", "scalar_update"]

_CLIPPED = 25.0  # times S that an innovation^2 counts for at most where it tells of the motion's roughness
_NEIGHBOURS = 0.5  # s from one sample of a speed to the next, for the two to tell of the sensor's noise
_LEAST_SLOPE = 0.05


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
    away = math.fabs(nu) / math.sqrt(S)
    cap = state.options[O_HUBER]
    if S < 5.0 * R:
        state.stats[column, 0] += 1.0
        state.stats[column, 1] += nu * nu - (S - R)
    state.stats[column, 2] += nu * nu / S
    state.stats[column, 4] += 1.0
    since = state.clock[C_SINCE]
    state.stats[column, 5] += since * (min(nu * nu, _CLIPPED * S) - S) / (S * S)
    state.stats[column, 6] += since * since / (S * S)
    if 6 <= column < 12:
        count_speed(state, column, nu, S, (S - R) / (S * max(away / cap, 1.0)))
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
def count_speed(state: JointState, column: int, nu: float, S: float, gain: float) -> None:
    """Count what the innovation nu of a speed tells of the sensor's noise and of the motion's roughness.

    With e the error before the sample and v its noise, nu = e + v, and the error at the next one is e - K nu + w. So
    (1 - K) nu^2 - nu nu' is v nu on average, R, whatever the gain K, and whatever the filter takes the roughness for
    (Mehra 1970); one sample alone tells R and the roughness only together. Of a random walk of variance q per second
    that a filter of gain K follows, the steady state has dS/dq = h / (K (2 - K)).
    """
    own, since = state.stats[column], state.clock[C_SINCE]
    if own[13] > 0.0 and since < _NEIGHBOURS:
        own[7] += 1.0
        own[8] += (1.0 - own[12]) * own[11] * own[11] - nu * own[11]
    own[11], own[12], own[13] = nu, gain, 1.0
    slope = since / max(gain * (2.0 - gain), _LEAST_SLOPE)
    own[9] += slope * (min(nu * nu, _CLIPPED * S) - S) / (S * S)
    own[10] += slope * slope / (S * S)


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
