"""Body velocity and gravity direction at every sample, from whatever was measured.

Velocity is taken as measured, or derived from the pose: the displacement over one interval, turned into the body, and
the relative rotation over it are exact interval means; two equal first-order low-passes smooth them. The thrusters'
mean wrench and the gravity direction then pass through the SAME low-passes: filtering the motion alone would bias the
mass by +8 .. +10 %. A marker jump shows in one interval mean only; it is cut to the running estimate.

The gravity direction comes from the attitude where there is one, else from the gyro with a slow correction towards the
accelerometer (towards level where there is none): a complementary filter on k itself, k_dot = k x omega, which needs no
heading. It is good enough to say which way is up where a free run begins (`drifting_attitude`); gyros alone start level
and drift, so they count for two minutes only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.attitude import quaternion_from_euler
from towtank.identification.data.samples import Sources
from towtank.recording import Grid
from towtank.recording.channel import in_one_block

__all__ = ["drifting_attitude", "gravity_directions"]

ABSENT, MEASURED, DERIVED = 0.0, 1.0, 2.0
ATTITUDE_MEASURED, ATTITUDE_ACCELEROMETER, ATTITUDE_GYRO = 0.0, 1.0, 2.0
VELOCITIES = {"absent": ABSENT, "measured": MEASURED, "derived": DERIVED}  # by the words of `Sources`
ATTITUDES = {"measured": ATTITUDE_MEASURED, "accelerometer": ATTITUDE_ACCELEROMETER, "gyro": ATTITUDE_GYRO}
_CUT = 4.5  # jumps beyond this many deviations are cut,
_CUT_AFTER = 50.0  # samples of a stretch, so that the deviation is known,
_LEAST_CUT = (0.3, 0.5)  # but no change of velocity smaller than this [m/s, rad/s] within one interval
_SETTLED = 10.0  # time constants of the low-passes until they have settled
_CORRECTION = (0.0, 0.2, 0.05)  # 1/s, towards nothing, the accelerometer, level
_GYRO_ALONE = 120.0  # s that gyros alone count for
_CLOSE = 0.5  # s from the sample that a roll and pitch are asked for at


class MotionRows(NamedTuple):
    """Samples of the motion, NaN where not measured; see `motion_step`."""

    t: Array  # (n,)
    pose: Array  # (n, 6)
    velocity: Array  # (n, 6)
    acceleration: Array  # (n, 3)


class LastSample(NamedTuple):
    """The sample taken last."""

    t: Array  # (1,) [s], NaN before the start
    position: Array  # (3,)
    quaternion: Array  # (4,)
    velocity: Array  # (6,)
    gravity: Array  # (3,)


class LowPassed(NamedTuple):
    """What has passed the first low-pass, and both."""

    velocity: Array  # (2, 6)
    gravity: Array  # (2, 3)
    wrench: Array  # (2, 6)


class Counts(NamedTuple):
    """Counts of samples, (1,) each."""

    since_start: Array  # of the stretch
    starts: Array  # stretches begun
    jumps: Array  # cut


class Motion(NamedTuple):
    """State of the front end; arrays are changed in place."""

    source: Array  # (6,) ABSENT, MEASURED or DERIVED for u v w p q r
    attitude: float  # ATTITUDE_MEASURED, ATTITUDE_ACCELEROMETER or ATTITUDE_GYRO
    corner: float  # of the low-passes [rad/s], 0 where nothing is derived
    gap: float  # longest between samples that belong together [s]
    last: LastSample
    last_step: Array  # (1,) from the sample before it to the last one [s], 0 at a start
    low: LowPassed
    scatter: Array  # (6,) running standard deviation of the raw derived velocity about the smoothed one
    counts: Counts
    seen: Array  # (6,) time of the last measurement of each velocity
    nu: Array  # (2, 6) velocity at the start and the end of the interval
    valid: Array  # (2, 6) 1 where it was measured or derived there, 0 where the last one stands in
    k: Array  # (2, 3) gravity direction there
    wrench: Array  # (2, 6) low-passed wrench there


def new_motion(source: Array, attitude: float, corner: float, gap: float) -> Motion:
    """Return a fresh front end; `corner` is the low-pass corner [rad/s] used where velocity is derived."""
    derived = bool((source == DERIVED).any())
    return Motion(
        source=np.ascontiguousarray(source, dtype=np.float64),
        attitude=float(attitude),
        corner=float(corner) if derived else 0.0,
        gap=float(gap),
        last=LastSample(*(np.full(size, np.nan) for size in (1, 3, 4, 6, 3))),
        last_step=np.zeros(1),
        low=LowPassed(*(np.zeros((2, size)) for size in (6, 3, 6))),
        scatter=np.zeros(6),
        counts=Counts(*(np.zeros(1) for _ in Counts._fields)),
        seen=np.full(6, np.nan),
        nu=np.zeros((2, 6)),
        valid=np.zeros((2, 6)),
        k=np.zeros((2, 3)),
        wrench=np.zeros((2, 6)),
    )


@inlined_kernel
def _turn_gravity_into(k: Array, omega: Array, towards: Array, gain: float, h: float) -> None:
    """Turn k (3,) by the body rate omega (3,) over h seconds, corrected slowly towards `towards` (3,)."""
    ex = k[1] * towards[2] - k[2] * towards[1]
    ey = k[2] * towards[0] - k[0] * towards[2]
    ez = k[0] * towards[1] - k[1] * towards[0]
    ax, ay, az = -(omega[0] - gain * ex) * h, -(omega[1] - gain * ey) * h, -(omega[2] - gain * ez) * h
    angle = math.sqrt(ax * ax + ay * ay + az * az)
    if angle > 1e-12:
        ax, ay, az = ax / angle, ay / angle, az / angle
        c, s = math.cos(angle), math.sin(angle)
        dot = (ax * k[0] + ay * k[1] + az * k[2]) * (1.0 - c)
        k0 = k[0] * c + (ay * k[2] - az * k[1]) * s + ax * dot
        k1 = k[1] * c + (az * k[0] - ax * k[2]) * s + ay * dot
        k2 = k[2] * c + (ax * k[1] - ay * k[0]) * s + az * dot
        n = 1.0 / math.sqrt(k0 * k0 + k1 * k1 + k2 * k2)
        k[0], k[1], k[2] = k0 * n, k1 * n, k2 * n


@inlined_kernel
def _unit_or_level_into(a: Array, out: Array) -> None:
    """Write the direction of gravity seen by a specific force `a` (3,), or level where it is not measured."""
    n = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    if n > 1.0:
        for i in range(3):
            out[i] = -a[i] / n
    else:
        out[0], out[1], out[2] = 0.0, 0.0, 1.0


@inlined_kernel
def _mean_velocity_into(last: LastSample, pose: Array, q: Array, h: float, out: Array) -> None:
    """Write the body velocity (6,) that turns the last pose into this one in h seconds."""
    e, at = last.quaternion, last.position
    w = e[0] * q[0] + e[1] * q[1] + e[2] * q[2] + e[3] * q[3]
    x = e[0] * q[1] - e[1] * q[0] - e[2] * q[3] + e[3] * q[2]
    y = e[0] * q[2] + e[1] * q[3] - e[2] * q[0] - e[3] * q[1]
    z = e[0] * q[3] - e[1] * q[2] + e[2] * q[1] - e[3] * q[0]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    s = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(s, w) / (s * h) if s > 1e-12 else 2.0 / h
    out[3], out[4], out[5] = x * scale, y * scale, z * scale
    # Attitude in the middle of the interval.
    m0, m1, m2, m3 = e[0] + q[0], e[1] + q[1], e[2] + q[2], e[3] + q[3]
    if e[0] * q[0] + e[1] * q[1] + e[2] * q[2] + e[3] * q[3] < 0.0:
        m0, m1, m2, m3 = e[0] - q[0], e[1] - q[1], e[2] - q[2], e[3] - q[3]
    n = 1.0 / math.sqrt(m0 * m0 + m1 * m1 + m2 * m2 + m3 * m3)
    m0, m1, m2, m3 = m0 * n, m1 * n, m2 * n, m3 * n
    dx, dy, dz = (pose[0] - at[0]) / h, (pose[1] - at[1]) / h, (pose[2] - at[2]) / h
    out[0] = (1.0 - 2.0 * (m2 * m2 + m3 * m3)) * dx + 2.0 * (m1 * m2 + m0 * m3) * dy + 2.0 * (m1 * m3 - m0 * m2) * dz
    out[1] = 2.0 * (m1 * m2 - m0 * m3) * dx + (1.0 - 2.0 * (m1 * m1 + m3 * m3)) * dy + 2.0 * (m2 * m3 + m0 * m1) * dz
    out[2] = 2.0 * (m1 * m3 + m0 * m2) * dx + 2.0 * (m2 * m3 - m0 * m1) * dy + (1.0 - 2.0 * (m1 * m1 + m2 * m2)) * dz


@inlined_kernel
def _lowpass_into(low: Array, value: Array, gain: float, start: bool) -> None:
    """Advance two equal first-order low-passes in a row (2, n) towards `value` (n,)."""
    for i in range(value.shape[0]):
        if start:
            low[0, i] = value[i]
            low[1, i] = value[i]
        else:
            low[0, i] += gain * (value[i] - low[0, i])
            low[1, i] += gain * (low[0, i] - low[1, i])


@kernel
def motion_step(m: Motion, t: float, pose: Array, velocity: Array, acceleration: Array, wrench: Array) -> float:
    """Take one sample; afterwards m.nu, m.k and m.wrench hold the interval's two ends.

    Args:
        t: time [s]. pose: x y z phi theta psi (6,). velocity: u v w p q r (6,). acceleration: specific force (3,).
            NaN where not measured.
        wrench: the wrench's integral (6,) since the last sample taken.

    Returns:
        The interval's length [s]; 0 where the sample only starts a new stretch (after a gap, or at the beginning, or
        while the low-passes settle); -1 where it cannot be used (something needed is missing) and nothing changed.
    """
    attitude, corner, gap = m.attitude, m.corner, m.gap
    derive = corner > 0.0
    present, to_learn, waiting = 0, 0, False
    for i in range(6):
        if m.source[i] == MEASURED:
            to_learn += 1
            if math.isfinite(velocity[i]):
                present += 1
                m.seen[i] = t
            elif t - m.seen[i] <= gap:
                waiting = True  # a slow sensor, or one sample lost; after a gap it counts as dead
    if waiting or (present < to_learn and (derive or present == 0)):
        return -1.0
    if attitude == ATTITUDE_MEASURED and not (math.isfinite(pose[3]) and math.isfinite(pose[4])):
        return -1.0
    if derive:
        for i in range(6):
            needed = m.source[0] == DERIVED or m.source[1] == DERIVED or m.source[2] == DERIVED
            if i > 2:
                needed = needed or m.source[3] == DERIVED or m.source[4] == DERIVED or m.source[5] == DERIVED
            if needed and not math.isfinite(pose[i]):
                return -1.0
    h: float = t - m.last.t[0]
    if h <= 0.0:
        return -1.0
    start = not h <= gap

    q = np.zeros(4)
    q[0] = 1.0
    k = np.zeros(3)
    if attitude == ATTITUDE_MEASURED:
        psi = pose[5] if math.isfinite(pose[5]) else 0.0
        q[0], q[1], q[2], q[3] = quaternion_from_euler(pose[3], pose[4], psi)
        k[0] = -math.sin(pose[4])
        k[1] = math.cos(pose[4]) * math.sin(pose[3])
        k[2] = math.cos(pose[4]) * math.cos(pose[3])
    else:
        towards = np.zeros(3)
        gain = _CORRECTION[int(attitude)]
        if not math.isfinite(acceleration[0] + acceleration[1] + acceleration[2]):
            gain = 0.0 if attitude == ATTITUDE_ACCELEROMETER else gain
        _unit_or_level_into(acceleration, towards)
        if start:
            for i in range(3):
                k[i] = towards[i] if attitude == ATTITUDE_ACCELEROMETER else (1.0 if i == 2 else 0.0)
        else:
            rate = np.zeros(3)
            for i in range(3):
                k[i] = m.last.gravity[i]
                rate[i] = 0.5 * (velocity[3 + i] + m.last.velocity[3 + i]) if m.source[3 + i] == MEASURED else 0.0
                if not math.isfinite(rate[i]):
                    rate[i] = m.nu[1, 3 + i]
            if attitude == ATTITUDE_GYRO:
                towards[0], towards[1], towards[2] = 0.0, 0.0, 1.0
            _turn_gravity_into(k, rate, towards, gain, h)

    if start:
        m.counts.since_start[0] = 0.0
        m.counts.starts[0] += 1.0
    else:
        m.counts.since_start[0] += 1.0
        for i in range(6):
            m.nu[0, i] = m.nu[1, i]
            m.valid[0, i] = m.valid[1, i]
            m.wrench[0, i] = m.wrench[1, i]
        for i in range(3):
            m.k[0, i] = m.k[1, i]
        if derive:
            _smooth(m, pose, q, velocity, k, wrench, h)
    if not derive:
        for i in range(6):
            known = m.source[i] == MEASURED and math.isfinite(velocity[i])
            m.valid[1, i] = 1.0 if known else 0.0
            if known or start or m.source[i] == ABSENT:
                m.nu[1, i] = velocity[i] if known else 0.0
        for i in range(3):
            m.k[1, i] = k[i]
    m.last.t[0] = t
    for i in range(3):
        m.last.position[i] = pose[i]
        m.last.gravity[i] = k[i]
    for i in range(4):
        m.last.quaternion[i] = q[i]
    for i in range(6):
        m.last.velocity[i] = velocity[i] if math.isfinite(velocity[i]) else m.nu[1, i]
    settled = 2.0 + (_SETTLED / (corner * h) if derive and not start else 0.0)
    span = 0.5 * (h + m.last_step[0]) if derive else h  # low-passed means stand for the middle of their steps
    m.last_step[0] = 0.0 if start else h
    return 0.0 if start or (derive and m.counts.since_start[0] < settled) else span


@inlined_kernel
def _smooth(m: Motion, pose: Array, q: Array, velocity: Array, k: Array, wrench: Array, h: float) -> None:
    """Derive the interval's mean velocity, cut jumps, and pass motion, gravity and wrench through the low-passes."""
    mean, down, force = np.zeros(6), np.zeros(3), np.zeros(6)
    _mean_velocity_into(m.last, pose, q, h, mean)
    count = m.counts.since_start[0]
    for i in range(6):
        if m.source[i] == MEASURED:
            mean[i] = 0.5 * (velocity[i] + m.last.velocity[i])
        elif m.source[i] == ABSENT:
            mean[i] = 0.0
        elif count != 1.0:
            error = mean[i] - m.low.velocity[1, i]
            limit = max(_CUT * m.scatter[i], _LEAST_CUT[0] if i < 3 else _LEAST_CUT[1])
            if count > _CUT_AFTER and math.fabs(error) > limit:
                mean[i] = m.low.velocity[1, i]
                m.counts.jumps[0] += 1.0
                error = math.copysign(limit, error)
            weight = max(0.01, 1.0 / count)
            m.scatter[i] = math.sqrt((1.0 - weight) * m.scatter[i] ** 2 + weight * error * error)
    for i in range(3):
        down[i] = 0.5 * (k[i] + m.last.gravity[i])
    for i in range(6):
        force[i] = wrench[i] / h
    gain, start = -math.expm1(-m.corner * h), count == 1.0
    _lowpass_into(m.low.velocity, mean, gain, start)
    _lowpass_into(m.low.gravity, down, gain, start)
    _lowpass_into(m.low.wrench, force, gain, start)
    for i in range(6):
        m.valid[1, i] = 1.0 if m.source[i] != ABSENT else 0.0
        m.nu[1, i] = m.low.velocity[1, i]
        m.wrench[1, i] = m.low.wrench[1, i]
    for i in range(3):
        m.k[1, i] = m.low.gravity[1, i]


