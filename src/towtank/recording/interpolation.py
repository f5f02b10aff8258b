"""Linear interpolation that never bridges a gap and never goes beyond the ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.recording.rotations import interpolate_rotation
from towtank.recording.timing import gap_limit

__all__ = ["Weights", "interpolation_weights"]

_COINCIDENT = 1e-4  # of a step: a time this close to a sample is the sample's


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
