"""A page printed to PDF by a browser that is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO

from towtank.errors import InputError
from towtank.outputs import write_atomically

__all__ = ["find_browser", "print_pdf"]

_NAMES = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge", "microsoft-edge-stable",
    "chrome", "msedge",
)  # fmt: skip
_PLACES = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
    r"C:\Program Files\Microsoft\Edge\Application\msedge.exe",
)
_QUIET = (
    "--headless", "--disable-gpu", "--no-first-run", "--no-default-browser-check", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-quic", "--no-pdf-header-footer",
)  # fmt: skip
_LONGEST = 120.0  # s
_WHERE = "install Chromium, Chrome or Edge, or ask for .html and print it from any browser"


def find_browser() -> str | None:
    """Return the program of an installed Chromium, Chrome or Edge; None where there is none."""
    for name in _NAMES:
        found = shutil.which(name)
        if found:
            return found
    return next((place for place in _PLACES if Path(place).is_file()), None)


def print_pdf(html: str, path: Path) -> None:
    """Print a page to a PDF file, whole or not at all.

    Raises:
        InputError: no browser is installed, it fails or takes too long, or the place cannot be written.
    """
    browser = find_browser()
    if browser is None:
        raise InputError(f"--report {path}: no browser to print a PDF with was found; {_WHERE}")
    with tempfile.TemporaryDirectory(prefix="towtank-report-", ignore_cleanup_errors=True) as folder:
        page, printed = Path(folder) / "report.html", Path(folder) / "report.pdf"
        page.write_text(html, encoding="utf-8")
        command = [browser, *_QUIET, *_sandbox(), f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}"]
        why = _run([*command, page.as_uri()])
        if why or not printed.is_file() or not printed.stat().st_size:
            raise InputError(f"--report {path}: {browser} printed no PDF ({why or 'it said nothing'}); {_WHERE}")
        data = printed.read_bytes()
    write_atomically(path, lambda stream: _put(stream, data))


def _put(stream: BinaryIO, data: bytes) -> None:
    stream.write(data)


def _sandbox() -> tuple[str, ...]:
    """Return what a browser that is run by root, as in a container, must be told."""
    root = sys.platform != "win32" and os.geteuid() == 0
    return ("--no-sandbox",) if root else ()


def _run(command: list[str]) -> str:
    """Run the browser; return why it failed, in a few words, or an empty text."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return f"no answer in {_LONGEST:g} s"
    except OSError as error:
        return error.strerror or "it could not be started"
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        return lines[-1][:200] if lines else f"exit code {done.returncode}"
    return ""
