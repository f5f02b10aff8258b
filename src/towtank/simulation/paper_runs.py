"""The two surge experiments of the paper: stairs and square wave with equal commands on all horizontal thrusters.

Stairs: 13, 18, 23, 28 for 2 s each ahead, then the same astern. Square: +-30, period 5 s. Both after 0.5 s at rest.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.vehicle import Vehicle, configuration_matrix

__all__ = ["REST", "paper_commands", "paper_force", "square_orders", "stairs_orders"]

REST = 0.5  # s
_LEVELS = np.array([13.0, 18.0, 23.0, 28.0]) / 28.0
_LEVEL_TIME = 2.0  # s
_PERIOD = 5.0  # s
_HORIZONTAL = 0.3  # least part of a thruster's force along x
_FITTED = (0.0684, -0.03366, 0.006736)  # the paper's (7), newtons of |command|
_DEAD_BAND = 5.0


def stairs_orders(t: Array, amplitude: float) -> Array:
    """Return the orders (n,) of the stairs, positive ahead; the last step is `amplitude` (28 in the paper)."""
    k = np.floor((t - REST) / _LEVEL_TIME + 1e-9).astype(np.intp)
    return np.where(k < 0, 0.0, amplitude * np.concatenate([_LEVELS, -_LEVELS])[k % 8])


def square_orders(t: Array, amplitude: float) -> Array:
    """Return the orders (n,) of the square wave, ahead first; `amplitude` is 30 in the paper."""
    k = np.floor((t - REST) / (0.5 * _PERIOD) + 1e-9).astype(np.intp)
    return np.where(k < 0, 0.0, amplitude * (1.0 - 2.0 * (k % 2)))


def paper_commands(vehicle: Vehicle, orders: Array) -> Array:
    """Return the commands (n, m): the order on each horizontal thruster with the sign that pushes ahead.

    Raises:
        InputError: no thruster pushes along x, or a command would be beyond the limits of its thruster.
    """
    ahead = configuration_matrix(vehicle)[0]
    if not (np.abs(ahead) > _HORIZONTAL).any():
        raise InputError(f"{vehicle.name}: no thruster pushes along x, so there is no surge run")
    out = np.empty((orders.size, ahead.size))
    for k, thruster in enumerate(vehicle.thrusters):
        curve = thruster.curve
        out[:, k] = curve.rest + (orders * np.sign(ahead[k]) if abs(ahead[k]) > _HORIZONTAL else 0.0)
        low, high = (-math.inf, math.inf) if curve.limits is None else curve.limits
        if out[:, k].min() < low or out[:, k].max() > high:
            raise InputError(
                f"{vehicle.name}: commands of +-{np.abs(orders).max():g} are beyond the limits {low:g} .. {high:g} "
                f'of thruster "{thruster.name}"; give an amplitude in its unit'
            )
    return out


def paper_force(orders: Array) -> Array:
    """Return the surge force (n,) [N] of the paper's vehicle, X = 2 (cos 45 + cos 35) F(order)."""
    size = np.abs(orders)
    force = np.where(size < _DEAD_BAND, 0.0, np.polynomial.polynomial.polyval(size, _FITTED))
    return 2.0 * (math.cos(math.radians(45.0)) + math.cos(math.radians(35.0))) * np.sign(orders) * force
