"""Samples that are off together for a moment: a marker that is hidden, a multipath echo, an instrument that hangs.

Each may be within the gate by itself. But where residuals are white otherwise, the mean of ten neighbours has less than
a third of their deviation, and ten that are all off by one deviation stand out. Where they are not white, the model is
at fault as likely as the instrument, and nothing is taken out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array

__all__ = ["jumps"]

_TOGETHER = 10  # samples
_COMPONENTS = 3  # of one instrument: what is wrong in one direction is not to be trusted in the others
_GATE = 4.5
_MEDIAN = 0.6744897501960817  # of |x| for a standard normal x
_WHITE = 1.5  # deviation of the means, in that of the means of white residuals, up to which they are taken for white


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
        usual = float(np.median(np.abs(means))) / _MEDIAN
        if usual > _WHITE:
            continue
        first = np.flatnonzero(np.abs(means) > _GATE * max(usual, 1.0))
        if first.size:
            change = np.zeros(x.size + 1, dtype=np.int64)
            np.add.at(change, first, 1)
            np.add.at(change, first + _TOGETHER, -1)
            out[there, j] = np.cumsum(change[:-1]) > 0
    for j in range(0, residuals.shape[1], _COMPONENTS):
        out[:, j : j + _COMPONENTS] |= out[:, j : j + _COMPONENTS].any(axis=1, keepdims=True)
    return out & np.isfinite(residuals)
