"""Braking as hard as the thrusters can: what the guard falls back on, and by what it predicts the stopping point.

Linear-quadratic state feedback of the forces f of the thrusters about rest, held over each period,

    f = f_0 - K [u v w p q r, roll, pitch, f - f_0],

clipped to what each thruster can do. Errors of the velocity are taken from a slow way back to the middle, faster off a
wall, and count no more than what takes all thrust. Where surge tilts the vehicle, as with thrusters below its origin
and none for pitch, the regulator finds how hard it may brake. Lag and delay stand in it as one lag.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.errors import InputError
from towtank.vehicle import Vehicle, allocatable_axes, configuration_matrix, force_range

__all__ = ["PERIOD", "Bounds", "Brake", "brake_into", "brake_of"]

PERIOD = 0.04  # s, of control and of the prediction
_STATES = 8  # of the feedback, before the forces: u v w p q r, roll, pitch

# Of the braking, by guard_study.py: errors that are worth all of the thrust, and where the drag is taken
_SPEED_ERROR, _TURN_ERROR, _TILT_ERROR = 0.15, 3.0, 0.4  # m/s, rad/s, rad
_AT_SPEED, _AT_TURN = 0.3, 0.5  # m/s, rad/s
_LARGEST_ERROR = 0.3  # m/s, a faster vehicle is braked no harder: the thrusters are at their limits
_LEAK = 0.02  # 1/s, at least, of a motion that no thruster stops: the regulator needs it stable
_AHEAD, _AWAY_RATE, _AWAY_SPEED = 0.5, 2.0, 0.5  # s, 1/s, m/s, of the way off a wall
_BACK_RATE, _BACK_SPEED = 0.5, 0.1  # 1/s, m/s, of the way back to the middle


class Bounds(NamedTuple):
    """Limits: of the body origin, lower and upper (3,) [m], NED; (3,) speed [m/s], tilt [rad], turn [rad/s]."""

    lower: Array
    upper: Array
    motion: Array


class Brake(NamedTuple):
    """Feedback of braking.

    Attributes:
        gain: forces per state (m, 8 + m). hover: forces at rest (m,) [N].
        low, high: what each thruster can do (m,) [N]. home: where it goes back to (3,) [m], NED.
        lower, upper: bounds of the body origin (3,) [m], NED.
        matrix: wrench per force (6, m). inverse: least forces per wrench (m, 6), over the axes that can be set.
        tilting: least forces per moments K, M (m, 2).
    """

    gain: Array
    hover: Array
    low: Array
    high: Array
    home: Array
    lower: Array
    upper: Array
    matrix: Array
    inverse: Array
    tilting: Array


@kernel
def _beyond(brake: Brake, a: int, place: float) -> float:
    """Return the velocity [m/s] along axis `a` that leads back from a place [m] beyond a bound; 0 within."""
    out = max(brake.lower[a] - place, 0.0) - max(place - brake.upper[a], 0.0)
    return float(min(max(_AWAY_RATE * out, -_AWAY_SPEED), _AWAY_SPEED))


@kernel
def brake_into(brake: Brake, x: Array, force: Array, k: int, out: Array) -> None:
    """Write the forces (m,) [N] that brake the vehicle of lane `k` into `out`.

    Args:
        x: states (13, K), see `towtank.core.rk4`. force: of the thrusters now (m, K) [N].
    """
    qw, qx, qy, qz = x[3, k], x[4, k], x[5, k], x[6, k]
    kx, ky = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx)
    kz = 1.0 - 2.0 * (qx * qx + qy * qy)
    lean = math.hypot(kx, ky)
    turned = math.atan2(lean, kz) / lean if lean > 1e-9 else 1.0
    # The way back, a velocity in NED: slow, and faster where the vehicle would be beyond a bound a little later.
    dx, dy, dz = brake.home[0] - x[0, k], brake.home[1] - x[1, k], brake.home[2] - x[2, k]
    far = math.sqrt(dx * dx + dy * dy + dz * dz)
    pace = min(_BACK_RATE, _BACK_SPEED / max(far, 1e-9))
    u, v, w = x[7, k], x[8, k], x[9, k]
    vx = (1.0 - 2.0 * (qy * qy + qz * qz)) * u + 2.0 * (qx * qy - qw * qz) * v + 2.0 * (qx * qz + qw * qy) * w
    vy = 2.0 * (qx * qy + qw * qz) * u + (1.0 - 2.0 * (qx * qx + qz * qz)) * v + 2.0 * (qy * qz - qw * qx) * w
    vz = kx * u + ky * v + kz * w
    dx = pace * dx + _beyond(brake, 0, x[0, k] + _AHEAD * vx)
    dy = pace * dy + _beyond(brake, 1, x[1, k] + _AHEAD * vy)
    dz = pace * dz + _beyond(brake, 2, x[2, k] + _AHEAD * vz)
    u = x[7, k] - (
        (1.0 - 2.0 * (qy * qy + qz * qz)) * dx + 2.0 * (qx * qy + qw * qz) * dy + 2.0 * (qx * qz - qw * qy) * dz
    )
    v = x[8, k] - (
        2.0 * (qx * qy - qw * qz) * dx + (1.0 - 2.0 * (qx * qx + qz * qz)) * dy + 2.0 * (qy * qz + qw * qx) * dz
    )
    w = x[9, k] - (2.0 * (qx * qz + qw * qy) * dx + 2.0 * (qy * qz - qw * qx) * dy + kz * dz)
    size = math.sqrt(u * u + v * v + w * w)
    cap = min(1.0, _LARGEST_ERROR / max(size, 1e-9))
    u, v, w = cap * u, cap * v, cap * w
    m = out.shape[0]
    for j in range(m):
        row = brake.gain[j]
        f = row[0] * u + row[1] * v + row[2] * w + row[3] * x[10, k] + row[4] * x[11, k] + row[5] * x[12, k]
        f += turned * (row[6] * ky - row[7] * kx)
        for i in range(m):
            f += row[_STATES + i] * (force[i, k] - brake.hover[i])
        out[j] = min(max(brake.hover[j] - f, brake.low[j]), brake.high[j])


def brake_of(vehicle: Vehicle, home: Array, bounds: Bounds) -> Brake:
    """Return the feedback that brakes a vehicle and then leads it home, a place (3,) [m] in NED, within bounds.

    Raises:
        InputError: a thruster has no limits.
    """
    from scipy.linalg import expm, solve_discrete_are

    T, rows = configuration_matrix(vehicle), list(allocatable_axes(vehicle))
    m = T.shape[1]
    inverse = np.zeros((m, 6))
    inverse[:, rows] = np.linalg.pinv(T[rows])
    limits = np.array([force_range(thruster.curve) for thruster in vehicle.thrusters])
    limits *= np.array([thruster.gain for thruster in vehicle.thrusters])[:, None]
    if not np.isfinite(limits).all():
        name = vehicle.thrusters[int(np.argwhere(~np.isfinite(limits))[0, 0])].name
        raise InputError(
            f"{vehicle.name}: thruster {name} has no limits; give its curve limits, a guard brakes by them"
        )
    inverse_mass = np.linalg.inv(vehicle.mass_matrix)
    at = np.array([_AT_SPEED] * 3 + [_AT_TURN] * 3)
    damping = np.diag([vehicle.coefficient(f"{a}_{v}") + vehicle.coefficient(f"{a}_{v * 2}") * s
                       for a, v, s in zip("XYZKMN", "uvwpqr", at, strict=True)])  # fmt: skip
    damping = np.minimum(damping, -_LEAK * np.diag(np.diag(vehicle.mass_matrix)))
    righting = np.zeros((6, 2))
    righting[3, 0] = righting[4, 1] = -vehicle.restoring_moment[2]
    n = _STATES + m
    A, B = np.zeros((n, n)), np.zeros((n, m))
    A[:6, :6], A[:6, 6:8], A[:6, 8:] = inverse_mass @ damping, inverse_mass @ righting, inverse_mass @ T
    A[6, 3] = A[7, 4] = 1.0
    A[6, 6] = A[7, 7] = -_LEAK
    late = np.array([t.time_constant for t in vehicle.thrusters]) + vehicle.command_delay + 0.5 * PERIOD
    A[8:, 8:], B[8:] = -np.diag(1.0 / late), np.diag(1.0 / late)
    weights = np.array([_SPEED_ERROR] * 3 + [_TURN_ERROR] * 3 + [_TILT_ERROR] * 2) ** -2.0
    Q = np.diag(np.concatenate([weights, np.full(m, 1e-9)]))
    R = np.diag((0.5 * (limits[:, 1] - limits[:, 0])) ** -2.0)
    held = expm(PERIOD * np.block([[A, B], [np.zeros((m, n + m))]]))  # the input is held over each period
    A, B = held[:n, :n], held[:n, n:]
    P = solve_discrete_are(A, B, Q, R)
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    weight = np.array([0.0, 0.0, vehicle.weight_minus_buoyancy, 0.0, 0.0, 0.0])
    hover = np.clip(-inverse @ weight, limits[:, 0], limits[:, 1])
    return Brake(
        np.ascontiguousarray(gain),
        hover,
        np.ascontiguousarray(limits[:, 0]),
        np.ascontiguousarray(limits[:, 1]),
        home,
        bounds.lower,
        bounds.upper,
        T,
        inverse,
        np.asarray(np.linalg.pinv(T[3:5]), dtype=np.float64),
    )
