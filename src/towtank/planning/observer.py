"""Velocity from poses: the nominal vehicle runs along, and what its acceleration lacks is found.

A fading-memory filter of second degree about the model (Brookner, "Tracking and Kalman Filtering Made Easy", 1998):
with theta = exp(-w dt) the pose is corrected by 1 - theta^3 of the innovation, the velocity by
1.5 (1 - theta)^2 (1 + theta) / dt of it, and the unknown acceleration by (1 - theta)^3 / dt^2. Three equal poles: no
overshoot of its own. The model need not be right: what it lacks is followed within about 3 / w. Faster for rotation,
which a thruster changes faster.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import quaternion_from_euler, to_body
from towtank.core.rk4 import N_STATES, has_extra_terms, is_coupled, step_into
from towtank.core.zero_order_hold import ZeroOrderHold, force_integral_into, hold_force, new_zero_order_hold
from towtank.simulation.inputs import initial_states
from towtank.vehicle import Vehicle, configuration_matrix

__all__ = ["Observer", "correct_into"]

_PLACE_RATE, _ATTITUDE_RATE = 20.0, 40.0  # 1/s, by guard_study.py: noise of 1 mm and 1 mrad at 100 Hz


@kernel
def _predict_into(p: Array, x: Array, lacking: Array, tau: Array, dt: float) -> None:
    """Advance the state `x` (13, 1) by dt [s] under a wrench tau (6,); accelerations `lacking` (6,) are added."""
    wrench, work, still = np.empty((3, 6, 1)), np.empty((3, N_STATES, 1)), np.zeros(3)
    for s in range(3):
        for a in range(6):
            wrench[s, a, 0] = tau[a]
    step_into(p, x, wrench, still, dt, work, is_coupled(p), has_extra_terms(p))
    for a in range(6):
        x[7 + a, 0] += dt * lacking[a]


@kernel
def correct_into(x: Array, lacking: Array, pose: Array, dt: float) -> None:
    """Correct the state `x` (13, 1) and the accelerations `lacking` (6,) by a pose (6,) [m, rad] after dt [s].

    A pose that is not finite is passed over.
    """
    for a in range(6):
        if not math.isfinite(pose[a]):
            return
    w, i, j, k = quaternion_from_euler(pose[3], pose[4], pose[5])
    qw, qx, qy, qz = x[3, 0], x[4, 0], x[5, 0], x[6, 0]
    # Rotation from the predicted to the measured attitude, in the body: conj(q) times the measured one.
    ew = qw * w + qx * i + qy * j + qz * k
    ex = qw * i - qx * w - qy * k + qz * j
    ey = qw * j + qx * k - qy * w - qz * i
    ez = qw * k - qx * j + qy * i - qz * w
    sign = 2.0 if ew >= 0.0 else -2.0
    ex, ey, ez = sign * ex, sign * ey, sign * ez
    dx, dy, dz = pose[0] - x[0, 0], pose[1] - x[1, 0], pose[2] - x[2, 0]
    u, v, c = to_body(x[3:7, 0], (dx, dy, dz))
    theta = math.exp(-_PLACE_RATE * dt)
    first, second, third = 1.0 - theta**3, 1.5 * (1.0 - theta) ** 2 * (1.0 + theta) / dt, (1.0 - theta) ** 3 / dt**2
    x[0, 0] += first * dx
    x[1, 0] += first * dy
    x[2, 0] += first * dz
    x[7, 0] += second * u
    x[8, 0] += second * v
    x[9, 0] += second * c
    lacking[0] += third * u
    lacking[1] += third * v
    lacking[2] += third * c
    theta = math.exp(-_ATTITUDE_RATE * dt)
    first, second, third = 1.0 - theta**3, 1.5 * (1.0 - theta) ** 2 * (1.0 + theta) / dt, (1.0 - theta) ** 3 / dt**2
    x[10, 0] += second * ex
    x[11, 0] += second * ey
    x[12, 0] += second * ez
    lacking[3] += third * ex
    lacking[4] += third * ey
    lacking[5] += third * ez
    hx, hy, hz = 0.5 * first * ex, 0.5 * first * ey, 0.5 * first * ez
    x[3, 0] = qw - qx * hx - qy * hy - qz * hz
    x[4, 0] = qx + qw * hx + qy * hz - qz * hy
    x[5, 0] = qy + qw * hy + qz * hx - qx * hz
    x[6, 0] = qz + qw * hz + qx * hy - qy * hx
    size = math.sqrt(x[3, 0] ** 2 + x[4, 0] ** 2 + x[5, 0] ** 2 + x[6, 0] ** 2)
    for a in range(3, 7):
        x[a, 0] /= size


@dataclass(frozen=True, eq=False)
class Observer:
    """The state of a vehicle, followed from its poses and what its thrusters were asked for. Made by `Observer.of`.

    Attributes:
        parameters: kernel vector (170, 1) of the nominal vehicle. matrix: wrench per force (6, m).
        held: forces asked for, with delay and lag. x: state (13, 1). lacking: unknown acceleration (6,), body.
        clock: time of the state (1,) [s].
    """

    parameters: Array
    matrix: Array
    held: ZeroOrderHold
    x: Array
    lacking: Array
    clock: Array

    @classmethod
    def of(cls, vehicle: Vehicle, eta0: Array, t: float = 0.0) -> Observer:
        """Return the observer of a vehicle at rest at the pose eta0 (6,) [m, rad] at time t [s]."""
        lags = np.array([thruster.time_constant for thruster in vehicle.thrusters])
        held = new_zero_order_hold(lags.size, lags, vehicle.command_delay)
        hold_force(held, t - 1.0, np.zeros(lags.size))
        held.clock[0] = t
        x = initial_states(np.asarray(eta0, dtype=np.float64), np.zeros(6)).reshape(N_STATES, 1)
        parameters = np.array(vehicle.parameters).reshape(-1, 1)
        return cls(parameters, configuration_matrix(vehicle), held, x, np.zeros(6), np.array([float(t)]))

    @property
    def state(self) -> Array:
        """State (13,): place, attitude, velocity over ground."""
        return self.x[:, 0].copy()

    def give(self, t: float, forces: Array) -> None:
        """Take note of the forces (m,) [N] that the thrusters are asked for from time t [s] on."""
        hold_force(self.held, t, forces)

    def see(self, t: float, pose: Array) -> None:
        """Take in the pose (6,) [m, rad] measured at time t [s]; one that is not later than the last is passed over."""
        dt = t - float(self.clock[0])
        if not dt > 0.0:
            return
        impulse = np.empty(self.held.force.size)
        force_integral_into(self.held, t, impulse)
        _predict_into(self.parameters, self.x, self.lacking, self.matrix @ impulse / dt, dt)
        correct_into(self.x, self.lacking, pose, dt)
        self.clock[0] = t
