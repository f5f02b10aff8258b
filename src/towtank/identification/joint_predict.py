"""The joint filter between measurements: the motion under the inputs, and its covariance, P <- F P F^T + Q."""

from __future__ import annotations

import math

from towtank.core.arrays import kernel
from towtank.identification.held_input import HeldInput, held_means_into
from towtank.identification.joint_state import (
    C_DURATION,
    C_TIME,
    O_ADAPT,
    O_BIAS_WALK,
    O_BIASES,
    O_CURRENT_WALK,
    O_FLOOR_FORCE,
    O_FLOOR_MOMENT,
    O_REST,
    O_STEP,
    O_TIME_CONSTANT,
    REST_MEMORY,
    JointState,
)
from towtank.identification.parameters import IN_GAIN
from towtank.identification.transition import N_FIXED, N_MOVING, step_and_linearise, turn_by

__all__ = ["input_wrench", "predict"]

_DIST = 12
_TINY = 1e-30


@kernel
def input_wrench(state: JointState) -> None:
    """Write the mean wrench of the inputs over the last step into `state.tau`, with the anchor's gains."""
    m = state.shape.shape[1]
    for i in range(6):
        s = 0.0
        for j in range(m):
            s += state.shape[i, j] * state.pushed[0, j]
        state.tau[i] = s
    for c in range(state.theta.shape[0]):
        if state.codes[c, 0] == IN_GAIN:
            j = state.codes[c, 1]
            more = math.exp(state.anchor[c]) - 1.0
            for i in range(6):
                state.tau[i] += more * state.shape[i, j] * state.pushed[0, j]


@kernel
def _off_anchor(state: JointState) -> None:
    """Add to the motion what the coefficients' way from their anchor does over the step, to first order."""
    x, F = state.x, state.F
    n = state.theta.shape[0]
    ex = ey = ez = 0.0
    for c in range(n):
        away = state.theta[c] - state.anchor[c]
        if away != 0.0:
            column = N_FIXED + c
            for i in range(3):
                x[i] += F[i, column] * away
            ex += F[3, column] * away
            ey += F[4, column] * away
            ez += F[5, column] * away
            for i in range(6):
                x[7 + i] += F[6 + i, column] * away
    turn_by(x, ex, ey, ez)


@kernel
def _covariance(state: JointState, h: float) -> None:
    P, F, T, W = state.P, state.F, state.step, state.W
    columns, size = F.shape[1], P.shape[0]
    fade = math.exp(-h / state.options[O_TIME_CONSTANT])
    for i in range(N_MOVING):
        for j in range(columns):
            T[j, i] = F[i, j]
        for j in range(size):
            W[i, j] = 0.0
        for k in range(columns):
            f = F[i, k]
            if f != 0.0:
                for j in range(size):
                    W[i, j] += f * P[k, j]
    for i in range(N_MOVING):
        for j in range(N_MOVING):
            P[i, j] = 0.0
        for k in range(columns):
            a = W[i, k]
            if a != 0.0:
                for j in range(i, N_MOVING):
                    P[i, j] += a * T[k, j]
        for j in range(N_MOVING, size):
            P[i, j] = W[i, j]
        for j in range(_DIST, _DIST + 6):
            P[i, j] *= fade
    for i in range(N_MOVING):
        for j in range(i + 1, size):
            P[j, i] = P[i, j]
    for i in range(_DIST, _DIST + 6):
        for j in range(N_MOVING, size):
            P[i, j] *= fade
    for j in range(_DIST, _DIST + 6):
        for i in range(N_MOVING, size):
            P[i, j] *= fade
    _noise(state, h, fade)


@kernel
def _noise(state: JointState, h: float, fade: float) -> None:
    P = state.P
    for i in range(6):
        P[_DIST + i, _DIST + i] += state.sigma[i] ** 2 * (1.0 - fade * fade)
        P[6 + i, 6 + i] += state.rough[i] ** 2 * h
    for i in range(3):
        P[18 + i, 18 + i] += state.options[O_CURRENT_WALK] * h
    n = state.theta.shape[0]
    for c in range(n):
        P[N_FIXED + c, N_FIXED + c] += state.walk[c] * h
    if state.options[O_BIASES] > 0.0:
        for i in range(6):
            P[N_FIXED + n + i, N_FIXED + n + i] += state.options[O_BIAS_WALK] * h


@kernel
def _follow_level(state: JointState, h: float) -> None:
    """Count E[d^2] of each axis, and let the disturbance's level follow it where that is wanted."""
    adapt = state.options[O_ADAPT]
    for i in range(6):
        variance = state.P[_DIST + i, _DIST + i]
        power = state.force[i] ** 2 + variance
        state.level[i, 0] += h
        state.level[i, 1] += h * state.force[i] ** 2
        state.level[i, 2] += h * variance
        left = 1.0 - variance / max(state.sigma[i] ** 2, _TINY)
        if 0.0 < left < 1.0:  # what is old of it by tau has a variance of 1 - exp(-2 tau / T)
            state.level[i, 3] += h / max(-0.5 * state.options[O_TIME_CONSTANT] * math.log(left), h)
        if adapt > 0.0:
            floor = state.options[O_FLOOR_FORCE] if i < 3 else state.options[O_FLOOR_MOMENT]
            now = state.sigma[i] ** 2
            now += (power - now) * min(1.0, h / adapt)
            state.sigma[i] = max(math.sqrt(now), floor)


@kernel
def _rest(state: JointState, h: float) -> None:
    """Let coefficients rest that hardly learn any more, and wake those that would learn again.

    One that learns at a steady rate gains 1 / T per second after T seconds. One that gains a small share of that hears
    little, and what it hears is what the model of disturbances does not know: it would only wander.
    """
    share = state.options[O_REST]
    fade = math.exp(-h / REST_MEMORY)
    for c in range(state.theta.shape[0]):
        taught = state.taught[c]
        state.gained[c] *= fade
        rests = taught > REST_MEMORY and state.gained[c] * taught < share * REST_MEMORY
        state.awake[N_FIXED + c] = 0.0 if rests else 1.0
        if not rests:
            state.taught[c] = taught + h


@kernel
def predict(state: JointState, held: HeldInput, t: float, coupled: bool) -> bool:
    """Advance the filter to the time t [s]; False where the inputs are not known yet."""
    span = t - state.clock[C_TIME]
    steps = max(1, math.ceil(span / state.options[O_STEP] - 1e-9))
    h = span / steps
    T = state.options[O_TIME_CONSTANT]
    fade = math.exp(-h / T)
    mean = (1.0 - fade) * T / h
    total = state.scratch[11]
    for k in range(steps):
        end = t if k == steps - 1 else state.clock[C_TIME] + h
        if not held_means_into(held, end, state.pushed):
            return False
        input_wrench(state)
        for i in range(6):
            total[i] = state.tau[i] + mean * state.force[i]
        step_and_linearise(
            state.p,
            state.x,
            total,
            state.current,
            h,
            1.0 / T,
            state.codes,
            state.anchor,
            state.shape,
            state.pushed,
            coupled,
            state.F,
            state.A,
            state.work,
            state.scratch,
        )
        _off_anchor(state)
        _covariance(state, h)
        for i in range(6):
            state.force[i] *= fade
        _follow_level(state, h)
        _rest(state, h)
        state.clock[C_TIME] = end
        state.clock[C_DURATION] += h
    return True
