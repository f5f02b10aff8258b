"""Arrays of unit quaternions [w x y z] (Hamilton, body to world): product, sign, interpolation."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array

__all__ = ["align_signs", "conjugate", "interpolate_rotation", "multiply", "normalised", "rotate"]


def multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton products a b, (..., 4) each, broadcasting."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, dtype=np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, dtype=np.float64), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: Array) -> Array:
    """Return the inverse rotations (..., 4)."""
    result: Array = np.asarray(q) * np.array([1.0, -1.0, -1.0, -1.0])
    return result


def rotate(q: Array, vector: Array) -> Array:
    """Return R(q) vector, (..., 3): body components to world components, broadcasting."""
    w, axis = q[..., :1], q[..., 1:]
    twice = 2.0 * np.cross(axis, vector)
    result: Array = vector + w * twice + np.cross(axis, twice)
    return result


def normalised(q: Array) -> Array:
    """Return q / |q| row by row (n, 4); NaN where the norm is far from 1 (a lost track reports zeros)."""
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Array = np.where(np.abs(norm - 1.0) < 0.1, q / norm, np.nan)
    return result


def align_signs(q: Array) -> Array:
    """Return the quaternions (n, 4), without NaN, with signs such that neighbours never point apart."""
    flips = np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0
    signs = np.ones(len(q))
    signs[1:] = 1.0 - 2.0 * (np.cumsum(flips) % 2)
    return q * signs[:, None]


def interpolate_rotation(a: Array, b: Array, weight: Array) -> Array:
    """Return the rotations on the shortest arc from a (n, 4) to b (n, 4) at weight (n,) in 0..1 (slerp)."""
    cosine = np.einsum("ij,ij->i", a, b)
    b = np.where(cosine[:, None] < 0.0, -b, b)
    angle = 2.0 * np.arctan2(np.linalg.norm(b - a, axis=1), np.linalg.norm(b + a, axis=1))
    small = angle < 1e-6
    sine = np.where(small, 1.0, np.sin(angle))
    from_a = np.where(small, 1.0 - weight, np.sin((1.0 - weight) * angle) / sine)
    from_b = np.where(small, weight, np.sin(weight * angle) / sine)
    q = from_a[:, None] * a + from_b[:, None] * b
    result: Array = q / np.linalg.norm(q, axis=1, keepdims=True)
    return result
