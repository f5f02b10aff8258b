"""What one measured number adds to the normal equations of a free run: its residual, its derivative, its weight.

Weights are Huber's up to `GATE`, beyond which, once the run is near the data, they fall to nothing (Hampel's three
parts): a marker that jumps has no say. In x = |residual| / scale:

    psi(x) = x (x <= 2),   2 (x <= 4.5),   2 (6 - x) / 1.5 (x <= 6),   0

A hidden marker, a multipath echo or an instrument that hangs puts many samples off together, each perhaps within the
gate. Where residuals are white otherwise, the mean of ten neighbours has less than a third of their deviation, and
ten that are all off by one deviation stand out: `jumps`. Where they are not white, the model is at fault as likely as
the instrument, and nothing is taken out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.vehicle.matrices import GRAVITY

__all__ = [
    "GATE",
    "GONE",
    "HUBER",
    "NORMAL_MEDIAN",
    "RobustMoments",
    "RowSums",
    "Weighing",
    "absorb_pose_into",
    "absorb_specific_force_into",
    "absorb_velocity_into",
    "jumps",
    "robust_cost",
    "robust_moments",
    "weight_of",
]

HUBER, GATE, GONE = 2.0, 4.5, 6.0
_UPRIGHT = 0.05  # cosine of pitch below which roll and yaw alone mean nothing
_TOGETHER = 10  # samples
_COMPONENTS = 3  # of one instrument: what is wrong in one direction is not to be trusted in the others
NORMAL_MEDIAN = 0.6744897501960817  # of |x| for a standard normal x
_WHITE = 1.5  # deviation of the means, in that of the means of white residuals, up to which they are taken for white


class Weighing(NamedTuple):
    """How residuals are weighed."""

    noise: Array  # (15,) standard deviations of the columns
    scale: Array  # (15,) robust size of the residuals, in those
    gated: bool  # whether far residuals are left out altogether


class RowSums(NamedTuple):
    """What the numbers of one row are added to."""

    H: Array  # (c, c) sum of w J J^T
    g: Array  # (c,) sum of w J r
    residuals: Array  # (15,) in standard deviations of the noise
    J: Array  # (3, c) scratch
    columns: int  # that are estimated; the others are padding


@inlined_kernel
def weight_of(x: float, gated: bool) -> float:
    """Return psi(x) / x of a residual in units of its scale."""
    x = math.fabs(x)
    if x <= HUBER:
        return 1.0
    if not gated or x <= GATE:
        return HUBER / x
    if x < GONE:
        return HUBER * (GONE - x) / ((GONE - GATE) * x)
    return 0.0


@kernel
def _cost_of(x: float, gated: bool) -> float:
    """Return the integral of psi from 0 to |x|."""
    x = math.fabs(x)
    if x <= HUBER:
        return 0.5 * x * x
    if not gated or x <= GATE:
        return HUBER * (x - 0.5 * HUBER)
    far = GONE - min(x, GONE)
    wide = GONE - GATE
    return HUBER * (GATE - 0.5 * HUBER) + 0.5 * HUBER * (wide - far * far / wide)


@kernel
def robust_cost(residuals: Array, scale: Array, gated: bool) -> float:
    """Return the cost of residuals (n, 15) [standard deviations of the noise]; NaN are not measured."""
    total = 0.0
    for i in range(residuals.shape[0]):
        for j in range(residuals.shape[1]):
            x = residuals[i, j]
            if x == x:
                total += _cost_of(x / scale[j], gated)
    return total


class RobustMoments(NamedTuple):
    """Sums over residuals x in units of their scale."""

    number: float
    weights: float  # sum of psi(x) / x
    slopes: float  # sum of psi'(x)
    squares: float  # sum of psi(x)^2
    beyond: float  # number beyond the gate


@kernel
def _moments_into(residuals: Array, scale: Array, out: Array) -> None:
    """Add the moments of residuals (n, 15) to `out` (5,), in the order of `RobustMoments`."""
    for i in range(residuals.shape[0]):
        for j in range(residuals.shape[1]):
            x = residuals[i, j]
            if x == x:
                x = math.fabs(x / scale[j])
                w = weight_of(x, True)
                out[0] += 1.0
                out[1] += w
                out[2] += 1.0 if x <= HUBER else 0.0
                out[3] += w * w * x * x
                out[4] += 1.0 if x > GATE else 0.0


def robust_moments(residuals: Array, scale: Array) -> RobustMoments:
    """Return the moments of residuals (n, 15) [standard deviations of the noise] whose scale is (15,)."""
    out = np.zeros(5)
    _moments_into(residuals, scale, out)
    return RobustMoments(*out)


@inlined_kernel
def _absorb_into(J: Array, residual: float, column: int, weighing: Weighing, sums: RowSums) -> None:
    """Add one residual with derivative J (c,) of the prediction, and note it."""
    noise, scale = weighing.noise[column], weighing.scale[column]
    r = residual / noise
    sums.residuals[column] = r
    w = weight_of(r / scale, weighing.gated) / (noise * noise * scale * scale)
    if w == 0.0:
        return
    H, g = sums.H, sums.g
    for i in range(sums.columns):
        a = w * J[i]
        if a != 0.0:
            g[i] += a * residual
            for j in range(H.shape[1]):
                H[i, j] += a * J[j]


@inlined_kernel
def absorb_velocity_into(z: Array, x: Array, S: Array, weighing: Weighing, sums: RowSums) -> None:
    """Add the body velocity and the angular rates of a row."""
    for j in range(6, 12):
        if math.isfinite(z[j]):
            _absorb_into(S[j], z[j] - x[j + 1], j, weighing, sums)


@inlined_kernel
def absorb_pose_into(z: Array, measured: Array, x: Array, S: Array, weighing: Weighing, sums: RowSums) -> None:
    """Add the position, and the attitude: the rotation from the run to the measurement, else single Euler angles.

    Args:
        z: measured row (15,). measured: quaternion (4,) of its three angles, NaN where one is missing.
    """
    J = sums.J
    for m in range(3):
        if math.isfinite(z[m]):
            _absorb_into(S[m], z[m] - x[m], m, weighing, sums)
    w, i, j, k = x[3], x[4], x[5], x[6]
    if math.isfinite(measured[0]):
        a, b, c, d = measured[0], measured[1], measured[2], measured[3]
        e0 = w * a + i * b + j * c + k * d
        e1 = w * b - i * a - j * d + k * c
        e2 = w * c + i * d - j * a - k * b
        e3 = w * d - i * c + j * b - k * a
        if e0 < 0.0:
            e0, e1, e2, e3 = -e0, -e1, -e2, -e3
        size = math.sqrt(e1 * e1 + e2 * e2 + e3 * e3)
        f = 2.0 * math.atan2(size, e0) / size if size > 1e-9 else 2.0
        _absorb_into(S[3], f * e1, 3, weighing, sums)
        _absorb_into(S[4], f * e2, 4, weighing, sums)
        _absorb_into(S[5], f * e3, 5, weighing, sums)
        return
    if not (math.isfinite(z[3]) or math.isfinite(z[4]) or math.isfinite(z[5])):
        return
    k0, k1, k2 = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)
    c2 = math.sqrt(k1 * k1 + k2 * k2)
    if c2 > _UPRIGHT:
        s1, c1, t2 = k1 / c2, k2 / c2, -k0 / c2
        if math.isfinite(z[3]):
            for m in range(S.shape[1]):
                J[0, m] = S[3, m] + t2 * (s1 * S[4, m] + c1 * S[5, m])
            r = _wrapped(z[3] - math.atan2(k1, k2))
            _absorb_into(J[0], r, 3, weighing, sums)
        if math.isfinite(z[4]):
            for m in range(S.shape[1]):
                J[0, m] = c1 * S[4, m] - s1 * S[5, m]
            r = z[4] - math.atan2(-k0, c2)
            _absorb_into(J[0], r, 4, weighing, sums)
        if math.isfinite(z[5]):
            for m in range(S.shape[1]):
                J[0, m] = (s1 * S[4, m] + c1 * S[5, m]) / c2
            r = _wrapped(z[5] - math.atan2(2.0 * (i * j + w * k), 1.0 - 2.0 * (j * j + k * k)))
            _absorb_into(J[0], r, 5, weighing, sums)


@kernel
def _wrapped(angle: float) -> float:
    """Return the angle within half a turn of zero."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def absorb_specific_force_into(
    z: Array, x: Array, rate: Array, A: Array, S: Array, states: int, weighing: Weighing, sums: RowSums
) -> None:
    """Add the specific force f = v_dot + omega x v - g k at the body origin.

    Args:
        rate: state derivative (13,) at x. A: derivative of the error's rate at x (12, 21 + n).
        states: how many of the columns are of initial states.
    """
    J, n = sums.J, sums.columns - states
    fixed = A.shape[1] - n
    w, i, j, k = x[3], x[4], x[5], x[6]
    k0, k1, k2 = 2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)
    u, v, ww, p, q, r = x[7], x[8], x[9], x[10], x[11], x[12]
    for m in range(3):
        for c in range(S.shape[1]):
            s = 0.0
            for a in range(3, 12):
                s += A[6 + m, a] * S[a, c]
            J[m, c] = s
        for c in range(n):
            J[m, states + c] += A[6 + m, fixed + c]
    for c in range(S.shape[1]):
        e0, e1, e2 = GRAVITY * S[3, c], GRAVITY * S[4, c], GRAVITY * S[5, c]
        J[0, c] += S[10, c] * ww - S[11, c] * v + q * S[8, c] - r * S[7, c] - (k1 * e2 - k2 * e1)
        J[1, c] += S[11, c] * u - S[9, c] * ww + r * S[6, c] - p * S[8, c] - (k2 * e0 - k0 * e2)
        J[2, c] += S[9, c] * v - S[10, c] * u + p * S[7, c] - q * S[6, c] - (k0 * e1 - k1 * e0)
    f0 = rate[7] + q * ww - r * v - GRAVITY * k0
    f1 = rate[8] + r * u - p * ww - GRAVITY * k1
    f2 = rate[9] + p * v - q * u - GRAVITY * k2
    if math.isfinite(z[12]):
        _absorb_into(J[0], z[12] - f0, 12, weighing, sums)
    if math.isfinite(z[13]):
        _absorb_into(J[1], z[13] - f1, 13, weighing, sums)
    if math.isfinite(z[14]):
        _absorb_into(J[2], z[14] - f2, 14, weighing, sums)


