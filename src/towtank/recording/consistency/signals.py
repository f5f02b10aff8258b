"""Signals of motion: columns as means over any cells of time, measured or derived, smoothed all in one way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.consistency.tracks import (
    Attitude,
    Track,
    attitude_track,
    halfway,
    pose_track,
    speed_track,
    turned_between,
)
from towtank.recording.frames.rotations import conjugate, rotate
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, LINEAR_VELOCITY, POSITION, RATES

__all__ = [
    "SMOOTHED",
    "Signal",
    "body_velocity",
    "depth_rate",
    "measured",
    "memory_of",
    "rates",
    "smooth_means",
    "turning",
]

SMOOTHED = 9  # cells of the window
_MEMORY = 10.0  # s of the autocorrelation
Means = Callable[[Array], Array]  # edges (n + 1,) [s] -> means over cells (n,)


class Signal(NamedTuple):
    """One column of motion: the tracks that it comes from, and its means over cells."""

    tracks: tuple[Track, ...]
    means: Means


def _of_track(track: Track) -> Signal:
    return Signal((track,), lambda edges: np.asarray(np.diff(track.at(edges)) / np.diff(edges)))


def rates(recording: Recording) -> dict[str, Signal]:
    """Return `p q r` as measured, else those of the attitude."""
    return {**turning(recording), **measured(recording, RATES)}


def turning(recording: Recording) -> dict[str, Signal]:
    """Return `p q r` as the attitude turns; of single angles the rate of each, of a body that is else level."""
    attitude = attitude_track(recording)
    if attitude is not None:
        return {name: _of_attitude(attitude, j) for j, name in enumerate(RATES)}
    tracks = {name: pose_track(recording, angle) for name, angle in zip(RATES, EULER, strict=True)}
    return {name: _of_track(track) for name, track in tracks.items() if track is not None}


def _of_attitude(attitude: Attitude, column: int) -> Signal:
    def means(edges: Array) -> Array:
        return np.asarray(turned_between(attitude.at(edges))[:, column] / np.diff(edges))

    return Signal(attitude.tracks, means)


def depth_rate(recording: Recording) -> dict[str, Signal]:
    """Return how fast the depth changes, under `z`."""
    track = pose_track(recording, "z")
    return {} if track is None else {"z": _of_track(track)}


def body_velocity(recording: Recording) -> dict[str, Signal]:
    """Return `u v w` as measured, else those of the position, turned into the body."""
    out = measured(recording, LINEAR_VELOCITY)
    attitude, place = attitude_track(recording), [pose_track(recording, name) for name in POSITION]
    where = [track for track in place if track is not None]
    if attitude is None or len(where) < len(POSITION):
        return out
    for j, name in enumerate(LINEAR_VELOCITY):
        out.setdefault(name, _of_place(where, attitude, j))
    return out


def _of_place(where: Sequence[Track], attitude: Attitude, column: int) -> Signal:
    def means(edges: Array) -> Array:
        world = np.stack([np.diff(track.at(edges)) / np.diff(edges) for track in where], axis=-1)
        return np.asarray(rotate(conjugate(halfway(attitude.at(edges))), world)[:, column])

    return Signal((*where, *attitude.tracks), means)


def measured(recording: Recording, names: Sequence[str]) -> dict[str, Signal]:
    """Return speeds or accelerations as measured, those that are."""
    tracks = {name: speed_track(recording, name) for name in names}
    return {name: _of_track(track) for name, track in tracks.items() if track is not None}


def smooth_means(signals: Sequence[Signal], edges: Array, width: int = SMOOTHED) -> Array:
    """Return means (n - width + 1, k) over n cells through a window of so many, NaN where one in it is unknown."""
    window = np.hanning(width + 2)[1:-1]
    means = [np.convolve(signal.means(edges), window / window.sum(), mode="valid") for signal in signals]
    return np.stack(means, axis=-1)


def memory_of(x: Array, y: Array, dt: float) -> Array:
    """Return in how many cells (k,) the products of two columns are independent (Bartlett)."""
    lags = min(round(_MEMORY / dt), len(x) - 1, len(y) - 1)
    total = np.ones(x.shape[1])
    for k in range(1, lags + 1):
        total += (
            2.0
            * (x[k:] * x[:-k]).sum(axis=0)
            * (y[k:] * y[:-k]).sum(axis=0)
            / np.maximum((x**2).sum(axis=0) * (y**2).sum(axis=0), 1e-300)
        )
    return np.maximum(total, 1.0)
