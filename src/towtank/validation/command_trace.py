"""Whether an error follows the command: a fault of the model does, a disturbance does not.

The regressors are what a fault looks like: the commanded force of the axis, and the speed times its size that the model
predicts from the commands (which is what a drag multiplies), both smoothed from each start of the prediction on. Errors
and regressors pass through the filter that makes the errors white (their memory), so that two slow series that only
happen to run alike are not taken for cause and effect. Least squares then says how the errors follow, and the jackknife
over blocks of time how sure that is: without any one block the answer must stay the same (Hotelling's T^2, with as many
degrees of freedom as there are blocks).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import fdtrc

from towtank.core.arrays import Array
from towtank.validation.error_memory import Memory, Samples, whiten
from towtank.validation.error_series import ErrorSeries, Stretch

__all__ = ["CommandTrace", "command_trace"]

_SMOOTHING = (0.4, 3.0)  # s
_ALIKE = 0.01  # share of the power, below which a combination of regressors repeats the others
_BLOCKS = 40
_LAGS = 40
_LONGEST = 10.0  # s
_BAND = 1.959963984540054


@dataclass(frozen=True, eq=False)
class CommandTrace:
    """What an error has to do with the commanded force of its axis.

    Attributes:
        lag: of the error behind the force (h,) [s]. correlation: normalised cross-correlation (h,). band: (h,) that it
            stays within with 95 % probability where there is no connection, for errors with this memory.
        share: of the error's power that follows the command, 0 .. 1. p: probability of such a trace by chance.
    """

    lag: Array
    correlation: Array
    band: Array
    share: float
    p: float

    @property
    def strongest(self) -> tuple[float, float]:
        """The lag [s] at which the correlation stands out most from its band, and the correlation there."""
        k = int(np.argmax(np.abs(self.correlation) / self.band))
        return float(self.lag[k]), float(self.correlation[k])


def command_trace(series: ErrorSeries, samples: Samples, memory: Memory) -> CommandTrace | None:
    """Return the trace of the command in an error; None where the axis was not commanded or samples are too few."""
    force = np.concatenate([stretch.wrench for stretch in series.stretches])
    if float(np.std(force)) <= 1e-9 * (1.0 + float(np.abs(force).max())):
        return None
    bank = np.vstack([_bank(stretch) for stretch in series.stretches])
    firsts = np.cumsum([0, *(stretch.t.size for stretch in series.stretches)])
    U = _distinct(bank[firsts[samples.stretch] + samples.row])
    n, m = U.shape
    blocks = min(_BLOCKS, n // 10)
    if not m or blocks < 3 * m:
        return None
    W, _ = whiten(samples, np.column_stack([samples.value, np.ones(n), U]), memory)
    ones = W[:, 1:2] / np.linalg.norm(W[:, 1])
    error, shape = W[:, :1] - ones @ (ones.T @ W[:, :1]), W[:, 2:] - ones @ (ones.T @ W[:, 2:])
    lag, correlation, band = _correlation(series, memory)
    share = _share(U, shape, error[:, 0], samples.value)
    return CommandTrace(lag, correlation, band, share, _chance(shape, error, blocks))


def _bank(stretch: Stretch) -> Array:
    """Return force and drag through low-passes from rest (n, 4)."""
    from scipy.signal import lfilter  # slow to import, seldom needed

    keep = [math.exp(-stretch.dt / tau) for tau in _SMOOTHING]
    return np.column_stack([lfilter([1.0 - k], [1.0, -k], x) for x in (stretch.wrench, stretch.drag) for k in keep])


def _distinct(U: Array) -> Array:
    """Return the combinations (n, m) of the columns that differ, uncorrelated and of unit size."""
    U = U - U.mean(axis=0)
    U = U[:, U.std(axis=0) > 0.0]
    U = U / U.std(axis=0)
    power, directions = np.linalg.eigh(U.T @ U / U.shape[0])
    kept = power > _ALIKE * power[-1:]
    return np.asarray(U @ directions[:, kept] / np.sqrt(power[kept]))


def _chance(shape: Array, error: Array, blocks: int) -> float:
    """Return the probability that the white error (n, 1) follows the white regressors (n, m) so much by chance."""
    n, m = shape.shape
    edges = np.linspace(0, n, blocks + 1).astype(np.intp)
    grams = np.array([shape[a:b].T @ shape[a:b] for a, b in pairwise(edges)])
    scores = np.add.reduceat(shape * error, edges[:-1], axis=0)
    gram, score = grams.sum(axis=0), scores.sum(axis=0)
    whole = np.linalg.lstsq(gram, score, rcond=None)[0]
    away = np.array(
        [np.linalg.lstsq(gram - g, score - s, rcond=None)[0] - whole for g, s in zip(grams, scores, strict=True)]
    )
    covariance = (blocks - 1.0) / blocks * away.T @ away
    statistic = float(whole @ np.linalg.pinv(covariance, rcond=1e-10, hermitian=True) @ whole)
    return float(fdtrc(m, blocks - m, statistic * (blocks - m) / (m * (blocks - 1.0))))


def _share(U: Array, shape: Array, error: Array, values: Array) -> float:
    """Return the share of the error's power along what the regressors explain, less what they explain by chance."""
    gram = np.linalg.pinv(shape.T @ shape, rcond=1e-10, hermitian=True)
    b = gram @ (shape.T @ error)
    left = error - shape @ b
    noise = float(left @ left) / max(error.size - U.shape[1], 1)
    explained = U @ b
    power = float(np.var(explained))
    if power <= 0.0:
        return 0.0
    chance = noise * float(np.trace(gram @ (U.T @ U))) / error.size
    alike = float(np.corrcoef(explained, values)[0, 1]) ** 2
    return float(alike * max(1.0 - chance / power, 0.0))


