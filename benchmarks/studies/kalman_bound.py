"""Cramer-Rao bounds of a free motion with random wrenches: the covariance of a Kalman filter linearised at the truth.

Unknown are the coefficients (logarithms, constant), the motion, the random wrench of every axis (its exact discrete
form, held over each step) and the gyro's constant bias. To first order everything is linear and Gaussian, and then the
covariance of the Kalman filter is the inverse of the information: no unbiased estimator does better, with its two
passes or more, given the same samples. The motion of one seed stands for the truth, or the motion without random
wrenches.

Prior deviations of the start: position 1 m and, where no sensor tells the attitude, 0.05 rad (the vehicle rests, its
righting moment holds it level), otherwise 1 rad; velocity 0.01 m/s and rad/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from bound import Flags, visible
from experiments import DT, Experiment
from scipy.linalg import cho_factor, cho_solve
from transitions import N_ERROR, transitions

from towtank.core.arrays import Array
from towtank.core.attitude import euler_rates_matrix, eulers_from_quaternions, quaternions_from_eulers
from towtank.recording.standard import POSE, VELOCITIES
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, simulate
from towtank.vehicle import thruster_wrench

__all__ = ["Block", "Bound", "kalman_bound", "measurements", "motion_of"]

_WRENCH = slice(N_ERROR, N_ERROR + 6)
_BIAS = slice(N_ERROR + 6, N_ERROR + 9)
_FIRST = N_ERROR + 9  # of the coefficients
_LN_PRIOR = 30.0  # of the logarithms: a factor of 1e13 either way
_PRIOR_POSITION, _PRIOR_TILT, _PRIOR_RATE = 1.0, 0.05, 0.01
_NO_ATTITUDE = 1.0  # rad, where the attitude is measured


@dataclass(frozen=True, eq=False)
class Block:
    """One instrument: rows of H (m, 21) on [error state 12, wrench 6, bias 3] and variances (m,), at some steps.

    Attributes:
        steps: (n + 1,) whether it samples at this step. euler: its rows are phi theta psi, whose H turns with them.
    """

    steps: Flags
    H: Array
    variances: Array
    euler: bool = False


@dataclass(frozen=True, eq=False)
class Bound:
    """Least deviations of the logarithms (m, k) at times t (m,) [s], and their full covariance at the end (k, k)."""

    t: Array
    std: Array
    covariance: Array


def kalman_bound(experiment: Experiment, *, seed: int | None = None, every: float = 0.5) -> Bound:
    """Return the bound of an experiment whose delay is known.

    Args:
        seed: whose motion and hidden samples are the truth; None: no random wrench, every sample seen.
        every: time between two rows of the result [s].
    """
    if (
        not experiment.delay_known
        or experiment.truth.command_delay
        or any(thruster.time_constant for thruster in experiment.truth.thrusters)
    ):
        raise ValueError(f"{experiment.name}: a delay or a lag is not part of this bound")
    states, wrench = motion_of(experiment, seed)
    F, B, Q = transitions(experiment.truth, states, wrench, experiment.free, DT)
    blocks = measurements(experiment, len(states), seed)
    eulers = eulers_from_quaternions(np.ascontiguousarray(states[:, 3:7]))
    deviations, a = _disturbance(experiment.disturbance)
    k = len(experiment.free)
    size = _FIRST + k
    P = np.diag(np.concatenate([_start(experiment), deviations**2, _bias(experiment) ** 2, np.full(k, _LN_PRIOR**2)]))
    t, rows = [], []
    step = np.eye(size)
    stride = round(every / DT)
    for i in range(len(states)):
        for block in blocks:
            if block.steps[i]:
                P = _updated(P, _at(block, eulers[i], size), block.variances)
        if i % stride == 0:
            t.append(i * DT)
            rows.append(np.sqrt(np.diag(P)[_FIRST:]))
        if i == len(states) - 1:
            break
        step[:N_ERROR, :N_ERROR], step[:N_ERROR, _WRENCH], step[:N_ERROR, _FIRST:] = F[i], B[i], Q[i]
        step[_WRENCH, _WRENCH] = a * np.eye(6)
        P = step @ P @ step.T
        P[_WRENCH, _WRENCH] += (1.0 - a * a) * np.diag(deviations**2)
        P = 0.5 * (P + P.T)
    return Bound(np.array(t), np.array(rows), P[_FIRST:, _FIRST:].copy())


def motion_of(experiment: Experiment, seed: int | None) -> tuple[Array, Array]:
    """Return the true states (n + 1, 13) and the wrench (n, 6), thrusters and random, of a seed, or without random."""
    disturbance = None if seed is None else experiment.disturbance
    run = simulate(
        experiment.truth,
        commands=experiment.commands,
        dt=DT,
        eta0=experiment.eta0,
        disturbance=disturbance,
        seed=seed or 0,
    )
    pose, nu = (np.column_stack([run[name].values for name in names]) for names in (POSE, VELOCITIES))
    states = np.hstack([pose[:, :3], quaternions_from_eulers(np.ascontiguousarray(pose[:, 3:])), nu])
    wrench = thruster_wrench(experiment.truth, experiment.commands)
    return states, wrench if disturbance is None else wrench + disturbance.sample(len(wrench), DT, seed or 0)


def measurements(experiment: Experiment, n: int, seed: int | None) -> tuple[Block, ...]:
    """Return the instruments of an experiment over n samples."""
    sensors = experiment.sensors
    if isinstance(sensors, Mocap):
        seen = (
            visible(sensors, DT * np.arange(n, dtype=np.float64), seed)
            if seed is not None
            else np.ones(n, dtype=np.bool_)
        )
        due = _due(n, sensors.rate)
        angles = _rows((3, 4, 5))
        return (
            Block(due & seen, _rows((0, 1, 2)), np.full(3, (1e-3 * sensors.noise_mm) ** 2)),
            Block(due, angles, np.full(3, (1e-3 * sensors.noise_mrad) ** 2), euler=True),
        )
    found = []
    if "u" not in experiment.hidden:
        found.append(Block(_due(n, sensors.dvl_rate), _rows((6, 7, 8)), np.full(3, sensors.dvl_noise**2)))
    if "p" not in experiment.hidden:
        gyro = _rows((9, 10, 11))
        gyro[:, _BIAS] = np.eye(3)
        found.append(Block(_due(n, sensors.imu_rate), gyro, np.full(3, sensors.gyro_noise**2)))
    if "z" not in experiment.hidden:
        found.append(Block(_due(n, sensors.depth_rate), _rows((2,)), np.full(1, sensors.depth_noise**2)))
    if "phi" not in experiment.hidden or "ax" not in experiment.hidden:
        raise ValueError(f"{experiment.name}: attitude and accelerometer are not part of this bound")
    return tuple(found)


def _updated(P: Array, H: Array, variances: Array) -> Array:
    """Return the covariance after a measurement, in Joseph's form."""
    PH = P @ H.T
    K = cho_solve(cho_factor(H @ PH + np.diag(variances), lower=True), PH.T).T
    left = np.eye(len(P)) - K @ H
    out: Array = left @ P @ left.T + (K * variances) @ K.T
    return out


