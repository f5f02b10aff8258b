"""`--report FILE`: where it may go, what it is made of, how it is written."""

from __future__ import annotations

import hashlib
import platform
import shlex
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from towtank.app.arguments import output_place
from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.report import LogFile, Origin

__all__ = ["command_text", "origin_of", "report_place", "write_report"]

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
