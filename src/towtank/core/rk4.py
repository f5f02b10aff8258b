"""Classical fourth-order Runge-Kutta integration of the six-degree-of-freedom vehicle.

State (13): [x y z, qw qx qy qz, u v w p q r], position in NED [m], quaternion body to NED, velocity relative to the
water in body FRD [m/s, rad/s]. With a current v_c constant in NED the equations of motion hold unchanged in the
relative velocity nu_r (Galilean invariance), so the current enters the kinematics alone:

    M nu_r_dot = tau + tau_0 - C(nu_r) nu_r + L nu_r + Q |nu_r| nu_r + u_r (F nu_r) + A nu_r^2 - g(eta)
    p_dot = R v_r + v_c,   q_dot = q (0, omega) / 2

Fossen (2021), sections 2.2, 6.1, 8.1; Kirchhoff's form of C(nu) nu in `towtank.core.inertia`.

Forces of the velocity beyond those of L and Q, forward speed u (F nu) and asymmetric drag A nu^2, are added to the
acceleration afterwards, where any is not zero: every other vehicle keeps its motion to the last bit, and pays one
test a step. They are called extra terms here.

Runs are advanced in lanes: every array carries the run as its last axis and the innermost loop goes over it, so that
the compiler turns several vehicles into one vector instruction. One vehicle is a lane of one: the same code.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel, parallel_kernel
from towtank.core.layout import (
    I_ASYMMETRY,
    I_CONSTANT,
    I_EXTRA,
    I_FORWARD,
    I_LINEAR,
    I_MASS,
    I_MASS_INVERSE,
    I_MOMENT,
    I_QUADRATIC,
    I_WEIGHT,
    N_EXTRA,
    N_PARAMETERS,
)

__all__ = [
    "LANES",
    "N_STATES",
    "has_extra_terms",
    "is_coupled",
    "simulate_run",
    "simulate_runs",
    "stage_into",
    "stage_of_one_into",
    "step_into",
    "step_of_one_into",
]

N_STATES = 13
LANES = 16
_M, _V, _L, _Q = I_MASS, I_MASS_INVERSE, I_LINEAR, I_QUADRATIC
_W, _B, _0, _F, _A = I_WEIGHT, I_MOMENT, I_CONSTANT, I_FORWARD, I_ASYMMETRY


@inlined_kernel
def stage_into(p: Array, x: Array, tau: Array, current: Array, rate: Array, coupled: bool) -> None:
    """Write the time derivative of the states `x` (13, lanes) into `rate` (13, lanes).

    Args:
        p: kernel parameters (170, lanes), see `towtank.core.layout`.
        tau: wrench (6, lanes) [N, N m], body FRD.
        current: water velocity (3,) [m/s], NED.
        coupled: False where every matrix is diagonal (`is_coupled`), which takes half the time.
    """
    _base_stage_into(p, x, tau, current, rate, coupled)
    if has_extra_terms(p):
        _add_extra_terms_into(p, x, rate)


@kernel
def _add_extra_terms_into(p: Array, x: Array, rate: Array) -> None:
    """Add M^-1 (u (F nu) + A nu^2) at the states `x` (13, lanes) to the acceleration in `rate` (13, lanes)."""
    for k in range(x.shape[1]):
        u, v, w, pp, q, r = x[7, k], x[8, k], x[9, k], x[10, k], x[11, k], x[12, k]
        f0 = p[_A, k] * u * u
        f1 = u * (p[_F, k] * v + p[_F + 1, k] * r) + p[_A + 1, k] * v * v
        f5 = u * (p[_F + 2, k] * v + p[_F + 3, k] * r) + p[_A + 5, k] * r * r
        f3 = u * p[_F + 4, k] * pp + p[_A + 3, k] * pp * pp
        f2 = u * (p[_F + 5, k] * w + p[_F + 6, k] * q) + p[_A + 2, k] * w * w
        f4 = u * (p[_F + 7, k] * w + p[_F + 8, k] * q) + p[_A + 4, k] * q * q
        for i in range(6):
            row = _V + 6 * i
            a = p[row, k] * f0 + p[row + 1, k] * f1 + p[row + 2, k] * f2
            rate[7 + i, k] += a + p[row + 3, k] * f3 + p[row + 4, k] * f4 + p[row + 5, k] * f5


@inlined_kernel
def _base_stage_into(p: Array, x: Array, tau: Array, current: Array, rate: Array, coupled: bool) -> None:
    """As `stage_into`, without the extra terms."""
    for k in range(x.shape[1]):
        qw, qx, qy, qz = x[3, k], x[4, k], x[5, k], x[6, k]
        u, v, w, pp, q, r = x[7, k], x[8, k], x[9, k], x[10, k], x[11, k], x[12, k]

        # Rotation matrix rows; its last row is k = R^T e_z, the direction of gravity in the body.
        r11 = 1.0 - 2.0 * (qy * qy + qz * qz)
        r12 = 2.0 * (qx * qy - qw * qz)
        r13 = 2.0 * (qx * qz + qw * qy)
        r21 = 2.0 * (qx * qy + qw * qz)
        r22 = 1.0 - 2.0 * (qx * qx + qz * qz)
        r23 = 2.0 * (qy * qz - qw * qx)
        kx = 2.0 * (qx * qz - qw * qy)
        ky = 2.0 * (qy * qz + qw * qx)
        kz = 1.0 - 2.0 * (qx * qx + qy * qy)
        rate[0, k] = r11 * u + r12 * v + r13 * w + current[0]
        rate[1, k] = r21 * u + r22 * v + r23 * w + current[1]
        rate[2, k] = kx * u + ky * v + kz * w + current[2]
        rate[3, k] = -0.5 * (qx * pp + qy * q + qz * r)
        rate[4, k] = 0.5 * (qw * pp + qy * r - qz * q)
        rate[5, k] = 0.5 * (qw * q + qz * pp - qx * r)
        rate[6, k] = 0.5 * (qw * r + qx * q - qy * pp)

        # Momentum h = M nu.
        if coupled:
            h0 = p[_M, k] * u + p[_M + 1, k] * v + p[_M + 2, k] * w
            h0 += p[_M + 3, k] * pp + p[_M + 4, k] * q + p[_M + 5, k] * r
            h1 = p[_M + 6, k] * u + p[_M + 7, k] * v + p[_M + 8, k] * w
            h1 += p[_M + 9, k] * pp + p[_M + 10, k] * q + p[_M + 11, k] * r
            h2 = p[_M + 12, k] * u + p[_M + 13, k] * v + p[_M + 14, k] * w
            h2 += p[_M + 15, k] * pp + p[_M + 16, k] * q + p[_M + 17, k] * r
            h3 = p[_M + 18, k] * u + p[_M + 19, k] * v + p[_M + 20, k] * w
            h3 += p[_M + 21, k] * pp + p[_M + 22, k] * q + p[_M + 23, k] * r
            h4 = p[_M + 24, k] * u + p[_M + 25, k] * v + p[_M + 26, k] * w
            h4 += p[_M + 27, k] * pp + p[_M + 28, k] * q + p[_M + 29, k] * r
            h5 = p[_M + 30, k] * u + p[_M + 31, k] * v + p[_M + 32, k] * w
            h5 += p[_M + 33, k] * pp + p[_M + 34, k] * q + p[_M + 35, k] * r
        else:
            h0, h1, h2 = p[_M, k] * u, p[_M + 7, k] * v, p[_M + 14, k] * w
            h3, h4, h5 = p[_M + 21, k] * pp, p[_M + 28, k] * q, p[_M + 35, k] * r

        # Damping: L + Q |nu| column by column, so that each column is scaled once.
        au, av, aw, ap, aq, ar = math.fabs(u), math.fabs(v), math.fabs(w), math.fabs(pp), math.fabs(q), math.fabs(r)
        if coupled:
            d0 = (p[_L, k] + p[_Q, k] * au) * u + (p[_L + 1, k] + p[_Q + 1, k] * av) * v
            d0 += (p[_L + 2, k] + p[_Q + 2, k] * aw) * w + (p[_L + 3, k] + p[_Q + 3, k] * ap) * pp
            d0 += (p[_L + 4, k] + p[_Q + 4, k] * aq) * q + (p[_L + 5, k] + p[_Q + 5, k] * ar) * r
            d1 = (p[_L + 6, k] + p[_Q + 6, k] * au) * u + (p[_L + 7, k] + p[_Q + 7, k] * av) * v
            d1 += (p[_L + 8, k] + p[_Q + 8, k] * aw) * w + (p[_L + 9, k] + p[_Q + 9, k] * ap) * pp
            d1 += (p[_L + 10, k] + p[_Q + 10, k] * aq) * q + (p[_L + 11, k] + p[_Q + 11, k] * ar) * r
            d2 = (p[_L + 12, k] + p[_Q + 12, k] * au) * u + (p[_L + 13, k] + p[_Q + 13, k] * av) * v
            d2 += (p[_L + 14, k] + p[_Q + 14, k] * aw) * w + (p[_L + 15, k] + p[_Q + 15, k] * ap) * pp
            d2 += (p[_L + 16, k] + p[_Q + 16, k] * aq) * q + (p[_L + 17, k] + p[_Q + 17, k] * ar) * r
            d3 = (p[_L + 18, k] + p[_Q + 18, k] * au) * u + (p[_L + 19, k] + p[_Q + 19, k] * av) * v
            d3 += (p[_L + 20, k] + p[_Q + 20, k] * aw) * w + (p[_L + 21, k] + p[_Q + 21, k] * ap) * pp
            d3 += (p[_L + 22, k] + p[_Q + 22, k] * aq) * q + (p[_L + 23, k] + p[_Q + 23, k] * ar) * r
            d4 = (p[_L + 24, k] + p[_Q + 24, k] * au) * u + (p[_L + 25, k] + p[_Q + 25, k] * av) * v
            d4 += (p[_L + 26, k] + p[_Q + 26, k] * aw) * w + (p[_L + 27, k] + p[_Q + 27, k] * ap) * pp
            d4 += (p[_L + 28, k] + p[_Q + 28, k] * aq) * q + (p[_L + 29, k] + p[_Q + 29, k] * ar) * r
            d5 = (p[_L + 30, k] + p[_Q + 30, k] * au) * u + (p[_L + 31, k] + p[_Q + 31, k] * av) * v
            d5 += (p[_L + 32, k] + p[_Q + 32, k] * aw) * w + (p[_L + 33, k] + p[_Q + 33, k] * ap) * pp
            d5 += (p[_L + 34, k] + p[_Q + 34, k] * aq) * q + (p[_L + 35, k] + p[_Q + 35, k] * ar) * r
        else:
            d0, d1 = (p[_L, k] + p[_Q, k] * au) * u, (p[_L + 7, k] + p[_Q + 7, k] * av) * v
            d2, d3 = (p[_L + 14, k] + p[_Q + 14, k] * aw) * w, (p[_L + 21, k] + p[_Q + 21, k] * ap) * pp
            d4, d5 = (p[_L + 28, k] + p[_Q + 28, k] * aq) * q, (p[_L + 35, k] + p[_Q + 35, k] * ar) * r

        # Net wrench: tau + constant - C(nu) nu + damping - g.  -C(nu) nu = -[omega x h1 ; v x h1 + omega x h2];
        # -g = [(W - B) k ; b x k].
        weight = p[_W, k]
        bx, by, bz = p[_B, k], p[_B + 1, k], p[_B + 2, k]
        f0 = tau[0, k] + p[_0, k] - (q * h2 - r * h1) + d0 + weight * kx
        f1 = tau[1, k] + p[_0 + 1, k] - (r * h0 - pp * h2) + d1 + weight * ky
        f2 = tau[2, k] + p[_0 + 2, k] - (pp * h1 - q * h0) + d2 + weight * kz
        f3 = tau[3, k] + p[_0 + 3, k] - (v * h2 - w * h1 + q * h5 - r * h4) + d3 + by * kz - bz * ky
        f4 = tau[4, k] + p[_0 + 4, k] - (w * h0 - u * h2 + r * h3 - pp * h5) + d4 + bz * kx - bx * kz
        f5 = tau[5, k] + p[_0 + 5, k] - (u * h1 - v * h0 + pp * h4 - q * h3) + d5 + bx * ky - by * kx

        if coupled:
            a0 = p[_V, k] * f0 + p[_V + 1, k] * f1 + p[_V + 2, k] * f2
            a0 += p[_V + 3, k] * f3 + p[_V + 4, k] * f4 + p[_V + 5, k] * f5
            a1 = p[_V + 6, k] * f0 + p[_V + 7, k] * f1 + p[_V + 8, k] * f2
            a1 += p[_V + 9, k] * f3 + p[_V + 10, k] * f4 + p[_V + 11, k] * f5
            a2 = p[_V + 12, k] * f0 + p[_V + 13, k] * f1 + p[_V + 14, k] * f2
            a2 += p[_V + 15, k] * f3 + p[_V + 16, k] * f4 + p[_V + 17, k] * f5
            a3 = p[_V + 18, k] * f0 + p[_V + 19, k] * f1 + p[_V + 20, k] * f2
            a3 += p[_V + 21, k] * f3 + p[_V + 22, k] * f4 + p[_V + 23, k] * f5
            a4 = p[_V + 24, k] * f0 + p[_V + 25, k] * f1 + p[_V + 26, k] * f2
            a4 += p[_V + 27, k] * f3 + p[_V + 28, k] * f4 + p[_V + 29, k] * f5
            a5 = p[_V + 30, k] * f0 + p[_V + 31, k] * f1 + p[_V + 32, k] * f2
            a5 += p[_V + 33, k] * f3 + p[_V + 34, k] * f4 + p[_V + 35, k] * f5
        else:
            a0, a1, a2 = p[_V, k] * f0, p[_V + 7, k] * f1, p[_V + 14, k] * f2
            a3, a4, a5 = p[_V + 21, k] * f3, p[_V + 28, k] * f4, p[_V + 35, k] * f5
        rate[7, k] = a0
        rate[8, k] = a1
        rate[9, k] = a2
        rate[10, k] = a3
        rate[11, k] = a4
        rate[12, k] = a5


@kernel
def is_coupled(p: Array) -> bool:
    """Whether the mass or a damping matrix of any lane of `p` (170, lanes) has an element off its diagonal."""
    for start in (_M, _L, _Q):
        for i in range(6):
            for j in range(6):
                for k in range(p.shape[1]):
                    if i != j and p[start + 6 * i + j, k] != 0.0:
                        return True
    return False


@kernel
def has_extra_terms(p: Array) -> bool:
    """Whether any force of the velocity beyond L and Q of any lane of `p` (170, lanes) is not zero."""
    for n in range(N_EXTRA):
        for k in range(p.shape[1]):
            if p[I_EXTRA + n, k] != 0.0:
                return True
    return False


@inlined_kernel
def step_into(
    p: Array, x: Array, tau: Array, current: Array, dt: float, work: Array, coupled: bool, extra: bool
) -> None:
    """Advance the states `x` (13, lanes) by one step of `dt` seconds, in place.

    Args:
        p: kernel parameters (170, lanes), or (3, 170, lanes) at the start, the middle and the end of the step.
        tau: wrench (3, 6, lanes) at the same instants.
        current: water velocity (3,), NED.
        work: scratch (3, 13, lanes).
        coupled: as `stage_into`. extra: whether there are extra terms (`has_extra_terms`).
    """
    if extra:
        _extra_step_into(p, x, tau, current, dt, work)
    else:
        _base_step_into(p, x, tau, current, dt, work, coupled, False)


@kernel
def _extra_step_into(p: Array, x: Array, tau: Array, current: Array, dt: float, work: Array) -> None:
    """A step with extra terms, out of line so that all other vehicles keep their short one."""
    _base_step_into(p, x, tau, current, dt, work, True, True)


@inlined_kernel
def _base_step_into(
    parameters: Array, x: Array, tau: Array, current: Array, dt: float, work: Array, coupled: bool, extra: bool
) -> None:
    """As `step_into`; extra: with the extra terms."""
    rate, trial, total = work[0], work[1], work[2]
    for i in range(N_STATES):
        for k in range(x.shape[1]):
            trial[i, k] = x[i, k]
            total[i, k] = x[i, k]
    for stage in range(4):
        p = parameters if parameters.ndim == 2 else parameters[(stage + 1) // 2]
        if coupled:
            _base_stage_into(p, trial, tau[(stage + 1) // 2], current, rate, True)
        else:
            _base_stage_into(p, trial, tau[(stage + 1) // 2], current, rate, False)
        if extra:
            _add_extra_terms_into(p, trial, rate)
        weight = dt / 6.0 if stage == 0 or stage == 3 else dt / 3.0
        ahead = dt if stage == 2 else 0.5 * dt
        for i in range(N_STATES):
            for k in range(x.shape[1]):
                total[i, k] += weight * rate[i, k]
                trial[i, k] = x[i, k] + ahead * rate[i, k]
    for i in range(N_STATES):
        for k in range(x.shape[1]):
            x[i, k] = total[i, k]
    for k in range(x.shape[1]):
        n = 1.0 / math.sqrt(x[3, k] * x[3, k] + x[4, k] * x[4, k] + x[5, k] * x[5, k] + x[6, k] * x[6, k])
        x[3, k] *= n
        x[4, k] *= n
        x[5, k] *= n
        x[6, k] *= n


@kernel
def stage_of_one_into(p: Array, x: Array, tau: Array, current: Array, rate: Array, coupled: bool) -> None:
    """As `stage_into` for one vehicle: p (170,), x (13,), tau (6,), rate (13,); compiled once for all callers."""
    lane = rate.reshape(N_STATES, 1)
    stage_into(p.reshape(N_PARAMETERS, 1), x.reshape(N_STATES, 1), tau.reshape(6, 1), current, lane, coupled)


@kernel
def step_of_one_into(
    p: Array, x: Array, tau: Array, current: Array, dt: float, work: Array, coupled: bool, extra: bool
) -> None:
    """As `step_into` for one vehicle: p (170,), x (13,), tau (3, 6), work (3, 13); compiled once for all callers."""
    lane, wrench, space = x.reshape(N_STATES, 1), tau.reshape(3, 6, 1), work.reshape(3, N_STATES, 1)
    step_into(p.reshape(N_PARAMETERS, 1), lane, wrench, current, dt, space, coupled, extra)


@inlined_kernel
def _add_current(x: Array, k: int, current: Array, sign: float) -> None:
    """Add `sign` R^T v_c to the linear velocity of lane `k`: relative to absolute velocity (+1) or back (-1)."""
    qw, qx, qy, qz = x[3, k], x[4, k], x[5, k], x[6, k]
    cx, cy, cz = current[0], current[1], current[2]
    x[7, k] += sign * (
        (1.0 - 2.0 * (qy * qy + qz * qz)) * cx + 2.0 * (qx * qy + qw * qz) * cy + 2.0 * (qx * qz - qw * qy) * cz
    )
    x[8, k] += sign * (
        2.0 * (qx * qy - qw * qz) * cx + (1.0 - 2.0 * (qx * qx + qz * qz)) * cy + 2.0 * (qy * qz + qw * qx) * cz
    )
    x[9, k] += sign * (
        2.0 * (qx * qz + qw * qy) * cx + 2.0 * (qy * qz - qw * qx) * cy + (1.0 - 2.0 * (qx * qx + qy * qy)) * cz
    )


@kernel
def simulate_run(p: Array, state0: Array, tau: Array, dt: float, current: Array) -> Array:
    """Simulate one vehicle and keep every state.

    Args:
        p: kernel parameters (170,).
        state0: initial state (13,) with the ABSOLUTE velocity nu in its last six places.
        tau: wrench (n, s, 6): s = 1 held over each step; s = 3 at the start, the middle and the end of each step.
        dt: step [s].
        current: water velocity (3,) [m/s], NED.

    Returns:
        States (n + 1, 13), absolute velocity in columns 7:13.
    """
    n, s = tau.shape[0], tau.shape[1]
    parameters = np.empty((N_PARAMETERS, 1))
    x = np.empty((N_STATES, 1))
    wrench = np.empty((3, 6, 1))
    work = np.empty((3, N_STATES, 1))
    for j in range(N_PARAMETERS):
        parameters[j, 0] = p[j]
    for j in range(N_STATES):
        x[j, 0] = state0[j]
    out = np.empty((n + 1, N_STATES))
    out[0] = state0
    coupled, extra = is_coupled(parameters), has_extra_terms(parameters)
    still = current[0] == 0.0 and current[1] == 0.0 and current[2] == 0.0
    if not still:
        _add_current(x, 0, current, -1.0)
    for i in range(n):
        for j in range(6):
            wrench[0, j, 0] = tau[i, 0, j]
            wrench[1, j, 0] = tau[i, s // 2, j]
            wrench[2, j, 0] = tau[i, s - 1, j]
        step_into(parameters, x, wrench, current, dt, work, coupled, extra)
        for j in range(N_STATES):
            out[i + 1, j] = x[j, 0]
        if not still:
            row = out[i + 1].reshape(N_STATES, 1)
            _add_current(row, 0, current, 1.0)
    return out


@parallel_kernel
def simulate_runs(p: Array, state0: Array, tau: Array, dt: float, current: Array, every: int) -> Array:
    """Simulate many vehicles at once on all cores and keep the states after each `every` steps.

    Args:
        p: kernel parameters (runs, 170).
        state0: initial states (runs, 13), absolute velocity in the last six places.
        tau: held wrench (runs, n, 6), or (1, n, 6) shared by all runs.
        dt: step [s].
        current: water velocity (3,) [m/s], NED.
        every: 1 keeps every state, n the final one alone.

    Returns:
        States (runs, n // every, 13), absolute velocity in columns 7:13; the start is not among them.
    """
    runs, n = p.shape[0], tau.shape[1]
    out = np.empty((runs, n // every, N_STATES))
    blocks = (runs + LANES - 1) // LANES
    for block in numba.prange(blocks):
        first = block * LANES
        parameters = np.empty((N_PARAMETERS, LANES))
        x = np.empty((N_STATES, LANES))
        wrench = np.empty((3, 6, LANES))
        work = np.empty((3, N_STATES, LANES))
        for k in range(LANES):
            run = min(first + k, runs - 1)
            for j in range(N_PARAMETERS):
                parameters[j, k] = p[run, j]
            for j in range(N_STATES):
                x[j, k] = state0[run, j]
            _add_current(x, k, current, -1.0)
        coupled, extra = is_coupled(parameters), has_extra_terms(parameters)
        for i in range(n):
            if tau.shape[0] == 1:
                for j in range(6):
                    for k in range(LANES):
                        wrench[0, j, k] = tau[0, i, j]
            else:
                for k in range(LANES):
                    run = min(first + k, runs - 1)
                    for j in range(6):
                        wrench[0, j, k] = tau[run, i, j]
            wrench[1] = wrench[0]
            wrench[2] = wrench[0]
            step_into(parameters, x, wrench, current, dt, work, coupled, extra)
            if (i + 1) % every == 0:
                for k in range(min(LANES, runs - first)):
                    row = out[first + k, i // every].reshape(N_STATES, 1)
                    for j in range(N_STATES):
                        row[j, 0] = x[j, k]
                    _add_current(row, 0, current, 1.0)
    return out
