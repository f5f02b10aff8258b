"""Where the joint estimator starts: coefficients from least squares or the body's size, levels from the data."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.joint_state import Tuning
from towtank.identification.log_learning import Levels
from towtank.identification.noise import noise_level, noise_levels
from towtank.identification.parameters import LINEAR, LOG, MASS, NEGATIVE_LOG, PLAIN, QUADRATIC, FreeParameters
from towtank.identification.samples import Samples
from towtank.recording import Recording
from towtank.recording.standard import EULER, MOTION, QUATERNION
from towtank.vehicle import COEFFICIENTS, Vehicle

__all__ = [
    "levels_of",
    "prior_information",
    "rows_noise",
    "rows_rough",
    "size_of",
    "start_levels",
    "start_theta",
    "tuning_for",
    "usual_disturbance",
]

_WATER = 1000.0  # kg/m^3
_FORCE, _MOMENT = 0.006, 0.015  # m/s^2, rad/s^2: what a disturbance does to a vehicle, to begin with
_FLOOR = 0.3  # of that
_LATEST, _FEWEST = 2000, 30  # rows that tell the noise of a stream
_APART = 0.1  # s between two speeds whose difference tells what a vehicle does
_ADDED = 0.6  # of the rigid body's inertia
_LINEAR_SPEED = (0.3, 0.5)  # m/s, rad/s at which a guessed linear damping equals the quadratic one
_TYPICAL = np.array([2e-3] * 3 + [2e-3] * 3 + [1e-2] * 3 + [3e-3] * 3 + [5e-2] * 3)
_LEAST = np.array([1e-5] * 3 + [1e-5] * 3 + [1e-4] * 3 + [1e-5] * 3 + [1e-3] * 3)


def start_levels(recording: Recording, vehicle: Vehicle) -> Levels:
    """Return noise levels from the recording's own samples and a usual level of the disturbance."""
    found = noise_levels(recording)
    if all(name in recording for name in QUATERNION) and not all(name in found for name in EULER):
        found = {**found, **{name: found[q] for name, q in zip(EULER, QUATERNION[1:], strict=True) if q in found}}
    noise = _TYPICAL.copy()
    for j, name in enumerate(MOTION):
        level = found.get(name)
        if level is not None and np.isfinite(level.std) and level.std > 0.0 and not level.dead:
            noise[j] = max(level.of_each(_rate(recording, name)), level.quantum / math.sqrt(12.0), float(_LEAST[j]))
    return Levels(noise, usual_disturbance(vehicle))


def levels_of(recordings: Sequence[Recording], samples: Sequence[Samples], vehicle: Vehicle) -> Levels:
    """Return the levels that several recordings start with: their usual noise, the largest roughness."""
    each = [start_levels(recording, vehicle) for recording in recordings]
    rough = np.fmax.reduce([rows_rough(one.t, one.values) for one in samples], axis=0)
    return Levels(np.median([level.noise for level in each], axis=0), each[0].sigma, rough)


def rows_noise(t: Array, values: Array) -> Array:
    """Return the noise (15,) of rows (n,), (n, 15), from the latest of them."""
    noise = _TYPICAL.copy()
    for j, name in enumerate(MOTION):
        column = values[-_LATEST:, j]
        known = np.isfinite(column)
        if known.sum() < _FEWEST:
            continue
        stamps = t[-_LATEST:][known]
        regular = np.concatenate([[True], np.diff(stamps) > 0.0])
        level = noise_level(stamps[regular], column[known][regular], "angle" if name in ("phi", "psi") else "linear")
        if np.isfinite(level.std) and level.std > 0.0 and not level.dead:
            span = float(stamps[-1] - stamps[0])
            rate = (len(stamps) - 1) / span if span > 0.0 else level.rate
            noise[j] = max(level.of_each(rate), level.quantum / math.sqrt(12.0), float(_LEAST[j]))
    return noise


def rows_rough(t: Array, values: Array) -> Array:
    """Return what the speeds of rows (n,), (n, 15) do in all, as a random walk (6,) [m/s^2 sqrt(s), rad/s^2 sqrt(s)].

    No model leaves more than this unexplained: a filter that starts from here cannot lose the motion. NaN where there
    are too few samples to tell.
    """
    rough = np.full(6, np.nan)
    for i in range(6):
        known = np.isfinite(values[:, 6 + i])
        if known.sum() < _FEWEST:
            continue
        stamps, speeds = t[known], values[known, 6 + i]
        apart = np.searchsorted(stamps, stamps + _APART)
        from_, to = np.flatnonzero(apart < stamps.size), apart[apart < stamps.size]
        near = stamps[to] - stamps[from_] < 5.0 * _APART
        if near.any():
            steps = (speeds[to] - speeds[from_])[near] ** 2 / (stamps[to] - stamps[from_])[near]
            rough[i] = math.sqrt(float(np.mean(steps)))
    return rough


