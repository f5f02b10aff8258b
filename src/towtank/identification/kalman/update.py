"""The joint filter at a measurement: what each sensor should show, whether it is accepted, and the update.

With g = P H^T and S = H g + R one number updates by dx += g nu / S, P -= g g^T with g / sqrt(S), which keeps the
covariance symmetric to the last bit. An innovation beyond the cap counts as if its sensor were so much worse: S grows
until the innovation is at the cap (Huber). The three numbers of a sensor are gated at 4.5 deviations and rejected
together, else taken one after the other. Errors wait in dx until they are put into the state.

A coefficient that is considered but not updated has no gain, and P -= g g^T / S leaves out the block of those. The rest
of P still counts with their uncertainty (Schmidt's consider states), so that it stays true.

The accelerometer shows what the forces of the model do.
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel
from towtank.core.rk4 import stage_into
from towtank.identification.kalman.state import JointState
from towtank.identification.model.linearisation import N_FIXED, linearise_into, turn_by

__all__ = ["GRAVITY", "attitude_error", "count_speed", "inject", "scalar_update", "update_row"]

_CLIPPED_SQUARE = 25.0  # times S that an innovation^2 counts for at most in the score of a random walk
_NOISE_SHOWS = 5.0  # times R: below, S shows the sensor's noise
_NEIGHBOURS = 0.5  # s from one sample of a speed to the next, for the two to show the sensor's noise
_LEAST_SLOPE = 0.05  # s per s: of S by the walk's variance in the steady state
GRAVITY = 9.81  # m/s^2, as in `towtank.vehicle`
_RETURNED = 8.0  # log likelihood ratio for a sensor that has come back, against one that is still off
_OFFSET_WEIGHT = 0.1  # least weight of a sample in the mean offset of a sensor that is rejected
_LONGEST_OUTAGE = (math.inf, math.inf, 0.3, 0.03)  # s: of position, attitude, velocity, rates, and, of the latter two,
_MOST_REJECTED = 3.0  # samples
_LOOSE = (1.0, 0.1, 0.5, 0.5, 0.0)  # m, rad, m/s, rad/s: deviation of a state that is taken from its sensor anew


@kernel
def innovation_variance_into(state: JointState, column: int) -> float:
    """Write g = P H^T for the row in `state.h` into `state.g`; return S with the column's noise."""
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
    S = innovation_variance_into(state, column)
    nu = residual
    for k in range(size):
        if h[k] != 0.0:
            nu -= h[k] * dx[k]
            h[k] = 0.0
    if not S > 0.0:
        return
    R = state.noise[column] ** 2
    away = math.fabs(nu) / math.sqrt(S)
    clock, own = state.clock[0], state.statistics[column]
    cap = state.settings[0].huber
    if S < _NOISE_SHOWS * R:
        own.noise_samples += 1.0
        own.noise_sum += nu * nu - (S - R)
    own.nis_sum += nu * nu / S
    own.accepted += 1.0
    since = clock.since_accepted
    own.walk_score += since * (min(nu * nu, _CLIPPED_SQUARE * S) - S) / (S * S)
    own.walk_information += since * since / (S * S)
    if 6 <= column < 12:
        count_speed(state, column, nu, S, (S - R) / (S * max(away / cap, 1.0)))
    if away > cap:
        clock.log_likelihood -= 0.5 * (math.log(S) + cap * (2.0 * away - cap))
        S *= away / cap
    else:
        clock.log_likelihood -= 0.5 * (math.log(S) + away * away)
    gain = nu / S
    active = state.active
    for j in range(size):
        dx[j] += active[j] * g[j] * gain
    root = 1.0 / math.sqrt(S)
    for i in range(size):
        g[i] *= root
    for c in range(state.theta.shape[0]):
        i = N_FIXED + c
        if P[i, i] > 0.0:
            state.information_rate[c] += g[i] * g[i] / P[i, i]
    for i in range(size):
        a = g[i]
        if a != 0.0 and active[i] > 0.0:
            for j in range(size):
                P[i, j] -= a * g[j]
    for c in range(state.theta.shape[0]):
        i = N_FIXED + c
        if active[i] == 0.0:
            for j in range(size):
                if active[j] > 0.0:
                    P[i, j] = P[j, i]


