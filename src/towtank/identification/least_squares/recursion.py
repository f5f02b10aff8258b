"""The recursion of the paper's method, one sample at a time: motion, exact increments, one filter on both sides, QR.

The same `paper_step` serves streaming and logs; `paper_events` is its loop. Nothing is allocated that lasts, and
nothing depends on how the samples arrived. Each axis keeps the square root of its information (QR) over ALL its
columns, so that which coefficients are free is decided when the estimate is read, and sums of row products over blocks
of time, from which the covariance that honours coloured residuals is built (`least_squares.solution`).

Row i of the regression holds the integrals over one sample interval of [nu_i, |nu_i| nu_i, r_i(k), 1, F_i] and the
left-hand side nu_i(end) - nu_i(start); F_i is the wrench less C(nu) nu, less the off-diagonal inertia, plus
off-diagonal damping, forward-speed terms and the restoring terms that are no column of their own, all from the model as
known so far; see `model.terms`. Functions of the state are integrated by the trapezoid with end correction
(`core.least_squares`). The slopes at the two ends come from the mean acceleration over the interval, which is
measured, and its change within the interval, which the model gives; a wrong model costs O(h^3) only.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.forces import add_extra_force_into, add_extra_rate_into
from towtank.core.inertia import bilinear_coriolis_into
from towtank.core.layout import I_CONSTANT, I_LINEAR, I_MASS, I_MASS_INVERSE, I_MOMENT, I_QUADRATIC, I_WEIGHT
from towtank.core.least_squares import accumulate_into, cubic_increment, hermite_increment
from towtank.core.zero_order_hold import ZeroOrderHold, force_integral_into, hold_force
from towtank.identification.least_squares.forgetting import absorb_row, forget_blocks
from towtank.identification.least_squares.state import N_BLOCKS, Instruments, PaperState, refresh_model
from towtank.identification.least_squares.velocity import ABSENT, Motion, MotionRows, motion_step
from towtank.identification.model.terms import (
    C_CONSTANT,
    C_FORCE,
    C_LHS,
    C_LINEAR,
    C_MASS,
    C_QUADRATIC,
    C_RESTORING,
    N_COLUMNS,
)

__all__: list[str] = []

_ROUNDING = 1e-6  # s, so that times that are equal but for rounding give equal blocks
_REFRESH = 0.25  # s between updates of the model that the couplings and the end corrections use
_FASTEST = 20.0  # m/s or rad/s, of a simulated instrument


@inlined_kernel
def _state_force_into(p: Array, mass: Array, nu: Array, k: Array, out: Array) -> None:
    """Write -C(nu) nu + off-diagonal damping + extra terms + restoring terms without a column, (6,)."""
    bilinear_coriolis_into(mass, nu, nu, out)
    for i in range(6):
        out[i] = -out[i]
        for j in range(6):
            if j != i:
                out[i] += (p[I_LINEAR + 6 * i + j] + p[I_QUADRATIC + 6 * i + j] * math.fabs(nu[j])) * nu[j]
    add_extra_force_into(p, nu, 1.0, out)
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
    add_extra_rate_into(p, nu, nu_dot, out)
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
        p: kernel parameters (170,) as known so far.
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


@inlined_kernel
def _drive_instruments(own: Instruments, axis: int, row: Array, h: float, decay: float) -> None:
    """Advance the velocity that the commands alone would give, and its filtered columns."""
    linear, quadratic, rest, constant, mass = (
        own.driven[axis, C_LINEAR],
        own.driven[axis, C_QUADRATIC],
        own.driven[axis, C_RESTORING],
        own.driven[axis, C_CONSTANT],
        own.driven[axis, C_MASS],
    )
    force = (row[C_FORCE] + rest * row[C_RESTORING] + constant * row[C_CONSTANT]) / h
    x0 = own.velocity[axis]
    f0 = (force + (linear + quadratic * math.fabs(x0)) * x0) / mass
    xm = x0 + 0.5 * h * f0
    x1 = x0 + h * (force + (linear + quadratic * math.fabs(xm)) * xm) / mass
    x1 = min(max(x1, -_FASTEST), _FASTEST)
    own.velocity[axis] = x1
    own.linear[axis] = decay * own.linear[axis] + 0.5 * h * (x0 + x1)
    own.quadratic[axis] = decay * own.quadratic[axis] + 0.5 * h * (math.fabs(x0) * x0 + math.fabs(x1) * x1)


@inlined_kernel
def _merge_blocks(state: PaperState) -> None:
    """Add neighbouring blocks of time, which makes room for as many again of twice the length."""
    half = N_BLOCKS // 2
    for axis in range(6):
        for b in range(half):
            for i in range(N_COLUMNS * N_COLUMNS):
                state.blocks[axis, b, i] = state.blocks[axis, 2 * b, i] + state.blocks[axis, 2 * b + 1, i]
        for b in range(half, N_BLOCKS):
            for i in range(N_COLUMNS * N_COLUMNS):
                state.blocks[axis, b, i] = 0.0
    state.clock.block[0] = float(half)
    state.clock.block_length[0] *= 2.0


@kernel
def _learn_interval(state: PaperState, motion: Motion, h: float) -> None:
    """Absorb one interval of length h [s] whose ends are in `motion` and whose wrench integral is `state.pending`."""
    settings, clock, instruments = state.settings, state.clock, state.instruments
    rows, z, g, wrench = state.scratch.rows, state.scratch.z, state.scratch.g, state.pending
    axis_increments_into(state.p, motion.nu, motion.k, wrench, state.slope, h, state.scratch.increments, rows)
    decay = math.exp(-settings.a * h)
    block = int(clock.block[0])
    for axis in range(6):
        if motion.source[axis] == ABSENT:
            continue
        if motion.valid[0, axis] == 0.0 or motion.valid[1, axis] == 0.0:
            _restart_axis(state, axis, motion.nu[1, axis])
            continue
        accumulate_into(state.filtered[axis], rows[axis], decay, N_COLUMNS)
        state.commanded[axis] += wrench[axis] ** 2 / h
        state.forced[axis] += rows[axis, C_FORCE] ** 2 / h
        for i in range(N_COLUMNS):
            z[i] = state.filtered[axis, i]
            g[i] = z[i]
        if settings.instruments and instruments.driven[axis, C_MASS] > 0.0:
            _drive_instruments(instruments, axis, rows[axis], h, decay)
            instruments.squared_error[axis] += h * (instruments.velocity[axis] - motion.nu[1, axis]) ** 2
            g[C_LINEAR] = instruments.linear[axis]
            g[C_QUADRATIC] = instruments.quadratic[axis]
        absorb_row(state, axis, g, z, block)
    forget_blocks(state, block)
    clock.block_time[0] += h
    clock.since_refresh[0] += h
    clock.learned[0] += h
    clock.rows[0] += 1.0
    clock.rows_left[0] = settings.forgetting * clock.rows_left[0] + 1.0
    if clock.block_time[0] >= clock.block_length[0] - _ROUNDING:
        clock.block_time[0] = 0.0
        clock.block[0] += 1.0
        if clock.block[0] >= N_BLOCKS:
            _merge_blocks(state)
    if clock.since_refresh[0] >= _REFRESH - _ROUNDING and settings.learn_model:
        clock.since_refresh[0] = 0.0
        refresh_model(state)


@inlined_kernel
def _smooth_input(state: PaperState, command: Array, h: float) -> None:
    """Put the integral of the cubic through the last four wrenches (equal spacing) in place of the held one."""
    recent = state.recent
    for i in range(6):
        recent[0, i], recent[1, i], recent[2, i] = recent[1, i], recent[2, i], recent[3, i]
        recent[3, i] = 0.0
        for j in range(command.shape[0]):
            recent[3, i] += state.shape[i, j] * command[j]
        state.slope[i] = (recent[3, i] - recent[2, i]) / h
        state.pending[i] = cubic_increment(recent[0, i], recent[1, i], recent[2, i], recent[3, i], h)


@inlined_kernel
def _restart_axis(state: PaperState, axis: int, velocity: float) -> None:
    """Begin a new stretch of one axis: the filters from zero, the instruments from the measured velocity."""
    for i in range(N_COLUMNS):
        state.filtered[axis, i] = 0.0
    state.instruments.velocity[axis] = velocity
    state.instruments.linear[axis] = 0.0
    state.instruments.quadratic[axis] = 0.0


@kernel
def paper_step(
    state: PaperState,
    motion: Motion,
    held: ZeroOrderHold,
    t: float,
    pose: Array,
    velocity: Array,
    acceleration: Array,
    command: Array,
) -> float:
    """Take one sample at time t [s]; NaN where a quantity was not measured.

    Args:
        pose: x y z phi theta psi (6,). velocity: u v w p q r (6,). acceleration: specific force (3,).
        command: steady force of each held input (m,) asked for from t on.

    Returns:
        Length [s] of the interval that was learned from, 0 where none was.
    """
    if not math.isfinite(t):
        return 0.0
    forces = state.scratch.forces
    known = force_integral_into(held, t, forces)
    hold_force(held, t, command)
    smooth, derived = state.settings.smooth, motion.corner > 0.0
    if smooth:
        since = t - motion.last.t[0]
        _smooth_input(state, command, since if since > 0.0 else 1.0)
    else:
        for i in range(6):
            for j in range(forces.shape[0]):
                state.pending[i] += state.shape[i, j] * forces[j]
    h = motion_step(motion, t, pose, velocity, acceleration, state.pending)
    if h < 0.0:
        return 0.0
    if smooth:
        for i in range(6):
            known = known and math.isfinite(state.pending[i])
        if not known:
            motion.counts.since_start[0] = 0.0
        known = known and motion.counts.since_start[0] > 2.0
    if h == 0.0 or not known:
        for i in range(6):
            state.pending[i] = 0.0
        if motion.counts.since_start[0] == 0.0:
            for axis in range(6):
                _restart_axis(state, axis, velocity[axis] if math.isfinite(velocity[axis]) else 0.0)
        return 0.0
    if derived:
        for i in range(6):
            state.pending[i] = 0.5 * h * (motion.wrench[0, i] + motion.wrench[1, i])
            state.slope[i] = 0.0
    _learn_interval(state, motion, h)
    for i in range(6):
        state.pending[i] = 0.0
    return h


@kernel
def paper_events(
    state: PaperState,
    motion: Motion,
    held: ZeroOrderHold,
    rows: MotionRows,
    stamps: Array,
    forces: Array,
    asked: Array,
) -> tuple[int, float]:
    """Take samples and held inputs (k, m) with time stamps (k,) of their own, in the order of their times.

    The same as `paper_step` for each; a smooth input needs its stamps to be the samples'. A stream has no stamps, but
    what is `asked` for with each sample (n, m), a log (0, m). Returns how many intervals taught, and the last's length.
    """
    t, pose, velocity, acceleration = rows
    used, event, length = 0, 0, 0.0
    nothing = np.full(held.force.shape[0], np.nan)
    smooth = state.settings.smooth
    for i in range(t.shape[0]):
        now = asked[i] if asked.shape[0] > 0 else nothing
        due = t[i] + 1e-3 * (t[i] - t[i - 1]) if smooth and i > 0 else t[i]
        while event < stamps.shape[0] and stamps[event] <= due:
            if smooth:
                now = forces[event]
            else:
                hold_force(held, stamps[event], forces[event])
            event += 1
        length = paper_step(state, motion, held, t[i], pose[i], velocity[i], acceleration[i], now)
        if length > 0.0:
            used += 1
    return used, length
