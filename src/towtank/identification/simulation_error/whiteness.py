"""How long the residuals of a free run are correlated: white for the noise of a sensor, long for what the model lacks.

The integrated autocorrelation time of n samples dt apart is dt (1 + 2 sum r_k), up to the lag at which r_k has died: so
many seconds of data say once what white samples would say every dt. A marker that jumps by two deviations of its noise,
too little for any gate, is in one place for half a second; what a model lacks is elsewhere too. So residuals that are
not white are judged once more without the bursts: seconds, a tenth of all at most, whose sum chance does not explain;
of what is left more is asked, since that choice makes it look whiter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.identification.data.samples import N_MEASURED

__all__: list[str] = []

_BAND = 2.0  # standard deviations of r_k of a white series
_FEWEST = 20
_SECOND, _BURSTS, _CHANCE = 1.0, 0.1, 4.0  # s; share of these that may be bursts; deviations of the sum of one
_MANY = 10  # samples that a second needs to have
_WHITE, _WHITER = 2.0, 1.3  # samples that white residuals may be correlated over; and without the bursts
Kept = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Of the residuals of each of the 18 columns; NaN where too little is measured.

    Attributes:
        std: standard deviation (18,), in that of the noise. lag_one: correlation of neighbouring samples (18,).
        time: integrated autocorrelation time (18,) [s]. decorrelation_lag: (18,) [s] at which the correlation has died.
        step: usual time between samples (18,) [s]. time_without_bursts: as `time`, without the seconds that are off.
    """

    std: Array
    lag_one: Array
    time: Array
    decorrelation_lag: Array
    step: Array
    time_without_bursts: Array

    def white(self, columns: Sequence[int]) -> bool:
        """Whether those of these columns that are measured are nothing but noise; no where none is."""
        step, time, steady = (each[list(columns)] for each in (self.step, self.time, self.time_without_bursts))
        known = np.isfinite(time)
        return bool(known.any() and np.all((time <= _WHITE * step) | (steady <= _WHITER * step) | ~known))


def autocorrelation_of(runs: Sequence[tuple[Array, Array]], limits: Array) -> Autocorrelation:
    """Return the autocorrelation of residuals.

    Args:
        runs: times (n,) [s] and residuals (n, 18) of each recording, NaN where nothing was measured.
        limits: (18,) beyond which a residual is an outlier and left out.
    """
    columns = [_column(runs, j, limits[j]) for j in range(N_MEASURED)]
    return Autocorrelation(*np.array(columns).T)


def _column(runs: Sequence[tuple[Array, Array]], j: int, limit: float) -> tuple[float, ...]:
    """Return of column j what `Autocorrelation` holds, in its order."""
    parts = []
    for t, residuals in runs:
        there = np.isfinite(residuals[:, j])
        if there.any():
            parts.append((t[there], residuals[there, j]))
    if sum(x.size for _, x in parts) < _FEWEST:
        return (np.nan,) * 6
    kept = [np.abs(x) <= limit for _, x in parts]
    whole = _correlation(parts, kept)
    coloured = whole.time > _WHITE * whole.step and whole.step * _MANY <= _SECOND
    return *whole, _correlation(parts, _without_bursts(parts, kept)).time if coloured else whole.time


class _Correlation(NamedTuple):
    """The first five of `Autocorrelation`, of one column."""

    std: float
    lag_one: float
    time: float
    decorrelation_lag: float
    step: float


def _correlation(parts: Sequence[tuple[Array, Array]], kept: Sequence[Kept]) -> _Correlation:
    """Return the correlation of the samples that are kept of times (n,) and residuals (n,)."""
    longest = max(x.size for _, x in parts)
    products, pairs = np.zeros(longest), np.zeros(longest)
    for (_, x), good in zip(parts, kept, strict=True):
        size = 1 << (2 * x.size - 1).bit_length()
        for into, series in ((products, np.where(good, x, 0.0)), (pairs, good.astype(np.float64))):
            spectrum = np.fft.rfft(series, size)
            into[: x.size] += np.fft.irfft(spectrum.real**2 + spectrum.imag**2, size)[: x.size]
    pairs = np.rint(pairs)
    step = float(np.median(np.concatenate([np.diff(t) for t, _ in parts])))
    if not (products[0] > 0.0 and pairs[0] >= _FEWEST):
        return _Correlation(np.nan, np.nan, np.nan, np.nan, step)
    covariance = products / np.maximum(pairs, 1.0)
    r = covariance[: max(2, longest // 2)] / covariance[0]
    pairwise = 0.5 * (r[1:-1] + r[2:]) if r.size > 2 else r[1:]
    dead = np.flatnonzero(pairwise < _BAND / np.sqrt(2.0 * pairs[0]))
    lags = int(dead[0]) if dead.size else pairwise.size
    time = step * (1.0 + 2.0 * float(r[1 : lags + 1].sum()))
    return _Correlation(float(np.sqrt(covariance[0])), float(r[1]), time, step * lags, step)


def _without_bursts(parts: Sequence[tuple[Array, Array]], kept: Sequence[Kept]) -> list[Kept]:
    """Return what is left of `kept` without the seconds whose residuals would least likely add up so by chance."""
    size = np.sqrt(np.mean(np.concatenate([x[good] for (_, x), good in zip(parts, kept, strict=True)]) ** 2))
    seconds = [np.unique(((t - t[0]) / _SECOND).astype(np.int64), return_inverse=True)[1] for t, _ in parts]
    sums = []
    for (_, x), good, at in zip(parts, kept, seconds, strict=True):
        total = np.abs(np.bincount(at, np.where(good, x, 0.0)))
        sums.append(total / (size * np.sqrt(np.maximum(np.bincount(at, good), 1.0))))
    off = np.concatenate(sums)
    worst = np.argsort(-off, kind="stable")[: int(_BURSTS * off.size)]
    left = np.ones(off.size, dtype=np.bool_)
    left[worst[off[worst] > _CHANCE]] = False
    edges = np.cumsum([each.size for each in sums])[:-1]
    return [good & own[at] for good, own, at in zip(kept, np.split(left, edges), seconds, strict=True)]
