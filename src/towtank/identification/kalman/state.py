"""The joint filter's state: motion, disturbance, current, coefficients and biases, with their common covariance.

Errors stand in this order: position 3 (NED), attitude 3 (body), velocity 6 (relative to the water), disturbance 6
(an acceleration, body), current 3 (NED), free coefficients n; where an IMU is there, biases of gyro 3, accelerometer 3
and attitude 3; where there are waves, the velocity of the water in them 3 and its quadrature 3 (NED).

A wave is a complex Ornstein-Uhlenbeck process z on each axis, z_dot = (-1/T + i omega) z + noise: its real part moves
the water, its imaginary part is a quarter of a period behind. T is four periods: half the motion lies within 4 % of the
period, as of swell; with one, it would lie within 16 %, and a wave that goes on as it went would be a surprise each
time. The attitude of an AHRS wanders: a bias with a memory of half a minute.

Kernels of this package advance a `JointState` in place. What it counts and what it is set to stand in records, arrays
whose elements have named fields of 8 bytes each: `state.clock[0].time`, `state.statistics["accepted"]`.

Also whether a running filter is healthy, and how it goes on where it is not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.rk4 import N_STATES
from towtank.identification.data.samples import N_MEASURED, NoiseLevels
from towtank.identification.model.measurements import N_SENSORS
from towtank.identification.model.parameters import (
    IN_DELAY,
    IN_LAG,
    IN_LATENCY,
    IN_PLACE,
    N_FIXED,
    N_MOVING,
    PLACED,
    PLACES,
    Codes,
    FreeParameters,
    put_parameters,
)

__all__ = [
    "FilterSettings",
    "HealthySnapshot",
    "JointState",
    "coefficient_block",
    "coefficient_std",
    "columns_of",
    "forget_surroundings",
    "healthy_snapshot",
    "in_waves",
    "new_joint_state",
    "places_of",
    "recovered",
    "restored_state",
    "surely_flows",
    "transition_scratch",
]

INFORMATION_MEMORY = 10.0  # s over which the rate of information of a coefficient is averaged
_LEAST_VELOCITY_WALK = 1e-4  # m/s^2 sqrt(s), rad/s^2 sqrt(s): what no model of forces accounts for
_RECOVERY_INFLATION = 4.0  # factor to the variances of a filter that had to recover
_GYRO_BIAS, _ACCELEROMETER_BIAS = 0.02, 0.3  # rad/s, m/s^2: deviations at the start
_CURRENT_STD = 0.15  # m/s, at the start
_NO_CHANCE = 3.0  # deviations of a current, up to which it may be chance
_WAVE_MEMORY = 4.0  # periods of a wave
_ATTITUDE_BIAS = (0.009, 0.009, 0.03)  # rad: half a degree of tilt, a compass worse
N_BIASES, N_WAVES = 9, 6  # errors

Record = NDArray[Any]  # elements with named fields


def _fields(*names: str, **shapes: tuple[int, ...]) -> np.dtype[Any]:
    """Return the type of a record of numbers, and of arrays of these shapes."""
    fields = [(name, np.float64) for name in names] + [(name, np.float64, shape) for name, shape in shapes.items()]
    return np.dtype((np.record, fields))


CLOCK = _fields(
    *("time", "started", "waits_from", "waited", "speeds", "log_likelihood"),
    *("rows", "duration", "resets", "since_accepted"),
)
SETTINGS = _fields(
    *("time_constant", "gate", "huber", "reacquire", "gap", "step", "adapt", "floor_force", "floor_moment"),
    *("current_walk", "bias_walk", "biases", "waves", "wave_frequency", "wave_decay", "considered_share"),
    attitude_bias=(3,),
)
STATISTICS = _fields(
    *("noise_samples", "noise_sum", "nis_sum", "rejected", "accepted", "neighbours", "neighbour_sum"),
    *("steady_score", "steady_information", "last_innovation", "last_gain", "has_last"),
)
OUTAGE = _fields("rejected", "log_ratio", offset=(3,), seen=(3,), shown=(3,), left=(3,))
DISTURBANCE_STATISTICS = _fields("time", "square", "variance", "effective_samples")


@dataclass(frozen=True)
class FilterSettings:
    """What a normal user never touches.

    Attributes:
        time_constant: of the disturbance force [s].
        gate: an innovation beyond this many deviations is rejected; huber: beyond this many it counts less.
        reacquire: after this long without an accepted sample [s] a sensor that still speaks is taken at its word.
        gap: after a pause longer than this [s] the motion begins anew.
        step: longest integration step [s].
        adapt: time over which the disturbance's level is adapted [s], 0 for a fixed level.
        floor_force, floor_moment: least level of the disturbance [m/s^2], [rad/s^2].
        usual: level of it [m/s^2, rad/s^2] that short data are supplemented with, 0 for none.
        current: water current (3) estimated. bias_walk: random walk of biases [rad/s or m/s^2 per sqrt(s)].
        biases: those of an IMU are estimated. wanders: the attitude comes from one, too.
        wave_period: [s] where the levels have waves.
    """

    time_constant: float = 2.0
    gate: float = 4.5
    huber: float = 2.0
    reacquire: float = 0.7
    gap: float = 2.0
    step: float = 0.02
    adapt: float = 0.0
    floor_force: float = 0.001
    floor_moment: float = 0.003
    usual: tuple[float, ...] = (0.0,) * 6
    current: bool = False
    bias_walk: float = 1e-5
    biases: bool = False
    wanders: bool = False
    wave_period: float = 6.0

    @property
    def record(self) -> Record:
        """What kernels read, (1,): walks as variances per s, 1 for that of a current; no coefficient is considered."""
        numbers = (
            *(self.time_constant, self.gate, self.huber, self.reacquire, self.gap, self.step, self.adapt),
            *(self.floor_force, self.floor_moment, float(self.current), self.bias_walk**2),
            *(float(self.biases), 0.0, *_turning(self.wave_period)),
            *(0.0, _ATTITUDE_BIAS if self.wanders else (0.0, 0.0, 0.0)),
        )
        return np.array([numbers], dtype=SETTINGS)


def _turning(period: float) -> tuple[float, float]:
    """Return the angular frequency of waves [rad/s], and how fast they forget [1/s], for a period [s]."""
    return 2.0 * math.pi / period, 1.0 / (_WAVE_MEMORY * period)


class JointState(NamedTuple):
    """Arrays of the filter, changed in place.

    Fields of the records:
        settings (1,): those of `FilterSettings`; considered_share: of a steady information rate, below which a
            coefficient is considered but not updated.
        clock (1,): time [s]; started: 1 once the motion has begun, -1 while that waits, from `waits_from` [s] to
            `waited`, for inputs and a speed; speeds: 1 where they are measured; log_likelihood: of the innovations;
            rows: taken; duration: learned from [s]; resets: of a sensor's states; since_accepted: time since the last
            accepted sample of the sensor at hand [s].
        statistics (18,), per column: noise_sum: of innovation^2 - H P H^T over noise_samples; nis_sum: of
            innovation^2 / S; rejected, accepted: samples. Of speeds: neighbour_sum: what pairs of neighbours show of
            the noise's variance; steady_score, steady_information: of a random walk in the steady state; the last
            innovation, its gain, whether it is there.
        outages (6,), per sensor: rejected: samples in a row; offset: their mean; log_ratio: evidence of its return.
            Of a pose: when [s] each number was `seen` and accepted last, what was `shown`, and what the state has
            `left` of it, or of the last samples on average.
        disturbance_statistics (6,), per axis: time [s]; square, variance: integrals of d_hat^2 and of its variance;
            effective_samples: independent ones.
    """

    x: Array  # (13,) position, quaternion, velocity relative to the water
    force: Array  # (6,) disturbance [m/s^2, rad/s^2]
    current: Array  # (3,) [m/s] NED
    theta: Array  # (n,) free coefficients
    bias: Array  # (9,) gyro [rad/s], accelerometer [m/s^2]; attitude [rad], about x and y of the body and the vertical
    wave: Array  # (6,) [m/s] NED: the water's velocity in waves, and its quadrature
    water: Array  # (3,) [m/s] NED: current and waves
    rate: Array  # (6,) acceleration over the last step [m/s^2, rad/s^2]
    latency: NDArray[np.int64]  # (6,) which coefficient is the latency of each sensor, -1 where it is known
    place: NDArray[np.int64]  # (3, 3) which are the places of accelerometer, DVL, marker, -1 where it is the origin
    P: Array  # (N, N)
    p: Array  # (170,) kernel parameters at the linearisation point
    linear: Array  # (37,) whether `p` has losses by inflow now, and its linear damping without them
    codes: Codes  # (n, 4)
    current_at: Array  # (3,) current [m/s] NED that the motion is linearised about
    away: Array  # (6,) how far the current lies from there [m/s], in the body and NED
    linearised_at: Array  # (n,) theta that the motion is linearised about; `p` and the inputs have these values
    learns: Array  # (n,) 1, and 0 for one of motion that nothing shows or drives: considered, never updated
    information_time: Array  # (n,) time over which theta has learned [s]
    information_rate: Array  # (n,) information of late: -d(log variance), fading over INFORMATION_MEMORY
    active: Array  # (N,) 1, and 0 for a coefficient that is considered but not updated
    B: Array  # (6, m) wrench of each unit input
    noise: Array  # (18,) deviations of the measured columns
    disturbance: Array  # (6,) levels of the disturbance [m/s^2, rad/s^2]
    wave_level: Array  # (3,) deviations of the water's velocity in waves [m/s]
    velocity_walk: Array  # (6,) random walk of the speeds [m/s^2 sqrt(s), rad/s^2 sqrt(s)]
    settings: Record
    clock: Record
    shown: Array  # (18,) what sensors have shown last while the motion waits to begin
    last_accepted: Array  # (6,) time of the last accepted sample of each sensor [s]; the attitude's may be NEVER
    outages: Record
    statistics: Record
    disturbance_statistics: Record
    wave_statistics: Record  # (3,) as those of the disturbance
    F: Array  # (12, 21 + n)
    A: Array  # (12, 21 + n)
    work: Array  # (5, 13)
    scratch: Array  # (12, 6)
    W: Array  # (12, N)
    H: Array  # (3, N) of the sensor at hand
    G: Array  # (3, N) P H^T
    dx: Array  # (N,) error found and not yet put into the state
    mean_force: Array  # (3, m) of the inputs over a step, after it that of now, and its derivatives by delay and ln lag
    small: Array  # (6, 6)
    innovation: Array  # (3,) of the sensor at hand
    variance: Array  # (3,) of the innovation
    tau: Array  # (6,) wrench of the inputs: mean over the step, and at its end for the accelerometer


def transition_scratch(n: int) -> tuple[Array, Array, Array, Array]:
    """Return F, A, work and scratch for `step_and_linearise` with n free coefficients."""
    return (
        np.zeros((N_MOVING, N_FIXED + n)),
        np.zeros((N_MOVING, N_FIXED + n)),
        np.zeros((5, N_STATES)),
        np.zeros((12, 6)),
    )


def new_joint_state(
    p: Array,
    free: FreeParameters,
    theta: Array,
    deviation: Array,
    B: Array,
    levels: NoiseLevels,
    settings: FilterSettings,
    linearised_at: Array | None = None,
    learns: NDArray[np.bool_] | None = None,
) -> JointState:
    """Return a filter that has seen nothing.

    Args:
        p: kernel parameters (170,) for all that is not free.
        theta, deviation: start values and their deviations (n,), or a covariance (n, n) in place of the deviations.
        B: wrench of each unit input (6, m).
        linearised_at: what the motion is linearised about (n,), by default the start values.
        learns: which coefficients are learned (n,), by default all; the others count with their deviation.
    """
    n = len(free)
    waves = bool(np.any(levels.waves > 0.0))
    size = N_FIXED + n + N_BIASES * settings.biases + N_WAVES * waves
    F, A, work, scratch = transition_scratch(n)
    P = np.zeros((size, size))
    block = np.diag(deviation**2) if deviation.ndim == 1 else deviation
    P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n] = block
    kernel = np.array(p)
    start = np.array(theta, dtype=np.float64)
    about = start.copy() if linearised_at is None else np.array(linearised_at, dtype=np.float64)
    put_parameters(kernel, free.codes, about, np.empty((6, 6)))
    x = np.zeros(13)
    x[3] = 1.0
    record = settings.record
    record["waves"] = float(waves)
    record["current_walk"] *= levels.current_walk**2
    record["attitude_bias"][:, 2] = np.maximum(record["attitude_bias"][:, 2], levels.heading_bias)
    state = JointState(
        x=x,
        force=np.zeros(6),
        current=np.zeros(3),
        theta=start,
        bias=np.zeros(N_BIASES),
        wave=np.zeros(N_WAVES),
        water=np.zeros(3),
        rate=np.zeros(6),
        latency=columns_of(free.codes, IN_LATENCY, N_SENSORS),
        place=places_of(free.codes),
        P=P,
        p=kernel,
        linear=np.zeros(37),
        codes=np.ascontiguousarray(free.codes),
        current_at=np.zeros(3),
        away=np.zeros(6),
        linearised_at=about,
        learns=np.ones(n) if learns is None else learns.astype(np.float64),
        information_time=np.zeros(n),
        information_rate=np.zeros(n),
        active=np.ones(size),
        B=np.ascontiguousarray(B),
        noise=np.array(levels.noise, dtype=np.float64),
        disturbance=np.array(levels.disturbance, dtype=np.float64),
        wave_level=np.array(levels.waves, dtype=np.float64),
        velocity_walk=np.fmax(levels.velocity_walk, _LEAST_VELOCITY_WALK),
        settings=record,
        clock=np.zeros(1, dtype=CLOCK),
        shown=np.full(N_MEASURED, np.nan),
        last_accepted=np.zeros(N_SENSORS),
        outages=np.zeros(N_SENSORS, dtype=OUTAGE),
        statistics=np.zeros(N_MEASURED, dtype=STATISTICS),
        disturbance_statistics=np.zeros(6, dtype=DISTURBANCE_STATISTICS),
        wave_statistics=np.zeros(3, dtype=DISTURBANCE_STATISTICS),
        F=F,
        A=A,
        work=work,
        scratch=scratch,
        W=np.zeros((12, size)),
        H=np.zeros((3, size)),
        G=np.zeros((3, size)),
        dx=np.zeros(size),
        mean_force=np.zeros((3, B.shape[1])),
        small=np.zeros((6, 6)),
        innovation=np.zeros(3),
        variance=np.zeros(3),
        tau=np.zeros(6),
    )
    state.active[N_FIXED : N_FIXED + n] = state.learns
    forget_surroundings(state)
    return state


def forget_surroundings(state: JointState, elapsed: float | None = None) -> None:
    """Put current, waves and biases back to what is supposed of them: another recording has its own.

    Of the same water, so long after [s], waves alone are forgotten; current and biases have walked on.
    """
    settings, n, size = state.settings[0], state.theta.size, state.P.shape[0]
    biases = N_FIXED + n
    variance = np.zeros(size)
    variance[18:21] = _CURRENT_STD**2 * (settings.current_walk > 0.0)
    if settings.biases > 0.0:
        variance[biases : biases + 6] = [_GYRO_BIAS**2] * 3 + [_ACCELEROMETER_BIAS**2] * 3
        variance[biases + 6 : biases + N_BIASES] = settings.attitude_bias**2
    if settings.waves > 0.0:
        variance[-N_WAVES:] = np.tile(state.wave_level**2, 2)
    rows = np.r_[18:N_FIXED, biases:size]
    if elapsed is not None:
        rows = np.r_[size - N_WAVES * (settings.waves > 0.0) : size].astype(np.int64)
        state.P[np.r_[18:21], np.r_[18:21]] += settings.current_walk * elapsed
        if settings.biases > 0.0:
            walked = np.r_[biases : biases + 6]
            state.P[walked, walked] += settings.bias_walk * elapsed
    else:
        state.current[:] = state.bias[:] = state.current_at[:] = 0.0
    state.P[rows] = 0.0
    state.P[:, rows] = 0.0
    state.P[rows, rows] = variance[rows]
    state.wave[:] = 0.0
    state.water[:] = state.current


def in_waves(state: JointState, levels: Array, period: float) -> JointState:
    """Return a copy of a filter without waves in whose water they may begin now, with levels (3,) and a period [s]."""
    size = state.P.shape[0] + N_WAVES
    P, settings = np.zeros((size, size)), state.settings.copy()
    P[:-N_WAVES, :-N_WAVES] = state.P
    P[range(size - N_WAVES, size), range(size - N_WAVES, size)] = np.tile(levels**2, 2)
    settings["waves"] = 1.0
    settings["wave_frequency"], settings["wave_decay"] = _turning(period)
    wider = {name: np.zeros((*getattr(state, name).shape[:-1], size)) for name in ("W", "H", "G")}
    wider |= {"dx": np.append(state.dx, np.zeros(N_WAVES)), "active": np.append(state.active, np.ones(N_WAVES))}
    own: dict[str, Any] = {"P": P, "settings": settings, "wave_level": np.array(levels), **wider}
    return JointState(**{name: own[name] if name in own else value.copy() for name, value in state._asdict().items()})


def columns_of(codes: Codes, kind: int, count: int) -> NDArray[np.int64]:
    """Return which coefficient is each of this kind (count,), -1 where none is."""
    out = np.full(count, -1)
    for k, code in enumerate(codes):
        if code[0] == kind:
            out[code[1]] = k
    return out


def places_of(codes: Codes) -> NDArray[np.int64]:
    """Return which coefficients are the place of each sensor of `PLACED` (3, 3), -1 where none is."""
    return columns_of(codes, IN_PLACE, len(PLACES)).reshape(len(PLACED), 3)


def restored_state(arrays: Mapping[str, Any], prefix: str) -> JointState:
    """Return a filter from its arrays, kept by name behind a prefix."""
    records = {"settings": SETTINGS, "clock": CLOCK, "outages": OUTAGE, "statistics": STATISTICS}
    records["disturbance_statistics"] = records["wave_statistics"] = DISTURBANCE_STATISTICS
    kept = {name: arrays[prefix + name] for name in JointState._fields}
    return JointState(**{name: each.view(records.get(name, each.dtype)) for name, each in kept.items()})


@dataclass(frozen=True, eq=False)
class HealthySnapshot:
    """What a filter knew when it was last found healthy: theta (n,), its covariance (n, n), levels."""

    theta: Array
    covariance: Array
    levels: NoiseLevels


def surely_flows(current: Array, variance: Array) -> Array:
    """Return the part of a current (3,) [m/s] that is no chance: none up to 3 deviations, nearly all beyond."""
    chance = _NO_CHANCE**2 * variance
    sure = current**2 > chance
    return np.where(sure, current - chance / np.where(sure, current, 1.0), 0.0)


def healthy_snapshot(state: JointState) -> HealthySnapshot | None:
    """Return what the filter knows; None where a number is not finite or a variance negative."""
    finite = np.isfinite(state.theta).all() and np.isfinite(state.P).all() and np.isfinite(state.x).all()
    if not (finite and (np.diag(state.P) >= 0.0).all()):
        return None
    levels = NoiseLevels(
        state.noise.copy(),
        state.disturbance.copy(),
        state.velocity_walk.copy(),
        state.wave_level.copy(),
        current_walk=math.sqrt(state.settings[0].current_walk),
        heading_bias=float(state.settings[0].attitude_bias[2]),
    )
    return HealthySnapshot(state.theta.copy(), coefficient_block(state).copy(), levels)


def coefficient_block(state: JointState) -> Array:
    """Return the covariance (n, n) of the coefficients, a view."""
    block = slice(N_FIXED, N_FIXED + state.theta.size)
    return state.P[block, block]


def coefficient_std(state: JointState) -> Array:
    """Return the deviations (n,) of the coefficients."""
    return np.asarray(np.sqrt(np.maximum(np.diag(coefficient_block(state)), 0.0)))


def recovered(
    state: JointState, healthy: HealthySnapshot, free: FreeParameters, settings: FilterSettings
) -> JointState:
    """Return a filter that begins its motion anew with what was known last, and trusts that less.

    Inputs keep the delay and the lag that they have been linearised about.
    """
    late = np.isin(free.codes[:, 0], (IN_DELAY, IN_LAG))
    levels = replace(healthy.levels, disturbance=np.sqrt(_RECOVERY_INFLATION) * healthy.levels.disturbance)
    fresh = new_joint_state(
        state.p,
        free,
        healthy.theta,
        _RECOVERY_INFLATION * healthy.covariance,
        state.B,
        levels,
        settings,
        np.where(late, state.linearised_at, healthy.theta),
        learns=state.learns > 0.0,
    )
    for name in ("adapt", "considered_share"):
        fresh.settings[name] = state.settings[name]
    for name in ("rows", "duration", "speeds"):
        fresh.clock[name] = state.clock[name]
    fresh.information_time[:] = state.information_time
    return fresh
