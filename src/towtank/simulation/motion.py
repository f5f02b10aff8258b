"""The true motion of a simulated vehicle: what its sensors look at."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import eulers_from_quaternions
from towtank.core.dynamics import forward_dynamics
from towtank.simulation.integration import in_body
from towtank.vehicle.matrices import GRAVITY

__all__ = ["GRAVITY", "Motion", "continuous_eulers"]

_TURN = 2.0 * np.pi


def continuous_eulers(q: Array, start: Array | None = None) -> Array:
    """Return Euler angles (..., n, 3) [rad] of quaternions (..., n, 4) without jumps of roll and yaw along n.

    Args:
        start: angles of the first row (..., 3), e.g. with whole turns of yaw; they are kept.
    """
    angles = eulers_from_quaternions(np.ascontiguousarray(q.reshape(-1, 4))).reshape(*q.shape[:-1], 3)
    angles = np.unwrap(angles, axis=-2)
    if start is not None:
        angles += _TURN * np.round((start - angles[..., 0, :]) / _TURN)[..., None, :]
    return angles


@dataclass(frozen=True, eq=False)
class Motion:
    """True motion at the steps of a simulation.

    Attributes:
        t: times (n + 1,) [s]. dt: step [s].
        eta: x y z phi theta psi (n + 1, 6) [m, rad], angles without jumps. q: the same attitude (n + 1, 4).
        nu: velocity over ground (n + 1, 6) [m/s, rad/s], body FRD. nu_r: relative to the water (n + 1, 6).
        tau: total wrench on the body from each instant on (n + 1, 6) [N, N m]; last row: up to the end.
        parameters: kernel vector (170,) of the vehicle. later: the vector from a step on, where the vehicle changes.
        water_acceleration: of the water (3,) or (n + 1, 3) [m/s^2], NED.
    """

    t: Array
    dt: float
    eta: Array
    q: Array
    nu: Array
    nu_r: Array
    tau: Array
    parameters: Array
    later: tuple[tuple[int, Array], ...] = ()
    water_acceleration: Array = field(default_factory=lambda: np.zeros(3))

    @cached_property
    def nu_r_dot(self) -> Array:
        """Rate of the velocity relative to the water (n + 1, 6) [m/s^2, rad/s^2], from the equations of motion."""
        out: Array = forward_dynamics(self.parameters[None, :], self.q, self.nu_r, self.tau)
        for first, p in self.later:
            out[first:] = forward_dynamics(p[None, :], self.q[first:], self.nu_r[first:], self.tau[first:])
        return out

    def specific_force(self, place: Array | tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
        """What an accelerometer at a place of the body (3,) [m] feels (n + 1, 3) [m/s^2]: v_dot + omega x v - R^T g.

        v_dot + omega x v is the inertial acceleration in the body frame: that of the velocity relative to the water,
        to which a constant current adds nothing and waves R^T dv_w/dt. v is that of the place r, v + omega x r: its
        acceleration has omega_dot x r + omega x (omega x r) more.
        """
        w, x, y, z = self.q.T
        down = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1)
        omega = self.nu_r[:, 3:]
        v = self.nu_r[:, :3] + np.cross(omega, place)
        v_dot = self.nu_r_dot[:, :3] + np.cross(self.nu_r_dot[:, 3:], place)
        water = in_body(self.q, self.water_acceleration)
        force: Array = v_dot + np.cross(omega, v) + water - GRAVITY * down
        return force
