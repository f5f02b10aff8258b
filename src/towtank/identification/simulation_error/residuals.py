"""What one measured number adds to the normal equations of a free run: its residual, its derivative, its weight.

Weights are Huber's up to `GATE`, beyond which, once the run is near the data, they fall to nothing (Hampel's three
parts): a marker that jumps has no say. In x = |residual| / scale:

    psi(x) = x (x <= 2),   2 (x <= 4.5),   2 (6 - x) / 1.5 (x <= 6),   0

A hidden marker, a multipath echo or an instrument that hangs puts many samples off together, each perhaps within the
gate. Where residuals are white otherwise, the mean of ten neighbours has less than a third of their deviation, and
ten that are all off by one deviation stand out: `jumps`. Where they are not white, the model is at fault as likely as
the instrument, and nothing is taken out.

Residuals are white for the noise of a sensor, and correlated for long over what the model lacks. The integrated
autocorrelation time of n samples dt apart is dt (1 + 2 sum r_k), up to the lag at which r_k has died: so many seconds
of data say once what white samples would say every dt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.identification.data.samples import N_MEASURED
from towtank.identification.model.measurements import (
    ATTITUDE,
    N_SENSORS,
    SPECIFIC_FORCE,
    cosine_of_pitch,
    measurement_row_into,
    residual_of,
    rotation_between,
    specific_force,
    specific_force_row_into,
    unit_error,
)
from towtank.identification.model.terms import N_FIXED

__all__: list[str] = []

HUBER, GATE, GONE = 2.0, 4.5, 6.0
_UPRIGHT = 0.05  # cosine of pitch below which roll and yaw alone mean nothing
_TOGETHER = 10  # samples
_COMPONENTS = 3  # of one instrument: what is wrong in one direction is not to be trusted in the others
NORMAL_MEDIAN = 0.6744897501960817  # of |x| for a standard normal x
_WHITE = 1.5  # deviation of the means, in that of the means of white residuals, up to which they are taken for white
_BAND = 2.0  # standard deviations of the autocorrelation r_k of a white series
_FEWEST = 20


class Weighing(NamedTuple):
    """How residuals are weighed."""

    noise: Array  # (18,) standard deviations of the columns
    scale: Array  # (18,) robust size of the residuals, in those
    gated: bool  # whether far residuals are left out altogether


class RowSpace(NamedTuple):
    """What a row is compared in: the water, the biases that a free run has none of, and room for a row of H."""

    current: Array  # (3,) [m/s]
    bias: Array  # (9,) of gyro, accelerometer and attitude
    h: Array  # (21 + n,) zero


class RowSums(NamedTuple):
    """What the numbers of one row are added to."""

    H: Array  # (c, c) sum of w J J^T
    g: Array  # (c,) sum of w J r
    residuals: Array  # (18,) in standard deviations of the noise
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
    """Return the cost of residuals (n, 18) [standard deviations of the noise]; NaN are not measured."""
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
    """Add the moments of residuals (n, 18) to `out` (5,), in the order of `RobustMoments`."""
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
    """Return the moments of residuals (n, 18) [standard deviations of the noise] whose scale is (18,)."""
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
def absorb_row_into(
    z: Array, attitude: Array, x: Array, space: RowSpace, S: Array, weighing: Weighing, sums: RowSums
) -> None:
    """Add what all sensors of a row show, but for the specific force.

    Args:
        z: measured row (18,). attitude: quaternion (4,) of its three angles, NaN where one is missing.
        S: sensitivities (12, c) of the state x (13,).
    """
    h, J = space.h, sums.J
    for sensor in range(N_SENSORS):
        if sensor == SPECIFIC_FORCE:
            continue
        whole = sensor != ATTITUDE or math.isfinite(attitude[0])
        if sensor == ATTITUDE and not whole and not cosine_of_pitch(x) > _UPRIGHT:
            continue
        turned = 0.0, 0.0, 0.0
        if sensor == ATTITUDE and whole:
            turned = rotation_between(x[3:7], attitude[0], attitude[1], attitude[2], attitude[3])
        for k in range(3):
            column = 3 * sensor + k
            if not math.isfinite(z[column]):
                continue
            if sensor == ATTITUDE and whole:
                residual = turned[k]
            else:
                residual = residual_of(z, x, space.current, space.bias, sensor, k, whole)
            unit = unit_error(sensor, k, whole)
            if unit >= 0:
                for c in range(S.shape[1]):
                    J[0, c] = S[unit, c]
            else:
                measurement_row_into(x, space.current, False, sensor, k, whole, h)
                for c in range(S.shape[1]):
                    J[0, c] = 0.0
                    for a in range(12):
                        J[0, c] += h[a] * S[a, c]
                h[:12] = 0.0
            _absorb_into(J[0], residual, column, weighing, sums)


@kernel
def absorb_specific_force_into(
    z: Array, x: Array, rate: Array, A: Array, S: Array, space: RowSpace, weighing: Weighing, sums: RowSums
) -> None:
    """Add the specific force at the body origin.

    Args:
        rate: state derivative (13,) at x. A: derivative of the error's rate at x (12, 21 + n).
    """
    h, J = space.h, sums.J
    fixed = N_FIXED - (sums.columns - (A.shape[1] - N_FIXED))  # place in h of the coefficient of a column, less it
    for k in range(3):
        column = 3 * SPECIFIC_FORCE + k
        if not math.isfinite(z[column]):
            continue
        specific_force_row_into(x, A, k, h)
        for c in range(S.shape[1]):
            s = 0.0
            for a in range(3, 12):
                s += h[a] * S[a, c]
            J[0, c] = s
        for c in range(N_FIXED - fixed, sums.columns):
            J[0, c] += h[fixed + c]
        h[:] = 0.0
        _absorb_into(J[0], z[column] - specific_force(x, rate, k), column, weighing, sums)


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


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Of the residuals of each of the 18 columns; NaN where too little is measured.

    Attributes:
        std: standard deviation (18,), in that of the noise. time: integrated autocorrelation time (18,) [s].
        decorrelation_lag: (18,) [s] at which the correlation has died. step: usual time between samples (18,) [s].
    """

    std: Array
    time: Array
    decorrelation_lag: Array
    step: Array


