"""Configurations met before: whether what a vehicle has become is one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.change_window import Window
from towtank.identification.joint_start import size_of
from towtank.identification.parameters import DELAY, GAIN_PREFIX, IN_GAIN, LAG, PLAIN, FreeParameters
from towtank.vehicle import COEFFICIENTS, Vehicle

__all__ = ["Known", "known_as", "likeness"]

_REPEATS = 0.01  # share by which a vehicle differs from itself, taken up again
_NO_STD = 0.05  # share by which a coefficient is known that bears no deviation
_UNKNOWN = 0.5  # probability, to begin with, that a changed vehicle has not been met before


@dataclass(frozen=True, eq=False)
class Known:
    """A configuration in the coordinates of a filter: its name, theta (n,), covariance (n, n)."""

    name: str
    theta: Array
    covariance: Array


def known_as(name: str, model: Vehicle, vehicle: Vehicle, free: FreeParameters, theta0: Array, P0: Array) -> Known:
    """Return a stored model as a configuration. What it does not tell of is as before: theta0 (n,), P0 (n, n)."""
    n = len(free)
    theta = free.theta(model, delay=model.command_delay, lag=0.05)
    slopes, size = np.abs(free.slopes(theta)), size_of(vehicle, free)
    gains = {each.name: each.gain for each in model.thrusters}
    before = {each.name: each.gain for each in vehicle.thrusters}
    std = np.zeros(n)
    told = np.zeros(n, dtype=bool)
    for k, coefficient in enumerate(free.names):
        if free.codes[k, 0] == IN_GAIN:
            thruster = coefficient.removeprefix(GAIN_PREFIX)
            theta[k] = np.log(max(gains.get(thruster, before[thruster]) / before[thruster], 1e-3))
            std[k], told[k] = _REPEATS, True
            continue
        if coefficient in (DELAY, LAG) or coefficient not in COEFFICIENTS or not np.isfinite(theta[k]):
            continue
        value = abs(model.coefficient(coefficient))
        given = model.deviation(coefficient)
        plain = free.codes[k, 3] == PLAIN
        if value == 0.0 and given is None and not plain:
            continue  # it has none in the file
        scale = max(value, 0.1 * size[k]) if plain else slopes[k]
        std[k] = np.hypot(given if given is not None else _NO_STD * scale, _REPEATS * scale) / slopes[k]
        told[k] = True
    covariance = np.where(np.outer(told, told), np.diag(std**2), 0.0)
    left = np.outer(~told, ~told)
    covariance = np.where(left, P0, covariance)
    return Known(name, np.where(told, theta, theta0), covariance)


def likeness(window: Window, known: Sequence[Known], otherwise: float) -> Array:
    """Return the probability of each configuration and, last, of none of them (k + 1,).

    Args:
        otherwise: log evidence of a vehicle that has not been met before, on the scale of `Window.evidence`.
    """
    each = -np.log(max(len(known), 1)) + np.log1p(-_UNKNOWN)
    scores = [each + window.evidence(one.covariance, one.theta - window.theta0) for one in known]
    scores.append(float(np.log(_UNKNOWN)) + otherwise)
    return np.asarray(np.exp(np.array(scores) - np.logaddexp.reduce(scores)))
