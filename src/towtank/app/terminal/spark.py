"""Spark lines: a series in a few characters."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from towtank.core.arrays import Array

__all__ = ["error_spark", "spark"]

_BLOCKS, _ASCII = "▁▂▃▄▅▆▇█", "_.:-=+*#"


def spark(values: Sequence[float] | Array, width: int, *, ascii_only: bool = False, floor: float | None = None) -> str:
    """Return `width` characters that rise and fall as the values do; blank where they are NaN.

    Args:
        floor: value of the lowest character, by default the least there is.

    >>> spark([0.0, 1.0, 2.0, 3.0], 4, ascii_only=True)
    '_:+#'
    """
    series = np.asarray(values, dtype=np.float64)
    if not series.size:
        return " " * width
    edges = np.linspace(0, series.size, width + 1).astype(np.intp)
    cells = [series[a : max(b, a + 1)] for a, b in pairwise(edges)]
    means = np.array([part[np.isfinite(part)].mean() if np.isfinite(part).any() else np.nan for part in cells])
    known = means[np.isfinite(means)]
    if not known.size:
        return " " * width
    signs = _ASCII if ascii_only else _BLOCKS
    low = float(known.min()) if floor is None else floor
    span = float(known.max()) - low
    levels = np.rint((means - low) / span * (len(signs) - 1)) if span > 0.0 else np.zeros(width)
    return "".join(" " if m != m else signs[int(k)] for m, k in zip(means, np.nan_to_num(levels), strict=True))


def error_spark(errors: Array, width: int, *, ascii_only: bool = False) -> str:
    """Return the size of errors (n,), NaN where there is none, in `width` slots of time; the floor is no error."""
    with np.errstate(over="ignore"):
        size = np.abs(errors)
    return spark(np.where(np.isfinite(size), size, np.nan), width, ascii_only=ascii_only, floor=0.0)
