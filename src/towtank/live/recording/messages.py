"""What a session publishes to viewers, in JSON with schemas: pose, velocity, wrench, coefficients, how it fares.

The same messages go to Foxglove, whose own schema the pose bears; anything that plots JSON by a schema shows the others
field by field. A recording keeps the pose ten times a second, and the coefficients once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from towtank.core.attitude import quaternion_from_euler
from towtank.live.learning import Learnt
from towtank.live.recording.recorder import Form, Message
from towtank.live.status import Status
from towtank.recording.standard import VELOCITIES, WRENCH

__all__ = [
    "COEFFICIENTS",
    "POSE",
    "PREDICTION",
    "SESSION",
    "VELOCITY",
    "WORLD",
    "WRENCHES",
    "Kept",
    "coefficients",
    "pose",
    "prediction",
    "session",
    "vector",
]

WORLD = "ned"  # frame of poses: x north, y east, z down
_TWO_SIDED_95 = 1.959963984540054  # deviations
_XYZ = {axis: {"type": "number"} for axis in "xyz"}
_T = {"type": "number", "description": "s, on the clock of the session"}
_POSES, _COEFFICIENTS = 0.1, 1.0  # s between two of them


def _number(description: str = "") -> dict[str, Any]:
    return {"type": ["number", "null"], **({"description": description} if description else {})}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties)}


def _form(topic: str, name: str, schema: Mapping[str, Any]) -> Form:
    return Form(f"/towtank/{topic}", (name, "jsonschema", json.dumps({"title": name, **schema}).encode()))


_COEFFICIENT = _object(
    value=_number(),
    std=_number(),
    low=_number("lower end of the 95 % interval"),
    high=_number("upper end of the 95 % interval"),
    unit={"type": "string"},
    identified={"type": "boolean"},
)


_PERCENTILES = {name: _number("ms") for name in ("median", "p99", "max")}


POSE = _form(
    "pose",
    "foxglove.PoseInFrame",
    _object(
        timestamp=_object(sec={"type": "integer"}, nsec={"type": "integer"}),
        frame_id={"type": "string"},
        pose=_object(position=_object(**_XYZ), orientation=_object(**_XYZ, w={"type": "number"})),
    ),
)


VELOCITY = _form("velocity", "towtank.Velocity", _object(t=_T, **{name: _number("FRD") for name in VELOCITIES}))


WRENCHES = _form("wrench", "towtank.Wrench", _object(t=_T, **{name: _number("FRD") for name in WRENCH}))


COEFFICIENTS = _form(
    "coefficients",
    "towtank.Coefficients",
    {**_object(t=_T, delay_s=_number()), "additionalProperties": _COEFFICIENT},
)


PREDICTION = _form(
    "prediction",
    "towtank.Prediction",
    _object(
        t=_T,
        measured=_object(**{name: _number("FRD") for name in VELOCITIES}),
        predicted=_object(**{name: _number("FRD, of a free run of the model as learned now") for name in VELOCITIES}),
    ),
)


SESSION = _form(
    "session",
    "towtank.Session",
    _object(
        t=_T,
        elapsed_s=_number(),
        samples={"type": "integer"},
        latency_ms=_object(**_PERCENTILES),
        processing_ms=_object(**_PERCENTILES),
        excitation=_object(**{name: _number("root mean square over ten seconds, N or N m") for name in WRENCH}),
        dropped={"type": "integer"},
        late={"type": "integer"},
        bad={"type": "integer"},
        warnings={"type": "array", "items": {"type": "string"}},
    ),
)


def pose(t: float, epoch: float, values: Sequence[float]) -> Message | None:
    """Return x y z [m, NED] phi theta psi [rad] as a pose in the world; None where not all is known.

    Args:
        t: time [s of the session]. epoch: Unix time of its zero [s].
    """
    if not all(map(math.isfinite, values)):
        return None
    w, x, y, z = quaternion_from_euler(*values[3:6])
    nanoseconds = round((epoch + t) * 1e9)
    return _message(
        POSE,
        t,
        {
            "timestamp": {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9},
            "frame_id": WORLD,
            "pose": {
                "position": dict(zip("xyz", map(float, values[:3]), strict=True)),
                "orientation": {"x": float(x), "y": float(y), "z": float(z), "w": float(w)},
            },
        },
    )


def vector(form: Form, t: float, values: Sequence[float]) -> Message | None:
    """Return a velocity or a wrench (6,); None where nothing of it is known."""
    if not any(map(math.isfinite, values)):
        return None
    names = VELOCITIES if form is VELOCITY else WRENCH
    return _message(form, t, {"t": t, **dict(zip(names, map(_plain, values), strict=True))})


def prediction(t: float, measured: Sequence[float], predicted: Sequence[float]) -> Message:
    """Return velocities (6,), measured and predicted, body FRD, at time t [s of the session]."""
    told = {"measured": measured, "predicted": predicted}
    fields = {key: dict(zip(VELOCITIES, map(_plain, values), strict=True)) for key, values in told.items()}
    return _message(PREDICTION, t, {"t": t, **fields})


def coefficients(learnt: Learnt) -> Message | None:
    """Return every coefficient with its deviation and 95 % interval; None before the first sample."""
    if not math.isfinite(learnt.t):
        return None
    fields: dict[str, Any] = {"t": learnt.t, "delay_s": _plain(learnt.delay)}
    for each in learnt.estimate.coefficients:
        spread = _TWO_SIDED_95 * each.std
        fields[each.name] = {
            "value": _plain(each.value),
            "std": _plain(each.std),
            "low": _plain(each.value - spread),
            "high": _plain(each.value + spread),
            "unit": each.unit,
            "identified": bool(each.identified),
        }
    return _message(COEFFICIENTS, learnt.t, fields)


def session(status: Status) -> Message:
    """Return how a session fares."""
    learnt = status.learnt
    t = learnt.t if math.isfinite(learnt.t) else 0.0
    excitation = learnt.excitation or (math.nan,) * 6
    return _message(
        SESSION,
        t,
        {
            "t": t,
            "elapsed_s": status.elapsed,
            "samples": status.samples,
            "latency_ms": {name: _plain(learnt.latency[name]) for name in _PERCENTILES},
            "processing_ms": {name: _plain(learnt.processing[name]) for name in _PERCENTILES},
            "excitation": dict(zip(WRENCH, map(_plain, excitation), strict=True)),
            "dropped": status.dropped,
            "late": status.late,
            "bad": status.bad,
            "warnings": list(status.warnings),
        },
    )


def _message(form: Form, t: float, message: Mapping[str, Any]) -> Message:
    return Message(form, t, json.dumps(message, allow_nan=False))


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


class Kept:
    """Listens to the instants of a session.

    Args:
        put: takes what is to be kept. learnt: returns where learning stands. epoch: Unix time of t = 0 [s].
    """

    def __init__(self, put: Callable[[Message], None], learnt: Callable[[], Learnt], epoch: float) -> None:
        self._put, self._learnt, self._epoch = put, learnt, epoch
        self._posed = self._summed_up = -math.inf

    def see(self, t: float, arguments: Mapping[str, Any]) -> None:
        """Take the learner's arguments of time t [s]."""
        values = arguments.get("pose")
        if values is not None and not 0.0 <= t - self._posed < _POSES:
            message = pose(t, self._epoch, values)
            if message is not None:
                self._posed = t
                self._put(message)
        if not 0.0 <= t - self._summed_up < _COEFFICIENTS:
            self._summed_up = t
            message = coefficients(self._learnt())
            if message is not None:
                self._put(message)
