"""How one step of a vehicle answers to its state, its wrench and its coefficients, along a given motion.

The error state is [position 3 NED, attitude 3 as a small rotation in the body, nu 6], the coefficients are logarithms.
Everything is by central differences of single Runge-Kutta steps: nothing of the estimators' own linearisation is used.
"""

from __future__ import annotations

import numpy as np
from sensitivity import changed

from towtank.core.arrays import Array
from towtank.core.rk4 import simulate_runs
from towtank.vehicle import Vehicle

__all__ = ["N_ERROR", "error_between", "perturbed", "transitions"]

N_ERROR = 12
_STEP = 1e-5
_CHUNK = 400  # steps at a time


def transitions(vehicle: Vehicle, states: Array, wrench: Array, names: tuple[str, ...], dt: float) -> tuple[Array, ...]:
    """Return F (n, 12, 12), B (n, 12, 6) for a wrench held over the step, and Q (n, 12, k) for the coefficients.

    Args:
        states: (n + 1, 13) along which to linearise, their last row unused. wrench: total (n, 6) of every step.
    """
    n, k = len(wrench), len(names)
    still = np.zeros(3)
    p = np.array(vehicle.parameters)
    variants = [np.array(changed(vehicle, name, side * _STEP).parameters) for name in names for side in (1.0, -1.0)]
    out = np.empty((n, N_ERROR, N_ERROR + 6 + k))
    for first in range(0, n, _CHUNK):
        x, tau = states[first : first + _CHUNK][: n - first], wrench[first : first + _CHUNK]
        m = len(tau)
        ends = []
        for j in range(N_ERROR):
            for side in (1.0, -1.0):
                ends.append((p, perturbed(x, side * _STEP * np.eye(N_ERROR)[j]), tau))
        for j in range(6):
            for side in (1.0, -1.0):
                ends.append((p, x, tau + side * _STEP * np.eye(6)[j]))
        ends += [(variant, x, tau) for variant in variants]
        after = []
        for parameters, start, force in ends:
            rows = np.ascontiguousarray(np.broadcast_to(parameters, (m, parameters.size)))
            after.append(simulate_runs(rows, np.ascontiguousarray(start), force[:, None, :].copy(), dt, still, 1)[:, 0])
        for j in range(N_ERROR + 6 + k):
            out[first : first + m, :, j] = error_between(after[2 * j + 1], after[2 * j]) / (2.0 * _STEP)
    return out[:, :, :N_ERROR], out[:, :, N_ERROR : N_ERROR + 6], out[:, :, N_ERROR + 6 :]


def perturbed(states: Array, error: Array) -> Array:
    """Return states (n, 13) moved by an error (12,)."""
    out = states.copy()
    out[:, :3] += error[:3]
    small = np.concatenate([[np.sqrt(1.0 - 0.25 * error[3:6] @ error[3:6])], 0.5 * error[3:6]])
    out[:, 3:7] = _product(states[:, 3:7], small)
    out[:, 7:] += error[6:]
    return out


def error_between(a: Array, b: Array) -> Array:
    """Return the error (n, 12) that leads from states a to b (n, 13), to second order."""
    conjugate = a[:, 3:7] * np.array([1.0, -1.0, -1.0, -1.0])
    turn = _product(conjugate, b[:, 3:7])
    angle = 2.0 * turn[:, 1:] * np.sign(turn[:, :1])
    return np.hstack([b[:, :3] - a[:, :3], angle, b[:, 7:] - a[:, 7:]])


def _product(a: Array, b: Array) -> Array:
    """Return Hamilton products (n, 4) of quaternions (n, 4) and (n, 4) or (4,)."""
    w, x, y, z = np.moveaxis(a, -1, 0)
    s, i, j, k = np.moveaxis(np.broadcast_to(b, a.shape), -1, 0)
    return np.stack(
        [
            w * s - x * i - y * j - z * k,
            w * i + x * s + y * k - z * j,
            w * j - x * k + y * s + z * i,
            w * k + x * j - y * i + z * s,
        ],
        axis=-1,
    )
