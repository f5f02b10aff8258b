"""Inertia: the rigid body's mass matrix, and the Coriolis and centripetal forces of any symmetric mass matrix.

Kirchhoff's equations give C(nu) nu from the momentum h = M nu, with h1 = h[:3], h2 = h[3:]:

    C(nu) nu = [omega x h1 ; v x h1 + omega x h2]

for the rigid body and for the added mass alike. Fossen (2021), sections 3.3 and 6.3. The printed paper's (29) has a
leading minus too many; the Munk moment is the test: surge and sway give N = (Y_vdot - X_udot) u v on the right-hand
side.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel

__all__ = ["bilinear_coriolis_into", "coriolis_force", "coriolis_matrix", "rigid_body_mass", "skew"]


@kernel
def skew(a: Array) -> Array:
    """Return S(a) (3, 3) with S(a) b = a x b."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2] = -a[2], a[1]
    out[1, 0], out[1, 2] = a[2], -a[0]
    out[2, 0], out[2, 1] = -a[1], a[0]
    return out


@kernel
def rigid_body_mass(mass: float, r_G: Array, inertia: Array) -> Array:
    """Return M_RB (6, 6) about the body origin, Fossen (3.49).

    Args:
        mass: [kg].
        r_G: centre of gravity (3,) [m], body FRD.
        inertia: inertia (3, 3) about the centre of gravity [kg m^2].
    """
    S = skew(r_G)
    out = np.zeros((6, 6))
    for i in range(3):
        out[i, i] = mass
        for j in range(3):
            out[i, 3 + j] = -mass * S[i, j]
            out[3 + i, j] = mass * S[i, j]
            steiner = 0.0
            for k in range(3):
                steiner += S[i, k] * S[k, j]
            out[3 + i, 3 + j] = inertia[i, j] - mass * steiner
    return out


@kernel
def coriolis_matrix(M: Array, nu: Array) -> Array:
    """Return the skew-symmetric C(nu) (6, 6) = -[0, S(h1); S(h1), S(h2)], h = M nu, Fossen (3.60)."""
    h = np.zeros(6)
    for i in range(6):
        for j in range(6):
            h[i] += M[i, j] * nu[j]
    S1, S2 = skew(h[:3]), skew(h[3:])
    out = np.zeros((6, 6))
    for i in range(3):
        for j in range(3):
            out[i, 3 + j] = -S1[i, j]
            out[3 + i, j] = -S1[i, j]
            out[3 + i, 3 + j] = -S2[i, j]
    return out


@kernel
def coriolis_force(M: Array, nu: Array) -> Array:
    """Return C(nu) nu (6,) [N, N m] by Kirchhoff's equations, for any symmetric M (6, 6)."""
    out = np.empty(6)
    bilinear_coriolis_into(M, nu, nu, out)
    return out


@kernel
def bilinear_coriolis_into(M: Array, a: Array, b: Array, out: Array) -> None:
    """Write [omega_a x h1 ; v_a x h1 + omega_a x h2] with h = M b into `out` (6,); bilinear in the velocities a, b."""
    h0 = h1 = h2 = h3 = h4 = h5 = 0.0
    for j in range(6):
        h0 += M[0, j] * b[j]
        h1 += M[1, j] * b[j]
        h2 += M[2, j] * b[j]
        h3 += M[3, j] * b[j]
        h4 += M[4, j] * b[j]
        h5 += M[5, j] * b[j]
    u, v, w, p, q, r = a[0], a[1], a[2], a[3], a[4], a[5]
    out[0] = q * h2 - r * h1
    out[1] = r * h0 - p * h2
    out[2] = p * h1 - q * h0
    out[3] = v * h2 - w * h1 + q * h5 - r * h4
    out[4] = w * h0 - u * h2 + r * h3 - p * h5
    out[5] = u * h1 - v * h0 + p * h4 - q * h3