def autocorrelation_of(runs: Sequence[tuple[Array, Array]], limits: Array) -> Autocorrelation:
    """Return the autocorrelation of residuals.

    Args:
        runs: times (n,) [s] and residuals (n, 18) of each recording, NaN where nothing was measured.
        limits: (18,) beyond which a residual is an outlier and left out.
    """
    columns = [_column(runs, j, limits[j]) for j in range(N_MEASURED)]
    return Autocorrelation(*np.array(columns).T)


def _column(runs: Sequence[tuple[Array, Array]], j: int, limit: float) -> tuple[float, float, float, float]:
    """Return of column j what `Autocorrelation` holds, in its order."""
    parts = []
    for t, residuals in runs:
        there = np.isfinite(residuals[:, j])
        if there.any():
            parts.append((t[there], residuals[there, j]))
    if sum(x.size for _, x in parts) < _FEWEST:
        return (np.nan,) * 4
    longest = max(x.size for _, x in parts)
    products, pairs = np.zeros(longest), np.zeros(longest)
    for _, x in parts:
        good = np.abs(x) <= limit
        size = 1 << (2 * x.size - 1).bit_length()
        for into, series in ((products, np.where(good, x, 0.0)), (pairs, good.astype(np.float64))):
            spectrum = np.fft.rfft(series, size)
            into[: x.size] += np.fft.irfft(spectrum.real**2 + spectrum.imag**2, size)[: x.size]
    pairs = np.rint(pairs)
    step = float(np.median(np.concatenate([np.diff(t) for t, _ in parts])))
    if not (products[0] > 0.0 and pairs[0] >= _FEWEST):
        return np.nan, np.nan, np.nan, step
    covariance = products / np.maximum(pairs, 1.0)
    r = covariance[: max(2, longest // 2)] / covariance[0]
    pairwise = 0.5 * (r[1:-1] + r[2:]) if r.size > 2 else r[1:]
    dead = np.flatnonzero(pairwise < _BAND / np.sqrt(2.0 * pairs[0]))
    lags = int(dead[0]) if dead.size else pairwise.size
    time = step * (1.0 + 2.0 * float(r[1 : lags + 1].sum()))
    return float(np.sqrt(covariance[0])), time, step * lags, step
