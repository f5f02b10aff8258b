"""Sensors: one row each, and what each of their numbers should show. The joint filter and free runs both read it.
Channels and usual noise stand in `recording.standard`, which files, links and merging read as well.

Columns of a row of measurements stand sensor by sensor, three of each: column 3 s + k is number k of sensor s. With the
state x = [position (NED), quaternion, velocity through the water, rates] and errors in the order of
`model.linearisation` (position 3, attitude 3, velocity 6, disturbance 6, current 3, coefficients):

    position            h = p                                  H = e_k
    attitude, whole     h = log of the rotation to what is measured, body
    single Euler angles h = atan2(k_y, k_z), ...               H by the rotation vector's derivative
    velocity            h = v + R^T v_c                        H = e_k, R^T and [R^T v_c]x beside a current
    rates               h = omega + b_gyro
    specific force      h = v_dot + omega x v - g k + b_acc    H = row of A, and the derivatives of the rest
    water velocity      h = v                                  H = e_k

The velocity is that through the water, v_c a current that is constant in the world: then d/dt (v + R^T v_c) + omega x
(v + R^T v_c) is v_dot + omega x v, and the accelerometer sees no current.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import row_of_rotation, to_body
from towtank.recording.axes import axes_shown
from towtank.recording.standard import MEASURED, QUANTITIES, TRIPLES
from towtank.vehicle.matrices import GRAVITY

__all__ = [
    "ATTITUDE",
    "LEAST_NOISE",
    "LONGEST_OUTAGE",
    "LOOSE",
    "NEVER",
    "N_SENSORS",
    "OFFSET_STAYS",
    "REACQUIRE",
    "SENSORS",
    "SPECIFIC_FORCE",
    "SPEEDS",
    "TYPICAL_NOISE",
    "attitude_error",
    "cosine_of_pitch",
    "measurement_row_into",
    "pace_of",
    "residual_of",
    "rotation_between",
    "shown_axes",
    "specific_force",
    "specific_force_row_into",
    "unit_error",
]


def shown_axes(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return of which axes (6,) the motion is shown, by any channel that tells of it.

    Args:
        measured: which columns (18,) are measured.
    """
    return np.array(axes_shown({name for name, known in zip(MEASURED, measured, strict=True) if known}))


class Sensor(NamedTuple):
    """One sensor; numbers in the unit of its columns (m, rad, m/s, rad/s, m/s^2).

    Attributes:
        first_error: place of the error state that its first number measures; -1 where H is no unit vector.
        least: deviation of its noise, of all that is believed.
        offset_stays: what is wrong once stays wrong (a camera that has lost its marker), so that a sensor is accepted
            again only when its samples speak against the offset; else its samples only jump.
        reacquire: times `FilterSettings.reacquire` until one that still speaks is taken at its word; inf: never, as
            befits an H that is no unit vector.
        longest_outage: [s] after which samples beyond the gate, three of them, count all the same.
        loose: deviation of a state that is taken from it anew.
        latency: time from the motion to its stamp and deviation [s], before any data. late: whether data tell it.
    """

    name: str
    first_error: int
    least: float
    offset_stays: bool
    reacquire: float
    longest_outage: float
    loose: float
    latency: tuple[float, float] = (0.05, 0.1)
    late: bool = True


