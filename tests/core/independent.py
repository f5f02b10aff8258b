"""The mechanics of a vehicle in water, derived a second time and in another way than the kernels.

Rotations are products of turns about one axis. The equations of motion are the balance of linear and angular momentum
in the INERTIAL frame, so that no Coriolis matrix appears at all: with x the position of the body origin and h = M nu,

    P = R h1,   L = x x P + R h2,   dP/dt = R f,   dL/dt = x x R f + R m,   nu = M^-1 [R^T P ; R^T (L - x x P)].

Everything is written so that complex numbers pass through: `derivative` differentiates by a complex step, to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from towtank.core.layout import pack_parameters

Vector = Any  # float64, or complex128 in a complex step

E1, E2, E3 = np.eye(3)


def derivative(function: Callable[[Any], Any], at: float = 0.0) -> Any:
    """Derivative of an analytic function of one real variable, to rounding."""
    return np.imag(function(at + 1e-30j)) / 1e-30


def cross_matrix(a: Vector) -> Vector:
    """S (3, 3) with S b = a x b, column by column."""
    return np.stack([np.cross(a, e) for e in np.eye(3)], axis=1)


def turn(axis: int, angle: Vector) -> Vector:
    """Rotation about a coordinate axis (0, 1, 2): turns vectors by the right-hand rule."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.zeros((3, 3), dtype=np.result_type(angle, float))
    i, j, k = axis, (axis + 1) % 3, (axis + 2) % 3
    R[i, i] = 1.0
    R[j, j] = R[k, k] = c
    R[k, j], R[j, k] = s, -s
    return R


def rotation(euler: Vector) -> Vector:
    """Body to inertial: turn by roll, then pitch, then yaw about the inertial axes."""
    return turn(2, euler[2]) @ turn(1, euler[1]) @ turn(0, euler[0])


def rates_to_omega(euler: Vector) -> Vector:
    """Matrix of omega (body) = E (phi_dot, theta_dot, psi_dot): each rate turns about its own, carried axis."""
    roll, pitch = turn(0, euler[0]).T, turn(1, euler[1]).T
    return np.stack([E1 + 0.0 * euler[0], roll @ E2, roll @ pitch @ E3], axis=1)


def quaternion(euler: Vector) -> Vector:
    """Unit quaternion as the product of three half turns, Hamilton's i j k written as complex 2x2 matrices."""

    def half(axis: int, angle: float) -> Vector:
        unit = ([[1j, 0], [0, -1j]], [[0, 1], [-1, 0]], [[0, 1j], [1j, 0]])[axis]
        return np.cos(angle / 2) * np.eye(2) + np.sin(angle / 2) * np.array(unit)

    m = half(2, euler[2]) @ half(1, euler[1]) @ half(0, euler[0])
    return np.array([m[0, 0].real, m[0, 0].imag, m[0, 1].real, m[0, 1].imag])


@dataclass(frozen=True)
class Body:
    """A vehicle in the terms of mechanics: weights and where they act, added mass, damping, a constant wrench."""

    M_RB: Vector
    M_A: Vector
    L: Vector
    Q: Vector
    W: float
    B: float
    r_G: Vector
    r_B: Vector
    constant: Vector = field(default_factory=lambda: np.zeros(6))
    lift: Vector = field(default_factory=lambda: np.zeros(9))  # Y_uv Y_ur N_uv N_ur K_up Z_uw Z_uq M_uw M_uq
    asymmetry: Vector = field(default_factory=lambda: np.zeros(6))  # X_u2 .. N_r2

    @property
    def M(self) -> Vector:
        return self.M_RB + self.M_A

    @cached_property
    def p(self) -> Vector:
        """The kernels' parameter vector (170,)."""
        return pack_parameters(
            self.M,
            self.L,
            self.Q,
            self.W - self.B,
            self.W * self.r_G - self.B * self.r_B,
            self.constant,
            self.lift,
            self.asymmetry,
        )

    def potential(self, eta: Vector) -> Vector:
        """Potential energy [J]: weight and buoyancy times the depths at which they act (z is down)."""
        R = rotation(eta[3:])
        depth_G, depth_B = eta[2] + (R @ self.r_G)[2], eta[2] + (R @ self.r_B)[2]
        return -self.W * depth_G + self.B * depth_B

    def gravity(self, R: Vector) -> Vector:
        """Wrench of weight and buoyancy on the vehicle (6,), body frame, from force and lever arm."""
        weight, buoyancy = R.T @ (self.W * E3), R.T @ (-self.B * E3)
        return np.concatenate([weight + buoyancy, np.cross(self.r_G, weight) + np.cross(self.r_B, buoyancy)])

    def damping(self, nu: Vector) -> Vector:
        """Damping, and the lift of hull and wings: all forces that depend on the velocity but for the inertial ones."""
        return self.L @ nu + self.Q @ (np.abs(nu) * nu) + self.forward_speed(nu) + self.asymmetry * nu**2

    def forward_speed(self, nu: Vector) -> Vector:
        Y_uv, Y_ur, N_uv, N_ur, K_up, Z_uw, Z_uq, M_uw, M_uq = self.lift
        u, v, w, p, q, r = nu
        Y, N = Y_uv * u * v + Y_ur * u * r, N_uv * u * v + N_ur * u * r
        Z, M = Z_uw * u * w + Z_uq * u * q, M_uw * u * w + M_uq * u * q
        return np.array([0.0 * u, Y, Z, K_up * u * p, M, N])

    def motion(self, eta0: Vector, nu0: Vector, wrench: Callable[[float], Vector], end: float) -> Vector:
        """Motion [eta, nu] (12,) at time `end`, by momenta and Euler angles, DOP853; water at rest."""
        R = rotation(eta0[3:])
        h = self.M @ nu0
        start = np.concatenate([eta0, R @ h[:3], np.cross(eta0[:3], R @ h[:3]) + R @ h[3:]])
        inverse = np.linalg.inv(self.M)

        def velocity(s: Vector, R: Vector) -> Vector:
            return inverse @ np.concatenate([R.T @ s[6:9], R.T @ (s[9:] - np.cross(s[:3], s[6:9]))])

        def rate(t: float, s: Vector) -> Vector:
            R = rotation(s[3:6])
            nu = velocity(s, R)
            f = wrench(t) + self.damping(nu) + self.gravity(R) + self.constant
            force, moment = R @ f[:3], R @ f[3:]
            turning = np.linalg.solve(rates_to_omega(s[3:6]), nu[3:])
            return np.concatenate([R @ nu[:3], turning, force, np.cross(s[:3], force) + moment])

        found = solve_ivp(rate, (0.0, end), start, method="DOP853", rtol=1e-12, atol=1e-13)
        s = found.y[:, -1]
        return np.concatenate([s[:6], velocity(s, rotation(s[3:6]))])