def prior_information(prior: Vehicle, free: FreeParameters) -> tuple[Array, Array]:
    """Return mean (n,) and information (n, n) of a vehicle whose coefficients bear deviations."""
    mean = free.theta(prior, delay=prior.command_delay, lag=0.05)
    slopes = free.slopes(mean)
    information = np.zeros((len(free), len(free)))
    for k, name in enumerate(free.names):
        std = prior.deviation(name) if name in COEFFICIENTS else None
        if std is not None and std > 0.0:
            information[k, k] = (slopes[k] / std) ** 2
    return mean, information


def _rate(recording: Recording, name: str) -> float:
    channel = recording[name] if name in recording else recording[QUATERNION[0]]
    known = channel.measured
    return (len(known) - 1) / max(float(known.t[-1] - known.t[0]), 1e-9) if len(known) > 1 else 1.0


def usual_disturbance(vehicle: Vehicle) -> Array:
    """Return levels (6,) [N, N m] of a disturbance that a vehicle of this inertia feels."""
    inertia = np.diag(vehicle.rigid_body_matrix) * (1.0 + _ADDED)
    return np.asarray(inertia * np.array([_FORCE] * 3 + [_MOMENT] * 3), dtype=np.float64)


def tuning_for(vehicle: Vehicle) -> Tuning:
    """Return the filter's settings for a vehicle: floors of the disturbance in proportion to its inertia."""
    usual = usual_disturbance(vehicle)
    return Tuning(
        floor_force=_FLOOR * float(usual[:3].min()),
        floor_moment=_FLOOR * float(usual[3:].min()),
        usual=tuple(float(level) for level in usual),
    )


def start_theta(vehicle: Vehicle, known: Vehicle, free: FreeParameters, *, delay: float, lag: float) -> Array:
    """Return theta (n,): the values of `known` where it has them, else what a body of this size would have."""
    theta = free.theta(known, delay=delay, lag=lag)
    rigid = vehicle.rigid_body_matrix
    for k, name in enumerate(free.names):
        kind, i, transform = free.codes[k, 0], free.codes[k, 1], free.codes[k, 3]
        if kind == MASS and transform == LOG:
            if known.coefficient(name) == 0.0:
                theta[k] = math.log((1.0 + _ADDED) * rigid[i, i])
            theta[k] = max(theta[k], math.log(0.3 * rigid[i, i]))
        elif transform == NEGATIVE_LOG and not known.coefficient(name) < 0.0:
            other = _other_damping(free, k)
            theta[k] = math.log(_damping_guess(vehicle, int(kind), int(i)) * (0.1 if _has(known, other) else 1.0))
    return theta


def _other_damping(free: FreeParameters, k: int) -> str:
    name = free.names[k]
    return name[:3] if free.codes[k, 0] == QUADRATIC else name + name[-1]


def _has(vehicle: Vehicle, name: str) -> bool:
    return vehicle.coefficient(name) < 0.0


def _damping_guess(vehicle: Vehicle, kind: int, axis: int) -> float:
    length = (float(vehicle.rigid_body_matrix[0, 0]) / _WATER) ** (1.0 / 3.0)
    quadratic = 0.5 * _WATER * length**2 if axis < 3 else 0.05 * _WATER * length**5
    return float(quadratic * _LINEAR_SPEED[0 if axis < 3 else 1]) if kind == LINEAR else quadratic


def size_of(vehicle: Vehicle, free: FreeParameters) -> Array:
    """Return the size (n,) of the coefficients that are no logarithms, for a wide start; 1 for logarithms."""
    rigid = np.diag(vehicle.rigid_body_matrix)
    usual = usual_disturbance(vehicle)
    out = np.ones(len(free))
    length = (float(rigid[0]) / _WATER) ** (1.0 / 3.0)
    weight = 9.81 * float(rigid[0])
    for k in range(len(free)):
        kind, i, j, transform = (int(c) for c in free.codes[k])
        if transform != PLAIN:
            continue
        if kind == MASS:
            out[k] = 0.3 * math.sqrt(rigid[i] * rigid[j])
        elif kind in (LINEAR, QUADRATIC):
            guess = math.sqrt(_damping_guess(vehicle, kind, i) * _damping_guess(vehicle, kind, j))
            out[k] = 0.5 * guess
        elif kind == 3:  # weight
            out[k] = 0.05 * weight
        elif kind == 4:  # restoring moment
            out[k] = 0.1 * weight * length
        elif kind == 5:  # constant wrench
            out[k] = 3.0 * usual[i]
    return out
