"""`towtank.learn`, `towtank.validate` and `towtank.inspect`: what the commands of these names do, as functions."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from towtank.app.commands.arguments import LogPlace, Window, is_number, positive_option, reachable_fit
from towtank.app.commands.learn import names_of
from towtank.app.files import LogParts, counted, known_beforehand, naming_logs, parts_of, read_logs
from towtank.app.inspection import Inspection, inspect_recording
from towtank.app.judging import alone, with_wiring
from towtank.app.results import Judgement, LearnedModel, Log
from towtank.app.tables.free_motion import rate_warnings
from towtank.app.tables.repairs import learning_warnings
from towtank.app.terminal.output import Progress
from towtank.errors import InputError
from towtank.identification import learn_recordings
from towtank.recording import Recording, with_body_velocity
from towtank.recording.mapping import AnyMapping
from towtank.vehicle import AnyVehicle, Vehicle, vehicle_of

__all__ = ["inspect", "learn", "validate"]

_LOG = (str, os.PathLike, Recording)
Logs: TypeAlias = Log | Sequence[Log]
Stretch: TypeAlias = "tuple[float | None, float | None]"
Windows: TypeAlias = "Stretch | Sequence[Stretch] | NDArray[Any]"


def learn(
    logs: Logs,
    vehicle: AnyVehicle | LearnedModel,
    *,
    method: str = "joint",
    free: str | Collection[str] | None = None,
    window: Windows | None = None,
    mapping: AnyMapping | None = None,
    delay: float | None = None,
    prior: AnyVehicle | LearnedModel | None = None,
    keep_all: bool = False,
    progress: Progress | None = None,
) -> LearnedModel:
    """Learn a model from one or several logs, as `towtank learn` does.

    Args:
        logs: paths or recordings, one or several.
        vehicle: what is supposed: a vehicle, its name in the catalog, the path of its file, or what was learned before.
        method: "joint", "output-error" or "paper".
        free: names of the unknowns to learn, all others but delay and lag stay as supposed; everything plausible where
            omitted. A text may name several: "X_udot,X_uu".
        window: (start, end) [s] in the logs' own time, None where open, negative from the end; or one for each log.
        mapping: for logs that are files: which column is which channel (`read`).
        delay: from command to force [s]; found where omitted.
        prior: a vehicle that was learned, or bears deviations: what is known beside the first.
        keep_all: use all of the logs, not only where the vehicle moves freely in water under known commands.
        progress: called with a text and the share done, 0 .. 1.

    Raises:
        InputError: a file that cannot be read, a vehicle or name that there is not, a negative delay, or nothing to
            learn from.
    """
    positive_option("delay", delay, zero=True)
    known, report = _vehicle(vehicle), progress or _silent
    beforehand = None if prior is None else known_beforehand(_vehicle(prior), f"prior {_named(prior)}")
    every = _several(logs)
    parts = _parts(every, mapping, window, known, keep_all, report)
    recordings = counted(parts)
    names = names_of(free, "free") if isinstance(free, str) else free
    with naming_logs(parts):
        learning = learn_recordings(
            known,
            recordings,
            method=method,
            free=names,
            delay=delay,
            prior=beforehand,
            progress=lambda text, share: report(text, 0.9 * share),
        )
    report("predicting", 0.9)
    named = None if prior is None else _named(prior)
    warnings = [*rate_warnings(parts), *learning_warnings(learning, recordings)]
    learned = LearnedModel.of(learning, parts, recordings, warnings, named)
    report("done", 1.0)
    return learned


def validate(
    model: AnyVehicle | LearnedModel,
    logs: Logs,
    *,
    window: Windows | None = None,
    horizon: float | None = None,
    mapping: AnyMapping | None = None,
    delay: float | None = None,
    keep_all: bool = False,
    require: float | None = None,
    progress: Progress | None = None,
) -> Judgement:
    """Predict logs from their commands alone and compare with what was measured, as `towtank validate` does.

    Args:
        model: what was learned, a vehicle, its name in the catalog, or the path of its file.
        logs, window, mapping, keep_all, progress: as of `learn`; logs that the model was not learned from.
        horizon: set the prediction back to the measured state every so many seconds; never where omitted.
        delay: from command to force [s]; the model's own where omitted.
        require: fit [%] that every axis driven and measured must reach; `met` of the result says whether they do.

    Raises:
        InputError: a file that cannot be read, nothing measured, no commands, a horizon that is not positive, a
            negative delay, or more than 100 % required.
    """
    positive_option("horizon", horizon)
    positive_option("delay", delay, zero=True)
    reachable_fit("require", require)
    vehicle, report = _vehicle(model), progress or _silent
    every = _several(logs)
    parts = _parts(every, mapping, window, vehicle, keep_all, report)
    recordings = counted(parts)
    judged = alone(vehicle, recordings, {"horizon": horizon, "delay": delay}, report)
    judged = with_wiring(judged, vehicle, recordings)
    warnings = tuple(rate_warnings(parts))
    return Judgement(_named(model), vehicle, judged, tuple(parts), horizon, delay, warnings, require)


@overload
def inspect(  # type: ignore[overload-overlap]  # a text is a path, not a sequence
    logs: Log,
    vehicle: AnyVehicle | LearnedModel | None = None,
    *,
    window: Windows | None = None,
    mapping: AnyMapping | None = None,
    keep_all: bool = False,
    progress: Progress | None = None,
) -> Inspection: ...


@overload
def inspect(
    logs: Sequence[Log],
    vehicle: AnyVehicle | LearnedModel | None = None,
    *,
    window: Windows | None = None,
    mapping: AnyMapping | None = None,
    keep_all: bool = False,
    progress: Progress | None = None,
) -> tuple[Inspection, ...]: ...


def inspect(
    logs: Logs,
    vehicle: AnyVehicle | LearnedModel | None = None,
    *,
    window: Windows | None = None,
    mapping: AnyMapping | None = None,
    keep_all: bool = False,
    progress: Progress | None = None,
) -> Inspection | tuple[Inspection, ...]:
    """Return what is in a log and what can be learned from it, as `towtank inspect` does; of several logs, of each.

    Args:
        logs, window, mapping, keep_all, progress: as of `learn`.
        vehicle: that made it, for verdicts by coefficient; a quick regression without one.

    Raises:
        InputError: a file that cannot be read, fewer than 4 samples, or thrusters that the vehicle lacks.
    """
    known, report = None if vehicle is None else _vehicle(vehicle), progress or _silent
    every = _several(logs)
    parts = _parts(every, mapping, window, known, keep_all, report)
    found = tuple(inspect_recording(each, known, report) for each in parts)
    return found[0] if isinstance(logs, _LOG) else found


def _silent(text: str, share: float) -> None:
    """Tell nobody."""


def _vehicle(vehicle: AnyVehicle | LearnedModel) -> Vehicle:
    return vehicle.model if isinstance(vehicle, LearnedModel) else vehicle_of(vehicle)


def _named(vehicle: AnyVehicle | LearnedModel) -> str:
    """Return what a vehicle is called, as it was given."""
    if isinstance(vehicle, LearnedModel):
        return vehicle.model.name
    return vehicle.name if isinstance(vehicle, Vehicle) else str(vehicle)


def _several(logs: Logs) -> list[Log]:
    """Return one log or several as a list. Raises InputError where there is none, or one is neither path nor log."""
    every: list[Log] = [logs] if isinstance(logs, _LOG) else list(logs) if isinstance(logs, Sequence) else []
    if not every:
        raise InputError(f"logs: found {_shown(logs)}, expected a path or a recording, or several")
    for each in every:
        if not isinstance(each, _LOG):
            raise InputError(f"logs: found {_shown(each)} among them, expected paths or recordings")
    return every


def _shown(value: object) -> str:
    return "none" if isinstance(value, Sequence) and not value else f"an object of type {type(value).__name__}"


def _names(logs: Sequence[Log]) -> tuple[str, ...]:
    return tuple(
        (log.source or f"recording {k}") if isinstance(log, Recording) else os.fspath(log)
        for k, log in enumerate(logs, 1)
    )


def _parts(
    logs: Sequence[Log],
    mapping: AnyMapping | None,
    window: Windows | None,
    vehicle: Vehicle | None,
    keep_all: bool,
    progress: Progress,
) -> list[LogParts]:
    """Return what counts of logs, read where they are paths, within the window of each."""
    if mapping is not None and all(isinstance(log, Recording) for log in logs):
        raise InputError("mapping: the logs are recordings already; a mapping is for files, or for towtank.read")
    places, recordings = [], []
    for name, log, stretch in zip(_names(logs), logs, _windows(window, len(logs)), strict=True):
        places.append(LogPlace(Path(name), () if stretch is None else (stretch,)))
        if isinstance(log, Recording):
            recordings.append(with_body_velocity(log))
        else:
            recordings += read_logs([Path(log)], mapping, progress)
    return parts_of(places, recordings, vehicle, keep_all=keep_all)


def _windows(window: Windows | None, count: int) -> list[Window | None]:
    """Return the window of each of `count` logs. Raises InputError."""
    if window is None:
        return [None] * count
    given = window.tolist() if isinstance(window, np.ndarray) else window
    parts = list(given) if isinstance(given, Sequence) else []
    if len(parts) == 2 and all(part is None or is_number(part) for part in parts):
        return [_window(tuple(parts))] * count
    if len(parts) != count:
        expected = f"(start, end) in seconds, or one such pair for each log ({count})"
        raise InputError(f"window: found {window!r}, expected {expected}")
    return [_window(part) for part in parts]


def _window(part: Any) -> Window:
    if isinstance(part, Mapping | str) or not isinstance(part, Sequence) or len(part) != 2:
        raise InputError(f"window: found {part!r}, expected (start, end) in seconds, None where it is open")
    return Window.of(*part)
