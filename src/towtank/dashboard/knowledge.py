"""How well each axis is known, in one number that means something: its inertia, and its drag at a speed it has had."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.identification import Estimate
from towtank.identification.axes import AXES, Axis

__all__ = ["AxisKnowledge", "axes_known", "verdict"]

_WELL = 0.05  # relative deviation
_SLOWEST = 1e-3  # m/s, rad/s


@dataclass(frozen=True)
class AxisKnowledge:
    """How well one axis is known.

    Attributes:
        axis: its name. learned: whether anything of it is to be learned.
        inertia: relative deviation of rigid-body and added inertia together; NaN where not known.
        drag: relative deviation of the drag at `speed`; NaN where not known.
        speed: largest that was seen [m/s, rad/s]. asked: force or moment asked for (rms over 10 s) [N, N m].
    """

    axis: str
    learned: bool
    inertia: float
    drag: float
    speed: float
    asked: float

    @property
    def known(self) -> float:
        """The worse of the two; NaN where one of those that are learned is not known."""
        told = self.learned and math.isfinite(self.inertia) and math.isfinite(self.drag)
        return max(self.inertia, self.drag) if told else math.nan


def axes_known(estimate: Estimate, speeds: Sequence[float], asked: Sequence[float]) -> tuple[AxisKnowledge, ...]:
    """Return how well each axis is known.

    Args:
        speeds: the largest (6,) seen so far [m/s, rad/s]. asked: rms of the wrench (6,), or nothing.
    """
    return tuple(
        _axis(estimate, axis, float(speeds[axis.index]), float(asked[axis.index]) if len(asked) else 0.0)
        for axis in AXES
    )


def _axis(estimate: Estimate, axis: Axis, speed: float, asked: float) -> AxisKnowledge:
    drags = [name for name in (axis.linear, axis.quadratic) if name in estimate.names]
    sums = {each.name: each for each in estimate.sums}
    inertia = drag = math.nan
    if axis.sum_name in sums:
        total = sums[axis.sum_name]
        inertia = total.std / abs(total.value) if total.value else math.nan
    known = [name for name in drags if estimate[name].identified]
    if known and speed > _SLOWEST:
        rows = [estimate.names.index(name) for name in known]
        weights = np.array([speed if name == axis.linear else speed * speed for name in known])
        force = float(weights @ estimate.values[rows])
        spread = float(weights @ estimate.covariance[np.ix_(rows, rows)] @ weights)
        drag = math.sqrt(max(spread, 0.0)) / abs(force) if force else math.nan
    elif not drags:
        drag = 0.0
    if axis.added_mass not in estimate.names:
        inertia = 0.0
    learned = bool(drags) or axis.added_mass in estimate.names
    return AxisKnowledge(axis.name, learned, inertia, drag, speed, asked)


def verdict(axes: Sequence[AxisKnowledge]) -> str:
    """Return in one sentence what is known and what to do next."""
    wanted = [each for each in axes if each.learned]
    if not wanted:
        return "No axis is being learned."
    well = [each for each in wanted if each.known <= _WELL]
    if len(well) == len(wanted):
        return "All axes are known to 5 % or better: save the model, or go on to make it surer."
    unknown = [each for each in wanted if math.isnan(each.known)]
    rest = unknown or [max((e for e in wanted if e.known > _WELL), key=lambda each: each.known)]
    doing = [each for each in wanted if each.asked > 0.0 and not each.known <= _WELL]
    names = _listed([each.axis for each in rest])
    told = f"{len(well)} of {len(wanted)} axes known to 5 % or better."
    if doing and all(each.axis in {e.axis for e in doing} for each in rest):
        return f"{told} Keep driving {names}, with changes of speed."
    return f"{told} Next: drive {names}."


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