@kernel
def count_speed(state: JointState, column: int, nu: float, S: float, gain: float) -> None:
    """Count what the innovation nu of a speed shows of the sensor's noise and of the velocity walk.

    With e the error before the sample and v its noise, nu = e + v, and the error at the next one is e - K nu + w. So
    (1 - K) nu^2 - nu nu' is v nu on average, R, whatever the gain K, and whatever the filter takes the walk for
    (Mehra 1970); one sample alone shows R and the walk only together. Of a random walk of variance q per second
    behind a filter of gain K, the steady state has dS/dq = h / (K (2 - K)).
    """
    own, since = state.statistics[column], state.clock[0].since_accepted
    if own.has_last > 0.0 and since < _NEIGHBOURS:
        last = own.last_innovation
        own.neighbours += 1.0
        own.neighbour_sum += (1.0 - own.last_gain) * last * last - nu * last
    own.last_innovation, own.last_gain, own.has_last = nu, gain, 1.0
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
        for i in range(6):
            state.bias[i] += dx[N_FIXED + n + i]
    for j in range(dx.shape[0]):
        dx[j] = 0.0


@kernel
def measurement_row_into(state: JointState, sensor: int, k: int, whole: bool) -> None:
    """Write H of number k of a sensor (0 position .. 3 angular rates) into `state.h`, which is zero before."""
    h = state.h
    x = state.x
    n = state.theta.shape[0]
    if sensor == 0:
        h[k] = 1.0
    elif sensor == 1:
        if whole:
            h[3 + k] = 1.0
        else:
            qw, qx, qy, qz = x[3], x[4], x[5], x[6]
            kx, ky, kz = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
            c2 = math.hypot(ky, kz)
            s1, c1 = ky / c2, kz / c2
            if k == 0:
                h[3], h[4], h[5] = 1.0, -s1 * kx / c2, -c1 * kx / c2
            elif k == 1:
                h[4], h[5] = c1, -s1
            else:
                h[4], h[5] = s1 / c2, c1 / c2
    elif sensor == 2:
        h[6 + k] = 1.0
        c0, c1, c2 = _current_in_body(state)
        if c0 != 0.0 or c1 != 0.0 or c2 != 0.0 or state.P[18, 18] > 0.0:
            qw, qx, qy, qz = x[3], x[4], x[5], x[6]
            if k == 0:
                h[18], h[19], h[20] = (
                    1.0 - 2.0 * (qy * qy + qz * qz),
                    2.0 * (qx * qy + qw * qz),
                    2.0 * (qx * qz - qw * qy),
                )
                h[4], h[5] = -c2, c1  # R^T v_c turns with the attitude: [c]x e
            elif k == 1:
                h[18], h[19], h[20] = (
                    2.0 * (qx * qy - qw * qz),
                    1.0 - 2.0 * (qx * qx + qz * qz),
                    2.0 * (qy * qz + qw * qx),
                )
                h[3], h[5] = c2, -c0
            else:
                h[18], h[19], h[20] = (
                    2.0 * (qx * qz + qw * qy),
                    2.0 * (qy * qz - qw * qx),
                    1.0 - 2.0 * (qx * qx + qy * qy),
                )
                h[3], h[4] = -c1, c0
    else:
        h[9 + k] = 1.0
        if state.settings[0].biases > 0.0:
            h[N_FIXED + n + k] = 1.0


@kernel
def _current_in_body(state: JointState) -> tuple[float, float, float]:
    qw, qx, qy, qz = state.x[3], state.x[4], state.x[5], state.x[6]
    a, b, c = state.current[0], state.current[1], state.current[2]
    return (
        (1.0 - 2.0 * (qy * qy + qz * qz)) * a + 2.0 * (qx * qy + qw * qz) * b + 2.0 * (qx * qz - qw * qy) * c,
        2.0 * (qx * qy - qw * qz) * a + (1.0 - 2.0 * (qx * qx + qz * qz)) * b + 2.0 * (qy * qz + qw * qx) * c,
        2.0 * (qx * qz + qw * qy) * a + 2.0 * (qy * qz - qw * qx) * b + (1.0 - 2.0 * (qx * qx + qy * qy)) * c,
    )


