"""Autocorrelation of series with gaps and irregular samples, and the portmanteau test that they are white.

    r_k = sum of e_i e_j over all pairs k slots apart / sum of e_i^2,    Q = n (n + 2) sum_k r_k^2 / N_k ~ chi^2(h)

N_k counts the pairs that both were sampled (Parzen's amplitude modulation); without gaps N_k = n - k and Q is that of
Ljung and Box (1978). A slot is as wide as the typical time between samples, so that irregular pairs fall into the
nearest. The variance of each r_k is measured, sum of e_i^2 e_j^2 / (sum of e_i^2)^2, in place of N_k / n^2: with a
noise level that changes in time, or with outliers, the plain statistic finds structure where there is none (Lobato,
Nankervis and Savin, 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtrc

from towtank.core.arrays import Array

__all__ = ["Autocorrelation", "Portmanteau", "autocorrelation", "portmanteau"]

_BAND = 1.959963984540054
_LAGS = 20  # of the portmanteau, at most a fifth of the samples


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Normalised autocorrelation.

    Attributes:
        lag: (h,) [s], from one slot on. value: (h,). pairs: samples that each rests on (h,).
        band: (h,) that a white series stays within with 95 % probability, each lag by itself.
        variance: of each value for a white series (h,).
    """

    lag: Array
    value: Array
    pairs: Array
    band: Array
    variance: Array


@dataclass(frozen=True)
class Portmanteau:
    """A test of whiteness: statistic, number of lags, probability of as much or more if the series is white."""

    statistic: float
    lags: int
    p: float


def autocorrelation(parts: Sequence[tuple[Array, float]], slot: float, count: int) -> Autocorrelation:
    """Return the autocorrelation at `count` lags of `slot` [s] each; pairs never reach from one part to another.

    Args:
        parts: values (n,) at uniform rows, NaN where there is no sample, with the time between rows [s].
    """
    known = np.concatenate([x[~np.isnan(x)] for x, _ in parts])
    mean = float(known.mean()) if known.size else 0.0
    products, squares, pairs = np.zeros(count + 1), np.zeros(count + 1), np.zeros(count + 1)
    for x, dt, lags in _joined(parts, (count + 0.5) * slot):
        there = ~np.isnan(x)
        centred = np.where(there, x - mean, 0.0)
        slots = np.rint(np.arange(lags + 1) * dt / slot).astype(np.intp)
        inside = (slots <= count) & (slots > 0)
        for into, series in ((products, centred), (squares, centred**2), (pairs, there.astype(np.float64))):
            np.add.at(into, slots[inside], _lagged(series, lags)[inside])
    n = known.size
    total = float(np.sum((known - mean) ** 2))
    pairs = np.rint(pairs)
    scale = n / np.where(pairs > 0, pairs, np.nan)  # to the correlation of the pairs themselves
    white = pairs / max(n, 1) ** 2
    value = products / total if total**2 > 0.0 else np.zeros(count + 1)
    variance = np.maximum(squares / total**2, 1e-3 * white) if total**2 > 0.0 else white
    return Autocorrelation(
        lag=slot * np.arange(1.0, count + 1.0),
        value=(value * scale)[1:],
        pairs=pairs[1:],
        band=(_BAND * np.sqrt(variance) * scale)[1:],
        variance=(variance * scale**2)[1:],
    )


def portmanteau(parts: Sequence[tuple[Array, float]], slot: float) -> Portmanteau | None:
    """Return the test that a series (see `autocorrelation`) is white; None for fewer than 20 samples."""
    n = sum(int(np.count_nonzero(~np.isnan(x))) for x, _ in parts)
    if n < 20:
        return None
    found = autocorrelation(parts, slot, min(_LAGS, n // 5))
    usable = found.pairs >= max(5.0, 0.02 * n)
    if not usable.any():
        return None
    small_sample = (n + 2.0) / n
    statistic = small_sample * float(np.sum(found.value[usable] ** 2 / found.variance[usable]))
    lags = int(np.count_nonzero(usable))
    return Portmanteau(statistic, lags, float(chdtrc(lags, statistic)))


def _joined(parts: Sequence[tuple[Array, float]], longest: float) -> list[tuple[Array, float, int]]:
    """Return the parts of equal steps as one, with the number of lags in which none reaches into the next."""
    groups: dict[float, list[Array]] = {}
    for x, dt in parts:
        groups.setdefault(dt, []).append(x)
    out = []
    for dt, group in groups.items():
        lags = min(int(longest / dt), max(x.size for x in group) - 1)
        gap = np.full(lags, np.nan)
        out.append((np.concatenate([piece for x in group for piece in (x, gap)]), dt, lags))
    return out


def _lagged(x: Array, lags: int) -> Array:
    """Return the sums of x_i x_{i+k} for k = 0 .. lags."""
    size = next_fast_len(x.size + lags + 1, real=True)
    return np.asarray(irfft(np.abs(rfft(x, size)) ** 2, size)[: lags + 1])
