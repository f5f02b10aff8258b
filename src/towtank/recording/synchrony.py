"""Channels brought to common times: those at which all of them were measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.channel import Channel
from towtank.recording.recording import Recording
from towtank.recording.rotations import normalised
from towtank.recording.standard import QUATERNION

__all__ = ["common_samples", "quaternion_samples"]


def common_samples(channels: Sequence[Channel]) -> tuple[Array, Array]:
    """Return the times (n,) at which all channels have a value, and the values (n, len(channels))."""
    t = channels[0].t
    if all(channel.t is t or np.array_equal(channel.t, t) for channel in channels[1:]):
        values = np.column_stack([channel.values for channel in channels])
    else:
        for channel in channels[1:]:
            t = np.intersect1d(t, channel.t, assume_unique=True)
        values = np.column_stack([channel.values[np.searchsorted(channel.t, t)] for channel in channels])
    known = ~np.isnan(values).any(axis=1)
    return (t, values) if known.all() else (t[known], values[known])


def quaternion_samples(recording: Recording) -> tuple[Array, Array]:
    """Return times (n,) and unit quaternions (n, 4); zeros (of a lost track) are left out."""
    t, q = common_samples([recording[name] for name in QUATERNION])
    q = normalised(q)
    known = ~np.isnan(q[:, 0])
    return (t, q) if known.all() else (t[known], q[known])
