"""What a learner knows while it streams, put together for a report, and how well its model predicts what it saw."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification import Estimate, Learner
from towtank.identification.data.samples import prepared
from towtank.identification.offline.convergence import Convergence
from towtank.live.learning import Learning
from towtank.recording import STANDARD, Recording, align
from towtank.recording.event import Event
from towtank.recording.grids.free_motion import free_parts
from towtank.recording.standard import EULER, MEASURED, QUATERNION, VELOCITIES, WRENCH
from towtank.report import LearnFacts
from towtank.validation import Usability, Validation, residuals, usability, validate
from towtank.vehicle import Vehicle

__all__ = ["Knowledge", "LiveFit", "judged", "knowledge_of", "stream_facts"]

_ENOUGH = 5.0  # s since the last change, for a prediction
_ANOTHER_ONE = ("change", "thruster")  # events after which the vehicle is another one


@dataclass(frozen=True)
class Knowledge:
    """What a learner knows at one moment; nothing in it changes afterwards.

    Attributes:
        vehicle: what it was given. model, estimate, method: of the learner. delay, lag: [s], NaN where it has none.
        remarks: sentences about it. gains: of thrusters. disturbance: level (6,) of the random force [N, N m], None
            where it has none.
    """

    vehicle: Vehicle
    model: Vehicle
    estimate: Estimate
    method: str
    delay: float
    lag: float
    remarks: tuple[str, ...]
    gains: dict[str, tuple[float, float]]
    disturbance: Array | None


def knowledge_of(learner: Learner) -> Knowledge:
    """Return what a learner knows; to be asked by the thread that owns it."""
    return Knowledge(
        learner.vehicle,
        learner.model(),
        learner.estimate,
        learner.method,
        learner.delay,
        learner.lag,
        learner.remarks,
        learner.gains,
        learner.disturbance,
    )


def judged_since(
    model: Vehicle, recording: Recording, events: Sequence[Event], of: str, *, keep_all: bool = False
) -> tuple[Validation | None, str, str]:
    """Return how a model predicts what counts of a recording, from the vehicle's last change on.

    Args:
        of: what the recording is, in words. keep_all: everything counts.

    Returns:
        The scores, None where there can be none; what was predicted, in words; why it could not be, else "".
    """
    last = max((event.t for event in events if event.kind in _ANOTHER_ONE), default=-math.inf)
    try:
        if last > recording.start:
            if recording.end - last < _ENOUGH:
                return None, of, "the vehicle has changed only just now"
            recording, of = (
                recording.window(last, recording.end),
                f"the last {recording.end - last:.0f} s, since the vehicle changed",
            )
        return validate(model, _counted(model, recording, keep_all=keep_all)), of, ""
    except InputError as error:
        return None, of, str(error)


def _counted(model: Vehicle, recording: Recording, *, keep_all: bool) -> list[Recording]:
    return [recording] if keep_all else free_parts(recording, model)


def stream_facts(
    now: Knowledge,
    recording: Recording | None,
    *,
    of: str,
    events: Sequence[Event] = (),
    convergence: Convergence | None = None,
    epoch: float = math.nan,
    prior: str | None = None,
    warnings: Sequence[str] = (),
    keep_all: bool = False,
    use: Usability | None = None,
) -> LearnFacts:
    """Return what a report of a stream is made of.

    Args:
        recording: what was learned from, or its recent part; of: which, in words. convergence: of the estimates.
        epoch: Unix time [s] of the events' time 0. prior: what was known beforehand, as it was named.
        keep_all: judge on all of the recording, not only where the vehicle moves freely in water.
        use: for how long the model predicts, where that was told already.
    """
    scores, predicted, why = None, of, ""
    if recording is not None and any(now.estimate.identified):
        scores, predicted, why = judged_since(now.model, recording, events, of, keep_all=keep_all)
    predictions = () if scores is None else scores.predictions
    level = now.disturbance
    if use is None and scores is not None and recording is not None:
        with contextlib.suppress(InputError):
            parts = _counted(now.model, recording, keep_all=keep_all)
            use = usability(now.model, [align(prepared(part, now.vehicle)) for part in parts])
    return LearnFacts(
        vehicle=now.vehicle,
        model=now.model,
        estimate=now.estimate,
        method=now.method,
        remarks=["learned sample by sample while it came", *now.remarks],
        delay=now.delay,
        lag=now.lag,
        gains=now.gains,
        prior=prior,
        fit={} if scores is None else scores.fit,
        rmse={} if scores is None else scores.rmse,
        predictions=predictions,
        predicted=predicted,
        use=use,
        residuals=residuals(predictions),
        recordings=() if recording is None else [recording],
        disturbance={}
        if level is None
        else {name: {"std": float(x), "unit": STANDARD[name].unit} for name, x in zip(WRENCH, level, strict=True) if x},
        convergence=convergence,
        events=events,
        epoch=epoch,
        warnings=[*warnings, *([f"no fit: {why}"] if why else [])],
    )


@dataclass(frozen=True)
class LiveFit:
    """Free-running prediction of a session by its own model.

    Attributes:
        fit: [%] by channel, None where not measured. of: what was predicted. reason: why there is no fit, "" where
            there is. noise: of each measured channel, "std" and "unit".
    """

    fit: dict[str, float | None] = field(default_factory=lambda: dict.fromkeys(VELOCITIES))
    of: str | None = None
    reason: str = ""
    noise: dict[str, dict[str, Any]] = field(default_factory=dict)


def judged(learning: Learning, recorded: Path | None, *, keep_all: bool = False) -> LiveFit:
    """Return how the model predicts the recording, else the last minute, since the last change; once it has ended."""
    learner = learning.learner
    if not any(learner.estimate.identified):
        return LiveFit(reason="nothing was identified")
    try:
        run, of = _session(learning, recorded)
        if run is None:
            return LiveFit(reason="no motion was learned from")

        found, of, reason = judged_since(learner.model(), run, learner.events, of, keep_all=keep_all)
    except InputError as error:
        return LiveFit(reason=str(error))
    if found is None:
        return LiveFit(reason=reason, noise=_noise(learner, run))
    return LiveFit({**dict.fromkeys(VELOCITIES), **found.fit}, of, noise=_noise(learner, run))


def _session(learning: Learning, recorded: Path | None) -> tuple[Recording | None, str]:
    if recorded is not None:
        from towtank.readers import read

        return read(recorded), f"the recording {recorded.name}"
    run = learning.recent.recording()
    return run, "" if run is None else f"the last {run.duration:.0f} s"


def _noise(learner: Learner, run: Recording) -> dict[str, dict[str, Any]]:
    """Return the noise of the sensors, where the learner estimates it; a quaternion is measured as angles."""
    noise = learner.noise
    if noise is None:
        return {}
    measured = set(run.channels) | (set(EULER) if set(QUATERNION) <= set(run.channels) else set())
    return {
        name: {"std": float(noise[k]), "unit": STANDARD[name].unit}
        for k, name in enumerate(MEASURED)
        if name in measured
    }
