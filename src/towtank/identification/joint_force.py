"""The accelerometer in the joint filter: what the forces of the model do is what it shows."""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel
from towtank.core.rk4 import stage_into
from towtank.identification.joint_scalar import inject, innovate, scalar_update
from towtank.identification.joint_state import C_TIME, O_BIASES, O_GATE, JointState
from towtank.identification.transition import N_FIXED, linearise_into

__all__ = ["GRAVITY", "update_specific_force"]

GRAVITY = 9.81  # m/s^2, as in `towtank.vehicle`


@kernel
def update_specific_force(state: JointState, z: Array, coupled: bool) -> None:
    """Update by the accelerometer: nu_dot + omega x v - g k + bias, all in the body."""
    inject(state)
    x, A, h = state.x, state.A, state.h
    lane = state.x.reshape(13, 1)
    rate = state.work[4]
    wrench = state.scratch[:1].reshape(6, 1)
    for i in range(6):
        wrench[i, 0] = state.tau[i] + state.force[i]
    stage_into(state.p.reshape(state.p.shape[0], 1), lane, wrench, state.current, rate, True)
    linearise_into(state.p, x, rate[:, 0], state.codes, state.anchor, state.shape, state.pushed, A, state.scratch[4:6])
    u, v, w, p, q, r = x[7], x[8], x[9], x[10], x[11], x[12]
    k0, k1, k2 = (
        2.0 * (x[4] * x[6] - x[3] * x[5]),
        2.0 * (x[5] * x[6] + x[3] * x[4]),
        1.0 - 2.0 * (x[4] ** 2 + x[5] ** 2),
    )
    n = state.theta.shape[0]
    gate = state.options[O_GATE]
    for pass_ in range(2):
        for k in range(3):
            if not math.isfinite(z[12 + k]):
                continue
            for j in range(N_FIXED + n):
                h[j] = A[6 + k, j]
            f = rate[7 + k, 0]
            for c in range(n):
                f += A[6 + k, N_FIXED + c] * (state.theta[c] - state.anchor[c])
            if k == 0:
                f += q * w - r * v - GRAVITY * k0
                h[8] += q
                h[7] -= r
                h[10] += w
                h[11] -= v
                h[4] += GRAVITY * k2
                h[5] -= GRAVITY * k1
            elif k == 1:
                f += r * u - p * w - GRAVITY * k1
                h[6] += r
                h[8] -= p
                h[11] += u
                h[9] -= w
                h[3] -= GRAVITY * k2
                h[5] += GRAVITY * k0
            else:
                f += p * v - q * u - GRAVITY * k2
                h[7] += p
                h[6] -= q
                h[9] += v
                h[10] -= u
                h[3] += GRAVITY * k1
                h[4] -= GRAVITY * k0
            if state.options[O_BIASES] > 0.0:
                h[N_FIXED + n + 3 + k] = 1.0
                f += state.bias[3 + k]
            residual = z[12 + k] - f
            if pass_ == 0:
                S = innovate(state, 12 + k, residual)
                for j in range(h.shape[0]):
                    h[j] = 0.0
                if residual * residual > gate * gate * S:
                    for m in range(3):
                        state.stats[12 + m, 3] += 1.0
                    return
            else:
                scalar_update(state, 12 + k, residual)
    state.heard[4] = state.clock[C_TIME]
