"""Spikes and dead sensors: what a measured channel shows that no vehicle did.

A spike is one sample far from both its neighbours while these agree with each other, and far beyond the
increments around it. Steps, plateaus of two samples or more (an occluded marker), corners of a triangle and
the flicker of a coarse quantiser are no spikes and stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.recording.channel import Channel
from towtank.recording.frames.conversion import wrap_angle
from towtank.recording.grids.timing import gap_limit
from towtank.recording.recording import Recording
from towtank.recording.standard import TRIPLES

__all__ = ["Kind", "dead_channels", "find_spikes"]

Kind = Literal["linear", "angle", "quaternion"]
_BEYOND = 10.0  # times the usual increment that a spike stands out
_AGREEMENT = 0.5  # of the spike's height that its neighbours may differ by
_WINDOW = 15  # samples on either side that make the usual increment
_MOST = 0.02  # of the samples: with more of them it is the signal's nature, not an accident
_PASSES = 3


def find_spikes(t: Array, x: Array, kind: Kind = "linear", gap: float | None = None) -> NDArray[np.intp]:
    """Return the indices of the isolated outliers of a channel; none where they are too many to be accidents.

    Args:
        t: times (n,) [s], strictly increasing.
        x: values (n,), or unit quaternions (n, 4) of either sign, all finite.
        kind: "angle" compares modulo 2 pi, "quaternion" modulo the sign.
        gap: longest step [s] over which samples are neighbours.
    """
    kept = np.arange(t.size)
    outliers: list[NDArray[np.intp]] = []
    for _ in range(_PASSES):
        if kept.size < 5:
            break
        spikes = _one_pass(t[kept], x[kept], kind, gap)
        if not spikes.size:
            break
        outliers.append(kept[spikes])
        kept = np.delete(kept, spikes)
    indices = np.sort(np.concatenate(outliers)) if outliers else np.empty(0, dtype=np.intp)
    return indices if indices.size <= max(1, int(_MOST * t.size)) else np.empty(0, dtype=np.intp)


def _one_pass(t: Array, x: Array, kind: Kind, gap: float | None) -> NDArray[np.intp]:
    step = _difference(x[1:], x[:-1], kind)  # (n-1, d)
    size = np.linalg.norm(step, axis=1)
    moving = size[size > 0.0]
    if not moving.size:
        return np.empty(0, dtype=np.intp)
    usual = float(np.median(moving))
    dt = np.diff(t)
    across = _difference(x[2:], x[:-2], kind)
    share = (dt[:-1] / (dt[:-1] + dt[1:]))[:, None]
    # of the samples 1 .. n-2 above the line between their neighbours
    height = np.linalg.norm(step[:-1] - share * across, axis=1)
    limit = gap_limit(t, gap)
    candidate = (
        (height > _BEYOND * usual)
        & (height >= np.maximum(np.append(height[1:], 0.0), np.append(0.0, height[:-1])))
        & (np.linalg.norm(across, axis=1) < _AGREEMENT * height)
        & (dt[:-1] <= limit)
        & (dt[1:] <= limit)
    )
    spikes = [int(i) for i in np.flatnonzero(candidate) + 1 if height[i - 1] > _BEYOND * _quiet(size, int(i))]
    return np.array(spikes, dtype=np.intp)


def _quiet(size: Array, i: int) -> float:
    """Usual increment around sample i: the local median, or half the calmer one beside it if larger."""
    local = np.concatenate((size[max(i - 1 - _WINDOW, 0) : i - 1], size[i + 1 : i + 1 + _WINDOW]))
    before = size[i - 2] if i >= 2 else np.inf
    after = size[i + 1] if i + 1 < size.size else np.inf
    beside = min(before, after) / 2.0
    return max(float(np.median(local)), float(beside)) if local.size else float("inf")


def _difference(a: Array, b: Array, kind: Kind) -> Array:
    if kind == "quaternion":
        aligned: Array = a * np.where(np.einsum("ij,ij->i", a, b) < 0.0, -1.0, 1.0)[:, None] - b
        return aligned
    difference = a - b
    return (wrap_angle(difference) if kind == "angle" else difference)[:, None]


def dead_channels(recording: Recording) -> tuple[str, ...]:
    """Names of motion channels that stand exactly still, always or from some time to the end, as a dead
    sensor does.

    Only reported where another channel of the same sensor carries noise, or all of them die together: a simulated
    vehicle that does not roll, a heading that is held, a channel without noise are not dead. A channel that dies
    must have carried noise itself before.
    """
    dead = []
    for group in TRIPLES:
        channels = [recording[name].measured for name in group if name in recording]
        noisy = [channel.name for channel in channels if _is_noisy(channel.values)]
        died = [channel for channel in channels if _died(channel, len(channel) - _still_tail(channel))]
        together = len(died) == len(channels) > 1
        for channel in channels:
            if len(channel) < 100:
                continue
            still = _still_tail(channel)
            always = still == len(channel) and bool(noisy)
            if always or (channel in died and (together or _others_live(channels, channel, still))):
                dead.append(channel.name)
    return tuple(dead)


def _still_tail(channel: Channel) -> int:
    changes = np.flatnonzero(np.diff(channel.values))
    return len(channel) if not changes.size else int(len(channel) - 1 - changes[-1])


def _died(channel: Channel, alive: int) -> bool:
    if alive < 50 or alive >= len(channel):
        return False
    still = channel.t[-1] - channel.t[alive]
    return bool(still >= max(5.0, 0.1 * (channel.t[-1] - channel.t[0]))) and _is_noisy(channel.values[:alive])


def _others_live(channels: Sequence[Channel], dead: Channel, still: int) -> bool:
    since = dead.t[len(dead) - still]
    return any(_is_noisy(other.values[other.t >= since]) for other in channels if other is not dead)


def _is_noisy(values: Array) -> bool:
    """True where most increments differ from zero and each tends to undo the one before it."""
    steps = np.diff(values)
    if steps.size < 50 or np.count_nonzero(steps) < 0.5 * steps.size:
        return False
    return bool(np.dot(steps[1:], steps[:-1]) < -0.15 * np.dot(steps, steps))
