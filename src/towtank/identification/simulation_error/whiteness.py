"""How long the residuals of a free run are correlated: white for the noise of a sensor, long for what the model lacks.

The integrated autocorrelation time of n samples dt apart is dt (1 + 2 sum r_k), up to the lag at which r_k has died: so
many seconds of data say once what white samples would say every dt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import N_MEASURED

__all__: list[str] = []

_BAND = 2.0  # standard deviations of r_k of a white series
_FEWEST = 20


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
