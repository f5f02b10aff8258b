"""The joint filter over a stream: rows of measurements and commands in the order of time, a log's as a live link's.

Between measurements the motion goes on under the inputs, and its covariance, P <- F P F^T + Q.

The motion is linearised about fixed coefficients and a fixed current, and the filter is linear in their distance from
them, so that a wide prior cannot lead it off: early and wild estimates act to first order only, and what the filter
takes the current for on its way does not change what it takes the coefficients to do.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import quaternion_from_euler, row_of_rotation
from towtank.core.forces import add_inflow_damping_into, pull_into
from towtank.core.layout import I_INFLOW, I_LINEAR, I_MASS_INVERSE
from towtank.core.zero_order_hold import ZeroOrderHold, forces_now_into, hold_force, mean_forces_into
from towtank.identification.data.samples import Samples
from towtank.identification.kalman.state import INFORMATION_MEMORY, JointState
from towtank.identification.kalman.update import expect, product_of_rows, to_linearised_current, update, update_row
from towtank.identification.model.linearisation import step_and_linearise, turn_by
from towtank.identification.model.measurements import ATTITUDE, N_SENSORS, NEVER, SPEEDS
from towtank.identification.model.parameters import IN_GAIN, N_FIXED, N_MOVING
from towtank.vehicle.matrices import GRAVITY

__all__ = ["joint_events", "joint_step", "rows_of", "take_all", "take_row"]

_DIST = 12
_LIFT = 7  # rows of the scratch
_TINY = 1e-30  # m^2/s^4
_ATTITUDE_MEMORY = 30.0  # s: of the bias of an attitude that wanders
_START = (0.3, 0.2, 0.3, 0.2)  # m, rad, m/s, rad/s: deviations at the start where a sensor has shown nothing
_TURNING = 1.0  # rad/s: of rates that the next attitudes tell: a stretch may begin in full motion
_UNKNOWN_POSITION = 100.0  # m^2: variance of it
_ANSWERED = 0.5  # s after which thrusters have forgotten what they did before the first command
_SHOWN = 1.0  # s for which a start waits for a speed that is measured: drag at another tells wrongly of all else
_JUST_NOW = 0.06  # s: a speed that is no older is good enough to begin with,
_SINCE = 0.05  # m/s: off by what the vehicle has gained since, as a deviation


class Rows(NamedTuple):
    """Rows of measurements and inputs: times (n,) [s], values (n, 18), input stamps (k,) [s] and forces (k, m)."""

    t: Array
    values: Array
    input_t: Array
    input_force: Array


def rows_of(samples: Samples) -> Rows:
    """Return the rows and inputs of samples as kernels take them: views of another kind would be compiled for anew."""
    arrays = (samples.t, samples.values, samples.input_t, samples.input_force)
    return Rows(*(np.require(array, np.float64, ("C", "W")) for array in arrays))


@kernel
def input_wrench_into(state: JointState, force: Array) -> None:
    """Write the wrench of the inputs' forces (m,) into `state.tau`, gains at the linearisation point."""
    m = state.B.shape[1]
    for i in range(6):
        s = 0.0
        for j in range(m):
            s += state.B[i, j] * force[j]
        state.tau[i] = s
    for c in range(state.theta.shape[0]):
        if state.codes[c, 0] == IN_GAIN:
            j = state.codes[c, 1]
            more = math.exp(state.linearised_at[c]) - 1.0
            for i in range(6):
                state.tau[i] += more * state.B[i, j] * force[j]


@kernel
def _off_linearisation(state: JointState) -> None:
    """Add to the motion what the coefficients' distance from their linearisation point does, to first order."""
    x, F = state.x, state.F
    n = state.theta.shape[0]
    ex = ey = ez = 0.0
    for c in range(n):
        away = state.theta[c] - state.linearised_at[c]
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
def _from_linearised_current(state: JointState) -> None:
    """Go back, after a step, to the current that is estimated: to first order, as coefficients count."""
    x, F, away, moved = state.x, state.F, state.away, state.dx
    if away[3] == 0.0 and away[4] == 0.0 and away[5] == 0.0:
        return
    for i in range(N_MOVING):
        for k in range(3):
            moved[i] += F[i, 18 + k] * away[3 + k] - F[i, 6 + k] * away[k]
    for i in range(3):
        x[i] += moved[i]
        state.water[i] += away[3 + i]
    for i in range(6):
        x[7 + i] += moved[6 + i]
        for k in range(3):
            state.rate[i] += state.A[6 + i, 18 + k] * away[3 + k] - state.A[6 + i, 6 + k] * away[k]
    turn_by(x, moved[3], moved[4], moved[5])
    moved[:] = 0.0