def jumps(residuals: Array, scale: Array) -> NDArray[np.bool_]:
    """Return which residuals (n, c) belong to a jump; NaN are not measured.

    Args:
        scale: robust size of the residuals of each column (c,).
    """
    out = np.zeros(residuals.shape, dtype=np.bool_)
    for j in range(residuals.shape[1]):
        there = np.flatnonzero(np.isfinite(residuals[:, j]))
        if there.size < 4 * _TOGETHER:
            continue
        x = residuals[there, j] / scale[j]
        total = np.cumsum(np.concatenate([[0.0], x]))
        means = (total[_TOGETHER:] - total[:-_TOGETHER]) / np.sqrt(_TOGETHER)
        usual = float(np.median(np.abs(means))) / NORMAL_MEDIAN
        if usual > _WHITE:
            continue
        first = np.flatnonzero(np.abs(means) > GATE * max(usual, 1.0))
        if first.size:
            change = np.zeros(x.size + 1, dtype=np.int64)
            np.add.at(change, first, 1)
            np.add.at(change, first + _TOGETHER, -1)
            out[there, j] = np.cumsum(change[:-1]) > 0
    for j in range(0, residuals.shape[1], _COMPONENTS):
        out[:, j : j + _COMPONENTS] |= out[:, j : j + _COMPONENTS].any(axis=1, keepdims=True)
    return out & np.isfinite(residuals)