def point_masses(rng: np.random.Generator, n: int = 7) -> tuple[Vector, Vector]:
    """Masses (n,) [kg] and their places (n, 3) [m] in the body."""
    return rng.uniform(0.5, 5.0, n), rng.uniform(-0.4, 0.4, (n, 3))


def moments(masses: Vector, places: Vector) -> tuple[float, Vector, Vector]:
    """Mass, centre of gravity (3,) and inertia (3, 3) about it, as sums over points."""
    mass = masses.sum()
    centre = masses @ places / mass
    arms = places - centre
    inertia = sum(m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(masses, arms, strict=True))
    return float(mass), centre, inertia


def rigid_mass(masses: Vector, places: Vector) -> Vector:
    """M_RB (6, 6) as the sum of m J^T J, where v_point = J nu: from kinetic energy alone."""
    M = np.zeros((6, 6))
    for m, a in zip(masses, places, strict=True):
        J = np.hstack([np.eye(3), -cross_matrix(a)])
        M += m * J.T @ J
    return M


def body(seed: int, *, damped: bool = True) -> Body:
    """A vehicle with everything coupled: full M_A, full damping matrices, any centres, not neutral."""
    rng = np.random.default_rng(seed)
    masses, places = point_masses(rng)
    mass, centre, _ = moments(masses, places)
    A = rng.normal(size=(6, 6))
    scale = np.diag([3.0, 4.0, 4.5, 0.5, 0.6, 0.6])
    drag = np.array([20.0, 30.0, 40.0, 2.0, 3.0, 3.0])
    mixed = rng.uniform(-0.05, 0.05, (2, 6, 6)) * np.sqrt(np.outer(drag, drag))
    W = 9.81 * mass
    return Body(
        M_RB=rigid_mass(masses, places),
        M_A=scale @ (A @ A.T / 6 + 0.3 * np.eye(6)) @ scale,
        L=(mixed[0] - np.diag(0.4 * drag)) * damped,
        Q=(mixed[1] - np.diag(drag)) * damped,
        W=W,
        B=W + rng.uniform(-2.0, 2.0),
        r_G=centre,
        r_B=centre + rng.uniform(-0.01, 0.01, 3) - [0.0, 0.0, 0.03],
        constant=rng.uniform(-1.0, 1.0, 6) * [2.0, 2.0, 2.0, 0.1, 0.1, 0.1] * damped,
        lift=rng.uniform(-1.0, 1.0, 9) * [9.0, 3.0, 3.0, 1.0, 1.0, 9.0, 3.0, 3.0, 1.0] * damped
        - np.array([9.0, 0.0, 0.0, 1.0, 1.0, 9.0, 0.0, 0.0, 1.0]) * damped,
        asymmetry=rng.uniform(-0.4, 0.4, 6) * drag * damped,
    )


def state(eta: Vector, nu: Vector) -> Vector:
    """The integrator's state (13,) of a pose with Euler angles and a velocity."""
    return np.concatenate([eta[:3], quaternion(eta[3:]), nu])


def pose_difference(states: Vector, reference: Vector) -> float:
    """Largest difference of a final state (13,) to [eta, nu] (12,): position, rotation matrix, velocity."""
    q = states[3:7]
    R = rotation_of(q)
    return max(
        float(np.abs(states[:3] - reference[:3]).max()),
        float(np.abs(R - rotation(reference[3:6])).max()),
        float(np.abs(states[7:] - reference[6:]).max()),
    )


def rotation_of(q: Vector) -> Vector:
    """Rotation matrix of a unit quaternion by Rodrigues' formula."""
    S = cross_matrix(q[1:])
    return np.eye(3) + 2.0 * q[0] * S + 2.0 * S @ S
