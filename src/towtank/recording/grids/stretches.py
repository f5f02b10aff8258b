"""Stretches of recordings: rows that follow each other, with the inputs that matter to them.

The one way in which grids and samples are cut: into pieces of a length, into some that stand for the whole, from a row
on, up to a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol, Self, TypeVar

import numpy as np

from towtank.core.arrays import Array

__all__ = ["INPUTS_BEFORE", "Stretch", "cuts", "input_rows", "spread"]

INPUTS_BEFORE = 5.0  # s of inputs before a stretch that still matter
_ENOUGH, _FEW_MORE = 60_000, 1.5  # rows that stand for a long recording; so many times as many are no long one
_PIECE = 60.0  # s, of one that stands for a long recording


class Stretch(NamedTuple):
    """Rows first .. last - 1 of one of several recordings."""

    recording: int
    first: int
    last: int


class Sliceable(Protocol):
    """Rows at times `t` (n,) [s] that can be cut."""

    @property
    def t(self) -> Array:
        """Times (n,) [s]."""

    def stretch(self, first: int, last: int) -> Self:
        """Return the rows [first, last) with the inputs that matter to them."""


S = TypeVar("S", bound=Sliceable)


def input_rows(stamps: Array, begin: float, end: float, before: float = INPUTS_BEFORE) -> slice:
    """Return which inputs of stamps (k,) [s] matter from `begin` to `end` [s]: from the one in force `before` on."""
    first, last = (int(row) for row in np.searchsorted(stamps, (begin - before, end), "right"))
    return slice(max(0, first - 1), last)


def cuts(t: Array, length: float) -> list[tuple[int, int]]:
    """Return first row and row after the last of pieces of t (n,) about as long as `length` [s]."""
    if not t.size:
        return []
    parts = max(1, round(float(t[-1] - t[0]) / length))
    edges = np.searchsorted(t, np.linspace(t[0], t[-1], parts + 1)[1:-1])
    bounds = [0, *(int(edge) for edge in edges), t.size]
    return [(a, b) for a, b in pairwise(bounds) if b - a >= 3]


def spread(recordings: Sequence[S]) -> Sequence[S]:
    """Return stretches, evenly spread, that stand for long recordings; the recordings themselves where not long."""
    total = sum(each.t.size for each in recordings)
    if total <= _FEW_MORE * _ENOUGH:
        return recordings
    pieces = [Stretch(k, a, b) for k, each in enumerate(recordings) for a, b in cuts(each.t, _PIECE)]
    chosen = np.linspace(0, len(pieces) - 1, max(1, len(pieces) * _ENOUGH // total)).astype(np.int64)
    return [
        recordings[piece.recording].stretch(piece.first, piece.last) for piece in (pieces[k] for k in np.unique(chosen))
    ]
