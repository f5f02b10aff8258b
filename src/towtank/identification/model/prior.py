"""What is supposed of coefficients before any data: by the body's size, or by a vehicle with deviations."""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.model.parameters import MASS, QUADRATIC, FreeParameters
from towtank.identification.model.terms import (
    ADDED,
    LOG,
    NEGATIVE_LOG,
    TERMS,
    UNTRANSFORMED,
    body_size,
    damping_guess,
    usual_disturbance,
)
from towtank.vehicle import COEFFICIENTS, Vehicle

__all__ = ["prior_information", "size_of", "start_theta", "usual_disturbance"]


def prior_information(prior: Vehicle, free: FreeParameters) -> tuple[Array, Array]:
    """Return mean (n,) and information (n, n) of a vehicle whose coefficients bear deviations, or that has [prior]."""
    values = free.values(free.theta(prior, delay=prior.command_delay, lag=0.05))
    deviations = [prior.deviation(name) if name in COEFFICIENTS else None for name in free.names]
    for k, name in enumerate(free.names):
        if name in prior.prior:
            values[k], deviations[k] = prior.prior[name].value, prior.prior[name].std
    mean = free.thetas(values)
    slopes = free.slopes(mean)
    information = np.zeros((len(free), len(free)))
    for k, std in enumerate(deviations):
        if std is not None and std > 0.0:
            information[k, k] = (slopes[k] / std) ** 2
    return mean, information


def start_theta(vehicle: Vehicle, known: Vehicle, free: FreeParameters, *, delay: float, lag: float) -> Array:
    """Return theta (n,): the values of `known` where it has them, else what a body of this size would have."""
    theta = free.theta(known, delay=delay, lag=lag)
    rigid = vehicle.rigid_body_matrix
    for k, name in enumerate(free.names):
        kind, i, transform = free.codes[k, 0], free.codes[k, 1], free.codes[k, 3]
        if kind == MASS and transform == LOG:
            if known.coefficient(name) == 0.0:
                theta[k] = math.log((1.0 + ADDED) * rigid[i, i])
            theta[k] = max(theta[k], math.log(0.3 * rigid[i, i]))
        elif transform == NEGATIVE_LOG and not known.coefficient(name) < 0.0:
            other = _other_damping(free, k)
            theta[k] = math.log(
                damping_guess(body_size(vehicle), int(kind), int(i)) * (0.1 if _has(known, other) else 1.0)
            )
    return theta


def _other_damping(free: FreeParameters, k: int) -> str:
    name = free.names[k]
    return name[:3] if free.codes[k, 0] == QUADRATIC else name + name[-1]


def _has(vehicle: Vehicle, name: str) -> bool:
    return vehicle.coefficient(name) < 0.0


def size_of(vehicle: Vehicle, free: FreeParameters) -> Array:
    """Return the size (n,) of the coefficients that are no logarithms, for a wide start; 1 for all others."""
    body = body_size(vehicle)
    out = np.ones(len(free))
    for k in range(len(free)):
        kind, i, j, transform = (int(c) for c in free.codes[k])
        if transform == UNTRANSFORMED and kind in TERMS:
            out[k] = TERMS[kind].size(body, i, j)
    return out
