"""`--report FILE`: what a report is made of, what `towtank learn` found among it, and how it is written."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from towtank.app.tables.learning import delay_deviation, disturbance_document, noise_document, supposed_values
from towtank.identification import LogLearning
from towtank.identification.offline.convergence import convergence
from towtank.planning import Outlook, Plan, draws_of, forecast, forecasts, unsteered
from towtank.recording import Recording
from towtank.report import LearnFacts, PlanFacts
from towtank.report.learn_page import report_html
from towtank.report.plan_page import plan_html
from towtank.validation import Usability, Validation, residuals
from towtank.vehicle import Vehicle

if TYPE_CHECKING:
    from towtank.report import LogFile, Origin

__all__ = ["learn_facts", "origin_of", "plan_facts", "write_learn_report", "write_plan_report", "write_report"]

_LIBRARIES = ("numpy", "scipy", "numba")
_CHUNK = 1 << 20
_DRAWN = 40  # vehicles whose paths a report of a plan shows


def write_report(path: Path, html: str) -> None:
    """Write a page as HTML or PDF, by the suffix, whole or not at all. Raises InputError."""
    if path.suffix.lower() == ".pdf":
        from towtank.report.browser import print_pdf

        print_pdf(html, path)
    else:
        from towtank.outputs import write_text

        write_text(path, html)


def origin_of(logs: Sequence[Path], commands: Sequence[str]) -> Origin:
    """Return where a report comes from: hashes of the logs, commands, versions, the time."""
    from towtank import __version__
    from towtank.report import Origin

    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    versions = {"towtank": __version__, "Python": platform.python_version()}
    versions |= {name: version(name) for name in _LIBRARIES}
    return Origin(made, tuple(_log_file(log) for log in logs), tuple(commands), versions)


def _log_file(log: Path) -> LogFile:
    """Return name, size and hash of a log; of a folder those of its files, one after the other by name."""
    from towtank.report import LogFile

    digest, size = hashlib.sha256(), 0
    for file in sorted(path for path in log.rglob("*") if path.is_file()) if log.is_dir() else [log]:
        with file.open("rb") as stream:
            while chunk := stream.read(_CHUNK):
                digest.update(chunk)
                size += len(chunk)
    return LogFile(log.name, size, digest.hexdigest())


def write_learn_report(path: Path, facts: LearnFacts, logs: Sequence[Path], commands: Sequence[str]) -> None:
    """Write the report of a learning. Raises InputError where it cannot be written."""
    write_report(path, report_html(facts.of(origin_of(logs, commands))))


def learn_facts(
    learning: LogLearning,
    model: Vehicle,
    scores: Validation | None,
    recordings: Sequence[Recording],
    *,
    use: Usability | None = None,
    warnings: Sequence[str] = (),
    prior: str | None = None,
    left_out: Sequence[str] = (),
) -> LearnFacts:
    """Return what a report of a learning is made of.

    Args:
        scores, use: of the model's prediction of the logs, None where it could not be made.
        recordings: as they were learned from. prior: what was known beforehand, as it was named.
        left_out: what of the logs does not count, a line each.
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
        delay_given=learning.delay_given,
        lag=learning.lag,
        lag_std=learning.lag_std,
        together=learning.together,
        gains=learning.gains,
        prior=prior,
        supposed=supposed_values(learning),
        latency=learning.latency,
        fit={} if scores is None else scores.fit,
        rmse={} if scores is None else scores.rmse,
        predictions=predictions,
        residuals=residuals(predictions),
        recordings=recordings,
        left_out=left_out,
        noise=noise_document(learning.levels, learning.grids),
        disturbance=disturbance_document(learning.levels, learning.grids),
        convergence=convergence(learning, recordings),
        use=use,
        findings=learning.findings,
        driven=learning.driven,
        warnings=warnings,
    )


def plan_facts(made: Plan, vehicle: Vehicle, force: float | None = None) -> PlanFacts:
    """Return what a report of a plan is made of: it is forecast again, for the middle vehicle and for some others.

    Args:
        force: random force in the water [N], as it was planned with.
    """
    outlook = Outlook.of(vehicle, made.sensors, force=force)
    middle = draws_of(outlook, 1)[0]
    driven = [each.segment for each in made.segments]
    rest = made.commands(vehicle)[:2]
    before = replace(forecast(outlook, middle, rest), covariance=outlook.known.covariance)
    steps = forecasts(outlook, middle, driven, made.space)
    return PlanFacts(vehicle, made, before, steps, unsteered(outlook, driven, made.space, vehicles=_DRAWN, forces=1))


def write_plan_report(path: Path, facts: PlanFacts, commands: Sequence[str]) -> None:
    """Write the report of a plan. Raises InputError where it cannot be written."""
    write_report(path, plan_html(replace(facts, origin=origin_of((), commands))))
