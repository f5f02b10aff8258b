"""What is supposed of coefficients before any data: by the body's size, or by a vehicle with deviations."""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.model.parameters import (
    LINEAR,
    LOG,
    MASS,
    NEGATIVE_LOG,
    QUADRATIC,
    UNTRANSFORMED,
    FreeParameters,
)
from towtank.vehicle import COEFFICIENTS, Vehicle

__all__ = ["prior_information", "size_of", "start_theta", "usual_disturbance"]

_WATER = 1000.0  # kg/m^3
_FORCE, _MOMENT = 0.006, 0.015  # m/s^2, rad/s^2: what a disturbance does to a vehicle, to begin with
_ADDED = 0.6  # of the rigid body's inertia
_LINEAR_SPEED = (0.3, 0.5)  # m/s, rad/s at which a guessed linear damping equals the quadratic one


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


def usual_disturbance(vehicle: Vehicle) -> Array:
    """Return levels (6,) [N, N m] of a disturbance that a vehicle of this inertia feels."""
    inertia = np.diag(vehicle.rigid_body_matrix) * (1.0 + _ADDED)
    return np.asarray(inertia * np.array([_FORCE] * 3 + [_MOMENT] * 3), dtype=np.float64)


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
        if transform != UNTRANSFORMED:
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
