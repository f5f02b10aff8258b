"""One step of the vehicle and of its linearisation, by state, disturbance, current and every free coefficient.

The error state is [position (3, NED), attitude (3, body: q_true = q exp(e/2)), velocity (6, relative to the water)].
With x the state and everything taken at the middle of the step,

    d p_dot  = R dv - R [v]x e + d v_c
    d e_dot  = -[omega]x e + d omega
    d nu_dot = M^-1 { D d nu + [W - B; S(b)] ([k]x e) - sum Phi_j d c_j } + d a
    D        = L + 2 Q |nu| + 2 A nu + d(u F nu - C(nu) nu)/d nu

C(nu) nu is bilinear, so its derivative is C(dnu) nu + C(nu) dnu in Kirchhoff's form; Phi is the regressor of (8),
Phi c = tau along the motion, whence the last term. The disturbance a is an acceleration: one that is stated in newtons
would fix the scale of all forces by the accelerations that it could cause. So Phi is without what a does to nu_dot. The
step's matrix is F = I + A h + A^2 h^2 / 2.
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import row_of_rotation
from towtank.core.forces import add_extra_rate_into, pull_into
from towtank.core.inertia import bilinear_coriolis_into
from towtank.core.layout import I_LINEAR, I_MASS, I_MASS_INVERSE, I_QUADRATIC, INFLOW, N_KINDS
from towtank.core.regressor import unit_wrench_into
from towtank.core.rk4 import N_STATES, has_extra_terms, stage_of_one_into, step_of_one_into
from towtank.identification.model.terms import IN_DELAY, IN_GAIN, IN_LAG, LOG, N_FIXED, N_MOVING, Codes

__all__ = ["linearise_into", "step_and_linearise", "turn_by"]

_DIST, _CURRENT = 12, 18


@kernel
def turn_by(x: Array, ex: float, ey: float, ez: float) -> None:
    """Turn the attitude of the state x (13,) by the rotation vector e [rad], body: q <- q exp(e/2), normalised."""
    angle = math.sqrt(ex * ex + ey * ey + ez * ez)
    s = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    c = math.cos(0.5 * angle)
    a, b, d = s * ex, s * ey, s * ez
    qw, qx, qy, qz = x[3], x[4], x[5], x[6]
    w = qw * c - qx * a - qy * b - qz * d
    i = qw * a + qx * c + qy * d - qz * b
    j = qw * b - qx * d + qy * c + qz * a
    k = qw * d + qx * b - qy * a + qz * c
    norm = 1.0 / math.sqrt(w * w + i * i + j * j + k * k)
    x[3], x[4], x[5], x[6] = w * norm, i * norm, j * norm, k * norm


@kernel
def _by_mass(p: Array, A: Array, column: int, w: Array) -> None:
    """Add M^-1 w, most of which is zero as a rule, to the velocity rows of one column of `A`."""
    for j in range(6):
        if w[j] != 0.0:
            for i in range(6):
                A[6 + i, column] += p[I_MASS_INVERSE + 6 * i + j] * w[j]


@kernel
def inflow_wrench_into(B: Array, forces: Array, nu: Array, out: Array) -> None:
    """Write the wrench (6,) per unit of loss of thrust with inflow, -sum |T_j| b_j (b_j . nu), into `out`.

    Args:
        B: wrench of each unit force (6, m). forces: thrust (m,) [N]. nu: velocity through the water (6,).
    """
    for i in range(6):
        out[i] = 0.0
    for j in range(forces.shape[0]):
        along = 0.0
        for i in range(6):
            along += B[i, j] * nu[i]
        along *= math.fabs(forces[j])
        for i in range(6):
            out[i] -= B[i, j] * along


@kernel
def linearise_into(
    p: Array,
    x: Array,
    rate: Array,
    codes: Codes,
    theta: Array,
    shape: Array,
    pushed: Array,
    A: Array,
    wrenches: Array,
) -> None:
    """Write A (12, 21 + n), the derivative of the error's rate, at the state x (13,).

    `rate` (13,) is its derivative by the forces that the model knows, without the disturbance.

    Args:
        p: kernel parameters (170,), theta (n,) already put in.
        shape: wrench of each unit input (6, m).
        pushed: (3, m) of each input over the step: mean force, d mean / d delay, d mean / d ln lag.
        wrenches: scratch (2, 6).
    """
    n = theta.shape[0]
    A[:, :] = 0.0
    u, v, ww, pp, q, r = x[7], x[8], x[9], x[10], x[11], x[12]
    nu = x[7:13]
    nu_dot = rate[7:13]
    w, unit = wrenches[0], wrenches[1]
    k0, k1, k2 = row_of_rotation(x[3:7], 2)
    for i in range(3):
        a, b, c = row_of_rotation(x[3:7], i)
        A[i, 6], A[i, 7], A[i, 8] = a, b, c
        # -R [v]x: row (a b c) times -[v]x
        A[i, 3] = -(b * ww - c * v)
        A[i, 4] = -(c * u - a * ww)
        A[i, 5] = -(a * v - b * u)
        A[i, _CURRENT + i] = 1.0
        A[3 + i, 9 + i] = 1.0
    A[3, 4], A[3, 5] = r, -q
    A[4, 3], A[4, 5] = -r, pp
    A[5, 3], A[5, 4] = q, -pp

    for j in range(3):  # attitude: dk = k x e
        d0 = -k2 if j == 1 else (k1 if j == 2 else 0.0)
        d1 = k2 if j == 0 else (-k0 if j == 2 else 0.0)
        d2 = -k1 if j == 0 else (k0 if j == 1 else 0.0)
        pull_into(p, d0, d1, d2, w)
        _by_mass(p, A, 3 + j, w)

    # Velocity.
    mass = p[I_MASS:I_MASS_INVERSE].reshape(6, 6)
    extra = has_extra_terms(p.reshape(p.shape[0], 1))
    for j in range(6):
        for i in range(6):
            unit[i] = 0.0
        unit[j] = 1.0
        bilinear_coriolis_into(mass, unit, nu, w)
        for i in range(6):
            A[6 + i, _DIST + i] = -w[i]  # kept for a moment
        bilinear_coriolis_into(mass, nu, unit, w)
        size = 2.0 * math.fabs(nu[j])
        for i in range(6):
            c = p[I_LINEAR + 6 * i + j] + p[I_QUADRATIC + 6 * i + j] * size
            w[i] = c - w[i] + A[6 + i, _DIST + i]
        if extra:
            add_extra_rate_into(p, nu, unit, w)
        _by_mass(p, A, 6 + j, w)
    for i in range(6):
        for j in range(6):
            A[6 + i, _DIST + j] = 1.0 if i == j else 0.0

    # Coefficients.
    gravity = unit
    gravity[0], gravity[1], gravity[2] = k0, k1, k2
    for c in range(n):
        kind, i, j, transform = codes[c, 0], codes[c, 1], codes[c, 2], codes[c, 3]
        if kind == INFLOW:
            inflow_wrench_into(shape, pushed[0], nu, w)
        elif kind < N_KINDS:
            unit_wrench_into(kind, i, j, nu, nu_dot, gravity, w)
        elif kind == IN_GAIN:
            for m in range(6):
                w[m] = shape[m, i] * pushed[0, i]
        elif kind in (IN_DELAY, IN_LAG):
            row = 1 if kind == IN_DELAY else 2
            for m in range(6):
                w[m] = 0.0
                for a_ in range(shape.shape[1]):
                    w[m] += shape[m, a_] * pushed[row, a_]
        else:
            continue  # of a sensor: no force
        slope = 1.0
        if transform == LOG:
            slope = math.exp(theta[c])
        elif kind == IN_LAG:  # `pushed` is by its logarithm
            slope = 1.0 / max(theta[c], 1e-3)
        for m in range(6):
            w[m] *= slope
        _by_mass(p, A, N_FIXED + c, w)


@kernel
def step_and_linearise(
    p: Array,
    x: Array,
    tau: Array,
    disturbance: Array,
    current: Array,
    h: float,
    fade: float,
    codes: Codes,
    theta: Array,
    shape: Array,
    pushed: Array,
    F: Array,
    A: Array,
    work: Array,
    scratch: Array,
) -> None:
    """Advance the state x (13,) by h [s] in place and write the step's matrix F (12, 21 + n).

    Args:
        tau: mean wrench over the step (6,). disturbance: mean acceleration (6,) beside it. current: (3,) NED.
        fade: 1/T of the disturbance [1/s].
        A: scratch (12, 21 + n). work: scratch (5, 13). scratch: (12, 6) at least.
        Others as `linearise_into`.
    """
    middle, rate, wrench = work[3], work[4], scratch[:3]
    for j in range(6):
        total = tau[j]
        for k in range(6):
            total += p[I_MASS + 6 * j + k] * disturbance[k]
        for s in range(3):
            wrench[s, j] = total
    for i in range(N_STATES):
        middle[i] = x[i]
    extra = has_extra_terms(p.reshape(p.shape[0], 1))
    step_of_one_into(p, x, wrench, current, h, work[:3], True, extra)
    for i in range(N_STATES):
        middle[i] = 0.5 * (middle[i] + x[i])
    stage_of_one_into(p, middle, wrench[0], current, rate, True)
    for j in range(6):
        rate[7 + j] -= disturbance[j]
    linearise_into(p, middle, rate, codes, theta, shape, pushed, A, scratch[4:6])
    columns = A.shape[1]
    half = 0.5 * h * h
    for i in range(N_MOVING):
        for j in range(columns):
            F[i, j] = h * A[i, j]
        for j in range(_DIST, _CURRENT):
            F[i, j] -= half * fade * A[i, j]
        for k in range(3, N_MOVING):
            a = half * A[i, k]
            if a != 0.0:
                for j in range(3, columns):
                    F[i, j] += a * A[k, j]
        F[i, i] += 1.0
