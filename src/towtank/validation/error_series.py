"""The errors of a prediction as series of time: one per channel, with the wrench that was commanded on its axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from towtank.core.arrays import Array
from towtank.validation.prediction import Prediction

__all__ = ["AXIS", "ErrorSeries", "Stretch", "error_series"]

_POSITION = ("x", "y", "z")
_WRENCH_OF = dict(zip(("u", "v", "w", "p", "q", "r", "phi", "theta", "psi"), (0, 1, 2, 3, 4, 5, 3, 4, 5), strict=True))
AXIS = {
    "u": "surge", "v": "sway", "w": "heave", "p": "roll", "q": "pitch", "r": "yaw",
    "x": "north", "y": "east", "z": "depth", "phi": "roll angle", "theta": "pitch angle", "psi": "heading",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Stretch:
    """Errors from one start of the prediction to the next.

    Attributes:
        t: uniform times (n,) [s]. error: measured less predicted (n,), NaN where there was no sample.
        wrench: force or moment (n,) that acted along the channel over the step that ends at each time [N or N m].
        drag: speed times its size (n,), as predicted along the channel: what a drag is proportional to.
        dt: time between rows [s].
        recording: number of the recording; the same disturbance goes on from one stretch to the next in it.
    """

    t: Array
    error: Array
    wrench: Array
    drag: Array
    dt: float
    recording: int


@dataclass(frozen=True, eq=False)
class ErrorSeries:
    """All errors of one channel.

    Attributes:
        name: of the channel. stretches: in order of time, recording after recording.
        samples: number of errors. step: typical time between two of them [s]. duration: time covered [s].
    """

    name: str
    stretches: tuple[Stretch, ...]
    samples: int
    step: float
    duration: float

    @property
    def errors(self) -> Array:
        """All errors (samples,), gaps left out."""
        values = np.concatenate([stretch.error for stretch in self.stretches])
        return np.asarray(values[~np.isnan(values)])


def error_series(predictions: Sequence[Prediction], name: str) -> ErrorSeries | None:
    """Return the errors of a channel over all predictions; None where none of them measured it."""
    stretches: list[Stretch] = []
    for k, prediction in enumerate(predictions):
        if name in prediction.channels:
            stretches += _stretches(prediction, name, k)
    steps = [np.diff(stretch.t[~np.isnan(stretch.error)]) for stretch in stretches]
    between = np.concatenate([*steps, np.empty(0)])
    samples = sum(int(np.count_nonzero(~np.isnan(stretch.error))) for stretch in stretches)
    if not samples:
        return None
    step = float(np.median(between)) if between.size else stretches[0].dt
    duration = float(sum(stretch.t[-1] - stretch.t[0] + stretch.dt for stretch in stretches))
    return ErrorSeries(name, tuple(stretches), samples, step, duration)


def _stretches(prediction: Prediction, name: str, recording: int) -> list[Stretch]:
    """Cut at the restarts. The row of a restart belongs to the prediction that ends there."""
    y, yhat = prediction.channels[name]
    with np.errstate(invalid="ignore"):
        error = np.where(np.isnan(y), np.nan, y - yhat)
    speed = np.nan_to_num(prediction.states[:, 7:13], posinf=0.0, neginf=0.0)
    with np.errstate(over="ignore"):
        drag = _along(prediction, name, np.clip(np.abs(speed) * speed, -1e12, 1e12))
    wrench = _along(prediction, name, prediction.wrench)
    dt = float(prediction.t[-1] - prediction.t[0]) / (prediction.t.size - 1)
    rows = np.searchsorted(prediction.t, np.array(prediction.restarts) - 1e-9)
    edges = [int(rows[0]), *(int(row) + 1 for row in rows[1:]), prediction.t.size]
    return [
        Stretch(prediction.t[a:b], error[a:b], wrench[a:b], drag[a:b], dt, recording)
        for a, b in pairwise(edges)
        if b > a
    ]


def _along(prediction: Prediction, name: str, body: Array) -> Array:
    """Return what a body quantity (n, 6) is along a channel (n,); for a position, turned as the attitude predicted."""
    if name not in _POSITION:
        return np.ascontiguousarray(body[:, _WRENCH_OF[name]])
    known = np.isfinite(prediction.states[:, 3:7])
    w, x, y, z = np.where(known, prediction.states[:, 3:7], np.array([1.0, 0.0, 0.0, 0.0])).T
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.asarray((np.column_stack(rows[_POSITION.index(name)]) * body[:, :3]).sum(axis=1))
