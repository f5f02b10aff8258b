"""What `towtank learn` found, put together for its report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from towtank.app.learn_report import delay_deviation
from towtank.app.levels_tables import disturbance_document, noise_document
from towtank.app.report_output import origin_of, write_report
from towtank.identification import LogLearning
from towtank.identification.convergence import convergence
from towtank.recording import Recording
from towtank.report import LearnFacts
from towtank.report.learn_page import report_html
from towtank.validation import Validation, residuals
from towtank.vehicle import Vehicle

__all__ = ["learn_facts", "write_learn_report"]


def write_learn_report(
    path: Path,
    learning: LogLearning,
    model: Vehicle,
    scores: Validation | None,
    recordings: Sequence[Recording],
    logs: Sequence[Path],
    warnings: Sequence[str],
    prior: str | None,
    commands: Sequence[str],
) -> None:
    """Write the report of a learning. Raises InputError where it cannot be written."""
    facts = learn_facts(learning, model, scores, recordings, warnings=warnings, prior=prior)
    write_report(path, report_html(facts.of(origin_of(logs, commands))))


def learn_facts(
    learning: LogLearning,
    model: Vehicle,
    scores: Validation | None,
    recordings: Sequence[Recording],
    *,
    warnings: Sequence[str] = (),
    prior: str | None = None,
) -> LearnFacts:
    """Return what a report of a learning is made of.

    Args:
        scores: of the model's prediction of the logs, None where it could not be made.
        recordings: as they were learned from. prior: what was known beforehand, as it was named.
    """
    predictions = () if scores is None else scores.predictions
    return LearnFacts(
        vehicle=learning.vehicle,
        model=model,
        estimate=learning.estimate,
        method=learning.method,
        remarks=learning.remarks,
        delay=learning.delay,
        delay_std=delay_deviation(learning),
        delay_given=learning.delay_scan is None,
        lag=learning.lag,
        lag_std=learning.lag_std,
        gains=learning.gains,
        prior=prior,
        fit={} if scores is None else scores.fit,
        rmse={} if scores is None else scores.rmse,
        predictions=predictions,
        residuals=residuals(predictions),
        recordings=recordings,
        noise=noise_document(learning.levels, learning.grids),
        disturbance=disturbance_document(learning.levels, learning.sources),
        convergence=convergence(learning, recordings),
        warnings=warnings,
    )
