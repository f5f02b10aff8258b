"""Running the command line from tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from towtank.app.cli import app

__all__ = ["Ran", "command", "document", "process", "refused"]


class Ran:
    """Exit code, standard output and standard error of a command."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    def __repr__(self) -> str:
        return f"exit code {self.code}\n--- stdout\n{self.out}\n--- stderr\n{self.err}"


def command(*words: object) -> Ran:
    """Run `towtank WORDS` in this process."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    return Ran(result.exit_code, result.stdout, result.stderr)


def process(*words: object, cwd: Path, **environment: str) -> Ran:
    """Run `towtank WORDS` in a process of its own."""
    run = subprocess.run(
        [sys.executable, "-m", "towtank", *map(str, words)],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return Ran(run.returncode, run.stdout, run.stderr)


def document(*words: object) -> dict[str, Any]:
    """Run a command with --json and return its document; nothing else may be on standard output."""
    ran = command(*words, "--json")
    assert ran.code == 0, ran
    found = json.loads(ran.out, parse_constant=_no_constant)
    assert isinstance(found, dict)
    return found


def refused(*words: object) -> str:
    """Run a command that must end with exit code 2, and return its one line on standard error."""
    ran = command(*words)
    assert ran.code == 2, ran
    lines = ran.err.splitlines()
    assert len(lines) == 1, ran
    assert lines[0].startswith("towtank"), ran
    assert "Traceback" not in ran.err
    return lines[0]


def _no_constant(name: str) -> float:
    raise AssertionError(f"{name} is not JSON")
