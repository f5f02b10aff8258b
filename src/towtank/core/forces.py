"""Hydrodynamic damping: linear and quadratic, diagonal or full matrices of SNAME derivatives.

The force on the vehicle is L nu + Q |nu| nu with L_ij = X_u .. N_r and Q_ij = X_{u|u|} .. N_{r|r|}, negative on the
diagonal of a physical vehicle. Fossen's D(nu) nu is its opposite. The printed paper's (30) lacks a velocity factor.

Forward-speed terms u (F nu), lift of hull and wings at a small angle to the flow: in proportion to the speed ahead and
to the motion across it, u v and not |u| v. Symmetry to port and starboard leaves nine:

    Y = u (Y_uv v + Y_ur r),  N = u (N_uv v + N_ur r),  K = u K_up p,  Z = u (Z_uw w + Z_uq q),  M = u (M_uw w + M_uq q)

Their power is u [Y_uv v^2 + (Y_ur + N_uv) v r + N_ur r^2 + K_up p^2 + Z_uw w^2 + (Z_uq + M_uw) w q + M_uq q^2]. Where
these forms are negative, as fins make them, energy goes out while the vehicle goes ahead, and comes in while it goes
astern; a pair Y_ur = -N_uv does no work. The Munk moment is in C(nu) and no part of them. Fossen (2021), section 6.4;
Prestero, Verification of a six-degree of freedom simulation model for the REMUS AUV, MIT (2001), chapter 4.

Asymmetric drag A_i nu_i^2, of the same sign whichever way the body goes: with X = X_uu |u| u + X_u2 u^2 drag ahead is
(X_uu + X_u2) u^2 and drag astern (X_uu - X_u2) u^2. Its power sum_i A_i nu_i^3 changes its sign with the direction: out
one way, in the other way, and never more than quadratic drag takes out where |A_i| <= -Q_ii. It and the forward-speed
terms, the forces of the velocity beyond L and Q, are even: the same where all of the motion is reversed.

Loss of thrust with inflow. A thruster that moves through the water along its thrust gives less, T (1 - k u_j sign T):
k = inflow_loss [s/m], u_j [m/s] the velocity of its place through the water along its direction d_j. The thrust
coefficient of a propeller falls in a straight line with its advance number, Fossen (2021), chapter 9. With the wrench
b_j = [d_j ; r_j x d_j] of its unit force, u_j = d_j . (v + omega x r_j) = b_j . nu, so that all thrusters together lose

    tau_loss = -k sum_j |T_j| b_j b_j^T nu,

a linear damping whose matrix is symmetric and positive semidefinite: no thrust ever feeds energy in by it.

Restoring forces of gravity and buoyancy for any centres and any net weight.

With k = R^T e_z and b = r_G W - r_B B, Fossen (4.5) is g(eta) = -[(W - B) k ; b x k]. The printed paper's (20), row 4,
has the wrong sign; here a centre of buoyancy above the centre of gravity (BG_z = b_z > 0) rights the vehicle.

A water current, constant in the inertial frame and irrotational.

nu_r = nu - [R^T v_c ; 0] enters the hydrodynamic terms. Because the current is constant, an observer drifting with the
water is inertial too and sees the same rigid body: M_RB nu_r_dot + C_RB(nu_r) nu_r = M_RB nu_dot + C_RB(nu) nu, so the
whole of (8) holds in nu_r with the total mass matrix. Fossen (2021), section 8.1 and property 10.1.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import to_body
from towtank.core.layout import (
    FORWARD_COLUMNS,
    FORWARD_ROWS,
    I_ASYMMETRY,
    I_FORWARD,
    I_LINEAR,
    I_MOMENT,
    I_WEIGHT,
    N_FORWARD,
)

__all__ = [
    "add_extra_force_into",
    "add_extra_rate_into",
    "add_inflow_damping_into",
    "current_acceleration",
    "current_in_body",
    "damping_force",
    "pull_into",
    "restoring_wrench",
]


@kernel
def damping_force(linear: Array, quadratic: Array, nu: Array) -> Array:
    """Return the damping force on the vehicle (6,) [N, N m]: L nu + Q |nu| nu."""
    out = np.zeros(6)
    for i in range(6):
        for j in range(6):
            out[i] += (linear[i, j] + quadratic[i, j] * math.fabs(nu[j])) * nu[j]
    return out


@kernel
def add_extra_force_into(p: Array, nu: Array, factor: float, out: Array) -> None:
    """Add `factor` times u (F nu) + A nu^2, both in the kernel vector p (170,), to the wrench `out` (6,) [N, N m]."""
    for n in range(N_FORWARD):
        out[FORWARD_ROWS[n]] += factor * p[I_FORWARD + n] * nu[0] * nu[FORWARD_COLUMNS[n]]
    for i in range(6):
        out[i] += factor * p[I_ASYMMETRY + i] * nu[i] * nu[i]


@kernel
def add_extra_rate_into(p: Array, nu: Array, nu_dot: Array, out: Array) -> None:
    """Add the derivative of u (F nu) + A nu^2 along nu_dot to `out` (6,): by nu_j where nu_dot is the unit j.

    Args:
        p: kernel vector (170,). nu: velocity relative to the water (6,) [m/s, rad/s], body FRD.
        nu_dot: its rate (6,) [m/s^2, rad/s^2]; then `out` is the rate of the wrench [N/s, N m/s].
    """
    for n in range(N_FORWARD):
        c = FORWARD_COLUMNS[n]
        out[FORWARD_ROWS[n]] += p[I_FORWARD + n] * (nu[0] * nu_dot[c] + nu_dot[0] * nu[c])
    for i in range(6):
        out[i] += 2.0 * p[I_ASYMMETRY + i] * nu_dot[i] * nu[i]


@kernel
def add_inflow_damping_into(B: Array, forces: Array, loss: float, p: Array) -> None:
    """Add -loss sum_j |T_j| b_j b_j^T to the linear damping L of the kernel vector p (170,).

    Args:
        B: wrench of each thruster's unit force (6, m), b_j its columns [-, m].
        forces: thrust without inflow T (m,) [N].
        loss: share of the thrust lost per m/s [s/m].
    """
    for j in range(forces.shape[0]):
        share = loss * math.fabs(forces[j])
        for i in range(6):
            for k in range(6):
                p[I_LINEAR + 6 * i + k] -= share * B[i, j] * B[k, j]


@kernel
def restoring_wrench(p: Array, k: Array) -> Array:
    """Return g(eta) (6,) [N, N m] of (8), body FRD; the wrench that acts on the vehicle is its opposite, `pull_into`.

    Args:
        p: kernel parameters (170,), of which W - B [N] and b = r_G W - r_B B (3,) [N m], body FRD.
        k: direction of gravity in the body (3,), see `towtank.core.attitude.gravity_direction`.
    """
    out = np.empty(6)
    pull_into(p, -k[0], -k[1], -k[2], out)
    return out


@kernel
def pull_into(p: Array, k0: float, k1: float, k2: float, out: Array) -> None:
    """Write the wrench (6,) [N, N m] of gravity and buoyancy along k in the body, FRD: [(W - B) k; b x k], -g(eta) of
    Fossen (4.5)."""
    weight = p[I_WEIGHT]
    b0, b1, b2 = p[I_MOMENT], p[I_MOMENT + 1], p[I_MOMENT + 2]
    out[0], out[1], out[2] = weight * k0, weight * k1, weight * k2
    out[3], out[4], out[5] = b1 * k2 - b2 * k1, b2 * k0 - b0 * k2, b0 * k1 - b1 * k0


@kernel
def current_in_body(q: Array, current: Array) -> Array:
    """Return nu_c (6,) = [R^T v_c ; 0] for the attitude q (4,) and the current v_c (3,) [m/s], NED."""
    out = np.zeros(6)
    out[0], out[1], out[2] = to_body(q, current)
    return out


@kernel
def current_acceleration(q: Array, omega: Array, current: Array) -> Array:
    """Return nu_c_dot (6,) = [-omega x R^T v_c ; 0]: a constant current turns in a turning body."""
    c = current_in_body(q, current)
    out = np.zeros(6)
    out[0] = -(omega[1] * c[2] - omega[2] * c[1])
    out[1] = -(omega[2] * c[0] - omega[0] * c[2])
    out[2] = -(omega[0] * c[1] - omega[1] * c[0])
    return out
