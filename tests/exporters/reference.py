"""Rates of states and their derivatives, by the package's own kernels, for programs that have both."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from towtank.core.arrays import Array
from towtank.core.rk4 import stage_into
from towtank.exporters.request import speed_range
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

_STENCIL = ((3, 1.0 / 60.0), (2, -9.0 / 60.0), (1, 45.0 / 60.0))  # exact to the sixth power


def lags_of(vehicle: Vehicle) -> Array:
    return np.array([each.time_constant for each in vehicle.thrusters])


def rate_of_wrench(vehicle: Vehicle, x: Array, tau: Array, current: Array) -> Array:
    """The rate (n, 13) of states (n, 13) under wrenches (n, 6) in currents (n, 3), a state at a time."""
    p = np.array(vehicle.parameters)[:, None]
    out = np.empty((len(x), 13))
    rate = np.empty((13, 1))
    for k, (state, wrench) in enumerate(zip(x, tau, strict=True)):
        stage_into(
            p, np.ascontiguousarray(state[:13, None]), np.ascontiguousarray(wrench[:, None]), current[k], rate, True
        )
        out[k] = rate[:, 0]
    return out


def wrench_of_forces(vehicle: Vehicle, nu: Array, forces: Array) -> Array:
    """The wrench (n, 6) of thrusters on vehicles that move with nu (n, 6)."""
    B = configuration_matrix(vehicle)
    return np.asarray((forces - vehicle.coefficient("inflow_loss") * np.abs(forces) * (nu @ B)) @ B.T)


def rate_of_commands(vehicle: Vehicle, x: Array, u: Array, current: Array, voltage: float | None = None) -> Array:
    """The rate (n, 13 + lagged) of states under commands; the forces of thrusters with a lag are states."""
    steady = thruster_forces(vehicle, u, voltage)
    lags = lags_of(vehicle)
    forces = steady.copy()
    forces[:, lags > 0.0] = x[:, 13:]
    moved = rate_of_wrench(vehicle, x, wrench_of_forces(vehicle, x[:, 7:13], forces), current)
    return np.hstack([moved, (steady - forces)[:, lags > 0.0] / lags[lags > 0.0]])


def derivative(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """The derivatives (n, rows, columns) of rows of a function by each column of `at` (n, columns)."""
    columns = []
    for j, step in enumerate(steps):
        total: Array | float = 0.0
        for many, weight in _STENCIL:
            ahead, astern = at.copy(), at.copy()
            ahead[:, j] += many * step
            astern[:, j] -= many * step
            total = total + weight * (function(ahead) - function(astern))
        columns.append(np.asarray(total) / step)
    return np.stack(columns, axis=-1)


def random_full_states(vehicle: Vehicle, count: int, seed: int = 0) -> tuple[Array, Array]:
    """States (n, 13 + lagged) away from where drag and loss of thrust have a kink, and the steps for `derivative`."""
    chance = np.random.default_rng(seed)

    def away(n: int) -> Array:
        return chance.choice([-1.0, 1.0], (count, n)) * chance.uniform(0.1, 1.0, (count, n))

    speeds = speed_range(vehicle)
    q = chance.standard_normal((count, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    lagged = int(np.count_nonzero(lags_of(vehicle)))
    x = np.hstack([away(3), q, away(6) * speeds, away(lagged) * 20.0])
    steps = np.concatenate([np.full(3, 0.03), np.full(4, 0.03), 0.03 * speeds, np.full(lagged, 0.6)])
    return x, steps