@kernel
def _lift_into(state: JointState, total: Array) -> None:
    """Add to the acceleration (6,) of the body what water does that waves accelerate: gravity along -dv_w/dt.

    What accelerates the displaced water acts at the centre of buoyancy, the body's inertia at that of gravity
    (Fossen 2021, section 10.2), of the coefficients that the motion is linearised about. In m/s^2 and rad/s^2, FRD.
    Writes, too, what a quadrature of 1 m/s along each axis of NED does, (3, 6).
    """
    p, share, each = state.p, state.settings[0].wave_frequency / GRAVITY, state.scratch[_LIFT : _LIFT + 3]
    wrench = state.scratch[_LIFT + 3]
    for j in range(3):
        a, b, c = row_of_rotation(state.x[3:7], j)
        pull_into(p, share * a, share * b, share * c, wrench)
        for i in range(6):
            each[j, i] = 0.0
            for k in range(6):
                each[j, i] += p[I_MASS_INVERSE + 6 * i + k] * wrench[k]
            total[i] += each[j, i] * state.wave[3 + j]


@kernel
def _product_into(F: Array, P: Array, out: Array) -> None:
    np.dot(F, P, out)


@kernel
def _covariance(state: JointState, h: float) -> None:
    P, F, W = state.P, state.F, state.W
    columns, size = F.shape[1], P.shape[0]
    fade = math.exp(-h / state.settings[0].time_constant)
    waves = state.settings[0].waves > 0.0
    _product_into(F, P[:columns], W)
    if waves:
        for i in range(N_MOVING):  # the water of waves moves a vehicle as a current does
            for k in range(3):
                f = F[i, 18 + k]
                if f != 0.0:
                    for j in range(size):
                        W[i, j] += f * P[size - 6 + k, j]
                if i >= 6:
                    f = h * state.scratch[_LIFT + k, i - 6]
                    for j in range(size):
                        W[i, j] += f * P[size - 3 + k, j]
    for i in range(N_MOVING):
        for j in range(i, N_MOVING):
            P[i, j] = product_of_rows(W, i, F, j, columns)
            if waves:
                for k in range(3):
                    P[i, j] += W[i, size - 6 + k] * F[j, 18 + k]
                    if j >= 6:
                        P[i, j] += W[i, size - 3 + k] * h * state.scratch[_LIFT + k, j - 6]
        for j in range(N_MOVING, size):
            P[i, j] = W[i, j]
        for j in range(_DIST, _DIST + 6):
            P[i, j] *= fade
        for j in range(i + 1, size):
            P[j, i] = P[i, j]
    for i in range(_DIST, _DIST + 6):
        for j in range(N_MOVING, size):
            P[i, j] *= fade
    for j in range(_DIST, _DIST + 6):
        for i in range(N_MOVING, size):
            P[i, j] *= fade
    _noise(state, h, fade)
    if state.settings[0].biases > 0.0 and state.settings[0].attitude_bias[2] > 0.0:
        _attitude_bias(state, h)
    if state.settings[0].waves > 0.0:
        _waves(state, h)


@kernel
def _attitude_bias(state: JointState, h: float) -> None:
    """Let the bias of the attitude fade over a step."""
    P, first = state.P, N_FIXED + state.theta.shape[0] + 6
    fade = math.exp(-h / _ATTITUDE_MEMORY)
    for i in range(first, first + 3):
        state.bias[i - first + 6] *= fade
        for j in range(P.shape[0]):
            P[i, j] *= fade
        for j in range(P.shape[0]):
            P[j, i] *= fade
        P[i, i] += state.settings[0].attitude_bias[i - first] ** 2 * (1.0 - fade * fade)


