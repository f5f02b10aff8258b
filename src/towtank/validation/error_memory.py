"""What an error is made of: a slow part that remembers, and white noise of the sensor.

A slow disturbance d with the correlation time T_d pushes the vehicle, whose own lag T_v turns it into an error e of the
prediction; the sensor adds white noise of standard deviation n:

    d' = -d / T_d + w,    e' = (d - e) / T_v,    y - yhat = b + e + n

e remembers for T_d + T_v, the integral of its autocorrelation. A prediction starts from the measured state: there e is
new and d is not, and so it is wherever the prediction is set back. The likelihood comes from a Kalman filter, exact
for any times of the samples; its innovations, divided by their standard deviation, are the errors one step ahead of
someone who has watched the errors so far (the noise model of Box and Jenkins; Ljung, System Identification, 4.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from towtank.core.arrays import Array, kernel
from towtank.validation.error_series import ErrorSeries

__all__ = ["Memory", "Samples", "memory_of", "whiten"]

Indices = NDArray[np.int64]
_ENOUGH = 12_000  # samples that the fit looks at; of more, every second, third, ...
_FEWEST, _FEWEST_COARSE = 30, 200
_PER_MEMORY = 10.0
_LEAST_NOISE = 1e-3  # of the slow power: what is smoother was smoothed, and would be taken for a long memory
_SURE = float(chdtri(3, 1e-3))  # gain of likelihood that makes a memory believable
_STARTS = (1.0, 0.15, 0.02)  # shares of the longest time


@dataclass(frozen=True, eq=False)
class Samples:
    """Errors one after the other: their times (n,) [s], what begins there (0 nothing, 1 the prediction, 2 a recording).

    Attributes:
        stretch, row: where each came from (n,). step: typical time between two [s].
    """

    t: Array
    value: Array
    begins: Indices
    stretch: NDArray[np.intp]
    row: NDArray[np.intp]
    step: float


@dataclass(frozen=True)
class Memory:
    """A fitted model of the errors.

    Attributes:
        disturbance_time, vehicle_time: T_d and T_v [s]. slow, white: standard deviations of e and of the noise.
        bias: b. believable: the memory explains the errors better than white noise does, at 0.1 %.
    """

    disturbance_time: float
    vehicle_time: float
    slow: float
    white: float
    bias: float
    believable: bool

    @property
    def time(self) -> float:
        """Correlation time of the slow part [s]."""
        return self.disturbance_time + self.vehicle_time

    @property
    def noise_known(self) -> bool:
        """Whether the noise stands out of the slow part; `white` is a bound where it does not."""
        return self.white**2 > 1.1 * _LEAST_NOISE * self.slow**2

    def covariance(self, lag: Array) -> Array:
        """Return the covariance of the slow part at lags [s]; the white part is left out."""
        a, b = self.disturbance_time, self.vehicle_time
        if abs(a - b) < 1e-3 * a:
            b = 0.999 * a
        return np.asarray(self.slow**2 * (a * np.exp(-lag / a) - b * np.exp(-lag / b)) / (a - b))


def memory_of(series: ErrorSeries) -> tuple[Samples, Memory | None]:
    """Return the errors of a channel as the fit saw them, and their memory; None where there are too few or none.

    Errors so smooth that no noise is seen in them say more about the sensor's own smoothing than about a memory: they
    are taken at longer steps, ten to a memory.
    """
    every = max(1, math.ceil(series.samples / _ENOUGH))
    samples = _samples(series, every)
    memory = _fit(samples, series.duration)
    if memory is not None and not memory.noise_known:
        coarser = min(int(memory.time / (_PER_MEMORY * samples.step)), samples.t.size // _FEWEST_COARSE)
        if coarser > 1:
            samples = _samples(series, every * coarser)
            memory = _fit(samples, series.duration)
    return samples, memory


def _samples(series: ErrorSeries, every: int) -> Samples:
    """Return every so many errors of a channel."""
    t, value, begins, stretches, rows = [], [], [], [], []
    last = -1
    for k, stretch in enumerate(series.stretches):
        known = np.flatnonzero(~np.isnan(stretch.error))[::every]
        if not known.size:
            continue
        begins.append(np.zeros(known.size, dtype=np.int64))
        begins[-1][0] = 1 if stretch.recording == last else 2
        last = stretch.recording
        t.append(stretch.t[known])
        value.append(stretch.error[known])
        stretches.append(np.full(known.size, k))
        rows.append(known)
    return Samples(
        t=np.concatenate(t),
        value=np.concatenate(value),
        begins=np.concatenate(begins),
        stretch=np.concatenate(stretches),
        row=np.concatenate(rows),
        step=every * series.step,
    )


@kernel
def _whiten(
    t: Array, Y: Array, begins: Indices, T_d: float, T_v: float, slow: float, white: float
) -> tuple[Array, Array]:
    """Return innovations (n, c) of the columns Y (n, c), each over its deviation, and the deviations (n,).

    Args:
        T_d, T_v: time constants [s], not equal. slow, white: standard deviations.
    """
    n, c = Y.shape
    out, deviation = np.empty((n, c)), np.empty(n)
    d, e = np.zeros(c), np.zeros(c)
    s_ee = slow * slow
    s_dd = s_ee * (T_d + T_v) / T_d
    noise = white * white
    ee, ed, dd = 0.0, 0.0, s_dd
    h, a, b, g, q_ee, q_ed, q_dd = -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        if begins[i] == 0:
            if abs(t[i] - t[i - 1] - h) > 1e-9 * abs(h):
                h = t[i] - t[i - 1]
                a, b = math.exp(-h / T_d), math.exp(-h / T_v)
                g = (a - b) * T_d / (T_d - T_v)
                q_dd = s_dd * (1.0 - a * a)
                q_ed = s_ee - a * (b * s_ee + g * s_dd)
                q_ee = max(s_ee - (b * b * s_ee + 2.0 * b * g * s_ee + g * g * s_dd), 0.0)
            ee, ed, dd = (
                b * b * ee + 2.0 * b * g * ed + g * g * dd + q_ee,
                a * (b * ed + g * dd) + q_ed,
                a * a * dd + q_dd,
            )
            for j in range(c):
                e[j] = b * e[j] + g * d[j]
                d[j] = a * d[j]
        else:
            ee, ed = s_ee, 0.0
            e[:] = 0.0
            if begins[i] == 2:
                ed, dd = s_ee, s_dd
                d[:] = 0.0
        S = ee + noise
        k_e, k_d = ee / S, ed / S
        deviation[i] = math.sqrt(S)
        for j in range(c):
            away = Y[i, j] - e[j]
            out[i, j] = away / deviation[i]
            e[j] += k_e * away
            d[j] += k_d * away
        ee, ed, dd = ee - k_e * ee, ed - k_d * ee, dd - k_d * ed
    return out, deviation


def whiten(samples: Samples, columns: Array, memory: Memory) -> tuple[Array, Array]:
    """Return the columns (n, c), made white as the errors are by their memory, and the deviation of each row (n,)."""
    T_d, T_v = _apart(memory.disturbance_time, memory.vehicle_time)
    return _whiten(
        samples.t, np.ascontiguousarray(columns), samples.begins, T_d, T_v, memory.slow, max(memory.white, 1e-300)
    )


def _fit(samples: Samples, duration: float) -> Memory | None:
    """Fit the memory of an error by maximum likelihood; None where there are too few samples or no error at all.

    Args:
        duration: time that the errors cover [s]; a memory longer than this cannot be told.
    """
    from scipy.optimize import minimize  # slow to import, seldom needed

    n = samples.t.size
    spread = float(np.std(samples.value)) if n else 0.0
    if n < _FEWEST or not np.isfinite(samples.value).all() or spread <= 0.0:
        return None
    Y = np.column_stack([samples.value / spread, np.ones(n)])
    shortest, longest = 0.2 * samples.step, max(duration, 2.0 * samples.step)
    bounds = np.log([(_LEAST_NOISE, 1e8), (shortest, longest), (0.1 * shortest, longest)])

    def parts(x: Array) -> tuple[float, float, float, float]:
        ratio, T_d, T_v = np.exp(np.clip(x, bounds[:, 0], bounds[:, 1]))
        share = 1.0 / (1.0 + ratio)  # of the power that is slow
        return (*_apart(float(T_d), float(T_v)), math.sqrt(share), math.sqrt(max(1.0 - share, 1e-12)))

    def cost(x: Array) -> float:
        W, deviation = _whiten(samples.t, Y, samples.begins, *parts(x))
        beyond = x - np.clip(x, bounds[:, 0], bounds[:, 1])
        return _cost(W, deviation) + 10.0 * float(beyond @ beyond)

    starts = [
        np.log([ratio, max(share * 0.2 * longest, 2.0 * samples.step), max(0.1 * share * longest, shortest)])
        for ratio in (0.1, 10.0)
        for share in _STARTS
    ]
    simplex = min(starts, key=cost) + np.vstack([np.zeros(3), np.diag([1.0, 0.7, 0.7])])
    best = minimize(
        cost, simplex[0], method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.02, "maxfev": 250},
    )  # fmt: skip
    T_d, T_v, slow, white = parts(best.x)
    W, deviation = _whiten(samples.t, Y, samples.begins, T_d, T_v, slow, white)
    bias = float(W[:, 0] @ W[:, 1] / (W[:, 1] @ W[:, 1]))
    scale = spread * float(np.sqrt(np.mean((W[:, 0] - bias * W[:, 1]) ** 2)))
    plain = n * math.log(float(np.mean((Y[:, 0] - Y[:, 0].mean()) ** 2)))
    gain = plain - _cost(W, deviation)
    return Memory(T_d, T_v, scale * slow, scale * white, spread * bias, bool(gain > _SURE))


@kernel
def _cost(W: Array, deviation: Array) -> float:
    """Return -2 log likelihood, less a constant, with bias and scale at their best."""
    yy, y1, ones, logs = 0.0, 0.0, 0.0, 0.0
    for i in range(W.shape[0]):
        yy += W[i, 0] * W[i, 0]
        y1 += W[i, 0] * W[i, 1]
        ones += W[i, 1] * W[i, 1]
        logs += math.log(deviation[i])
    n = W.shape[0]
    return float(n * math.log(max(yy - y1 * y1 / ones, 1e-300) / n) + 2.0 * logs)


def _apart(T_d: float, T_v: float) -> tuple[float, float]:
    """Return the two time constants, not quite equal."""
    return (T_d, T_v) if abs(T_d - T_v) > 1e-3 * T_d else (T_d, 0.998 * T_d)
