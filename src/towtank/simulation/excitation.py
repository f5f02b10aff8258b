"""How hard and how fast to drive a vehicle along each axis so that it moves well and stays upright.

A third of what the thrusters can give is the rule, but no more than a gentle motion needs: about 0.6 m/s, a slow turn,
and in roll and pitch a tilt of ten degrees at rest (some twice that when it swings), also where the tilt comes from
horizontal thrusters above or below the origin. The periods of roll and pitch follow the natural period of the pendulum;
surge that tilts keeps away from it. Without thrusters the wrench comes from the mass.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array
from towtank.vehicle import Vehicle, allocatable_axes, configuration_matrix, curve_force, force_range

__all__ = ["AXES", "available_rows", "fit_to_thrusters", "tempo", "usual_amplitudes"]

AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_FRACTION = 0.35  # of what the thrusters can give on an axis
_HEADROOM = 0.9  # of what a thruster can give, where several axes are driven at once
_ACCELERATION = np.array([0.4, 0.4, 0.4, 0.1, 0.1, 0.4])  # m/s^2, rad/s^2, of a vehicle without thrusters
_GENTLE = {0: (0.6, 0.25), 1: (0.6, 0.25), 2: (0.6, 0.25), 5: (0.8, 0.8)}  # speed held against drag, acceleration
_TILT = math.sin(math.radians(10.0))
_TILT_ACCELERATION = 0.1  # rad/s^2
_SIDE_EFFECTS = ((0, 4), (1, 3))  # surge that pitches, sway that rolls
_USUAL_PERIOD = 5.0  # s, of a square wave


def available_rows(vehicle: Vehicle) -> tuple[int, ...]:
    """Return the rows 0..5 of the wrench that can be commanded one by one; all of them without thrusters."""
    return tuple(sorted(allocatable_axes(vehicle))) if vehicle.thrusters else tuple(range(6))


def usual_amplitudes(vehicle: Vehicle) -> Array:
    """Return a sensible amplitude (6,) [N, N m] for each axis; 0 where it cannot be commanded."""
    inertia = np.abs(np.diag(vehicle.mass_matrix))
    out: Array = _ACCELERATION * inertia
    if vehicle.thrusters:
        largest = _largest(vehicle)
        out = np.where(np.isfinite(largest), _FRACTION * largest, out)
    for row, (speed, acceleration) in _GENTLE.items():
        axis, motion = "XYZKMN"[row], "uvwpqr"[row]
        linear, quadratic = (abs(vehicle.coefficient(f"{axis}_{name}")) for name in (motion, 2 * motion))
        out[row] = min(out[row], acceleration * inertia[row] + linear * speed + quadratic * speed**2)
    for row in (3, 4):
        out[row] = min(out[row], _tilting_moment(vehicle, row))
    for force, moment in _SIDE_EFFECTS:
        arm = _arm(vehicle, force, moment)
        if arm > 0.0:
            out[force] = min(out[force], _tilting_moment(vehicle, moment) / arm)
    return out


def tempo(vehicle: Vehicle, row: int) -> float:
    """Return by what factor the usual periods of the wave forms are stretched for an axis.

    A square wave of 5 s becomes one of one and a half natural periods in roll and pitch, and one of at least two
    natural periods in surge or sway that tilts the vehicle; 1 for the other axes.
    """
    if row in (3, 4):
        natural = _natural_period(vehicle, row)
        return min(max(1.5 * natural / _USUAL_PERIOD, 0.2), 2.0) if natural else 1.0
    for force, moment in _SIDE_EFFECTS:
        if force == row and _arm(vehicle, force, moment) > 0.0:
            return min(max(2.0 * _natural_period(vehicle, moment) / _USUAL_PERIOD, 1.0), 2.0)
    return 1.0


def _tilting_moment(vehicle: Vehicle, row: int) -> float:
    """Return the moment [N m] that tilts gently in roll (3) or pitch (4)."""
    righting = abs(vehicle.coefficient("BG_z"))
    return _TILT * righting + _TILT_ACCELERATION * abs(float(vehicle.mass_matrix[row, row]))


def _natural_period(vehicle: Vehicle, row: int) -> float:
    """Return the period [s] of free roll (3) or pitch (4); 0 for a vehicle that does not right itself."""
    righting = vehicle.coefficient("BG_z")
    return 2.0 * math.pi * math.sqrt(abs(float(vehicle.mass_matrix[row, row])) / righting) if righting > 0.0 else 0.0


def _arm(vehicle: Vehicle, force: int, moment: int) -> float:
    """Return how much of a moment [N m] comes with each newton of a commanded force, whether wanted or not."""
    if not vehicle.thrusters:
        return 0.0
    arm = abs(float(configuration_matrix(vehicle)[moment] @ _inverse(vehicle)[:, force]))
    return arm if arm > 1e-6 else 0.0


def fit_to_thrusters(vehicle: Vehicle, wrench: Array) -> Array:
    """Return the wrench (n, 6), scaled down as a whole if it asks some thruster for more than nine tenths."""
    forces, limits = wrench @ _inverse(vehicle).T, _HEADROOM * _limits(vehicle)
    with np.errstate(divide="ignore", invalid="ignore"):
        use = np.where(forces < 0.0, forces / limits[:, 0], np.where(forces > 0.0, forces / limits[:, 1], 0.0))
    excess = float(use.max(initial=1.0))
    return wrench / excess if math.isfinite(excess) else wrench


def _largest(vehicle: Vehicle) -> Array:
    """Return the largest wrench (6,) on each axis alone that is possible both ways; infinite without limits."""
    inverse, limits = _inverse(vehicle), _limits(vehicle)
    out = np.zeros(6)
    for row in allocatable_axes(vehicle):
        f = np.abs(inverse[:, row])
        weakest = np.minimum(-limits[:, 0], limits[:, 1])
        used = f > 1e-9 * f.max()
        out[row] = float((weakest[used] / f[used]).min())
    return out


def _inverse(vehicle: Vehicle) -> Array:
    """Return the thruster forces per unit wrench (n, 6), least squares over the axes that can be commanded."""
    rows = list(allocatable_axes(vehicle))
    T = configuration_matrix(vehicle)
    out = np.zeros((T.shape[1], 6))
    out[:, rows] = np.linalg.pinv(T[rows])
    return out


def _limits(vehicle: Vehicle) -> Array:
    """Return the most negative and the most positive force (n, 2) of each thruster within the range of its fit."""
    out = np.empty((len(vehicle.thrusters), 2))
    for k, thruster in enumerate(vehicle.thrusters):
        curve = thruster.curve
        low, high = force_range(curve)
        if curve.fitted_range is not None:
            edge = curve.fitted_range[1]
            ends = [float(curve_force(curve, curve.rest + side * edge)) for side in (-1, 1)]
            low, high = max(low, min(ends)), min(high, max(ends))
        out[k] = low, high
    return out
