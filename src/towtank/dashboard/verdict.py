"""What a session comes to, in words: whether data come, how well each axis is known, what to note.

An axis is known in numbers that mean something: its inertia, and its drag at a speed it has had.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.dashboard.feed import Now
from towtank.dashboard.prediction import FreeRun
from towtank.digits import joined, short
from towtank.identification import Estimate
from towtank.identification.model.terms import AXES, Axis
from towtank.live.pipeline.hearing import no_data
from towtank.recording.event import Event
from towtank.vehicle import Vehicle, allocatable_axes

__all__ = ["COUNTED", "AxisKnowledge", "axes_known", "notes", "predicted", "verdict"]

# kinds of events that are noted with how often
COUNTED = ("mended", "link", "occlusion", "overload", "clock", "left out", "recording")
_SLOWEST = 1e-3  # m/s, rad/s
_LEAST = 0.05  # N, N m: what is asked for below that is what an allocation leaves over


@dataclass(frozen=True)
class AxisKnowledge:
    """How well one axis is known.

    Attributes:
        axis: its name. learned: whether anything of it is to be learned.
        inertia: relative deviation of rigid-body and added inertia together; NaN where not known.
        drag: relative deviation of the drag at `speed`; NaN where not known.
        speed: largest that was seen [m/s, rad/s]. asked: force or moment asked for (rms over 10 s) [N, N m].
        drivable: whether the vehicle's thrusters can drive it, whatever the other axes do.
    """

    axis: str
    learned: bool
    inertia: float
    drag: float
    speed: float
    asked: float
    drivable: bool = True

    @property
    def known(self) -> float:
        """The worse of the two; NaN where one of those that are learned is not known."""
        known = self.learned and math.isfinite(self.inertia) and math.isfinite(self.drag)
        return max(self.inertia, self.drag) if known else math.nan


def axes_known(
    estimate: Estimate, speeds: Sequence[float], asked: Sequence[float], vehicle: Vehicle | None = None
) -> tuple[AxisKnowledge, ...]:
    """Return how well each axis is known.

    Args:
        speeds: the largest (6,) seen so far [m/s, rad/s]. asked: rms of the wrench (6,), or nothing.
        vehicle: whose thrusters drive it; without one, or where it has none, all axes can be driven.
    """
    drivable = allocatable_axes(vehicle) if vehicle is not None and vehicle.thrusters else tuple(range(6))
    return tuple(
        replace(
            _axis_knowledge(estimate, axis, float(speeds[axis.index]), float(asked[axis.index]) if len(asked) else 0.0),
            drivable=axis.index in drivable,
        )
        for axis in AXES
    )


def _axis_knowledge(estimate: Estimate, axis: Axis, speed: float, asked: float) -> AxisKnowledge:
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
    return AxisKnowledge(axis.name, learned, inertia, drag, speed, asked if asked > _LEAST else 0.0)


def verdict(now: Now) -> str:
    """Return whether data come and are learned from; where they do, what the model can be used for and what to do next.

    What the model can be used for is said by the session, in the words of the report.
    """
    if now.silent is not None:
        names = joined([each.text for each in now.links if each.silent is not None])
        if not now.samples:
            return f"Nothing has come yet: {no_data(now.silent)} from {names}."
        return f"Link lost: {no_data(now.silent)} from {names}. All figures are as of then."
    judged = now.verdict or "Nothing can be said yet of what is learned."
    return f"Not learning: {now.not_learning}. {judged}" if now.not_learning else judged


def predicted(now: Now, run: FreeRun | None) -> str:
    """Return how far off the free run of the last seconds is, axis by axis (rms); or why nothing can be said."""
    if now.silent is not None:
        return no_data(now.silent)
    if run is None or not np.isfinite(run.rms).any():
        return "nothing to compare yet"
    groups = []
    for axes, scale, unit in ((AXES[:3], 1.0, "m/s"), (AXES[3:], 180.0 / math.pi, "°/s")):
        seen = [(axis.velocity, float(run.rms[axis.index])) for axis in axes]
        known = [f"{name} {short(scale * rms, 2)}" for name, rms in seen if math.isfinite(rms)]
        groups += [f"{', '.join(known)} {unit}"] if known else []
    return f"off by {'; '.join(groups)} (rms)"


def notes(now: Now) -> tuple[str, ...]:
    """Return what a person may want to know: what contradicts the model, what befell filter and links, and what the
    links say; each once.

    What has happened several times stands there with how often.
    """
    found: dict[str, list[Event]] = {}
    for event in now.events:
        text = _noted(event)
        if text:
            found.setdefault(text, []).append(event)
    told = [text if len(each) == 1 else f"{text} ({len(each)} times)" for text, each in found.items()]
    several = len(now.links) > 1
    said = [
        f"{link.text}: {text}" if several and not text.startswith(link.text) else text
        for link in now.links
        for text in link.said
    ]
    return tuple(dict.fromkeys((*now.remarks, *told, *said)))


def _noted(event: Event) -> str:
    """Return as what an event is noted, the same for all of its like; "" where it is not to be counted."""
    if event.kind == "link":
        return (
            f"{event.details.get('link', 'a link')}: the link was lost" if event.details.get("state") == "lost" else ""
        )
    if event.kind == "left out":
        return f"not learned from: {event.details['reason']}" if event.details.get("state") == "begun" else ""
    if event.kind == "occlusion":
        measured = event.details.get("measured")
        return f"{measured} not measured for a while" if measured else ""
    return event.text if event.kind in COUNTED else ""
