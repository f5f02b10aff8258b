"""What `towtank learn` found, put together for its report.

`--report FILE`: where it may go, what it is made of, how it is written.
"""

from __future__ import annotations

import hashlib
import platform
import shlex
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from towtank.app.commands.arguments import output_place
from towtank.app.tables.learning import delay_deviation, disturbance_document, noise_document
from towtank.errors import InputError
from towtank.identification import LogLearning
from towtank.identification.offline.convergence import convergence
from towtank.recording import Recording
from towtank.report import LearnFacts
from towtank.report.learn_page import report_html
from towtank.validation import Validation, residuals
from towtank.vehicle import Vehicle

if TYPE_CHECKING:
    from towtank.report import LogFile, Origin

__all__ = ["command_text", "learn_facts", "origin_of", "report_place", "write_learn_report", "write_report"]

_LIBRARIES = ("numpy", "scipy", "numba")
_CHUNK = 1 << 20


def report_place(path: Path | None) -> Path | None:
    """Return the place of a report. Raises InputError, before any work is done, if none can be written there."""
    if output_place("--report", path, (".html", ".pdf")) is not None and path is not None and _pdf(path):
        from towtank.report.browser import find_browser

        if find_browser() is None:
            raise InputError(
                f"--report {path}: no browser to print a PDF with was found; install Chromium, Chrome or Edge, or ask "
                "for .html and print it from any browser"
            )
    return path


def _pdf(path: Path) -> bool:
    return path.suffix.lower() == ".pdf"


def write_report(path: Path, html: str) -> None:
    """Write a page as HTML or PDF, by the suffix, whole or not at all. Raises InputError."""
    if _pdf(path):
        from towtank.report.browser import print_pdf

        print_pdf(html, path)
    else:
        from towtank.outputs import write_text

        write_text(path, html)


def command_text(command: str, words: Sequence[object], options: Mapping[str, Any]) -> str:
    """Return a command as it is typed; options that are None or False are left out.

    >>> command_text("learn", ["a b.csv"], {"--vehicle": "seamor", "--delay": None, "--current": True})
    "towtank learn 'a b.csv' --vehicle seamor --current"
    """
    parts = ["towtank", command, *map(str, words)]
    for name, value in options.items():
        if value is True:
            parts.append(name)
        elif value is not None and value is not False:
            for each in value if isinstance(value, list | tuple) else [value]:
                parts += [name, str(each)]
    return shlex.join(parts)


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
