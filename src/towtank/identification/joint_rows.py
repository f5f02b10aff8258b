"""What the sensors should show: rows of H and residuals for position, attitude, velocity and angular rates."""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel
from towtank.identification.joint_state import O_BIASES, JointState
from towtank.identification.transition import N_FIXED

__all__ = ["attitude_error", "is_upright", "residual_of", "row_of"]


@kernel
def row_of(state: JointState, sensor: int, k: int, whole: bool) -> None:
    """Write H of number k of a sensor into `state.h` (which is zero before): 0 position .. 3 angular rates."""
    h = state.h
    x = state.x
    n = state.theta.shape[0]
    if sensor == 0:
        h[k] = 1.0
    elif sensor == 1:
        if whole:
            h[3 + k] = 1.0
        else:
            qw, qx, qy, qz = x[3], x[4], x[5], x[6]
            kx, ky, kz = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
            c2 = math.hypot(ky, kz)
            s1, c1 = ky / c2, kz / c2
            if k == 0:
                h[3], h[4], h[5] = 1.0, -s1 * kx / c2, -c1 * kx / c2
            elif k == 1:
                h[4], h[5] = c1, -s1
            else:
                h[4], h[5] = s1 / c2, c1 / c2
    elif sensor == 2:
        h[6 + k] = 1.0
        c0, c1, c2 = _current_in_body(state)
        if c0 != 0.0 or c1 != 0.0 or c2 != 0.0 or state.P[18, 18] > 0.0:
            qw, qx, qy, qz = x[3], x[4], x[5], x[6]
            if k == 0:
                h[18], h[19], h[20] = (
                    1.0 - 2.0 * (qy * qy + qz * qz),
                    2.0 * (qx * qy + qw * qz),
                    2.0 * (qx * qz - qw * qy),
                )
                h[4], h[5] = -c2, c1  # R^T v_c turns with the attitude: [c]x e
            elif k == 1:
                h[18], h[19], h[20] = (
                    2.0 * (qx * qy - qw * qz),
                    1.0 - 2.0 * (qx * qx + qz * qz),
                    2.0 * (qy * qz + qw * qx),
                )
                h[3], h[5] = c2, -c0
            else:
                h[18], h[19], h[20] = (
                    2.0 * (qx * qz + qw * qy),
                    2.0 * (qy * qz - qw * qx),
                    1.0 - 2.0 * (qx * qx + qy * qy),
                )
                h[3], h[4] = -c1, c0
    else:
        h[9 + k] = 1.0
        if state.options[O_BIASES] > 0.0:
            h[N_FIXED + n + k] = 1.0


@kernel
def _current_in_body(state: JointState) -> tuple[float, float, float]:
    qw, qx, qy, qz = state.x[3], state.x[4], state.x[5], state.x[6]
    a, b, c = state.current[0], state.current[1], state.current[2]
    return (
        (1.0 - 2.0 * (qy * qy + qz * qz)) * a + 2.0 * (qx * qy + qw * qz) * b + 2.0 * (qx * qz - qw * qy) * c,
        2.0 * (qx * qy - qw * qz) * a + (1.0 - 2.0 * (qx * qx + qz * qz)) * b + 2.0 * (qy * qz + qw * qx) * c,
        2.0 * (qx * qz + qw * qy) * a + 2.0 * (qy * qz - qw * qx) * b + (1.0 - 2.0 * (qx * qx + qy * qy)) * c,
    )


@kernel
def attitude_error(q: Array, phi: float, theta: float, psi: float) -> tuple[float, float, float]:
    """Return the rotation vector (body) from the attitude q (4,) to the Euler angles' attitude."""
    c1, s1 = math.cos(0.5 * phi), math.sin(0.5 * phi)
    c2, s2 = math.cos(0.5 * theta), math.sin(0.5 * theta)
    c3, s3 = math.cos(0.5 * psi), math.sin(0.5 * psi)
    w = c1 * c2 * c3 + s1 * s2 * s3
    x = s1 * c2 * c3 - c1 * s2 * s3
    y = c1 * s2 * c3 + s1 * c2 * s3
    z = c1 * c2 * s3 - s1 * s2 * c3
    a, b, c, d = q[0], -q[1], -q[2], -q[3]
    ew = a * w - b * x - c * y - d * z
    ex = a * x + b * w + c * z - d * y
    ey = a * y - b * z + c * w + d * x
    ez = a * z + b * y - c * x + d * w
    size = math.sqrt(ex * ex + ey * ey + ez * ez)
    if size < 1e-9:
        scale = 2.0 if ew >= 0.0 else -2.0
    else:
        scale = 2.0 * math.atan2(size, math.fabs(ew)) / size
        if ew < 0.0:
            scale = -scale
    return scale * ex, scale * ey, scale * ez


@kernel
def _wrapped(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def residual_of(state: JointState, z: Array, sensor: int, k: int, whole: bool) -> float:
    """Return what number k of a sensor shows beyond what the state expects, angles by the shortest way."""
    x = state.x
    value = z[3 * sensor + k]
    if sensor == 0:
        return float(value - x[k])
    if sensor == 1:
        if whole:
            ex, ey, ez = attitude_error(x[3:7], z[3], z[4], z[5])
            return ex if k == 0 else (ey if k == 1 else ez)
        qw, qx, qy, qz = x[3], x[4], x[5], x[6]
        ky, kz = 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
        if k == 0:
            return _wrapped(value - math.atan2(ky, kz))
        if k == 1:
            return float(value - math.atan2(2.0 * (qw * qy - qx * qz), math.hypot(ky, kz)))
        return _wrapped(value - math.atan2(2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qy * qy + qz * qz)))
    if sensor == 2:
        c0, c1, c2 = _current_in_body(state)
        return float(value - x[7 + k] - (c0 if k == 0 else (c1 if k == 1 else c2)))
    return float(value - x[10 + k] - state.bias[k])


@kernel
def is_upright(state: JointState) -> bool:
    """Whether single Euler angles mean something: not within about 8 degrees of a pitch of 90."""
    x = state.x
    ky, kz = 2.0 * (x[5] * x[6] + x[3] * x[4]), 1.0 - 2.0 * (x[4] * x[4] + x[5] * x[5])
    return bool(ky * ky + kz * kz > 0.02)
