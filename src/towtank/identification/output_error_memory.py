"""How long the residuals of a free run remember: white for the noise of a sensor, long for what the model lacks.

The integrated autocorrelation time of n samples dt apart is dt (1 + 2 sum r_k), up to the lag at which r_k has died: so
many seconds of data say once what white samples would say every dt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array

__all__ = ["Memory", "residual_memory"]

_BAND = 2.0  # standard deviations of r_k of a white series
_FEWEST = 20


@dataclass(frozen=True, eq=False)
class Memory:
    """Of each of the 15 columns; NaN where too little is measured.

    Attributes:
        std: standard deviation (15,), in that of the noise. lag_one: correlation of neighbouring samples (15,).
        time: integrated autocorrelation time (15,) [s]. reach: lag (15,) [s] at which the correlation has died.
        step: usual time between samples (15,) [s].
    """

    std: Array
    lag_one: Array
    time: Array
    reach: Array
    step: Array


def residual_memory(runs: Sequence[tuple[Array, Array]], limits: Array) -> Memory:
    """Return the memory of residuals.

    Args:
        runs: times (n,) [s] and residuals (n, 15) of each recording, NaN where nothing was measured.
        limits: (15,) beyond which a residual is an outlier and left out.
    """
    out = np.full((5, 15), np.nan)
    for j in range(15):
        parts = []
        for t, residuals in runs:
            there = np.isfinite(residuals[:, j])
            if there.any():
                parts.append((t[there], residuals[there, j]))
        if sum(x.size for _, x in parts) >= _FEWEST:
            out[:, j] = _column(parts, float(limits[j]))
    return Memory(*out)


def _column(parts: Sequence[tuple[Array, Array]], limit: float) -> tuple[float, float, float, float, float]:
    longest = max(x.size for _, x in parts)
    products, pairs = np.zeros(longest), np.zeros(longest)
    steps = []
    for t, x in parts:
        kept = np.abs(x) <= limit
        size = 1 << (2 * x.size - 1).bit_length()
        for into, series in ((products, np.where(kept, x, 0.0)), (pairs, kept.astype(np.float64))):
            spectrum = np.fft.rfft(series, size)
            into[: x.size] += np.fft.irfft(spectrum.real**2 + spectrum.imag**2, size)[: x.size]
        steps.append(np.diff(t))
    pairs = np.rint(pairs)
    step = float(np.median(np.concatenate(steps)))
    if not (products[0] > 0.0 and pairs[0] >= _FEWEST):
        return np.nan, np.nan, np.nan, np.nan, step
    covariance = products / np.maximum(pairs, 1.0)
    r = covariance[: max(2, longest // 2)] / covariance[0]
    pairwise = 0.5 * (r[1:-1] + r[2:]) if r.size > 2 else r[1:]
    dead = np.flatnonzero(pairwise < _BAND / np.sqrt(2.0 * pairs[0]))
    lags = int(dead[0]) if dead.size else pairwise.size
    return (
        float(np.sqrt(covariance[0])),
        float(r[1]),
        step * (1.0 + 2.0 * float(r[1 : lags + 1].sum())),
        step * lags,
        step,
    )
