"""Recordings in pieces: of a length, or, where they are long, a few that stand for the whole."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.samples import Samples

__all__ = ["cuts", "spread_over", "spread_places"]

_ENOUGH, _FEW_MORE = 60_000, 1.5  # rows that stand for a long recording; so many times as many are no long one
_STRETCH = 60.0  # s


def cuts(t: Array, length: float) -> list[tuple[int, int]]:
    """Return first row and row after the last of pieces of t (n,) about as long as `length` [s]."""
    if not t.size:
        return []
    parts = max(1, round(float(t[-1] - t[0]) / length))
    edges = np.searchsorted(t, np.linspace(t[0], t[-1], parts + 1)[1:-1])
    bounds = [0, *(int(edge) for edge in edges), t.size]
    return [(a, b) for a, b in pairwise(bounds) if b - a >= 3]


def spread_places(stamps: Sequence[Array]) -> list[tuple[int, int, int]] | None:
    """Return stretches, evenly spread: number of the recording, first row, row after the last.

    None where the recordings, at the times `stamps`, are not long.
    """
    total = sum(t.size for t in stamps)
    if total <= _FEW_MORE * _ENOUGH:
        return None
    pieces = [(k, a, b) for k, t in enumerate(stamps) for a, b in cuts(t, _STRETCH)]
    chosen = np.linspace(0, len(pieces) - 1, max(1, len(pieces) * _ENOUGH // total)).astype(np.int64)
    return [pieces[k] for k in np.unique(chosen)]


def spread_over(samples: Sequence[Samples]) -> Sequence[Samples]:
    """Return stretches of long recordings, see `spread_places`; the recordings themselves where they are not long."""
    places = spread_places([each.t for each in samples])
    return samples if places is None else [samples[k].stretch(a, b) for k, a, b in places]
