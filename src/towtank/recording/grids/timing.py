"""Rates and gaps of time stamps; channels at common times; interpolation that bridges no gap and leaves no end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording.channel import Channel
from towtank.recording.frames.rotations import interpolate_rotation, normalised
from towtank.recording.recording import Recording
from towtank.recording.standard import QUATERNION

__all__ = [
    "Weights",
    "check_span",
    "common_samples",
    "find_gaps",
    "gap_limit",
    "interpolation_weights",
    "is_sparse",
    "median_step",
    "quaternion_samples",
    "sampling_rate",
]

_MINIMUM_GAP = 0.15  # s; shorter holes are always bridged
_MOST_CELLS = 20, 1_000_000  # of a grid: for each sample, and in any case
_COINCIDENT = 1e-4  # of a step: a time this close to a sample is the sample's


def median_step(t: Array) -> float:
    """Median step [s] of the times (n,); NaN where n < 2."""
    return float(np.median(np.diff(t))) if t.size > 1 else float("nan")


def gap_limit(t: Array, gap: float | None = None) -> float:
    """Longest step [s] that is bridged: `gap`, else three median steps but at least 0.15 s."""
    if gap is not None:
        return gap
    return max(3.0 * median_step(t), _MINIMUM_GAP) if t.size > 1 else _MINIMUM_GAP


def find_gaps(t: Array, gap: float | None = None) -> NDArray[np.intp]:
    """Indices i of the samples after which a gap begins: t[i+1] - t[i] exceeds the limit."""
    limit = gap_limit(t, gap)
    return np.flatnonzero(np.diff(t) > limit * (1.0 + 1e-9))


def sampling_rate(t: Array) -> float:
    """Rate [Hz] of the times (n,): that of the usual steps, gaps left out; NaN where n < 2.

    The usual step is the mean of those within 20 % of the median one, which undoes the rounding of printed
    stamps. Stamps that come in bursts (many receive times close together, then a pause) give their mean rate
    instead.
    """
    if t.size < 2:
        return float("nan")
    steps = np.diff(t)
    median = float(np.median(steps))
    near = steps[np.abs(steps - median) <= 0.2 * median]
    usual = float(near.mean()) if near.size else median
    inside = steps[steps <= max(3.0 * median, _MINIMUM_GAP)]
    mean = float(inside.mean())
    rate = 1.0 / (mean if mean > 1.5 * usual else usual)
    whole = round(rate)
    return float(whole) if whole and abs(rate - whole) <= 1e-6 * rate else rate


def is_sparse(stamps: Sequence[Array], rate: float) -> bool:
    """Return whether a grid of this rate [Hz] over all times (n,) would hold hardly any sample, and far too many cells.

    A clock that jumps by days makes that of a log of minutes.
    """
    known = [t for t in stamps if t.size]
    span = max(float(t[-1]) for t in known) - min(float(t[0]) for t in known) if known else 0.0
    return span * rate > _MOST_CELLS[0] * sum(t.size for t in known) + _MOST_CELLS[1]


def check_span(stamps: Sequence[Array], rate: float, prefix: str) -> None:
    """Raise InputError where the times (n,) of some channels are too sparse for a grid of this rate [Hz]."""
    if is_sparse(stamps, rate):
        span = max(float(t[-1]) for t in stamps) - min(float(t[0]) for t in stamps)
        raise InputError(
            f"{prefix}the motion spans {span:.6g} s but is measured for little of it, expected one run without a pause "
            "of days: its clocks disagree or jump; mend the times, or choose a part with --window START,END"
        )


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


@dataclass(frozen=True)
class Weights:
    """How each asked time lies between two samples.

    Attributes:
        left, right: indices (n,) of the samples around it.
        weight: share (n,) of the right one, 0..1.
        known: False (n,) in gaps and beyond the ends.
    """

    left: NDArray[np.intp]
    right: NDArray[np.intp]
    weight: Array
    known: NDArray[np.bool_]

    def linear(self, values: Array) -> Array:
        """Values (k,) or (k, m) of the samples at the asked times; NaN where unknown."""
        left, right = values[self.left], values[self.right]
        weight = self.weight if values.ndim == 1 else self.weight[:, None]
        known = self.known if values.ndim == 1 else self.known[:, None]
        result: Array = np.where(known, left + weight * (right - left), np.nan)
        return result

    def rotation(self, q: Array) -> Array:
        """Unit quaternions (n, 4) on the shortest arcs between the samples q (k, 4); NaN where unknown."""
        result: Array = np.where(
            self.known[:, None], interpolate_rotation(q[self.left], q[self.right], self.weight), np.nan
        )
        return result


def interpolation_weights(t: Array, at: Array, gap: float | None = None) -> Weights:
    """Return the weights of the samples at times t (k,), strictly increasing, k >= 1, for the times `at`
    (n,).

    Args:
        gap: longest step between samples [s] that is bridged; default as in `timing.gap_limit`.
    """
    if t.size == 1:
        zeros = np.zeros(at.size, dtype=np.intp)
        tolerance = 1e-9 + 4.0 * np.spacing(abs(float(t[0])))
        return Weights(zeros, zeros, np.zeros(at.size), np.abs(at - t[0]) <= tolerance)
    right = np.clip(np.searchsorted(t, at, "left"), 1, t.size - 1)
    left = right - 1
    step = t[right] - t[left]
    weight = (at - t[left]) / step
    near = _COINCIDENT * np.minimum(1.0, np.median(np.diff(t)) / step)
    weight = np.where(np.abs(weight) <= near, 0.0, np.where(np.abs(weight - 1.0) <= near, 1.0, weight))
    on_sample = (weight == 0.0) | (weight == 1.0)
    bridged = step <= gap_limit(t, gap) * (1.0 + 1e-9)
    known = on_sample | (bridged & (weight > 0.0) & (weight < 1.0))
    return Weights(left, right, np.clip(weight, 0.0, 1.0), known)