@kernel
def attitude_error(q: Array, phi: float, theta: float, psi: float) -> tuple[float, float, float]:
    """Return the rotation vector (body) from the attitude q (4,) to the Euler angles' attitude."""
    c1, s1 = math.cos(0.5 * phi), math.sin(0.5 * phi)
    c2, s2 = math.cos(0.5 * theta), math.sin(0.5 * theta)
    c3, s3 = math.cos(0.5 * psi), math.sin(0.5 * psi)
    w = c1 * c2 * c3 + s1 * s2 * s3
    x = s1 * c2 * c3 - c1 * s2 * s3
    y = c1 * s2 * c3 + s1 * c2 * s3
    z = c1 * c2 * s3 - s1 * s2 * c3
    a, b, c, d = q[0], -q[1], -q[2], -q[3]
    ew = a * w - b * x - c * y - d * z
    ex = a * x + b * w + c * z - d * y
    ey = a * y - b * z + c * w + d * x
    ez = a * z + b * y - c * x + d * w
    size = math.sqrt(ex * ex + ey * ey + ez * ez)
    if size < 1e-9:
        scale = 2.0 if ew >= 0.0 else -2.0
    else:
        scale = 2.0 * math.atan2(size, math.fabs(ew)) / size
        if ew < 0.0:
            scale = -scale
    return scale * ex, scale * ey, scale * ez


@kernel
def _wrapped(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def residual_of(state: JointState, z: Array, sensor: int, k: int, whole: bool) -> float:
    """Return what number k of a sensor shows beyond what the state expects, angles by the shortest way."""
    x = state.x
    value = z[3 * sensor + k]
    if sensor == 0:
        return float(value - x[k])
    if sensor == 1:
        if whole:
            ex, ey, ez = attitude_error(x[3:7], z[3], z[4], z[5])
            return ex if k == 0 else (ey if k == 1 else ez)
        qw, qx, qy, qz = x[3], x[4], x[5], x[6]
        ky, kz = 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
        if k == 0:
            return _wrapped(value - math.atan2(ky, kz))
        if k == 1:
            return float(value - math.atan2(2.0 * (qw * qy - qx * qz), math.hypot(ky, kz)))
        return _wrapped(value - math.atan2(2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qy * qy + qz * qz)))
    if sensor == 2:
        c0, c1, c2 = _current_in_body(state)
        return float(value - x[7 + k] - (c0 if k == 0 else (c1 if k == 1 else c2)))
    return float(value - x[10 + k] - state.bias[k])


@kernel
def is_upright(state: JointState) -> bool:
    """Return whether single Euler angles mean something: not within about 8 degrees of a pitch of 90."""
    x = state.x
    ky, kz = 2.0 * (x[5] * x[6] + x[3] * x[4]), 1.0 - 2.0 * (x[4] * x[4] + x[5] * x[5])
    return bool(ky * ky + kz * kz > 0.02)


@kernel
def update_specific_force(state: JointState, z: Array) -> None:
    """Update by the accelerometer: nu_dot + omega x v - g k + bias, all in the body."""
    inject(state)
    x, A, h = state.x, state.A, state.h
    lane = state.x.reshape(13, 1)
    rate = state.work[4]
    wrench = state.scratch[:1].reshape(6, 1)
    for i in range(6):
        wrench[i, 0] = state.tau[i] + state.force[i]
    stage_into(state.p.reshape(state.p.shape[0], 1), lane, wrench, state.current, rate, True)
    linearise_into(
        state.p, x, rate[:, 0], state.codes, state.linearised_at, state.B, state.mean_force, A, state.scratch[4:6]
    )
    u, v, w, p, q, r = x[7], x[8], x[9], x[10], x[11], x[12]
    k0, k1, k2 = (
        2.0 * (x[4] * x[6] - x[3] * x[5]),
        2.0 * (x[5] * x[6] + x[3] * x[4]),
        1.0 - 2.0 * (x[4] ** 2 + x[5] ** 2),
    )
    n = state.theta.shape[0]
    gate = state.settings[0].gate
    for pass_ in range(2):
        for k in range(3):
            if not math.isfinite(z[12 + k]):
                continue
            for j in range(N_FIXED + n):
                h[j] = A[6 + k, j]
            f = rate[7 + k, 0]
            for c in range(n):
                f += A[6 + k, N_FIXED + c] * (state.theta[c] - state.linearised_at[c])
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
            if state.settings[0].biases > 0.0:
                h[N_FIXED + n + 3 + k] = 1.0
                f += state.bias[3 + k]
            residual = z[12 + k] - f
            if pass_ == 0:
                S = innovation_variance_into(state, 12 + k)
                for j in range(h.shape[0]):
                    h[j] = 0.0
                if residual * residual > gate * gate * S:
                    for m in range(3):
                        state.statistics[12 + m].rejected += 1.0
                    return
            else:
                scalar_update(state, 12 + k, residual)
    state.last_accepted[4] = state.clock[0].time


