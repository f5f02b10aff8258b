"""Where a session stands as one JSON document: what `GET /api/state` answers and the page shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from towtank.dashboard.feed import About, Now
from towtank.dashboard.motion import signals_of
from towtank.dashboard.prediction import SECONDS, FreeRun
from towtank.dashboard.verdict import AxisKnowledge, notes, verdict
from towtank.identification.model.terms import AXES
from towtank.recording.event import Event

__all__ = ["events_message", "greeting", "number", "state_document"]

_AXIS = {name: axis.name for axis in AXES for name in (axis.added_mass, axis.linear, axis.quadratic) if name}


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
        "state": "ended" if ended else now.state,
        "no_data_s": now.silent,
        "not_learning": now.not_learning or None,
        "elapsed_s": now.elapsed,
        "t": number(now.t),
        "verdict": verdict(now),
        "notes": list(notes(now)),
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
        "prediction": None if run is None or now.silent is not None else _run_document(run),
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
                "no_data_s": each.silent,
            }
            for each in now.links
        ],
        "recording": None
        if recording is None
        else {"file": recording.path.name, "bytes": recording.size, "lost": recording.lost},
        "warnings": list(now.warnings),
        "plan": None if now.plan is None else dict(now.plan),
        "page": dict(page),
    }


def events_message(events: Sequence[Event]) -> dict[str, Any]:
    """Return the latest events, oldest first."""
    return {"type": "events", "events": [{"t": e.t, "kind": e.kind, "text": e.text} for e in events]}


def _run_document(run: FreeRun) -> dict[str, Any]:
    return {
        "rms": _numbers(tuple(run.rms)),
        "t": [number(run.t[0]), number(run.t[-1])],
        "derived": [axis.velocity for axis in AXES if run.derived[axis.index]],
    }


def _axis_state(each: AxisKnowledge) -> dict[str, Any]:
    return {
        "learned": each.learned,
        "known": number(each.known),
        "inertia": number(each.inertia),
        "drag": number(each.drag),
        "speed": number(each.speed),
        "asked_rms": number(each.asked),
        "drivable": each.drivable,
    }


def _numbers(values: Sequence[float]) -> list[float | None]:
    return [number(float(value)) for value in values]
