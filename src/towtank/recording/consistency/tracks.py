"""Tracks: channels as integrals at their own times, of which means over any cells of time are differences.

So measured rates and those between two attitudes go through the very same window, and neither is later than the other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.recording.frames.rotations import align_signs, conjugate, multiply
from towtank.recording.grids.timing import gap_limit, median_step, quaternion_samples
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, QUATERNION

__all__ = [
    "FEWEST",
    "Attitude",
    "Track",
    "attitude_track",
    "halfway",
    "held_track",
    "pose_track",
    "speed_track",
    "turned_between",
]

FEWEST = 20  # samples of a channel, known cells of a stretch
_USUAL = 20_000  # samples that tell a channel's step
_REPEATED = 0.3  # share of samples that are those before, from which they are repeats


class Track:
    """The integral of a channel (its value, of a pose) at its own times: what cells are made of by differences."""

    def __init__(self, t: Array, integral: Array, *, held: bool = False) -> None:
        self.t, self.integral, self.held = t, integral, held
        self.step = 0.0 if held else median_step(t[:_USUAL])
        self.limit = math.inf if held else gap_limit(t[:_USUAL])

    def at(self, times: Array) -> Array:
        """Return the integral at times (...), NaN in gaps and beyond the ends."""
        flat = times.ravel()
        out = np.interp(flat, self.t, self.integral, left=np.nan, right=np.nan)
        if not self.held:
            after = np.clip(np.searchsorted(self.t, flat), 1, self.t.size - 1)
            out[self.t[after] - self.t[after - 1] > self.limit] = np.nan
        return np.asarray(out.reshape(times.shape))


def pose_track(recording: Recording, name: str) -> Track | None:
    """Return the track of a coordinate of the pose; None where it has too few samples."""
    known = _fresh(recording, name)
    if known is None:
        return None
    t, x = known
    return Track(t, np.unwrap(x) if name in EULER else x)


def speed_track(recording: Recording, name: str) -> Track | None:
    """Return the track of a speed or an acceleration; None where it has too few samples."""
    known = _fresh(recording, name)
    if known is None:
        return None
    t, x = known
    return Track(t, np.append(0.0, np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))))


def held_track(t: Array, x: Array) -> Track | None:
    """Return the track of an input that holds; None where it has too few samples."""
    if t.size < FEWEST:
        return None
    return Track(t, np.append(0.0, np.cumsum(np.nan_to_num(x[:-1]) * np.diff(t))), held=True)


def _fresh(recording: Recording, name: str) -> tuple[Array, Array] | None:
    """Return the samples of a channel that were measured, without those that only repeat the one before."""
    if name not in recording:
        return None
    channel = recording[name].measured
    t, x = channel.t, channel.values
    same = np.diff(x) == 0.0
    if same.size and same.mean() > _REPEATED:
        kept = np.append(True, ~same)
        t, x = t[kept], x[kept]
    return (t, x) if t.size >= FEWEST else None


class Attitude(NamedTuple):
    """Tracks of the components of a quaternion, of three angles, or of the heading alone (of what lies level)."""

    tracks: tuple[Track, ...]

    def at(self, times: Array) -> Array:
        """Return quaternions (..., 4) at times (...), NaN where unknown."""
        parts = np.stack([track.at(times) for track in self.tracks], axis=-1)
        if len(self.tracks) == 4:
            q = parts / np.linalg.norm(parts, axis=-1, keepdims=True)
        else:
            angles = np.zeros((times.size, 3))
            angles[:, 3 - len(self.tracks) :] = np.nan_to_num(parts.reshape(times.size, -1))
            q = quaternions_from_eulers(angles).reshape(*times.shape, 4)
        return np.where(np.isfinite(parts).all(axis=-1, keepdims=True), q, np.nan)


def attitude_track(recording: Recording) -> Attitude | None:
    """Return the track of a whole attitude, from a quaternion or three angles; None where there is none."""
    if all(name in recording for name in QUATERNION):
        t, q = quaternion_samples(recording)
        if t.size < FEWEST:
            return None
        fresh = np.append(True, np.any(np.diff(q, axis=0) != 0.0, axis=1))
        if fresh.mean() < 1.0 - _REPEATED:
            t, q = t[fresh], q[fresh]
        aligned = align_signs(q)
        return Attitude(tuple(Track(t, aligned[:, j]) for j in range(4)))
    tracks = [pose_track(recording, name) for name in EULER]
    known = tuple(track for track in tracks if track is not None)
    return Attitude(known) if len(known) == len(EULER) else None


def turned_between(q: Array) -> Array:
    """Return the rotation vectors (..., n, 3) [rad] in the body from each attitude (..., n + 1, 4) to the next."""
    turned = multiply(conjugate(q[..., :-1, :]), q[..., 1:, :])
    axis = turned[..., 1:] * np.sign(turned[..., :1])
    sine = np.minimum(np.linalg.norm(axis, axis=-1, keepdims=True), 1.0)
    return np.asarray(axis * 2.0 * np.arcsin(sine) / np.maximum(sine, 1e-12))


def halfway(q: Array) -> Array:
    """Return the attitude in the middle of cells from that at their edges (..., n + 1, 4)."""
    first, last = q[..., :-1, :], q[..., 1:, :]
    middle = first + last * np.where(np.einsum("...i,...i", first, last) < 0.0, -1.0, 1.0)[..., None]
    return np.asarray(middle / np.linalg.norm(middle, axis=-1, keepdims=True))
