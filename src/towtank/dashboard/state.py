"""Where a session stands as one JSON document: what `GET /api/state` answers and the page shows.

It says how well each axis is known in numbers that mean something: its inertia, and its drag at a speed it has had.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from towtank.dashboard.feed import About, Now
from towtank.dashboard.motion import signals_of
from towtank.dashboard.prediction import SECONDS, FreeRun
from towtank.digits import joined
from towtank.identification import Estimate
from towtank.identification.model.terms import AXES, Axis
from towtank.recording.event import Event

__all__ = ["AxisKnowledge", "axes_known", "events_message", "greeting", "number", "state_document", "verdict"]

_WELL = 0.05  # relative deviation
_SLOWEST = 1e-3  # m/s, rad/s
_LEAST = 0.05  # N, N m: what is asked for below that is what an allocation leaves over
_AXIS = {name: axis.name for axis in AXES for name in (axis.added_mass, axis.linear, axis.quadratic) if name}


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
        known = self.learned and math.isfinite(self.inertia) and math.isfinite(self.drag)
        return max(self.inertia, self.drag) if known else math.nan


def axes_known(estimate: Estimate, speeds: Sequence[float], asked: Sequence[float]) -> tuple[AxisKnowledge, ...]:
    """Return how well each axis is known.

    Args:
        speeds: the largest (6,) seen so far [m/s, rad/s]. asked: rms of the wrench (6,), or nothing.
    """
    return tuple(
        _axis_knowledge(estimate, axis, float(speeds[axis.index]), float(asked[axis.index]) if len(asked) else 0.0)
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
    names = joined([each.axis for each in rest])
    count = f"{len(well)} of {len(wanted)} axes known to 5 % or better."
    if doing and all(each.axis in {e.axis for e in doing} for each in rest):
        return f"{count} Keep driving {names}, with changes of speed."
    return f"{count} Next: drive {names}."


def number(value: float, scale: float = 1.0) -> float | None:
    """Return a number that JSON can hold; None where there is none."""
    return float(value) * scale if math.isfinite(value) else None


def greeting(
    about: About, names: Sequence[str], units: Mapping[str, str], session: str, *, report: bool
) -> dict[str, Any]:
    """Return what a viewer gets once: names, units and what the session is about."""
    reference = {name: number(value) for name, value in about.reference.items() if name in units}
    until, values = about.earlier or (math.nan, {})
    earlier = {name: number(value) for name, value in values.items()}
    return {
        "type": "hello",
        "session": session,
        "title": about.title,
        "vehicle": about.vehicle.name,
        "method": about.method,
        "seconds": about.seconds,
        "report": report,
        "prediction_seconds": SECONDS,
        "reference_word": about.reference_word,
        "reference_since": number(until),
        "coefficients": [
            {
                "name": name,
                "unit": units[name],
                "axis": _AXIS.get(name, ""),
                "reference": reference.get(name),
                "earlier": earlier.get(name),
            }
            for name in names
        ],
        "signals": [
            {"name": each.name, "chart": each.chart, "unit": each.unit, "scale": each.scale}
            for each in signals_of(about.vehicle)
        ],
        "axes": [{"name": axis.name, "velocity": axis.velocity, "wrench": axis.wrench} for axis in AXES],
    }


def state_document(
    now: Now,
    axes: Sequence[AxisKnowledge],
    run: FreeRun | None,
    pose: Sequence[float],
    *,
    sequence: int,
    page: Mapping[str, Any],
    ended: bool,
) -> dict[str, Any]:
    """Return where a session stands.

    Args:
        pose: x y z [m] phi theta psi [rad], NaN where not measured. sequence: number of this state.
        page: what the page says of itself.
    """
    recording = now.recording
    return {
        "type": "state",
        "sequence": sequence,
        "ended": ended,
        "paused": now.paused,
        "elapsed_s": now.elapsed,
        "t": number(now.t),
        "verdict": verdict(axes),
        "coefficients": {
            each.name: {
                "value": number(each.value),
                "std": number(each.std),
                "relative_std": number(each.std / abs(each.value)) if each.value else None,
                "unit": each.unit,
                "identified": each.identified,
                "reason": each.reason,
            }
            for each in now.estimate.coefficients
        },
        "sums": {
            each.name: {"value": number(each.value), "std": number(each.std), "unit": each.unit}
            for each in now.estimate.sums
        },
        "axes": {each.axis: _axis_state(each) for each in axes},
        "prediction": None
        if run is None
        else {"rms": _numbers(tuple(run.rms)), "t": [number(run.t[0]), number(run.t[-1])]},
        "pose": _numbers(pose),
        "delay_s": number(now.delay),
        "lag_s": number(now.lag),
        "latency_ms": {key: number(value) for key, value in now.latency.items()},
        "processing_ms": {key: number(value) for key, value in now.processing.items()},
        "samples": now.samples,
        "instants": now.instants,
        "dropped": now.dropped,
        "late": now.late,
        "rejected": now.rejected,
        "waiting": now.waiting,
        "links": [
            {
                "text": each.text,
                "samples": each.samples,
                "rates_hz": {name: number(rate) for name, rate in each.rates.items()},
                "asked_hz": {name: number(rate) for name, rate in each.asked.items()},
                "said": list(each.said),
            }
            for each in now.links
        ],
        "recording": None
        if recording is None
        else {"file": recording.path.name, "bytes": recording.size, "lost": recording.lost},
        "warnings": list(now.warnings),
        "page": dict(page),
    }


def events_message(events: Sequence[Event]) -> dict[str, Any]:
    """Return the latest events, oldest first."""
    return {"type": "events", "events": [{"t": e.t, "kind": e.kind, "text": e.text} for e in events]}


def _axis_state(each: AxisKnowledge) -> dict[str, Any]:
    return {
        "learned": each.learned,
        "known": number(each.known),
        "inertia": number(each.inertia),
        "drag": number(each.drag),
        "speed": number(each.speed),
        "asked_rms": number(each.asked),
    }


def _numbers(values: Sequence[float]) -> list[float | None]:
    return [number(float(value)) for value in values]