def _at(block: Block, euler: Array, size: int) -> Array:
    H = np.zeros((len(block.H), size))
    H[:, : block.H.shape[1]] = block.H
    if block.euler:
        H[:, 3:6] = euler_rates_matrix(euler[0], euler[1])
    return H


def _rows(columns: tuple[int, ...]) -> Array:
    H = np.zeros((len(columns), _FIRST))
    H[np.arange(len(columns)), columns] = 1.0
    return H


def _due(n: int, rate: float) -> Flags:
    """Return (n,) at which steps a sensor samples: the nearest to k / rate."""
    every = max(1.0 / (rate * DT), 1.0)
    steps = np.rint(np.arange(math.floor((n - 1) / every * (1.0 + 1e-12)) + 1) * every).astype(np.intp)
    due = np.zeros(n, dtype=np.bool_)
    due[steps[steps < n]] = True
    return due


def _disturbance(disturbance: OrnsteinUhlenbeck | None) -> tuple[Array, float]:
    if disturbance is None:
        return np.zeros(6), 0.0
    return disturbance.deviations, math.exp(-DT / disturbance.time_constant)


def _start(experiment: Experiment) -> Array:
    """Return the prior variances (12,) of the start."""
    tilt = _PRIOR_TILT if isinstance(experiment.sensors, Ins) else _NO_ATTITUDE
    return np.concatenate([np.full(3, _PRIOR_POSITION), np.full(3, tilt), np.full(6, _PRIOR_RATE)]) ** 2


def _bias(experiment: Experiment) -> Array:
    return np.full(3, experiment.sensors.gyro_bias if isinstance(experiment.sensors, Ins) else 0.0)
