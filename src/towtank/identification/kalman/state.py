"""The joint filter's state: motion, disturbance, current, coefficients and biases, with their common covariance.

Errors stand in this order: position 3 (NED), attitude 3 (body), velocity 6 (relative to the water), disturbance 6
(body), current 3 (NED), free coefficients n, and, where an IMU is there, gyro bias 3 and accelerometer bias 3.

Whether a running joint filter is in order, and how it goes on where it is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import N_MEASURED
from towtank.identification.model.linearisation import N_FIXED, transition_scratch
from towtank.identification.model.parameters import UNTRANSFORMED, Codes, FreeParameters, put_parameters

__all__ = [
    "C_DURATION",
    "C_LIKELIHOOD",
    "C_RESETS",
    "C_ROWS",
    "C_SINCE",
    "C_STARTED",
    "C_TIME",
    "O_ADAPT",
    "O_BIASES",
    "O_BIAS_WALK",
    "O_CURRENT_WALK",
    "O_FLOOR_FORCE",
    "O_FLOOR_MOMENT",
    "O_FOLLOW",
    "O_GAP",
    "O_GATE",
    "O_HUBER",
    "O_REACQUIRE",
    "O_REST",
    "O_STEP",
    "O_TIME_CONSTANT",
    "REST_MEMORY",
    "FilterSettings",
    "HealthySnapshot",
    "JointState",
    "has_moved",
    "healthy_snapshot",
    "known_to",
    "mended",
    "new_joint_state",
]

(
    O_TIME_CONSTANT,
    O_GATE,
    O_HUBER,
    O_REACQUIRE,
    O_GAP,
    O_STEP,
    O_CURRENT_WALK,
    O_BIAS_WALK,
    O_ADAPT,
    O_FLOOR_FORCE,
    O_FLOOR_MOMENT,
    O_BIASES,
    O_CURRENT,
    O_FOLLOW,
    O_REST,
) = range(15)
REST_MEMORY = 10.0  # s over which it is told whether a coefficient learns
_LEAST_ROUGH = 1e-4  # m/s^2 sqrt(s), rad/s^2 sqrt(s): what no model of forces tells
# clock: time, started, log likelihood, rows taken, time learned from, resets, time since the sensor was last heard
C_TIME, C_STARTED, C_LIKELIHOOD, C_ROWS, C_DURATION, C_RESETS, C_SINCE = range(7)
_MOVED, _KNOWN = 0.2, 0.3  # a logarithm so far from its anchor, and its deviation when it counts as known
_DOUBT = 4.0  # by which the variances of a filter grow that had to be mended


@dataclass(frozen=True)
class FilterSettings:
    """What a normal user never touches.

    Attributes:
        time_constant: of the disturbance force [s].
        gate: an innovation beyond this many deviations is not believed; huber: beyond this many it counts less.
        reacquire: after this long without a believed sample [s] a sensor that still speaks is taken at its word.
        gap: after a pause longer than this [s] the motion begins anew.
        step: longest integration step [s].
        adapt: time over which the disturbance's level is followed [s], 0 for a fixed level.
        floor_force, floor_moment: least level of the disturbance [N], [N m].
        usual: level of it [N, N m] that short data are supplemented with, 0 for none.
        follow: the point of linearisation follows coefficients that are known; else it stays, and the filter is linear.
        current: water current (3) estimated. current_walk, bias_walk: random walks [m/s, rad/s or m/s^2 per sqrt(s)].
    """

    time_constant: float = 2.0
    gate: float = 4.5
    huber: float = 2.0
    reacquire: float = 0.7
    gap: float = 2.0
    step: float = 0.02
    adapt: float = 0.0
    floor_force: float = 0.02
    floor_moment: float = 0.002
    usual: tuple[float, ...] = (0.0,) * 6
    follow: bool = True
    current: bool = False
    current_walk: float = 1e-3
    bias_walk: float = 1e-5


class JointState(NamedTuple):
    """Arrays of the filter, changed in place."""

    x: Array  # (13,) position, quaternion, velocity relative to the water
    force: Array  # (6,) disturbance [N, N m]
    current: Array  # (3,) [m/s] NED
    theta: Array  # (n,) free coefficients
    bias: Array  # (6,) gyro [rad/s], accelerometer [m/s^2]
    P: Array  # (N, N)
    p: Array  # (154,) kernel parameters, the anchor put in
    codes: Codes  # (n, 4)
    linearised_at: Array  # (n,) theta that the motion is linearised about; `p` and the held input have these values
    walk: Array  # (n,) random walk of theta [variance per s]
    information_time: Array  # (n,) time over which theta has learned [s]
    information_rate: Array  # (n,) information of late: -d(log variance), fading over REST_MEMORY
    active: Array  # (N,) 1, and 0 for a coefficient that rests
    shape: Array  # (6, m) wrench of each input
    noise: Array  # (15,) deviations of the measured columns
    disturbance: Array  # (6,) levels of the disturbance [N, N m]
    velocity_walk: Array  # (6,) random walk of the speeds [m/s^2 sqrt(s), rad/s^2 sqrt(s)]
    options: Array  # (15,) see O_*
    clock: Array  # (7,) see C_*
    last_accepted: (
        Array  # (5,) time of the last believed sample of each sensor: position, attitude, velocity, rates, force
    )
    outage: Array  # (4, 5) per sensor: samples refused in a row, their mean offset, evidence of its return
    stats: Array  # (15, 14) per column: tell of noise, sum of their innovation^2 - H P H^T; then sum of it / S,
    # refused, believed, score and information of a random walk of the column; of speeds also: pairs of neighbours, sum
    # of what they say of the noise, score and information in the steady state, last innovation, its gain, whether it is
    level: Array  # (6, 4) per axis: time, integrals of d^2 and of its variance, independent looks at it
    step: Array  # (21 + n, 12) F transposed
    F: Array  # (12, 21 + n)
    A: Array  # (12, 21 + n)
    work: Array  # (5, 13, 1)
    scratch: Array  # (12, 6)
    W: Array  # (12, N)
    g: Array  # (N,)
    dx: Array  # (N,)
    h: Array  # (N,)
    pushed: Array  # (3, m)
    small: Array  # (6, 6)
    offset: Array  # (3,)
    tau: Array  # (6,) mean wrench of the inputs over the last step


def new_joint_state(
    p: Array,
    free: FreeParameters,
    theta: Array,
    deviation: Array,
    shape: Array,
    noise: Array,
    disturbance: Array,
    velocity_walk: Array,
    settings: FilterSettings,
    *,
    biases: bool,
    walk: Array | None = None,
    linearised_at: Array | None = None,
) -> JointState:
    """Return a filter that has seen nothing.

    Args:
        p: kernel parameters (154,) for all that is not free.
        theta, deviation: start values and their deviations (n,), or a covariance (n, n) in place of the deviations.
        shape: (6, m). noise: (15,). sigma, rough: (6,). biases: an IMU's biases are estimated.
        walk: [variance per s] (n,). anchor: what the motion is linearised about (n,), by default the start values.
    """
    n = len(free)
    size = N_FIXED + n + (6 if biases else 0)
    F, A, work, scratch = transition_scratch(n)
    options = np.zeros(15)
    options[O_TIME_CONSTANT], options[O_GATE], options[O_HUBER] = settings.time_constant, settings.gate, settings.huber
    options[O_REACQUIRE], options[O_GAP], options[O_STEP] = settings.reacquire, settings.gap, settings.step
    options[O_CURRENT_WALK] = settings.current_walk**2 if settings.current else 0.0
    options[O_BIAS_WALK], options[O_ADAPT] = settings.bias_walk**2, settings.adapt
    options[O_FLOOR_FORCE], options[O_FLOOR_MOMENT] = settings.floor_force, settings.floor_moment
    options[O_BIASES], options[O_CURRENT] = float(biases), float(settings.current)
    options[O_FOLLOW] = float(settings.follow)
    P = np.zeros((size, size))
    block = np.diag(deviation**2) if deviation.ndim == 1 else deviation
    P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n] = block
    if biases:
        P[N_FIXED + n :, N_FIXED + n :] = np.diag([0.02**2] * 3 + [0.3**2] * 3)
    if settings.current:
        P[18:21, 18:21] = 0.2**2 * np.eye(3)
    kernel = np.array(p)
    start = np.array(theta, dtype=np.float64)
    about = start.copy() if linearised_at is None else np.array(linearised_at, dtype=np.float64)
    put_parameters(kernel, free.codes, about, np.empty((6, 6)))
    m = shape.shape[1]
    x = np.zeros(13)
    x[3] = 1.0
    return JointState(
        x=x,
        force=np.zeros(6),
        current=np.zeros(3),
        theta=start,
        bias=np.zeros(6),
        P=P,
        p=kernel,
        codes=np.ascontiguousarray(free.codes),
        linearised_at=about,
        walk=np.zeros(n) if walk is None else np.array(walk, dtype=np.float64),
        information_time=np.zeros(n),
        information_rate=np.zeros(n),
        active=np.ones(size),
        shape=np.ascontiguousarray(shape),
        noise=np.array(noise, dtype=np.float64),
        disturbance=np.array(disturbance, dtype=np.float64),
        velocity_walk=np.fmax(velocity_walk, _LEAST_ROUGH),
        options=options,
        clock=np.zeros(7),
        last_accepted=np.zeros(5),
        outage=np.zeros((4, 5)),
        stats=np.zeros((N_MEASURED, 14)),
        level=np.zeros((6, 4)),
        step=np.zeros((N_FIXED + n, 12)),
        F=F,
        A=A,
        work=work,
        scratch=scratch,
        W=np.zeros((12, size)),
        g=np.zeros(size),
        dx=np.zeros(size),
        h=np.zeros(size),
        pushed=np.zeros((3, m)),
        small=np.zeros((6, 6)),
        offset=np.zeros(3),
        tau=np.zeros(6),
    )


@dataclass(frozen=True, eq=False)
class HealthySnapshot:
    """What a filter knew when it was last found in order: theta (n,), its covariance (n, n), levels."""

    theta: Array
    covariance: Array
    noise: Array
    disturbance: Array
    velocity_walk: Array


def healthy_snapshot(state: JointState) -> HealthySnapshot | None:
    """Return what the filter knows; None where a number is not finite or a variance negative."""
    n = state.theta.size
    finite = np.isfinite(state.theta).all() and np.isfinite(state.P).all() and np.isfinite(state.x).all()
    if not (finite and (np.diag(state.P) >= 0.0).all()):
        return None
    block = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n]
    return HealthySnapshot(
        state.theta.copy(), block.copy(), state.noise.copy(), state.disturbance.copy(), state.velocity_walk.copy()
    )


def known_to(state: JointState) -> Array:
    """Return the deviations (n,) of the coefficients."""
    n = state.theta.size
    return np.asarray(np.sqrt(np.maximum(np.diag(state.P)[N_FIXED : N_FIXED + n], 0.0)))


def has_moved(state: JointState, sound: HealthySnapshot) -> bool:
    """Whether a coefficient has become known far from where the motion is linearised."""
    std = np.sqrt(np.diag(sound.covariance))
    known = (state.codes[:, 3] != UNTRANSFORMED) & (std < _KNOWN)
    return bool(np.any(known & (np.abs(state.theta - state.linearised_at) > np.maximum(_MOVED, 2.0 * std))))


def mended(state: JointState, sound: HealthySnapshot, free: FreeParameters, settings: FilterSettings) -> JointState:
    """Return a filter that begins its motion anew with what was known last, and trusts that less."""
    fresh = new_joint_state(
        state.p,
        free,
        sound.theta,
        _DOUBT * sound.covariance,
        state.shape,
        sound.noise,
        np.sqrt(_DOUBT) * sound.disturbance,
        sound.velocity_walk,
        settings,
        biases=bool(state.options[O_BIASES]),
    )
    for option in (O_FOLLOW, O_ADAPT, O_REST):
        fresh.options[option] = state.options[option]
    fresh.clock[C_ROWS] = state.clock[C_ROWS]
    fresh.information_time[:] = state.information_time
    return fresh
