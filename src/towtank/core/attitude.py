"""Attitude: Euler angles (zyx) and unit quaternions, body FRD to inertial NED, both ways.

Quaternions are Hamilton's, [w, x, y, z], and turn body vectors into inertial ones. Fossen (2021), section 2.2;
the printed paper's (13), column 3, and (14), row 1, are wrong and are not used.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, kernel

__all__ = [
    "euler_from_quaternion",
    "euler_rates_matrix",
    "eulers_from_quaternions",
    "gravity_direction",
    "quaternion_from_euler",
    "quaternion_product",
    "quaternions_from_eulers",
    "rotation_from_euler",
    "rotation_from_quaternion",
    "row_of_rotation",
    "to_body",
]


@kernel
def quaternion_from_euler(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """Return (w, x, y, z) for roll, pitch and yaw [rad], zyx convention."""
    c1, s1 = math.cos(0.5 * phi), math.sin(0.5 * phi)
    c2, s2 = math.cos(0.5 * theta), math.sin(0.5 * theta)
    c3, s3 = math.cos(0.5 * psi), math.sin(0.5 * psi)
    return (
        c1 * c2 * c3 + s1 * s2 * s3,
        s1 * c2 * c3 - c1 * s2 * s3,
        c1 * s2 * c3 + s1 * c2 * s3,
        c1 * c2 * s3 - s1 * s2 * c3,
    )


@kernel
def euler_from_quaternion(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return (phi, theta, psi) [rad], phi and psi in [-pi, pi], theta in [-pi/2, pi/2].

    Yaw is read from the rotation with the roll already found taken out, so that the three together give the rotation
    back to rounding even where theta is +-pi/2 and roll and yaw alone mean nothing.
    """
    r32, r33 = 2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)
    phi = math.atan2(r32, r33)
    theta = math.atan2(2.0 * (w * y - z * x), math.hypot(r32, r33))
    s1, c1 = math.sin(phi), math.cos(phi)
    r12, r13 = 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    r22, r23 = 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    psi = math.atan2(s1 * r13 - c1 * r12, c1 * r22 - s1 * r23)
    return phi, theta, psi


@kernel
def quaternion_product(a: Array, b: Array) -> Array:
    """Return the Hamilton product a b (4,): the rotation b followed by a."""
    out = np.empty(4)
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return out


@kernel
def row_of_rotation(q: Array, k: int) -> tuple[float, float, float]:
    """Return row k of R, body FRD to NED, of the unit quaternion q (4,); for k = 2 gravity's direction in the body."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    if k == 0:
        return 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    if k == 1:
        return 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


@kernel
def rotation_from_quaternion(q: Array) -> Array:
    """Return R (3, 3), body to NED, of the unit quaternion q (4,)."""
    out = np.empty((3, 3))
    for k in range(3):
        out[k, 0], out[k, 1], out[k, 2] = row_of_rotation(q, k)
    return out


@kernel
def to_body(q: Array, v: Array | tuple[float, float, float]) -> tuple[float, float, float]:
    """Return R^T v, in the body (FRD) and the unit of v, of a vector v in NED, for the unit quaternion q (4,)."""
    a, b, c = row_of_rotation(q, 0), row_of_rotation(q, 1), row_of_rotation(q, 2)
    return (
        a[0] * v[0] + b[0] * v[1] + c[0] * v[2],
        a[1] * v[0] + b[1] * v[1] + c[1] * v[2],
        a[2] * v[0] + b[2] * v[1] + c[2] * v[2],
    )


@kernel
def rotation_from_euler(phi: float, theta: float, psi: float) -> Array:
    """Return J1 = R (3, 3), body to NED, Fossen (2.31): the corrected (13) of the paper."""
    c1, s1, c2, s2 = math.cos(phi), math.sin(phi), math.cos(theta), math.sin(theta)
    c3, s3 = math.cos(psi), math.sin(psi)
    out = np.empty((3, 3))
    out[0, 0] = c3 * c2
    out[0, 1] = -s3 * c1 + c3 * s2 * s1
    out[0, 2] = s3 * s1 + c3 * c1 * s2
    out[1, 0] = s3 * c2
    out[1, 1] = c3 * c1 + s1 * s2 * s3
    out[1, 2] = -c3 * s1 + s2 * s3 * c1
    out[2, 0] = -s2
    out[2, 1] = c2 * s1
    out[2, 2] = c2 * c1
    return out


@kernel
def euler_rates_matrix(phi: float, theta: float) -> Array:
    """Return J2 (3, 3), (phi_dot, theta_dot, psi_dot) = J2 (p, q, r), Fossen (2.40): the corrected (14)."""
    c1, s1, t2, c2 = math.cos(phi), math.sin(phi), math.tan(theta), math.cos(theta)
    out = np.zeros((3, 3))
    out[0, 0] = 1.0
    out[0, 1] = s1 * t2
    out[0, 2] = c1 * t2
    out[1, 1] = c1
    out[1, 2] = -s1
    out[2, 1] = s1 / c2
    out[2, 2] = c1 / c2
    return out


@kernel
def gravity_direction(q: Array) -> Array:
    """Return k = R^T e_z (3,), the direction of gravity in the body: (-sin th, cos th sin phi, cos th cos phi)."""
    out = np.empty(3)
    out[0], out[1], out[2] = row_of_rotation(q, 2)
    return out


@kernel
def quaternions_from_eulers(angles: Array) -> Array:
    """Return quaternions (n, 4) of Euler angles (n, 3) [rad]; NaN rows stay NaN."""
    out = np.empty((angles.shape[0], 4))
    for i in range(angles.shape[0]):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = quaternion_from_euler(angles[i, 0], angles[i, 1], angles[i, 2])
    return out


@kernel
def eulers_from_quaternions(q: Array) -> Array:
    """Return Euler angles (n, 3) [rad] of quaternions (n, 4), normalised first; NaN rows stay NaN."""
    out = np.empty((q.shape[0], 3))
    for i in range(q.shape[0]):
        n = math.sqrt(q[i, 0] ** 2 + q[i, 1] ** 2 + q[i, 2] ** 2 + q[i, 3] ** 2)
        out[i, 0], out[i, 1], out[i, 2] = euler_from_quaternion(q[i, 0] / n, q[i, 1] / n, q[i, 2] / n, q[i, 3] / n)
    return out