@kernel
def _waves(state: JointState, h: float) -> None:
    """Let the water in waves go on over a step: each axis turns in its complex plane, and fades."""
    P, wave, settings = state.P, state.wave, state.settings[0]
    size = P.shape[0]
    fade = math.exp(-h * settings.wave_decay)
    c, s = fade * math.cos(settings.wave_frequency * h), fade * math.sin(settings.wave_frequency * h)
    for k in range(3):
        own = state.wave_statistics[k]
        own.time += h
        own.square += h * wave[k] ** 2
        own.variance += h * P[size - 6 + k, size - 6 + k]
        a, b = size - 6 + k, size - 3 + k
        wave[k], wave[3 + k] = c * wave[k] - s * wave[3 + k], s * wave[k] + c * wave[3 + k]
        for j in range(size):
            P[a, j], P[b, j] = c * P[a, j] - s * P[b, j], s * P[a, j] + c * P[b, j]
        for j in range(size):
            P[j, a], P[j, b] = c * P[j, a] - s * P[j, b], s * P[j, a] + c * P[j, b]
        P[b, a] = P[a, b]  # to the last bit
        more = state.wave_level[k] ** 2 * (1.0 - fade * fade)
        P[a, a] += more
        P[b, b] += more
        state.water[k] = state.current[k] + wave[k]


@kernel
def _noise(state: JointState, h: float, fade: float) -> None:
    P = state.P
    for i in range(6):
        P[_DIST + i, _DIST + i] += state.disturbance[i] ** 2 * (1.0 - fade * fade)
        P[6 + i, 6 + i] += state.velocity_walk[i] ** 2 * h
    for i in range(3):
        P[18 + i, 18 + i] += state.settings[0].current_walk * h
    n = state.theta.shape[0]
    if state.settings[0].biases > 0.0:
        for i in range(6):
            P[N_FIXED + n + i, N_FIXED + n + i] += state.settings[0].bias_walk * h


@kernel
def _adapt_disturbance(state: JointState, h: float) -> None:
    """Count E[d^2] of each axis, and adapt the disturbance's level to it where that is set."""
    settings = state.settings[0]
    adapt = settings.adapt
    for i in range(6):
        variance = state.P[_DIST + i, _DIST + i]
        power = state.force[i] ** 2 + variance
        own = state.disturbance_statistics[i]
        own.time += h
        own.square += h * state.force[i] ** 2
        own.variance += h * variance
        left = 1.0 - variance / max(state.disturbance[i] ** 2, _TINY)
        if 0.0 < left < 1.0:  # what is old of it by tau has a variance of 1 - exp(-2 tau / T)
            own.effective_samples += h / max(-0.5 * settings.time_constant * math.log(left), h)
        if adapt > 0.0:
            floor = settings.floor_force if i < 3 else settings.floor_moment
            now = state.disturbance[i] ** 2
            now += (power - now) * min(1.0, h / adapt)
            state.disturbance[i] = max(math.sqrt(now), floor)


@kernel
def _choose_active(state: JointState, h: float) -> None:
    """Leave coefficients out of the update that hardly learn any more, and take in those that would learn again.

    One that learns at a steady rate gains 1 / T per second after T seconds. What one that gains a small share of that
    still learns is what the model of disturbances lacks: it would only wander.
    """
    share = state.settings[0].considered_share
    fade = math.exp(-h / INFORMATION_MEMORY)
    for c in range(state.theta.shape[0]):
        information_time = state.information_time[c]
        state.information_rate[c] *= fade
        is_considered = state.learns[c] == 0.0 or (
            information_time > INFORMATION_MEMORY
            and state.information_rate[c] * information_time < share * INFORMATION_MEMORY
        )
        state.active[N_FIXED + c] = 0.0 if is_considered else 1.0
        if not is_considered:
            state.information_time[c] = information_time + h


@kernel
def _with_inflow(state: JointState) -> None:
    """Add to the linear damping what the thrusters lose by the water through them, at the last step's forces."""
    if state.p[I_INFLOW] != 0.0:
        _without_inflow(state)
        state.linear[0] = 1.0
        for i in range(36):
            state.linear[1 + i] = state.p[I_LINEAR + i]
        add_inflow_damping_into(state.B, state.mean_force[0], state.p[I_INFLOW], state.p)


@kernel
def _without_inflow(state: JointState) -> None:
    """Take back what `_with_inflow` has added."""
    if state.linear[0] > 0.0:
        for i in range(36):
            state.p[I_LINEAR + i] = state.linear[1 + i]
        state.linear[0] = 0.0


