"""The joint filter at a measurement: what each sensor should show, whether it is accepted, and the update.

With G = P H^T and S = H G + R one number updates by dx += G nu / S, P -= G G^T with G / sqrt(S), which keeps the
covariance symmetric to the last bit. The three numbers of a sensor are gated at 4.5 deviations and rejected together,
else taken one after the other: each changes G, nu and S of the next, and P is lowered by all at once. An innovation
beyond the cap counts as if its sensor were so much worse: S grows until the innovation is at the cap (Huber). Errors
wait in dx until they are put into the state.

A coefficient that is considered but not updated has no gain, and P -= G G^T leaves out the block of those. The rest
of P still counts with their uncertainty (Schmidt's consider states), so that it stays true.

The accelerometer shows what the forces of the model do.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from towtank.core.arrays import Array, kernel, summing_kernel
from towtank.core.attitude import euler_from_quaternion, row_of_rotation, to_body
from towtank.core.rk4 import stage_of_one_into
from towtank.identification.model.linearisation import linearise_into, turn_by
from towtank.identification.model.measurements import (
    ATTITUDE,
    LONGEST_OUTAGE,
    LOOSE,
    N_SENSORS,
    NEVER,
    OFFSET_STAYS,
    POSITION,
    RATES,
    REACQUIRE,
    SPECIFIC_FORCE,
    VELOCITY,
    attitude_error,
    cosine_of_pitch,
    measurement_row_into,
    pace_of,
    residual_of,
    specific_force,
    specific_force_row_into,
    unit_error,
)
from towtank.identification.model.terms import N_FIXED

if TYPE_CHECKING:
    from towtank.identification.kalman.state import JointState


__all__ = ["inject"]

_CLIPPED_SQUARE = 25.0  # times S that an innovation^2 counts for at most in the score of a random walk
_NOISE_SHOWS = 5.0  # times R: below, S shows the sensor's noise
_NEIGHBOURS = 0.5  # s from one sample of a speed to the next, for the two to show the sensor's noise
_LEAST_SLOPE = 0.05  # s per s: of S by the walk's variance in the steady state
_NEAR = 3.0  # deviations of its noise within which a sensor has come back
_RETURNED = 8.0  # log likelihood ratio for a sensor that has come back, against one that is still off
_OFFSET_WEIGHT = 0.1  # least weight of a sample in the mean offset of a sensor that is rejected
_LAST = 0.3  # weight of the last sample in the mean of what the state does not follow
_BEGUN = 0.5  # s of a motion, before which nobody knows in which of two places it has begun
_NEXT = 0.06  # s from one sample of a pose to the next, for the two to show whether it has jumped
_MOST_REJECTED = 3.0  # samples of a sensor whose longest outage is over
_IMU, _DVL, _MARKER = range(3)  # rows of `state.place`, as sensors stand in `PLACED`
_UPRIGHT = math.sqrt(0.02)  # cosine of pitch, 8 degrees from 90, below which single Euler angles say nothing


@summing_kernel
def product_of_rows(A: Array, i: int, B: Array, j: int, size: int) -> float:
    """Return the sum of A[i, k] B[j, k] over k < size."""
    s = 0.0
    for k in range(size):
        s += A[i, k] * B[j, k]
    return s


@kernel
def look_ahead(state: JointState, column: int, residual: float) -> None:
    """Write G = P H^T, the innovation and its variance of a number into the state.

    Its H stands in a row of `state.H`, and `residual` is what it shows at dx = 0.
    """
    P, H, G = state.P, state.H, state.G
    row, size = column % 3, H.shape[1]
    G[row, :] = 0.0
    for k in range(size):
        h = H[row, k]
        if h != 0.0:
            residual -= h * state.dx[k]
            for j in range(size):
                G[row, j] += h * P[k, j]
    state.innovation[row] = residual
    state.variance[row] = product_of_rows(H, row, G, row, size) + state.noise[column] ** 2


@kernel
def update(state: JointState, z: Array, sensor: int) -> None:
    """Update by the numbers of a sensor that was looked ahead to, one after the other; P is lowered by all at once."""
    P, H, G, active = state.P, state.H, state.G, state.active
    size = G.shape[1]
    for row in range(3):
        nu, S = state.innovation[row], state.variance[row]
        for before in range(row):
            learned = considered = 0.0
            for k in range(size):
                if H[row, k] != 0.0:
                    learned += H[row, k] * active[k] * G[before, k]
                    considered += H[row, k] * (1.0 - active[k]) * G[before, k]
            nu -= learned * state.innovation[before]
            S -= learned * (learned + 2.0 * considered)
            for j in range(size):
                G[row, j] -= G[before, j] * (learned + active[j] * considered)
        if not (math.isfinite(z[3 * sensor + row]) and S > 0.0):  # not measured, or a motion that has diverged
            G[row, :] = state.innovation[row] = 0.0
            continue
        S = _weighed(state, 3 * sensor + row, nu, S)
        over = 1.0 / math.sqrt(S)
        for j in range(size):
            G[row, j] *= over
            state.dx[j] += active[j] * G[row, j] * nu * over
        state.innovation[row] = nu * over  # in its deviations
    for c in range(state.theta.shape[0]):
        i = N_FIXED + c
        if P[i, i] > 0.0:
            state.information_rate[c] += (G[0, i] ** 2 + G[1, i] ** 2 + G[2, i] ** 2) / P[i, i]
    for i in range(size):
        if active[i] > 0.0:
            for j in range(size):
                P[i, j] -= G[0, i] * G[0, j] + G[1, i] * G[1, j] + G[2, i] * G[2, j]
    for i in range(N_FIXED, N_FIXED + state.theta.shape[0]):
        if active[i] == 0.0:
            for j in range(size):
                if active[j] > 0.0:
                    P[i, j] = P[j, i]


@kernel
def _weighed(state: JointState, column: int, nu: float, S: float) -> float:
    """Count an innovation nu of variance S; return the variance that it is weighed with."""
    R = state.noise[column] ** 2
    away = math.fabs(nu) / math.sqrt(S)
    clock, own = state.clock[0], state.statistics[column]
    cap = state.settings[0].huber
    if S < _NOISE_SHOWS * R and away <= state.settings[0].gate:
        own.noise_samples += 1.0
        own.noise_sum += nu * nu - (S - R)
    own.nis_sum += nu * nu / S
    own.accepted += 1.0
    if 6 <= column < 12:
        count_speed(state, column, nu, S, (S - R) / (S * max(away / cap, 1.0)))
    if away > cap:
        clock.log_likelihood -= 0.5 * (math.log(S) + cap * (2.0 * away - cap))
        S *= away / cap
    else:
        clock.log_likelihood -= 0.5 * (math.log(S) + away * away)
    return S


@kernel
def count_speed(state: JointState, column: int, nu: float, S: float, gain: float) -> None:
    """Count what the innovation nu of a speed shows of the sensor's noise and of the velocity walk.

    With e the error before the sample and v its noise, nu = e + v, and the error at the next one is e - K nu + w. So
    (1 - K) nu^2 - nu nu' is v nu on average, R, whatever the gain K, and whatever the filter takes the walk for
    (Mehra 1970); one sample alone shows R and the walk only together. What a model that is off leaves is large, and
    alike from one sample to the next, so that R would come out negative: beyond the gate it does not count. Of a random
    walk of variance q per second behind a filter of gain K, the steady state has dS/dq = h / (K (2 - K)).
    """
    own, since = state.statistics[column], state.clock[0].since_accepted
    within = 1.0 if nu * nu <= state.settings[0].gate ** 2 * S else 0.0
    if within * own.has_last > 0.0 and since < _NEIGHBOURS:
        last = own.last_innovation
        own.neighbours += 1.0
        own.neighbour_sum += (1.0 - own.last_gain) * last * last - nu * last
    own.last_innovation, own.last_gain, own.has_last = nu, gain, within
    slope = since / max(gain * (2.0 - gain), _LEAST_SLOPE)
    own.steady_score += slope * (min(nu * nu, _CLIPPED_SQUARE * S) - S) / (S * S)
    own.steady_information += slope * slope / (S * S)


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
    if state.settings[0].biases > 0.0:
        for i in range(9):
            state.bias[i] += dx[N_FIXED + n + i]
    if state.settings[0].waves > 0.0:
        for i in range(6):
            state.wave[i] += dx[dx.shape[0] - 6 + i]
    for i in range(3):
        state.water[i] = state.current[i] + state.wave[i]
    dx[:] = 0.0


@kernel
def expect(state: JointState, z: Array, sensor: int, whole: bool) -> None:
    """Look ahead to the numbers of a sensor; H is zero where there is none."""
    n, size, water = state.theta.shape[0], state.P.shape[0], state.water
    waves = state.settings[0].waves > 0.0
    flows = waves or water[0] != 0.0 or water[1] != 0.0 or water[2] != 0.0 or state.P[18, 18] > 0.0
    state.H[:] = 0.0
    for k in range(3):
        h = state.H[k]
        if not math.isfinite(z[3 * sensor + k]):
            continue
        measurement_row_into(state.x, water, flows, sensor, k, whole, h)
        if state.settings[0].biases > 0.0:
            if sensor == RATES:
                h[N_FIXED + n + k] = 1.0
            elif sensor == ATTITUDE and (whole or k == 2):
                if k < 2:
                    h[N_FIXED + n + 6 + k] = 1.0
                h[N_FIXED + n + 8] = row_of_rotation(state.x[3:7], 2)[k] if whole else 1.0
        if waves and sensor == VELOCITY:
            for j in range(3):
                h[size - 6 + j] = h[18 + j]
        residual = residual_of(z, state.x, water, state.bias, sensor, k, whole)
        pace = 0.0
        if sensor == VELOCITY and state.place[_DVL, 0] >= 0:
            residual -= _speed_off_origin(state, k)
            pace = _across(state, state.rate[3:6], _DVL, k)
        elif sensor == POSITION and state.place[_MARKER, 0] >= 0:
            residual -= _position_off_origin(state, k)
            pace = _turned_with(state, k)
        column = state.latency[sensor]
        if column >= 0 and (whole or sensor != ATTITUDE):
            slope = pace + pace_of(state.x, water, state.rate, sensor, k)
            h[N_FIXED + column] = -slope
            residual += slope * (state.theta[column] - state.linearised_at[column])
        look_ahead(state, 3 * sensor + k, residual)


@kernel
def to_linearised_current(state: JointState) -> None:
    """Go over to the current that the motion is linearised about, as fast over ground: by `state.away` [m/s]."""
    away = state.away
    for k in range(3):
        away[3 + k] = state.current[k] - state.current_at[k]
        state.water[k] -= away[3 + k]
    away[0], away[1], away[2] = to_body(state.x[3:7], away[3:6])
    for i in range(3):
        state.x[7 + i] += away[i]


@kernel
def update_specific_force(state: JointState, z: Array) -> None:
    """Update by the accelerometer: nu_dot + omega x v - g k + bias, all in the body."""
    inject(state)
    to_linearised_current(state)
    x, A, away = state.x, state.A, state.away
    change = state.work[4]
    stage_of_one_into(state.p, x, state.tau, state.water, change, True)
    linearise_into(
        state.p, x, change, state.codes, state.linearised_at, state.B, state.mean_force, A, state.scratch[4:6]
    )
    for i in range(6):
        change[7 + i] += state.force[i]
    n = state.theta.shape[0]
    gate, within = state.settings[0].gate, True
    state.H[:] = 0.0
    for k in range(3):
        column, h = 3 * SPECIFIC_FORCE + k, state.H[k]
        if not math.isfinite(z[column]):
            continue
        specific_force_row_into(x, A, k, h)
        f = specific_force(x, change, k)
        if state.settings[0].biases > 0.0:
            h[N_FIXED + n + 3 + k] = 1.0
            f += state.bias[3 + k]
        if state.settings[0].waves > 0.0:
            f += carried_along(state, k)
        if state.place[_IMU, 0] >= 0:
            f += _off_origin(state, change[10:13], k)
        for j in range(3):
            f += h[18 + j] * away[3 + j] - h[6 + j] * away[j]
        for c in range(n):
            f += h[N_FIXED + c] * (state.theta[c] - state.linearised_at[c])
        look_ahead(state, column, z[column] - f)
        within = within and state.innovation[k] ** 2 <= gate * gate * state.variance[k]
    for k in range(3):
        x[7 + k] -= away[k]
        state.water[k] += away[3 + k]
    if within:
        update(state, z, SPECIFIC_FORCE)
        state.last_accepted[SPECIFIC_FORCE] = state.clock[0].time
        return
    for m in range(3):
        state.statistics[3 * SPECIFIC_FORCE + m].rejected += 1.0
    _leave_out(state, z, SPECIFIC_FORCE)


@kernel
def carried_along(state: JointState, k: int) -> float:
    """Return number k of R^T dv_w/dt [m/s^2], by which the water of waves takes an accelerometer along; add to its H.

    Each axis of the waves turns in its complex plane, v_w' = -omega s for a quadrature s.
    """
    h, omega, size = state.H[k], state.settings[0].wave_frequency, state.P.shape[0]
    felt = 0.0
    for j in range(3):
        share = -omega * row_of_rotation(state.x[3:7], j)[k]
        h[size - 3 + j] = share
        felt += share * state.wave[3 + j]
    return felt


@kernel
def _across(state: JointState, turning: Array, sensor: int, k: int) -> float:
    """Return number k, in the body, of `turning` (3,) x r: of omega [rad/s] a velocity [m/s], of omega_dot [rad/s^2]
    an acceleration [m/s^2]. r is the place [m] that a sensor, `_IMU` to `_MARKER`, is linearised at."""
    at, place = state.linearised_at, state.place[sensor]
    a, b = (k + 1) % 3, (k + 2) % 3
    return float(turning[a] * at[place[b]] - turning[b] * at[place[a]])


@kernel
def _speed_off_origin(state: JointState, k: int) -> float:
    """Return number k of omega x r [m/s], body, what a DVL away from the origin shows more; add that to its row of H.

    In r to first order about where it is linearised, as all coefficients are.
    """
    h, at, place, theta = state.H[k], state.linearised_at, state.place, state.theta
    a, b = (k + 1) % 3, (k + 2) % 3
    ca, cb = place[_DVL, a], place[_DVL, b]
    h[9 + a] += at[cb]
    h[9 + b] -= at[ca]
    h[N_FIXED + cb] += state.x[10 + a]
    h[N_FIXED + ca] -= state.x[10 + b]
    return float(state.x[10 + a] * theta[cb] - state.x[10 + b] * theta[ca])


@kernel
def _position_off_origin(state: JointState, k: int) -> float:
    """Return number k of R r [m], NED, by which a marker away from the origin stands elsewhere; add that to its H.

    With an error e of the attitude in the body, R (e x r) = (r x R_k) . e for row k of R.
    """
    h, at, place, theta = state.H[k], state.linearised_at, state.place[_MARKER], state.theta
    row, moved = row_of_rotation(state.x[3:7], k), 0.0
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        h[3 + i] += at[place[a]] * row[b] - at[place[b]] * row[a]
        h[N_FIXED + place[i]] += row[i]
        moved += row[i] * theta[place[i]]
    return moved


@kernel
def _turned_with(state: JointState, k: int) -> float:
    """Return number k of R (omega x r) [m/s], NED, how fast a marker away from the origin goes with the turning."""
    a, b, c = row_of_rotation(state.x[3:7], k)
    omega, at = state.x[10:13], _MARKER
    return float(a * _across(state, omega, at, 0) + b * _across(state, omega, at, 1) + c * _across(state, omega, at, 2))


@kernel
def _off_origin(state: JointState, turning: Array, k: int) -> float:
    """Return what number k of an accelerometer away from the origin shows more [m/s^2], body; add that to its row of H.

    omega_dot x r + omega x (omega x r), with r the place and `turning` the omega_dot (3,) that it is linearised at.
    """
    A, h, place, at = state.A, state.H[k], state.place[_IMU], state.linearised_at
    p, q, r = state.x[10], state.x[11], state.x[12]
    a, b = (k + 1) % 3, (k + 2) % 3
    omega = (p, q, r)
    where = (at[place[0]], at[place[1]], at[place[2]])
    along = p * where[0] + q * where[1] + r * where[2]
    h[N_FIXED + place[k]] += omega[k] * omega[k] - (p * p + q * q + r * r)
    h[N_FIXED + place[a]] += omega[k] * omega[a] - turning[b]
    h[N_FIXED + place[b]] += omega[k] * omega[b] + turning[a]
    for j in range(A.shape[1]):
        if j < N_FIXED + state.theta.shape[0]:
            h[j] += A[9 + a, j] * where[b] - A[9 + b, j] * where[a]
    return float(_across(state, turning, _IMU, k) + omega[k] * along - (p * p + q * q + r * r) * where[k])


@kernel
def _passes_gate(state: JointState, z: Array, sensor: int) -> bool:
    """Return whether all numbers of a sensor lie within the gate, and, after an outage, have come back.

    While a sensor is rejected the gate widens; an offset that stays would slip in, one lucky sample at first. So it is
    accepted again only where its own noise accounts for what it differs by, or its samples speak for what is expected,
    and against the offset that it was rejected for, by a log likelihood ratio summed as in Page's test.
    """
    gate, outage = state.settings[0].gate, state.outages[sensor]
    within = near = True
    ratio = 0.0
    for k in range(3):
        if outage.rejected == 0.0:
            outage.offset[k] = 0.0
        if math.isfinite(z[3 * sensor + k]):
            residual, S = math.fabs(state.innovation[k]), state.variance[k]
            within = within and residual <= gate * math.sqrt(S)
            near = near and residual <= _NEAR * state.noise[3 * sensor + k]
            ratio += ((state.innovation[k] - outage.offset[k]) ** 2 - residual * residual) / (2.0 * S)
        else:
            state.innovation[k] = outage.offset[k]
    outage.log_ratio = max(0.0, outage.log_ratio + ratio) if outage.rejected > 0.0 else 0.0
    returned = outage.rejected == 0.0 or near or outage.log_ratio > _RETURNED
    if within and (returned or not OFFSET_STAYS[sensor]):
        outage.rejected = 0.0
        return True
    if ratio < 0.0 or outage.rejected == 0.0:
        outage.rejected += 1.0
        share = max(1.0 / outage.rejected, _OFFSET_WEIGHT)
        for k in range(3):
            outage.offset[k] += (state.innovation[k] - outage.offset[k]) * share
    return False


@kernel
def _goes_on(state: JointState, z: Array, sensor: int) -> bool:
    """Return whether a pose beyond the gate goes on from where it was, as that of a vehicle which moves otherwise.

    A pose that fails jumps, and one that goes on from its last samples, which were accepted, has not failed: an unknown
    force pushes, or the speed beside it errs. That says something where it is measured often, and not in a motion's
    first moments: it may have begun elsewhere. What shows the same again is dead, or too coarse to tell.
    """
    own, gate, now = state.outages[sensor], state.settings[0].gate, state.clock[0].time
    if now - state.clock[0].waits_from < _BEGUN or own.rejected != 1.0:
        return False
    moves = False
    for k in range(3):
        if math.isfinite(z[3 * sensor + k]):
            jump = state.innovation[k] - own.left[k]
            if not (now - own.seen[k] <= _NEXT and math.fabs(jump) <= gate * state.noise[3 * sensor + k]):
                return False
            moves = moves or z[3 * sensor + k] != own.shown[k]
    return moves


@kernel
def _admits(state: JointState, z: Array, sensor: int, whole: bool) -> bool:
    """Return whether a sensor that was looked ahead to updates the state; one that has to be believed anew sets it."""
    own, now, last = state.outages[sensor], state.clock[0].time, state.last_accepted[sensor]
    if not (_passes_gate(state, z, sensor) or (OFFSET_STAYS[sensor] and _goes_on(state, z, sensor))):
        unseen = last == NEVER  # the motion began with a heading that nobody knew
        for k in range(3):
            if math.isfinite(z[3 * sensor + k]) and not unseen:
                state.statistics[3 * sensor + k].rejected += 1.0
        if unseen or now - last > state.settings[0].reacquire * REACQUIRE[sensor]:
            _reset_to_sensor(state, z, sensor, whole or unseen)
            expect(state, z, sensor, whole)
        elif now - last > LONGEST_OUTAGE[sensor] and own.rejected >= _MOST_REJECTED:
            return True
        else:
            _leave_out(state, z, sensor)
            return False
    own.rejected = 0.0
    state.last_accepted[sensor] = now
    return True


@kernel
def _leave_out(state: JointState, z: Array, sensor: int) -> None:
    """Count numbers of a sensor that was looked ahead to as rejected, each as unlikely as one at the gate."""
    gate, cap = state.settings[0].gate, state.settings[0].huber
    for k in range(3):
        if math.isfinite(z[3 * sensor + k]):
            state.clock[0].log_likelihood -= 0.5 * (math.log(state.variance[k]) + cap * (2.0 * gate - cap))


@kernel
def _remember(state: JointState, z: Array, sensor: int, again: bool) -> None:
    """Remember what a pose that is admitted shows, and how far from the state, which the update brings closer.

    Args:
        again: it was admitted the last time, too: what is left is the mean of the last samples then.
    """
    own, cap, now = state.outages[sensor], state.settings[0].huber, state.clock[0].time
    for k in range(3):
        nu, S, R = state.innovation[k], state.variance[k], state.noise[3 * sensor + k] ** 2
        if math.isfinite(z[3 * sensor + k]) and S > 0.0:
            nu -= nu * (S - R) / (S * max(math.fabs(nu) / (cap * math.sqrt(S)), 1.0))
            weight = _LAST if again and now - own.seen[k] <= _NEXT else 1.0
            own.left[k] += weight * (nu - own.left[k])
            own.shown[k], own.seen[k] = z[3 * sensor + k], now


@kernel
def _reset_to_sensor(state: JointState, z: Array, sensor: int, turn: bool) -> None:
    """Take the states that a sensor measures from it anew, with a wide deviation.

    Args:
        turn: set the attitude, too. A heading alone that comes back after rejections is left to the update that
            follows, which knows how it goes with the tilt; one that nobody knew may be too far for that.
    """
    inject(state)
    for k in range(3):
        if not math.isfinite(z[3 * sensor + k]):
            continue
        i = unit_error(sensor, k, True)
        for j in range(state.P.shape[0]):
            state.P[i, j] = 0.0
            state.P[j, i] = 0.0
        state.P[i, i] = LOOSE[sensor] ** 2
        state.statistics[3 * sensor + k].has_last = 0.0
        if i >= 6:
            state.x[i + 1] = z[3 * sensor + k] - (state.bias[k] if sensor == RATES else 0.0)
        elif sensor != ATTITUDE:
            state.x[k] = z[k]
    if sensor == ATTITUDE and turn:
        phi, theta, psi = euler_from_quaternion(state.x[3], state.x[4], state.x[5], state.x[6])
        phi = z[3] if math.isfinite(z[3]) else phi
        theta = z[4] if math.isfinite(z[4]) else theta
        psi = z[5] if math.isfinite(z[5]) else psi
        ex, ey, ez = attitude_error(state.x[3:7], phi, theta, psi)
        state.dx[3], state.dx[4], state.dx[5] = ex, ey, ez
        inject(state)
    state.clock[0].resets += 1.0


@kernel
def update_row(state: JointState, z: Array) -> None:
    """Take one row of measurements z (18,), NaN where there is none."""
    now = state.clock[0].time
    for sensor in range(N_SENSORS):
        if sensor == SPECIFIC_FORCE:  # last, once the others have told the state
            continue
        count = 0
        for k in range(3):
            if math.isfinite(z[3 * sensor + k]):
                count += 1
        if count == 0:
            continue
        whole = count == 3
        if sensor == ATTITUDE and not whole and not cosine_of_pitch(state.x) > _UPRIGHT:
            continue
        unseen = state.last_accepted[sensor] == NEVER
        state.clock[0].since_accepted = 0.0 if unseen else now - state.last_accepted[sensor]
        expect(state, z, sensor, whole)
        again = state.outages[sensor].rejected == 0.0
        if not _admits(state, z, sensor, whole):
            continue
        if OFFSET_STAYS[sensor]:
            _remember(state, z, sensor, again)
        update(state, z, sensor)
    if math.isfinite(z[12]) or math.isfinite(z[13]) or math.isfinite(z[14]):  # specific force
        update_specific_force(state, z)
    inject(state)