@kernel
def _passes_gate(state: JointState, z: Array, sensor: int, whole: bool) -> bool:
    """Return whether all numbers of a sensor lie within the gate, and, after an outage, have come back.

    While a sensor is rejected the gate widens; an offset that stays would slip in, one lucky sample at first. So it is
    accepted again only when its samples speak for what is expected, and against the offset that it was rejected for, by
    a log likelihood ratio summed as in Page's test.
    """
    gate, cap = state.settings[0].gate, state.settings[0].huber
    outage = state.outages[sensor]
    within = True
    stays = sensor < 2  # a camera that has lost its marker stays wrong; speeds only jump
    ratio, cost = 0.0, 0.0
    for k in range(3):
        if math.isfinite(z[3 * sensor + k]):
            residual = residual_of(state, z, sensor, k, whole)
            measurement_row_into(state, sensor, k, whole)
            S = innovation_variance_into(state, 3 * sensor + k)
            for j in range(state.h.shape[0]):
                if state.h[j] != 0.0:
                    residual -= state.h[j] * state.dx[j]
                    state.h[j] = 0.0
            if residual * residual > gate * gate * S:
                within = False
            ratio += ((residual - outage.offset[k]) ** 2 - residual * residual) / (2.0 * S)
            cost += math.log(S) + cap * (2.0 * gate - cap)
            state.innovation[k] = residual
        else:
            state.innovation[k] = outage.offset[k]
    if outage.rejected == 0.0:
        outage.log_ratio = 0.0
        for k in range(3):
            outage.offset[k] = 0.0
    else:
        outage.log_ratio = max(0.0, outage.log_ratio + ratio)
    if within and (outage.rejected == 0.0 or outage.log_ratio > _RETURNED or not stays):
        outage.rejected = 0.0
        return True
    if ratio < 0.0 or outage.rejected == 0.0:
        outage.rejected += 1.0
        share = max(1.0 / outage.rejected, _OFFSET_WEIGHT)
        for k in range(3):
            outage.offset[k] += (state.innovation[k] - outage.offset[k]) * share
    state.clock[0].log_likelihood -= 0.5 * cost
    return False


@kernel
def _reset_to_sensor(state: JointState, z: Array, sensor: int, whole: bool) -> None:
    """Take the states that a sensor measures from it anew, with a wide deviation."""
    inject(state)
    first = 3 * sensor if sensor < 4 else 6
    for k in range(3):
        if not math.isfinite(z[3 * sensor + k]):
            continue
        i = first + k
        for j in range(state.P.shape[0]):
            state.P[i, j] = 0.0
            state.P[j, i] = 0.0
        state.P[i, i] = _LOOSE[sensor] ** 2
        state.statistics[3 * sensor + k].has_last = 0.0
        if sensor == 0:
            state.x[k] = z[k]
        elif sensor == 2:
            state.x[7 + k] = z[6 + k]
        elif sensor == 3:
            state.x[10 + k] = z[9 + k] - state.bias[k]
    if sensor == 1 and whole:
        ex, ey, ez = attitude_error(state.x[3:7], z[3], z[4], z[5])
        state.dx[3], state.dx[4], state.dx[5] = ex, ey, ez
        inject(state)
    state.clock[0].resets += 1.0


@kernel
def update_row(state: JointState, z: Array) -> None:
    """Take one row of measurements z (15,), NaN where there is none."""
    now = state.clock[0].time
    for sensor in range(4):
        count = 0
        for k in range(3):
            if math.isfinite(z[3 * sensor + k]):
                count += 1
        if count == 0:
            continue
        whole = count == 3
        if sensor == 1 and not whole and not is_upright(state):
            continue
        state.clock[0].since_accepted = now - state.last_accepted[sensor]
        if not _passes_gate(state, z, sensor, whole):
            for k in range(3):
                if math.isfinite(z[3 * sensor + k]):
                    state.statistics[3 * sensor + k].rejected += 1.0
            quiet = now - state.last_accepted[sensor]
            if quiet > state.settings[0].reacquire * (1.0 if sensor == 0 else 3.0):
                _reset_to_sensor(state, z, sensor, whole)
                state.outages[sensor].rejected = 0.0
                state.last_accepted[sensor] = now
            elif quiet <= _LONGEST_OUTAGE[sensor] or state.outages[sensor].rejected < _MOST_REJECTED:
                continue
        else:
            state.last_accepted[sensor] = now
        for k in range(3):
            if math.isfinite(z[3 * sensor + k]):
                residual = residual_of(state, z, sensor, k, whole)
                measurement_row_into(state, sensor, k, whole)
                scalar_update(state, 3 * sensor + k, residual)
    if math.isfinite(z[12]) or math.isfinite(z[13]) or math.isfinite(z[14]):
        update_specific_force(state, z)
    inject(state)