@kernel
def _gravity_directions(motion: Motion, rows: MotionRows) -> Array:
    out = np.full((rows.t.shape[0], 3), np.nan)
    nothing = np.zeros(6)
    for i in range(rows.t.shape[0]):
        if motion_step(motion, rows.t[i], rows.pose[i], rows.velocity[i], rows.acceleration[i], nothing) >= 0.0:
            for j in range(3):
                out[i, j] = motion.last.gravity[j]
    return out


def rows_of(grid: Grid) -> MotionRows:
    """Return the motion of a grid."""
    return MotionRows(grid.t, in_one_block(grid.pose), in_one_block(grid.velocity), in_one_block(grid.acceleration))


def gravity_directions(grid: Grid, sources: Sources) -> Array:
    """Return the direction of gravity in the body (n, 3) at every sample of a grid; NaN where it is not known."""
    rates = np.array([MEASURED if i > 2 and sources.velocity[i] == "measured" else ABSENT for i in range(6)])
    motion = new_motion(rates, ATTITUDES[sources.attitude], 0.0, np.inf)
    return _gravity_directions(motion, rows_of(grid))


def drifting_attitude(grid: Grid, sources: Sources, t: Array) -> Array:
    """Return roll and pitch (n, 2) [rad] at times t (n,), NaN where they are measured anyhow or not known."""
    out = np.full((t.size, 2), np.nan)
    if sources.attitude == "measured" or "measured" not in sources.velocity[3:]:
        return out
    k = gravity_directions(grid, sources)
    known = np.isfinite(k).all(axis=1)
    if sources.attitude == "gyro":
        known &= grid.t <= grid.t[0] + _GYRO_ALONE
    if not known.any():
        return out
    at, k = grid.t[known], k[known]
    near = np.array([np.interp(t, at, k[:, j]) for j in range(3)]).T
    fine = np.abs(at[np.clip(np.searchsorted(at, t), 0, at.size - 1)] - t) <= _CLOSE
    out[fine, 0] = np.arctan2(near[fine, 1], near[fine, 2])
    out[fine, 1] = np.arctan2(-near[fine, 0], np.hypot(near[fine, 1], near[fine, 2]))
    return out
