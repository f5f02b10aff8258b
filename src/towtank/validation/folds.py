"""Recordings cut into windows one after the other, each left out once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording import Recording

__all__ = ["Split", "split"]

_SHORTEST = 1.0  # s, a piece that is worth learning from or predicting


@dataclass(frozen=True)
class Split:
    """One window left out.

    Attributes:
        windows: what is left out, as (number of the recording, start [s], end [s]) in the recording's own clock.
        kept: recordings to learn from. left_out: recordings to predict.
    """

    windows: tuple[tuple[int, float, float], ...]
    kept: tuple[Recording, ...]
    left_out: tuple[Recording, ...]


def split(recordings: Sequence[Recording], windows: int) -> tuple[Split, ...]:
    """Return `windows` splits; their windows are equally long, laid over the recordings one after the other.

    Raises:
        InputError: fewer than 2 windows, no recording, or windows shorter than a second.
    """
    if not recordings:
        raise InputError("no recording given, expected at least one")
    if windows < 2:
        raise InputError(f"folds: found {windows}, expected 2 windows or more")
    lengths = np.array([recording.duration for recording in recordings])
    ends = np.cumsum(lengths)
    total = float(ends[-1])
    if total / windows < _SHORTEST:
        raise InputError(
            f"folds: found {windows} windows of {total / windows:.2g} s, expected at least {_SHORTEST:g} s each; "
            "use fewer"
        )
    edges = np.linspace(0.0, total, windows + 1)
    return tuple(_split(recordings, ends - lengths, a, b) for a, b in pairwise(edges.tolist()))


def _split(recordings: Sequence[Recording], origins: Array, a: float, b: float) -> Split:
    windows, kept, left_out = [], [], []
    for k, recording in enumerate(recordings):
        start, end = recording.start, recording.end
        shift = start - float(origins[k])
        first, last = max(a + shift, start), min(b + shift, end)
        if last - first < _SHORTEST and last - first < 0.999 * recording.duration:  # a sliver: stays with its recording
            kept.append(recording)
            continue
        windows.append((k, first, last))
        left_out.append(recording.window(first, last if last >= end else float(np.nextafter(last, first))))
        if first - start >= _SHORTEST:
            kept.append(recording.window(start, float(np.nextafter(first, start))))
        if end - last >= _SHORTEST:
            kept.append(recording.window(last, end))
    return Split(tuple(windows), tuple(kept), tuple(left_out))