SENSORS = (  # in the order of `TRIPLES`
    Sensor("position", 0, 1e-5, True, 1.0, math.inf, 1.0),
    Sensor("attitude", 3, 1e-5, True, 3.0, math.inf, 0.1),
    Sensor("velocity", 6, 1e-4, False, 3.0, 0.3, 0.5),
    Sensor("rates", 9, 1e-5, False, 3.0, 0.03, 0.5),
    Sensor("specific force", -1, 1e-3, False, math.inf, math.inf, 0.0, late=False),
    Sensor("velocity through the water", 6, 1e-4, False, 3.0, 0.3, 0.5),
)
POSITION, ATTITUDE, VELOCITY, RATES, SPECIFIC_FORCE, WATER_VELOCITY = range(6)
SPEEDS = (VELOCITY, WATER_VELOCITY)  # show u v w as they stand in the state, but for a current; the first comes first
N_SENSORS = len(SENSORS)
NEVER = -math.inf  # when a sensor was last accepted that has shown nothing since the motion began
# as kernels read them, by sensor
_FIRST_ERROR = tuple(each.first_error for each in SENSORS)
OFFSET_STAYS = tuple(each.offset_stays for each in SENSORS)
REACQUIRE = tuple(each.reacquire for each in SENSORS)
LONGEST_OUTAGE = tuple(each.longest_outage for each in SENSORS)
LOOSE = tuple(each.loose for each in SENSORS)
# by column
TYPICAL_NOISE = tuple(each.noise for each in QUANTITIES for _ in each.channels)  # where nothing tells it
LEAST_NOISE = tuple(each.least for each, columns in zip(SENSORS, TRIPLES, strict=True) for _ in columns)


@kernel
def unit_error(sensor: int, k: int, whole: bool) -> int:
    """Return the error state that number k of a sensor measures by itself; -1 where H is no unit vector.

    That of a velocity over ground is one in water at rest.
    """
    first = _FIRST_ERROR[sensor]
    return -1 if first < 0 or (sensor == ATTITUDE and not whole) else first + k


@kernel
def residual_of(z: Array, x: Array, current: Array, bias: Array, sensor: int, k: int, whole: bool) -> float:
    """Return what number k of a sensor shows beyond what the state expects, angles by the shortest way.

    Args:
        z: the row (18,). x: state (13,). current: (3,) [m/s], NED. bias: (9,) of gyro, accelerometer, attitude: about
            x and y of the body, and about the vertical, since a heading is off by as much whatever way it leans.
        sensor: not specific force. whole: all three numbers of the sensor are there.
    """
    value = z[3 * sensor + k]
    if sensor == POSITION:
        return float(value - x[k])
    if sensor == ATTITUDE:
        if whole:
            off = attitude_error(x[3:7], z[3], z[4], z[5] - bias[8])[k]
            return float(off - bias[6 + k] if k < 2 else off)
        kx, ky, kz = row_of_rotation(x[3:7], 2)
        if k == 0:
            return _wrapped(value - math.atan2(ky, kz))
        if k == 1:
            return float(value - math.atan2(-kx, math.hypot(ky, kz)))
        heading = math.atan2(row_of_rotation(x[3:7], 1)[0], row_of_rotation(x[3:7], 0)[0])
        return _wrapped(value - bias[8] - heading)
    if sensor == VELOCITY:
        return float(value - x[7 + k] - to_body(x[3:7], current)[k])
    if sensor == RATES:
        return float(value - x[10 + k] - bias[k])
    return float(value - x[7 + k])


@kernel
def measurement_row_into(x: Array, current: Array, flows: bool, sensor: int, k: int, whole: bool, h: Array) -> None:
    """Write H of number k of a sensor (not of specific force) into `h` (N,), which is zero before; `flows`: there may
    be a current."""
    unit = unit_error(sensor, k, whole)
    if unit >= 0:
        h[unit] = 1.0
    if sensor == ATTITUDE and not whole:
        kx, ky, kz = row_of_rotation(x[3:7], 2)
        c2 = math.hypot(ky, kz)
        s1, c1 = ky / c2, kz / c2
        if k == 0:
            h[3], h[4], h[5] = 1.0, -s1 * kx / c2, -c1 * kx / c2
        elif k == 1:
            h[4], h[5] = c1, -s1
        else:
            h[4], h[5] = s1 / c2, c1 / c2
    elif sensor == VELOCITY and flows:
        through, i, j = to_body(x[3:7], current), (k + 1) % 3, (k + 2) % 3
        h[3 + i], h[3 + j] = -through[j], through[i]  # R^T v_c turns with the attitude: [c]x e
        for n in range(3):
            h[18 + n] = row_of_rotation(x[3:7], n)[k]