def _correlation(series: ErrorSeries, memory: Memory) -> tuple[Array, Array, Array]:
    """Return lags, cross-correlation and its 95 % band over all stretches."""
    longest = min(_LONGEST, 0.25 * max(stretch.t[-1] - stretch.t[0] for stretch in series.stretches))
    lags = np.linspace(0.0, longest, _LAGS + 1)
    centre = float(series.errors.mean())
    force_mean = float(np.mean(np.concatenate([stretch.wrench for stretch in series.stretches])))
    products, variance, error_power, force_power = np.zeros(lags.size), 0.0, 0.0, 0.0
    for dt in {stretch.dt for stretch in series.stretches}:
        group = [stretch for stretch in series.stretches if stretch.dt == dt]
        n = max(stretch.t.size for stretch in group)
        apart = np.zeros(n)  # so that no lag reaches from one stretch to another
        raw = np.concatenate([piece for stretch in group for piece in (stretch.error, apart * np.nan)])
        force = np.concatenate([piece for stretch in group for piece in (stretch.wrench - force_mean, apart)])
        there = ~np.isnan(raw)
        error = np.where(there, raw - centre, 0.0)
        size = next_fast_len(error.size, real=True)
        rows = np.minimum(np.rint(lags / dt).astype(np.intp), n)
        products += irfft(rfft(error, size) * np.conj(rfft(force, size)), size)[rows]
        seen = irfft(np.abs(rfft(np.where(there, force, 0.0), size)) ** 2, size)[:n]
        slow = memory.covariance(np.arange(n) * np.float64(dt))
        variance += float(seen[0] * (slow[0] + memory.white**2) + 2.0 * seen[1:] @ slow[1:])
        error_power += float(error @ error)
        force_power += float(np.where(there, force, 0.0) @ force)
    scale = math.sqrt(max(error_power * force_power, 1e-300))
    return lags, products / scale, np.full(lags.size, _BAND * math.sqrt(max(variance, 0.0)) / scale)
