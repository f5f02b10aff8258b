"""The ways to judge a model: alone, against others, by folds that learn anew; what each shows and reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from towtank.errors import InputError, nearest
from towtank.methods import METHODS

if TYPE_CHECKING:
    from towtank.app.terminal.output import Output, Progress
    from towtank.identification import LogLearning
    from towtank.recording import Recording
    from towtank.recording.consistency import Finding
    from towtank.report.verdict import Verdict
    from towtank.validation import Usability, Validation
    from towtank.validation.cross_validation import Learn
    from towtank.vehicle import Vehicle

__all__ = ["Judged", "against_others", "alone", "by_folds", "learn_by", "with_wiring", "write_validate_report"]

_SPARK = 16  # characters


@dataclass(frozen=True)
class Judged:
    """What was found: scores, how to print it, its part of the document, what a report says of it, and its use.

    Attributes:
        findings: what cannot be right of the model's thrusters, as the logs have them.
    """

    found: Validation
    show: Callable[[Output], None]
    document: dict[str, Any]
    reported: Mapping[str, Any] = field(default_factory=dict)
    use: Usability | None = None
    findings: tuple[Finding, ...] = ()

    def verdict(self, name: str) -> Verdict:
        """Return what the model of this name can be used for."""
        from towtank.report.verdict import validate_verdict

        errors = self.reported.get("residuals", {})
        return validate_verdict(
            name, self.found.fit, [one.verdict.kind for one in errors.values()], self.use, self.findings
        )

    def lacking(self, least: float) -> tuple[str, ...]:
        """Return in words what does not reach a fit [%]: of the axes that were driven; of folds, of all that move."""
        from towtank.recording.axes import judged_by

        if self.use is None:
            judging = judged_by([name for name, value in self.found.fit.items() if value is not None])
            fit = {name: self.found.fit[name] or 0.0 for name in judging if name not in ("x", "y")}
        else:
            fit = {each.channel: each.fit for each in self.use.axes}
        if not fit:
            return ("no axis that was driven was measured",)
        return tuple(f"found a fit of {value:.1f} % for {name}" for name, value in fit.items() if not value >= least)


def alone(vehicle: Vehicle, recordings: Sequence[Recording], options: dict[str, Any], progress: Progress) -> Judged:
    """Judge one model."""
    from towtank.app.tables.fits import show_fits
    from towtank.app.tables.judging import residual_document, show_residuals
    from towtank.validation import residuals
    from towtank.validation import validate as judge

    found = judge(vehicle, recordings, progress=progress, **options)
    errors = residuals(found.predictions, progress=progress)
    use = _use(vehicle, recordings, options, progress)

    def show(output: Output) -> None:
        output.line()
        show_fits(found.fit, found.rmse, output, _sparks(found, ascii_only=output.ascii))
        show_residuals(errors, output)

    return Judged(found, show, {"residuals": residual_document(errors)}, {"residuals": errors}, use)


def with_wiring(judged: Judged, vehicle: Vehicle, recordings: Sequence[Recording]) -> Judged:
    """Return what was found with what the recordings tell of the sign of the model's thrusters, and of their order."""
    from towtank.identification.logs import wiring_findings

    found = wiring_findings(vehicle, recordings, "the model is judged as its file has them")
    document = {"findings": [{"what": each.what, "text": each.text} for each in found]}
    return replace(judged, findings=found, document=judged.document | document)


def _use(
    vehicle: Vehicle, recordings: Sequence[Recording], options: Mapping[str, Any], progress: Progress
) -> Usability:
    """Return for how long the model predicts the recordings, whatever the restarts asked for."""
    from towtank.recording import align, bind_thrusters
    from towtank.validation import usability

    names = [thruster.name for thruster in vehicle.thrusters]
    grids = [align(bind_thrusters(recording, names)) for recording in recordings]
    return usability(vehicle, grids, horizon=options["horizon"], delay=options["delay"], progress=progress)


def _sparks(found: Validation, *, ascii_only: bool) -> dict[str, str]:
    """Return the size of each channel's errors over time, recording after recording, as spark lines."""
    import numpy as np

    from towtank.app.terminal.spark import error_spark

    out = {}
    for name in found.fit:
        pairs = [prediction.channels[name] for prediction in found.predictions if name in prediction.channels]
        if pairs:
            with np.errstate(invalid="ignore", over="ignore"):
                errors = np.concatenate([measured - predicted for measured, predicted in pairs])
            out[name] = error_spark(errors, _SPARK, ascii_only=ascii_only)
    return out


def against_others(
    vehicles: Mapping[str, Vehicle], recordings: Sequence[Recording], options: dict[str, Any], progress: Progress
) -> Judged:
    """Judge several models on the same logs."""
    from towtank.app.tables.judging import comparison_document, residual_document, show_comparison
    from towtank.validation import compare, residuals

    found = compare(vehicles, recordings, progress=progress, **options)
    first = next(iter(found.validations.values()))
    errors = residuals(first.predictions, progress=progress)
    document = {"residuals": residual_document(errors), "comparison": comparison_document(found)}
    reported = {"residuals": errors, "comparison": found}
    use = _use(next(iter(vehicles.values())), recordings, options, progress)
    return Judged(first, lambda output: show_comparison(found, output), document, reported, use)


def by_folds(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    folds: int,
    learn: Learn,
    logs: Sequence[Path],
    options: dict[str, Any],
    progress: Progress,
) -> Judged:
    """Judge a model on windows, each learned anew on the others."""
    from towtank.app.tables.judging import fold_document, show_folds
    from towtank.validation import cross_validate

    found = cross_validate(vehicle, recordings, windows=folds, learn=learn, progress=progress, **options)
    document = {"cross_validation": fold_document(found, logs)}
    return Judged(found.scores, lambda output: show_folds(found, logs, output), document, {"folds": found})


def write_validate_report(
    path: Path,
    name: str,
    model: Vehicle,
    judged: Judged,
    logs: Sequence[Path],
    commands: Sequence[str],
    further: Mapping[str, Any],
) -> None:
    """Write the report of a validation; `further` are facts of it. Raises InputError."""
    from towtank.app.reports import origin_of, write_report
    from towtank.report import ValidateFacts
    from towtank.report.validate_page import validate_html

    facts = ValidateFacts(
        name=name,
        model=model,
        judged=judged.found,
        use=judged.use,
        findings=judged.findings,
        origin=origin_of(logs, commands),
        **judged.reported,
        **further,
    )
    write_report(path, validate_html(facts))


def learn_by(method: str | None, delay: float | None) -> Learn:
    """Return what learns by a method, `learn`'s own where omitted. Raises InputError for an unknown one."""
    if method is not None and method not in METHODS:
        expected = ", ".join(f'"{name}"' for name in METHODS)
        raise InputError(f'--method: found "{method}", expected one of {expected}{nearest(method, METHODS)}')

    def learn(vehicle: Vehicle, recordings: Sequence[Recording]) -> LogLearning:
        from towtank.identification import learn_recordings

        if method is None:
            return learn_recordings(vehicle, recordings, delay=delay)
        return learn_recordings(vehicle, recordings, method=method, delay=delay)

    return learn
