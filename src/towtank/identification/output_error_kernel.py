"""One free run of the vehicle with its sensitivities, and the normal equations of its residuals.

From an initial state the vehicle is left to its inputs; nothing measured corrects it on the way. With S the derivative
of the error state (`towtank.identification.transition`) by the initial errors and the free coefficients,

    S' = A S + [0 B],   S(0) = [I 0],   S_{k+1} = S_k + h D + h^2/2 A D,   D = A S_k + [0 B]

A and B at the middle of the step, or of two short ones under the same wrench.

Each measured number adds w J J^T to the normal equations of its segment and w J r to
the score of its block of time, w = weight(r / scale) / (noise scale)^2. Nothing is kept per sample but the residual.
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.rk4 import N_STATES, is_coupled, stage_into, step_into
from towtank.identification.held_input import HeldInput, held_means_into, held_push
from towtank.identification.output_error_inputs import due, force_now, forward_to, next_change, wrench_into
from towtank.identification.output_error_rows import absorb_pose, absorb_specific_force, absorb_velocity
from towtank.identification.output_error_space import FreeRun, Indices, NormalEquations, Workspace
from towtank.identification.parameters import IN_DELAY, IN_GAIN, IN_LAG, Codes, put_parameters
from towtank.identification.transition import N_FIXED, N_MOVING, linearise_into

__all__ = ["STEP", "free_run"]

STEP = 0.02  # s, longest step of the integration
_FASTEST = 1e3  # m/s, rad/s: beyond this a run has diverged


@kernel
def free_run(
    run: FreeRun,
    vehicle: Array,
    codes: Codes,
    theta: Array,
    held: HeldInput,
    states: Array,
    estimated: Indices,
    moving: Indices,
    scale: Array,
    gated: bool,
    out: NormalEquations,
    space: Workspace,
) -> bool:
    """Run all segments and add up their normal equations; False where the coefficients or the motion are impossible.

    Args:
        vehicle: kernel parameters (154,); theta (n,) is put into a copy.
        held: an empty input with the nominal lags and delay; changed.
        states: initial states (s, 13).
        estimated: which of the 12 initial errors are estimated; they are the first columns.
        moving: which of the 12 error states answer to any column.
        scale: of the residuals of each column (15,), in standard deviations of the noise.
        gated: whether far residuals are left out altogether.
    """
    out.normal[:] = 0.0
    out.scores[:] = 0.0
    out.reach[:] = 0.0
    S, D, E, A, J = space.S, space.D, space.E, space.A, space.J
    p, x, middle, rate = space.p, space.x, space.middle, space.rate
    p_lane, x_lane, middle_lane, rate_lane = space.p_lane, space.x_lane, space.middle_lane, space.rate_lane
    wrench, wrench_lane = space.wrench, space.wrench_lane
    pushed, gain, work, scratch, current = space.pushed, space.gain, space.work, space.scratch, space.current
    t, values, q, noise, shape, block = run.t, run.values, run.q, run.noise, run.shape, run.block
    input_t, input_force = run.input_t, run.input_force
    p[:] = vehicle
    if not put_parameters(p, codes, theta, scratch):
        return False
    gain[:] = 1.0
    steered = False  # whether coefficients of the inputs are free
    for c in range(theta.shape[0]):
        steered = steered or codes[c, 0] == IN_DELAY or codes[c, 0] == IN_LAG or codes[c, 0] == IN_GAIN
        if codes[c, 0] == IN_DELAY:
            held.delay[0] = theta[c]
        elif codes[c, 0] == IN_LAG:
            held.lag[:] = math.exp(theta[c])
        elif codes[c, 0] == IN_GAIN:
            gain[codes[c, 1]] = math.exp(theta[c])
    coupled, lagless, clock = is_coupled(p_lane), not (held.lag > 0.0).any(), held.clock
    k = estimated.shape[0]
    pushed[:] = 0.0
    given = 0
    if input_t.shape[0] > 0:
        held_push(held, input_t[0], input_force[0])
        given = 1
    for s in range(run.first.shape[0]):
        for j in range(N_STATES):
            x[j] = states[s, j]
        S[:] = 0.0
        for c in range(k):
            S[estimated[c], c] = 1.0
        H = out.normal[s]
        for row in range(run.first[s], run.last[s]):
            if row == run.first[s]:
                given = forward_to(input_t, input_force, held, given, t[row], pushed)
                steps, h, half_way, resting, change = 0, 0.0, False, False, -math.inf
            else:
                span = t[row] - t[row - 1]
                steps = max(1, math.ceil(span / STEP - 1e-6))
                h = span / steps
            for step in range(steps):
                end = t[row] if step == steps - 1 else t[row - 1] + h * (step + 1)
                if resting and end <= change:
                    clock[0] = end
                    steady = not steered
                else:
                    resting = lagless and end <= change
                    given = due(input_t, input_force, held, given, end)
                    held_means_into(held, end, pushed)
                    change = next_change(input_t, held, given)
                    steady = wrench_into(shape, pushed, gain, wrench) and not steered
                for j in range(N_STATES):
                    middle[j] = x[j]
                if coupled:
                    step_into(p_lane, x_lane, wrench_lane, current, h, work, True)
                else:
                    step_into(p_lane, x_lane, wrench_lane, current, h, work, False)
                if half_way and steady:
                    half_way = False  # the second step of a pair
                    _advance(S, D, E, h, 1.5 * h * h, moving)
                else:
                    half_way = steady and 2.0 * h < 1.01 * STEP
                    share = 0.0 if half_way else 0.5
                    for j in range(N_STATES):
                        middle[j] = share * middle[j] + (1.0 - share) * x[j]
                    stage_into(p_lane, middle_lane, wrench_lane[0], current, rate_lane, coupled)
                    linearise_into(p, middle, rate, codes, theta, shape, pushed, A, scratch)
                    _rates(A, S, D, E, k, theta.shape[0], moving)
                    _advance(S, D, E, h, 0.5 * h * h, moving)
            for j in range(7, N_STATES):
                if not math.fabs(x[j]) < _FASTEST:
                    return False
            z, g, residuals = values[row], out.scores[block[row]], out.residuals[row]
            absorb_pose(z, q[row], x, S, noise, scale, gated, k + theta.shape[0], H, g, residuals, J)
            absorb_velocity(z, x, S, noise, scale, gated, k + theta.shape[0], H, g, residuals)
            if math.isfinite(z[12]) or math.isfinite(z[13]) or math.isfinite(z[14]):
                half_way = resting = False
                given = due(input_t, input_force, held, given, t[row])
                force_now(held, t[row], pushed)
                wrench_into(shape, pushed, gain, wrench)
                stage_into(p_lane, x_lane, wrench_lane[0], current, rate_lane, coupled)
                linearise_into(p, x, rate, codes, theta, shape, pushed, A, scratch)
                absorb_specific_force(z, x, rate, A, S, k, noise, scale, gated, k + theta.shape[0], H, g, residuals, J)
        for i in range(N_MOVING):
            for j in range(S.shape[1]):
                out.reach[i, j] += math.fabs(S[i, j])
    return True


@inlined_kernel
def _rates(A: Array, S: Array, D: Array, E: Array, states: int, n: int, moving: Indices) -> None:
    """Write the first and the second derivative of the sensitivities S (12, c) into D and E."""
    _times(A, S, moving, D)
    for i in moving:
        for c in range(n):
            D[i, states + c] += A[i, N_FIXED + c]
    _times(A, D, moving, E)


@inlined_kernel
def _advance(S: Array, D: Array, E: Array, h: float, half: float, moving: Indices) -> None:
    """Add h D + half E to the sensitivities S (12, c)."""
    for i in moving:
        for j in range(S.shape[1]):
            S[i, j] += h * D[i, j] + half * E[i, j]


@inlined_kernel
def _times(A: Array, S: Array, moving: Indices, out: Array) -> None:
    """Write A S (12, c) into `out`, in the rows that move."""
    for i in moving:
        for j in range(S.shape[1]):
            out[i, j] = 0.0
        for k in moving:
            f = A[i, k]
            if f != 0.0:
                for j in range(S.shape[1]):
                    out[i, j] += f * S[k, j]
