"""Long series drawn in few points: of every column of pixels the least and the greatest, in the order they came."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array

__all__ = ["decimated", "pieces"]

_GAP = 6.0  # typical steps without a sample, beyond which a line is broken


def pieces(x: Array, y: Array) -> list[tuple[Array, Array]]:
    """Return the stretches (x, y) of a series without its NaN, cut where there is a gap."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y = np.asarray(x, dtype=np.float64)[known], np.asarray(y, dtype=np.float64)[known]
    if x.size < 2:
        return [(x, y)] if x.size else []
    steps = np.diff(x)
    cuts = np.flatnonzero(steps > _GAP * float(np.median(steps))) + 1
    return list(zip(np.split(x, cuts), np.split(y, cuts), strict=True))


def decimated(x: Array, y: Array, columns: int, span: tuple[float, float]) -> tuple[Array, Array]:
    """Return at most two points for each of `columns` equal parts of `span`; all where there are no more than that.

    No extreme is lost: the envelope of the line stays what it was.
    """
    if x.size <= 2 * columns:
        return x, y
    low, high = span
    column = np.clip(((x - low) / (high - low) * columns).astype(np.intp), 0, columns - 1)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(column) > 0]))
    ends = np.concatenate([starts[1:], [x.size]])
    rows: list[int] = []
    for first, last in zip(starts, ends, strict=True):
        least, most = int(first + np.argmin(y[first:last])), int(first + np.argmax(y[first:last]))
        rows += [min(least, most), max(least, most)] if least != most else [least]
    return x[rows], y[rows]