@kernel
def pace_of(x: Array, current: Array, rate: Array, sensor: int, k: int) -> float:
    """Return the derivative by time of number k of a sensor (not specific force; an attitude in the body): what it
    shows late.

    Args:
        x: state (13,). current: (3,) [m/s], NED. rate: acceleration (6,) [m/s^2, rad/s^2].
    """
    if sensor == POSITION:
        a, b, c = row_of_rotation(x[3:7], k)
        return float(a * x[7] + b * x[8] + c * x[9] + current[k])
    if sensor == ATTITUDE:
        return float(x[10 + k])
    if sensor == RATES:
        return float(rate[3 + k])
    if sensor == VELOCITY:  # R^T v_c turns with the body
        through, i, j = to_body(x[3:7], current), (k + 1) % 3, (k + 2) % 3
        return float(rate[k] - (x[10 + i] * through[j] - x[10 + j] * through[i]))
    return float(rate[k])


@kernel
def specific_force(x: Array, rate: Array, k: int) -> float:
    """Return number k of v_dot + omega x v - g k [m/s^2], body; `rate` is the state's derivative (13,) at x."""
    i, j = (k + 1) % 3, (k + 2) % 3
    return float(rate[7 + k] + x[10 + i] * x[7 + j] - x[10 + j] * x[7 + i] - GRAVITY * row_of_rotation(x[3:7], 2)[k])


@kernel
def specific_force_row_into(x: Array, A: Array, k: int, h: Array) -> None:
    """Write H of number k of the specific force into `h`, for all errors and coefficients that `A` (12, 21 + n) has."""
    i, j = (k + 1) % 3, (k + 2) % 3
    down = row_of_rotation(x[3:7], 2)
    for c in range(A.shape[1]):
        h[c] = A[6 + k, c]
    h[6 + j] += x[10 + i]
    h[6 + i] -= x[10 + j]
    h[9 + i] += x[7 + j]
    h[9 + j] -= x[7 + i]
    h[3 + i] += GRAVITY * down[j]
    h[3 + j] -= GRAVITY * down[i]


@kernel
def cosine_of_pitch(x: Array) -> float:
    """Return how far single Euler angles mean something: the cosine of pitch at the state x (13,)."""
    _, ky, kz = row_of_rotation(x[3:7], 2)
    return math.hypot(ky, kz)


@kernel
def attitude_error(q: Array, phi: float, theta: float, psi: float) -> tuple[float, float, float]:
    """Return the rotation vector (body) from the attitude q (4,) to the Euler angles' attitude."""
    c1, s1 = math.cos(0.5 * phi), math.sin(0.5 * phi)
    c2, s2 = math.cos(0.5 * theta), math.sin(0.5 * theta)
    c3, s3 = math.cos(0.5 * psi), math.sin(0.5 * psi)
    return rotation_between(
        q,
        c1 * c2 * c3 + s1 * s2 * s3,
        s1 * c2 * c3 - c1 * s2 * s3,
        c1 * s2 * c3 + s1 * c2 * s3,
        c1 * c2 * s3 - s1 * s2 * c3,
    )


@kernel
def rotation_between(q: Array, w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the rotation vector (body) from the attitude q (4,) to the quaternion w x y z, the shorter way round."""
    a, b, c, d = q[0], -q[1], -q[2], -q[3]
    ew = a * w - b * x - c * y - d * z
    ex = a * x + b * w + c * z - d * y
    ey = a * y - b * z + c * w + d * x
    ez = a * z + b * y - c * x + d * w
    size = math.sqrt(ex * ex + ey * ey + ez * ez)
    scale = 2.0 * math.atan2(size, math.fabs(ew)) / size if size >= 1e-9 else 2.0
    if ew < 0.0:
        scale = -scale
    return scale * ex, scale * ey, scale * ez


@kernel
def _wrapped(angle: float) -> float:
    """Return the angle within half a turn of zero."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
