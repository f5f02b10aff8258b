"""A recording as the samples that a live link would have given, in order of time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from towtank.recording import Recording
from towtank.recording.standard import is_standard

__all__ = ["Row", "rows_of"]

_TOGETHER = 1e-6  # s: stamps closer than this are one instant

Row = tuple[float, tuple[str, ...], tuple[float, ...]]  # t [s], names, values


def rows_of(recording: Recording, after: float = -np.inf) -> Iterator[Row]:
    """Yield every instant later than `after` [s] with all that was measured or commanded then."""
    names: list[str] = []
    stamps, owners, values = [], [], []
    for channel in recording.channels.values():
        if not is_standard(channel.name):
            continue
        known = np.isfinite(channel.values) & (channel.t > after)
        stamps.append(channel.t[known])
        values.append(channel.values[known])
        owners.append(np.full(stamps[-1].size, len(names)))
        names.append(channel.name)
    if not names:
        return
    t = np.concatenate(stamps)
    order = np.argsort(t, kind="stable")
    t, owner, value = t[order], np.concatenate(owners)[order], np.concatenate(values)[order]
    if not t.size:
        return
    starts = np.flatnonzero(np.concatenate(([True], np.diff(t) > _TOGETHER)))
    for first, last in zip(starts, [*starts[1:], t.size], strict=True):
        yield (
            float(t[first]),
            tuple(names[k] for k in owner[first:last]),
            tuple(value[first:last].tolist()),
        )
