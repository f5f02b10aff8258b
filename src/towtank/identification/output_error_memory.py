"""How long the residuals of a free run remember: white for the noise of a sensor, long for what the model lacks.

The integrated autocorrelation time of n samples dt apart is dt (1 + 2 sum r_k), up to the lag at which r_k has died: so
many seconds of data say once what white samples would say every dt.

What a model lacks is everywhere; a marker that jumps by two deviations of its noise, too little for any gate, is in one
place for half a second. So whether residuals are white is asked of all but the tenth of the seconds that lean furthest
to one side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array

__all__ = ["Memory", "residual_memory"]

Kept = NDArray[np.bool_]

_BAND = 2.0  # standard deviations of r_k of a white series
_FEWEST = 20
_SECOND, _LEANING = 1.0, 0.1  # s, and share of these that may lean to one side
_WHITE = 2.0  # samples that residuals may remember and still count as white


@dataclass(frozen=True, eq=False)
class Memory:
    """Of each of the 15 columns; NaN where too little is measured.

    Attributes:
        std: standard deviation (15,), in that of the noise. lag_one: correlation of neighbouring samples (15,).
        time: integrated autocorrelation time (15,) [s]. reach: lag (15,) [s] at which the correlation has died.
        step: usual time between samples (15,) [s]. calm: as `time`, without the seconds that lean furthest to one side.
    """

    std: Array
    lag_one: Array
    time: Array
    reach: Array
    step: Array
    calm: Array

    def white(self, columns: Sequence[int]) -> bool:
        """Whether those of these columns that are measured are nothing but noise; no where none is."""
        samples = self.calm[list(columns)] / self.step[list(columns)]
        known = samples[np.isfinite(samples)]
        return bool(known.size and known.max() <= _WHITE)


def residual_memory(runs: Sequence[tuple[Array, Array]], limits: Array) -> Memory:
    """Return the memory of residuals.

    Args:
        runs: times (n,) [s] and residuals (n, 15) of each recording, NaN where nothing was measured.
        limits: (15,) beyond which a residual is an outlier and left out.
    """
    out = np.full((6, 15), np.nan)
    for j in range(15):
        parts = []
        for t, residuals in runs:
            there = np.isfinite(residuals[:, j])
            if there.any():
                parts.append((t[there], residuals[there, j]))
        if sum(x.size for _, x in parts) >= _FEWEST:
            kept = [np.abs(x) <= limits[j] for _, x in parts]
            out[:5, j] = _column(parts, kept)
            out[5, j] = out[2, j] if out[2, j] <= _WHITE * out[4, j] else _column(parts, _but_leaning(parts, kept))[2]
    return Memory(*out)


def _column(parts: Sequence[tuple[Array, Array]], kept: Sequence[Kept]) -> tuple[float, float, float, float, float]:
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


def _but_leaning(parts: Sequence[tuple[Array, Array]], kept: Sequence[Kept]) -> list[Kept]:
    """Return what is left of `kept` without the seconds whose residuals, white ones, would least likely add up so."""
    second = [((t - t[0]) / _SECOND).astype(np.int64) for t, _ in parts]
    leans = []
    for (_, x), good, at in zip(parts, kept, second, strict=True):
        count = np.bincount(at, good)
        leans.append(np.abs(np.bincount(at, np.where(good, x, 0.0))) / np.sqrt(np.maximum(count, 1.0)))
    lean = np.concatenate(leans)
    left = np.ones(lean.size, dtype=np.bool_)
    left[np.argsort(-lean, kind="stable")[: int(_LEANING * lean.size)]] = False
    edges = np.cumsum([each.size for each in leans])[:-1]
    return [good & own[at] for good, own, at in zip(kept, np.split(left, edges), second, strict=True)]