@kernel
def predict(state: JointState, held: ZeroOrderHold, t: float) -> bool:
    """Advance the filter to the time t [s]; return whether the inputs are known."""
    clock = state.clock[0]
    span = t - clock.time
    steps = max(1, math.ceil(span / state.settings[0].step - 1e-9))
    h = span / steps
    T = state.settings[0].time_constant
    fade = math.exp(-h / T)
    mean = (1.0 - fade) * T / h
    total = state.scratch[11]
    for k in range(steps):
        end = t if k == steps - 1 else clock.time + h
        if not mean_forces_into(held, end, state.mean_force):
            return False
        input_wrench_into(state, state.mean_force[0])
        for i in range(6):
            total[i] = mean * state.force[i]
        if state.settings[0].waves > 0.0:
            _lift_into(state, total)
        _with_inflow(state)
        to_linearised_current(state)
        step_and_linearise(
            state.p,
            state.x,
            state.tau,
            total,
            state.water,
            h,
            1.0 / T,
            state.codes,
            state.linearised_at,
            state.B,
            state.mean_force,
            state.F,
            state.A,
            state.work,
            state.scratch,
        )
        for i in range(6):
            state.rate[i] = state.work[4, 7 + i] + total[i]
        _from_linearised_current(state)
        _off_linearisation(state)
        _covariance(state, h)
        for i in range(6):
            state.force[i] *= fade
        _adapt_disturbance(state, h)
        _choose_active(state, h)
        clock.time = end
        clock.duration += h
    forces_now_into(held, state.mean_force)  # an accelerometer feels the forces of now,
    input_wrench_into(state, state.mean_force[0])  # and tells of coefficients by the same
    _with_inflow(state)
    return True


@kernel
def begin_motion(state: JointState, held: ZeroOrderHold, t: float, z: Array) -> None:
    """Begin the motion at the time t [s] with z (18,) as shown last; coefficients, biases, current stay as they are."""
    x, P = state.x, state.P
    P[:18] = 0.0
    P[:, :18] = 0.0
    for i in range(3):
        x[i] = z[i] if math.isfinite(z[i]) else 0.0
        P[i, i] = _START[0] ** 2 if math.isfinite(z[i]) else _UNKNOWN_POSITION
    phi, theta, psi = z[3], z[4], z[5]
    if not (math.isfinite(phi) and math.isfinite(theta)):
        phi, theta = 0.0, 0.0
        if math.isfinite(z[12]) and math.isfinite(z[13]) and math.isfinite(z[14]) and z[14] < -0.3 * GRAVITY:
            phi = math.atan2(-z[13], -z[14])
            theta = math.atan2(z[12], math.hypot(z[13], z[14]))
    if not math.isfinite(psi):
        psi = 0.0
    x[3], x[4], x[5], x[6] = quaternion_from_euler(phi, theta, psi)
    turned = math.isfinite(z[3]) and math.isfinite(z[4]) and math.isfinite(z[5])
    for i in range(3):
        P[3 + i, 3 + i] = _START[1] ** 2
        speed = math.nan
        for sensor in SPEEDS:
            speed = speed if math.isfinite(speed) else z[3 * sensor + i]
        x[7 + i] = speed if math.isfinite(speed) else 0.0
        P[6 + i, 6 + i] = _START[2] ** 2
        measured = math.isfinite(z[9 + i])
        x[10 + i] = z[9 + i] - state.bias[i] if measured else 0.0
        P[9 + i, 9 + i] = (_TURNING if turned and not measured else _START[3]) ** 2
    for i in range(6):
        state.force[i] = 0.0
        state.rate[i] = 0.0
        P[12 + i, 12 + i] = state.disturbance[i] ** 2
    state.dx[:] = 0.0
    for k in range(N_SENSORS):
        state.last_accepted[k] = t if k != ATTITUDE or math.isfinite(z[5]) else NEVER
        state.outages[k].rejected = 0.0
        for i in range(3):
            state.outages[k].seen[i] = NEVER
    for j in range(6, 12):
        state.statistics[j].has_last = 0.0  # a speed of before the pause is no neighbour
    mean_forces_into(held, t, state.mean_force)
    forces_now_into(held, state.mean_force)
    input_wrench_into(state, state.mean_force[0])
    state.clock[0].time = t
    state.clock[0].started = 1.0


@kernel
def _inputs_known(held: ZeroOrderHold, t: float) -> bool:
    """Return whether the thrusters' force follows at t [s] from the commands that came.

    There may have been others before the first, which are not known: a log may be cut out of a longer one. A wrench has
    no lag.
    """
    received, ring = int(held.counters[0].received), held.times.shape[0]
    slow = False
    for j in range(held.lag.shape[0]):
        slow = slow or held.lag[j] > 0.0
    return received > 0 and (received > ring or not slow or t - held.times[0] + held.delay[0] > _ANSWERED)


