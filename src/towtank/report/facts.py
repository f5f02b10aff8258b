"""What a report is made of, as frozen records with optional parts: what is not there is left out of the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from towtank.identification import Estimate
from towtank.identification.offline.convergence import Convergence
from towtank.planning import Forecast, Plan, Unsteered
from towtank.recording import Recording
from towtank.recording.consistency import Finding
from towtank.recording.event import Event
from towtank.validation import Comparison, CrossValidation, Prediction, Residual, Usability, Validation
from towtank.vehicle import Vehicle

__all__ = ["LearnFacts", "LogFile", "Origin", "PlanFacts", "ValidateFacts"]


@dataclass(frozen=True)
class LogFile:
    """A log as it was read: its name, its size in bytes, its SHA-256 in hexadecimal."""

    name: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Origin:
    """Where a report comes from.

    Attributes:
        made: when, for a person. logs: the files. commands: that make it again, in order. versions: name -> version.
    """

    made: str = ""
    logs: Sequence[LogFile] = ()
    commands: Sequence[str] = ()
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class LearnFacts:
    """What was learned, and from what.

    Attributes:
        vehicle: as it was known before. model: with what was learned. estimate: coefficients.
        method: that they come from. asked: the method asked for. remarks: how it was learned, in plain words.
        delay, delay_std, lag, lag_std: [s], NaN where not known. delay_given: it was not searched for.
        together: delay and lag, and the deviation of their sum [s], where both were found.
        gains: of thrusters, value and deviation. prior: what was known beforehand, as it was named.
        supposed: of coefficients before any data, value and deviation. latency: of sensors likewise [s].
        fit, rmse: of the free-running prediction, per channel. predictions: one per log.
        predicted: which logs these are, in words. residuals: errors of the predictions, per channel.
        recordings: what was learned from, or its recent part. left_out: what of the logs does not count.
        noise, disturbance: name -> {"std", "unit"}.
        convergence: how the coefficients settled. truth: the vehicle that was simulated, where one was; truth_before:
            until when [s] it had been which one, where it became another.
        events: what happened; epoch: Unix time [s] at which their time is 0, NaN where that is not known.
        title: of the page; the vehicle's name by default. verdict: the first sentence; found from the facts by default.
        use: for how long it predicts the logs. findings: what cannot be right, gravest first.
        driven: axes (6,) that the inputs drove, () where not known.
        warnings: in plain words.
    """

    vehicle: Vehicle
    model: Vehicle
    estimate: Estimate
    method: str = "joint"
    asked: str = ""
    remarks: Sequence[str] = ()
    delay: float = math.nan
    delay_std: float | None = None
    delay_given: bool = False
    lag: float = math.nan
    lag_std: float = math.nan
    together: tuple[float, float] | None = None
    gains: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    prior: str | None = None
    supposed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    latency: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fit: Mapping[str, float | None] = field(default_factory=dict)
    rmse: Mapping[str, float | None] = field(default_factory=dict)
    predictions: Sequence[Prediction] = ()
    predicted: str = "the logs that it was learned from"
    residuals: Mapping[str, Residual] = field(default_factory=dict)
    recordings: Sequence[Recording] = ()
    left_out: Sequence[str] = ()
    noise: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    disturbance: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    convergence: Convergence | None = None
    truth: Vehicle | None = None
    truth_before: tuple[float, Vehicle] | None = None
    events: Sequence[Event] = ()
    epoch: float = math.nan
    title: str = ""
    verdict: str = ""
    use: Usability | None = None
    findings: Sequence[Finding] = ()
    driven: Sequence[bool] = ()
    warnings: Sequence[str] = ()
    origin: Origin = Origin()

    def of(self, origin: Origin) -> LearnFacts:
        """Return the same facts with where they come from."""
        return replace(self, origin=origin)


@dataclass(frozen=True)
class ValidateFacts:
    """How well a model predicts, and what its errors are.

    Attributes:
        name: of the model as it was given. model: the vehicle. judged: its scores and predictions.
        horizon, delay: [s] as asked for, None where not. residuals: errors per channel.
        use: for how long it predicts. comparison: with other models.
        folds: cross-validation; `judged` is then of its windows. findings: what cannot be right of the thrusters.
        left_out: what of the logs does not count.
    """

    name: str
    model: Vehicle
    judged: Validation
    horizon: float | None = None
    delay: float | None = None
    residuals: Mapping[str, Residual] = field(default_factory=dict)
    use: Usability | None = None
    comparison: Comparison | None = None
    folds: CrossValidation | None = None
    findings: Sequence[Finding] = ()
    recordings: Sequence[Recording] = ()
    left_out: Sequence[str] = ()
    warnings: Sequence[str] = ()
    origin: Origin = Origin()


@dataclass(frozen=True)
class PlanFacts:
    """What to drive, and what comes of it.

    Attributes:
        before: what is known of the middle vehicle. steps: after each segment, with its path.
        drawn: runs of other vehicles that it may be.
    """

    vehicle: Vehicle
    plan: Plan
    before: Forecast
    steps: Sequence[Forecast]
    drawn: Unsteered
    origin: Origin = Origin()
