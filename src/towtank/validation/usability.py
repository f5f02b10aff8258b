"""For how long a model predicts each axis well enough to be used.

A prediction is set back to what was measured every h seconds, for longer and longer h. It is of use up to the longest h
at which it explains half of the motion (a fit of 50 % or more), as at all shorter ones, and at which it is clearly
nearer than the last measured value, held: short predictions of anything slow are near, whatever the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.model.terms import AXES
from towtank.identification.offline.first_look import driven_by
from towtank.recording import Grid
from towtank.recording.frames.pose_rates import velocity_of_pose
from towtank.recording.standard import POSE, VELOCITIES
from towtank.validation.prediction import Prediction, predict
from towtank.validation.scores import score, started
from towtank.vehicle import Vehicle, allocatable_axes

__all__ = ["HORIZONS", "SHORTEST", "AxisUse", "Usability", "usability"]

HORIZONS = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0)  # s
LEAST = 50.0  # fit [%]
_AROUND = 0.2  # s before and after, over which a speed is told by the pose
_LONGEST = 1.0  # s, a gap in the pose over which no speed is told
_CLEARLY = 0.8  # of the square error of the last value, held: below it a prediction is nearer
_RESTARTS = 3  # a recording is as long as so many of the longest horizon, at least
SHORTEST = _RESTARTS * HORIZONS[0]  # s, below which nothing can be told


@dataclass(frozen=True)
class AxisUse:
    """What a prediction of an axis is good for.

    Attributes:
        axis: "surge". channel: by which it was judged, its speed, told by the pose where it is not measured.
        seconds: up to which a prediction is of use; 0 for none, inf for whole recordings.
        fit: [%] of the prediction, never set back or as often as was asked.
        held: at some horizon at which half is explained the last measured value, held, is about as near.
    """

    axis: str
    channel: str
    seconds: float
    fit: float
    held: bool = False


@dataclass(frozen=True)
class Usability:
    """For how long a model predicts each axis that was driven and measured.

    Attributes:
        axes: in their order. undriven: axes that the thrusters could drive, and hardly did. unmeasured: driven, but
            nothing shows them.
        duration: of the longest recording [s].
        drivable: axes that the thrusters drive independently of each other; None where that is not known.
    """

    axes: tuple[AxisUse, ...]
    undriven: tuple[str, ...]
    unmeasured: tuple[str, ...]
    duration: float
    drivable: tuple[str, ...] | None = None

    @property
    def good(self) -> tuple[AxisUse, ...]:
        """The axes whose prediction is of use."""
        return tuple(each for each in self.axes if each.seconds > 0.0)

    @property
    def poor(self) -> tuple[AxisUse, ...]:
        """The axes whose prediction is of none."""
        return tuple(each for each in self.axes if not each.seconds > 0.0)

    @property
    def seconds(self) -> float:
        """Up to which every axis that is predicted at all is of use [s]; 0 where none is."""
        return min((each.seconds for each in self.good), default=0.0)


def usability(
    model: Vehicle,
    grids: Sequence[Grid],
    *,
    horizon: float | None = None,
    delay: float | None = None,
    free: Sequence[Prediction] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Usability:
    """Return for how long a model predicts recordings, axis by axis.

    Args:
        horizon: of the predictions whose fit is told [s]; never set back where omitted.
        delay: from input to force [s]; the model's where omitted. free: predictions that are never set back, where they
            have been made.
        progress: called with a text and the share done, 0 .. 1.

    Raises:
        InputError: no recording, or one that cannot be predicted.
    """
    if not grids:
        raise InputError("no recording given, expected at least one")
    duration = max(float(grid.t[-1] - grid.t[0]) for grid in grids)
    horizons = [each for each in HORIZONS if _RESTARTS * each <= duration]
    made = [_with_speeds(each) for each in free or [predict(model, grid, delay=delay) for grid in grids]]
    driven = driven_by(np.array([_spread(made, axis.index) for axis in AXES]))
    fits = whole = score(made).fit
    if horizon is not None:
        fits = score([_with_speeds(predict(model, grid, horizon=horizon, delay=delay)) for grid in grids]).fit
    moved = {axis.name: axis.velocity for axis in AXES if driven[axis.index]}
    judged = {name: channel for name, channel in moved.items() if fits.get(channel) is not None}
    open_ = dict(judged)
    seconds = dict.fromkeys(open_, 0.0)
    held = dict.fromkeys(open_, False)
    for k, each in enumerate(horizons):
        if progress is not None:
            progress("how long predictions hold", k / (len(horizons) + 1))
        if not open_:
            break
        made.clear()  # room for the next
        made += [_with_speeds(predict(model, grid, horizon=each, delay=delay)) for grid in grids]
        some = score(made).fit
        for name, channel in tuple(open_.items()):
            if not (some[channel] or 0.0) >= LEAST:
                del open_[name]
            elif _held_is_as_near(made, channel):
                held[name] = True
            else:
                seconds[name] = each
    for name, channel in open_.items():
        if seconds[name] > 0.0 and (whole[channel] or 0.0) >= LEAST:
            seconds[name] = math.inf
    uses = tuple(
        AxisUse(name, channel, seconds[name], float(fits[channel] or 0.0), held[name])
        for name, channel in judged.items()
    )
    able = allocatable_axes(model) if model.thrusters else range(6)
    drivable = tuple(axis.name for axis in AXES if axis.index in able)
    undriven = tuple(name for name in drivable if name not in moved)
    return Usability(uses, undriven, tuple(name for name in moved if name not in judged), duration, drivable)


def _with_speeds(prediction: Prediction) -> Prediction:
    """Return the prediction with speeds by differences of the pose, where none are measured.

    A depth alone tells heave with what is predicted of surge and sway.
    """
    channels, t = prediction.channels, prediction.t
    missing = [name for name, pose in zip(VELOCITIES, POSE, strict=True) if name not in channels and pose in channels]
    if not missing:
        return prediction
    value, rate = np.full((6, len(t)), np.nan), np.full((6, len(t)), np.nan)
    for j, name in enumerate(POSE):
        if name in channels:
            value[j], rate[j] = _course(t, channels[name][0], angle=j > 2)
    predicted = prediction.states[:, 7:13]
    speeds = velocity_of_pose(value.T, rate.T, predicted)
    more = {}
    for name in missing:
        j = VELOCITIES.index(name)
        y = np.where(np.isfinite(channels[POSE[j]][0]), speeds[:, j], np.nan)
        if np.isfinite(y).any():
            more[name] = (y, predicted[:, j])
    return replace(prediction, channels={**channels, **more})


def _course(t: Array, y: Array, *, angle: bool) -> tuple[Array, Array]:
    """Return a channel (n,) between its samples, and its rate by differences, NaN where that is not known."""
    rows = np.flatnonzero(np.isfinite(y))
    known = np.unwrap(y[rows]) if angle else y[rows]
    value, rate = np.interp(t, t[rows], known), np.full(t.size, np.nan)
    if rows.size < 3:
        return value, rate
    k = max(1, round(_AROUND / max(float(np.median(np.diff(t[rows]))), 1e-6)))
    if rows.size > 2 * k:
        apart = t[rows[2 * k :]] - t[rows[: -2 * k]]
        found = np.where(apart > _LONGEST, np.nan, (known[2 * k :] - known[: -2 * k]) / apart)
        rate[rows[k] : rows[-k - 1] + 1] = np.interp(t[rows[k] : rows[-k - 1] + 1], t[rows[k:-k]], found)
    return value, rate


def _spread(predictions: Sequence[Prediction], axis: int) -> float:
    return max((float(np.nanstd(each.wrench[:, axis])) for each in predictions if len(each.wrench)), default=0.0)


def _held_is_as_near(predictions: Sequence[Prediction], channel: str) -> bool:
    """Whether the last value measured before each restart is about as near to what follows as what was predicted."""
    ours = theirs = 0.0
    for each in predictions:
        if channel not in each.channels:
            continue
        y, yhat = each.channels[channel]
        known = np.isfinite(y) & started(each) & np.isfinite(yhat)
        known &= each.t > each.restarts[0]
        held = _held(each.t, y, np.array(each.restarts))
        known &= np.isfinite(held)
        ours += float(np.square(y[known] - yhat[known]).sum())
        theirs += float(np.square(y[known] - held[known]).sum())
    return ours > _CLEARLY * theirs


def _held(t: Array, y: Array, restarts: Array) -> Array:
    """Return the value last measured before the restart that each row follows (n,); NaN before the first."""
    rows = np.searchsorted(t, restarts)
    seen = np.where(np.isfinite(y), np.arange(len(y)), -1)
    before = np.maximum.accumulate(seen)[np.minimum(rows, len(y) - 1)]
    values = np.where(before >= 0, y[np.maximum(before, 0)], np.nan)
    which = np.searchsorted(restarts, t, side="left") - 1  # the row of a restart ends the stretch before it
    return np.where(which >= 0, values[np.maximum(which, 0)], np.nan)