@kernel
def _shows_speed(z: Array) -> bool:
    shown = False
    for sensor in SPEEDS:
        shown = shown or (math.isfinite(z[3 * sensor]) and math.isfinite(z[3 * sensor + 1]))
    return shown


@kernel
def _take_last_speeds(state: JointState, z: Array) -> None:
    """Take the speeds [m/s] that were shown just before the row z (18,): less sure, by what has been gained since.

    Over ground or through the water, FRD, as the row itself would show them; nothing has passed since the last ones.
    """
    state.clock[0].since_accepted = 0.0
    for sensor in SPEEDS:
        first, whole, again = 3 * sensor, True, False
        for k in range(first, first + 3):
            whole = whole and math.isfinite(state.shown[k])
            again = again or math.isfinite(z[k])
        if again or not math.isfinite(state.shown[first]):
            continue
        sure = state.noise[first], state.noise[first + 1], state.noise[first + 2]
        for k in range(3):
            state.noise[first + k] = math.hypot(sure[k], _SINCE)
        expect(state, state.shown, sensor, whole)
        update(state, state.shown, sensor)
        for k in range(3):
            state.noise[first + k] = sure[k]


@kernel
def joint_step(state: JointState, held: ZeroOrderHold, t: float, z: Array) -> bool:
    """Take the row z (18,) of time t [s]; return whether it was of use: in order, and the inputs known."""
    clock = state.clock[0]
    now = clock.time
    started = clock.started > 0.0
    if started and not t > now:
        return False
    if not started or t - now > state.settings[0].gap:
        if clock.started >= 0.0 or not 0.0 <= t - clock.waited <= state.settings[0].gap:
            clock.started, clock.waits_from, state.shown[:] = -1.0, t, math.nan
        clock.waited = t
        for k in range(z.shape[0]):
            state.shown[k] = z[k] if math.isfinite(z[k]) else state.shown[k]
        shows_speed = _shows_speed(state.shown if t - clock.waits_from < _JUST_NOW else z)
        clock.speeds = 1.0 if shows_speed else clock.speeds
        if shows_speed or clock.speeds == 0.0 or not t - clock.waits_from < _SHOWN:
            if _inputs_known(held, t):
                begin_motion(state, held, t, state.shown)
                if t - clock.waits_from < _JUST_NOW:
                    _take_last_speeds(state, z)
                update_row(state, z)
            elif not t - clock.waits_from < _JUST_NOW:
                clock.waits_from = t
                for k in range(z.shape[0]):  # an assignment compiles a check of shapes, for seconds
                    state.shown[k] = z[k]
        return False
    if not predict(state, held, t):
        _without_inflow(state)
        clock.started = 0.0
        return False
    update_row(state, z)
    _without_inflow(state)
    clock.rows += 1.0
    return True


@kernel
def joint_events(state: JointState, held: ZeroOrderHold, rows: Rows, first: int, last: int, taken: int) -> int:
    """Take rows first .. last with the inputs that came by then, from the one numbered `taken` on; return the next."""
    for i in range(first, last):
        while taken < rows.input_t.shape[0] and rows.input_t[taken] <= rows.t[i]:
            hold_force(held, rows.input_t[taken], rows.input_force[taken])
            taken += 1
        joint_step(state, held, rows.t[i], rows.values[i])
    return taken


def take_all(state: JointState, held: ZeroOrderHold, samples: Samples) -> None:
    """Take all rows of samples and all inputs, those after the last row too."""
    hold_inputs(held, samples, joint_events(state, held, rows_of(samples), 0, len(samples), 0))


def hold_inputs(held: ZeroOrderHold, samples: Samples, first: int) -> None:
    """Take the inputs of samples from the one numbered `first` on: they came after the last row, act on the next."""
    for k in range(first, samples.input_t.size):
        hold_force(held, samples.input_t[k], samples.input_force[k])


def take_row(state: JointState, held: ZeroOrderHold, t: float, z: Array) -> bool:
    """Take the row z (18,) of time t [s], as `joint_step` does, by the code that is compiled for logs."""
    rows = Rows(np.array([t]), z.reshape(1, -1), np.empty(0), np.empty((0, held.values.shape[1])))
    before = state.clock["rows"][0]
    joint_events(state, held, rows, 0, 1, 0)
    return bool(state.clock["rows"][0] > before)
