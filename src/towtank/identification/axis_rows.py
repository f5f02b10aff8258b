"""Exact increments of the six axis regressions over one sample interval.

Row i holds the integrals over the interval of [nu_i, |nu_i| nu_i, r_i(k), 1, F_i] and the left-hand side
nu_i(end) - nu_i(start); F_i is the wrench less C(nu) nu, less the off-diagonal inertia, plus off-diagonal damping and
the restoring terms that are no column of their own, all from the model as known so far. See `identification.axes`.

Functions of the state are integrated by the trapezoid with end correction (`core.filtered.hermite_increment`). The
slopes at the two ends come from the mean acceleration over the interval, which is measured, and its change within the
interval, which the model gives; a wrong model costs O(h^3) only.
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.filtered import hermite_increment
from towtank.core.inertia import bilinear_coriolis_into
from towtank.core.layout import I_CONSTANT, I_LINEAR, I_MASS, I_MASS_INVERSE, I_MOMENT, I_QUADRATIC, I_WEIGHT
from towtank.identification.axes import C_CONSTANT, C_FORCE, C_LHS, C_LINEAR, C_QUADRATIC, C_RESTORING

__all__ = ["axis_increments_into"]


@inlined_kernel
def _state_force_into(p: Array, mass: Array, nu: Array, k: Array, out: Array) -> None:
    """Write -C(nu) nu + off-diagonal damping + restoring terms without a column, (6,)."""
    bilinear_coriolis_into(mass, nu, nu, out)
    for i in range(6):
        out[i] = -out[i]
        for j in range(6):
            if j != i:
                out[i] += (p[I_LINEAR + 6 * i + j] + p[I_QUADRATIC + 6 * i + j] * math.fabs(nu[j])) * nu[j]
    out[0] += p[I_WEIGHT] * k[0]
    out[1] += p[I_WEIGHT] * k[1]
    out[2] += p[I_CONSTANT + 2]
    out[3] += p[I_MOMENT + 1] * k[2]
    out[4] -= p[I_MOMENT] * k[2]
    out[5] += p[I_MOMENT] * k[1] - p[I_MOMENT + 1] * k[0]


@inlined_kernel
def _state_force_slope_into(
    p: Array, mass: Array, nu: Array, nu_dot: Array, k_dot: Array, work: Array, out: Array
) -> None:
    """Write the time derivative of `_state_force_into` (6,) along nu_dot and k_dot."""
    bilinear_coriolis_into(mass, nu_dot, nu, out)
    bilinear_coriolis_into(mass, nu, nu_dot, work)
    for i in range(6):
        out[i] = -out[i] - work[i]
        for j in range(6):
            if j != i:
                gain = p[I_LINEAR + 6 * i + j] + 2.0 * p[I_QUADRATIC + 6 * i + j] * math.fabs(nu[j])
                out[i] += gain * nu_dot[j]
    out[0] += p[I_WEIGHT] * k_dot[0]
    out[1] += p[I_WEIGHT] * k_dot[1]
    out[3] += p[I_MOMENT + 1] * k_dot[2]
    out[4] -= p[I_MOMENT] * k_dot[2]
    out[5] += p[I_MOMENT] * k_dot[1] - p[I_MOMENT + 1] * k_dot[0]


@inlined_kernel
def _restoring_column(k: Array, axis: int) -> float:
    """Return r(k) of an axis for the gravity direction k (3,), or its slope for k_dot."""
    r: float = 0.0
    if axis == 2:
        r = k[2]
    elif axis == 3:
        r = -k[1]
    elif axis == 4:
        r = k[0]
    return r


@inlined_kernel
def _turning_into(k: Array, nu: Array, out: Array) -> None:
    """Write k_dot = k x omega (3,)."""
    p, q, r = nu[3], nu[4], nu[5]
    out[0] = k[1] * r - k[2] * q
    out[1] = k[2] * p - k[0] * r
    out[2] = k[0] * q - k[1] * p


@kernel
def axis_increments_into(
    p: Array, nu: Array, k: Array, wrench: Array, slope: Array, h: float, work: Array, out: Array
) -> None:
    """Write the increments of all axes over one interval into `out` (6, 6), a row an axis.

    Args:
        p: kernel parameters (154,) as known so far.
        nu: velocity (2, 6) at the start and the end of the interval, 0 where not measured.
        k: gravity direction (2, 3) there.
        wrench: integral of the wrench over the interval (6,).
        slope: rate of change of the wrench within the interval (6,), 0 where commands are held.
        h: the interval's length [s].
        work: scratch (12, 6).
    """
    mass = p[I_MASS:I_MASS_INVERSE].reshape(6, 6)
    mean, middle, jerk, dk = work[0], work[1], work[2], work[3]
    f0, f1, s0, s1, spare = work[4], work[5], work[6], work[7], work[8]
    a0, a1, middle_k = work[9], work[10], work[11]
    for i in range(6):
        mean[i] = (nu[1, i] - nu[0, i]) / h
        middle[i] = 0.5 * (nu[0, i] + nu[1, i])
    for i in range(3):
        middle_k[i] = 0.5 * (k[0, i] + k[1, i])
    # Change of the acceleration within the interval: M jerk = d/dt (wrench and all that depends on the state).
    _turning_into(middle_k, middle, dk)
    _state_force_slope_into(p, mass, middle, mean, dk, spare, f0)
    for i in range(6):
        f0[i] += slope[i] + (p[I_LINEAR + 7 * i] + 2.0 * p[I_QUADRATIC + 7 * i] * math.fabs(middle[i])) * mean[i]
    f0[2] += p[I_WEIGHT] * dk[2]
    f0[3] -= p[I_MOMENT + 2] * dk[1]
    f0[4] += p[I_MOMENT + 2] * dk[0]
    for i in range(6):
        jerk[i] = 0.0
        for j in range(6):
            jerk[i] += p[I_MASS_INVERSE + 6 * i + j] * f0[j]
        a0[i] = mean[i] - 0.5 * h * jerk[i]
        a1[i] = mean[i] + 0.5 * h * jerk[i]

    _state_force_into(p, mass, nu[0], k[0], f0)
    _state_force_into(p, mass, nu[1], k[1], f1)
    _turning_into(k[0], nu[0], dk)
    _state_force_slope_into(p, mass, nu[0], a0, dk, spare, s0)
    for i in range(6):
        out[i, C_RESTORING] = _restoring_column(dk, i)
    _turning_into(k[1], nu[1], dk)
    _state_force_slope_into(p, mass, nu[1], a1, dk, spare, s1)
    for i in range(6):
        v0, v1 = nu[0, i], nu[1, i]
        out[i, C_LINEAR] = hermite_increment(v0, v1, a0[i], a1[i], h)
        out[i, C_QUADRATIC] = hermite_increment(
            math.fabs(v0) * v0, math.fabs(v1) * v1, 2.0 * math.fabs(v0) * a0[i], 2.0 * math.fabs(v1) * a1[i], h
        )
        r0, r1, slope1 = _restoring_column(k[0], i), _restoring_column(k[1], i), _restoring_column(dk, i)
        out[i, C_RESTORING] = hermite_increment(r0, r1, out[i, C_RESTORING], slope1, h)
        out[i, C_CONSTANT] = h if i != 2 else 0.0
        out[i, C_FORCE] = wrench[i] + hermite_increment(f0[i], f1[i], s0[i], s1[i], h)
        for j in range(6):
            if j != i:
                out[i, C_FORCE] -= mass[i, j] * (nu[1, j] - nu[0, j])
        out[i, C_LHS] = v1 - v0
