"""The terminal: 80 columns, no control codes in a pipe, spark lines."""

from __future__ import annotations

import io
import re
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from towtank.app.tables.judging import show_residuals
from towtank.app.terminal import output
from towtank.app.terminal.output import Output
from towtank.app.terminal.spark import error_spark, spark

from .commands import Ran, command, process


def assert_fits(ran: Ran) -> None:
    assert ran.code == 0, ran
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", ran.out + ran.err), ran
    assert max(map(len, ran.out.splitlines())) <= 80, ran
    assert "…" not in ran.out


def test_every_command_fits_80_columns(workshop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert_fits(command("learn", workshop / "yaw.csv", "--vehicle", "vlbv300", "--method", "paper", "--delay", 0))
    assert_fits(command("validate", workshop / "learned.toml", workshop / "yaw.csv"))
    assert_fits(command("inspect", workshop / "yaw.csv"))


def test_a_pipe_of_an_old_terminal_gets_plain_ascii(workshop: Path) -> None:
    ran = process("validate", "learned.toml", "yaw.csv@0,8", cwd=workshop, COLUMNS="80", PYTHONIOENCODING="ascii")
    assert_fits(ran)
    assert ran.out.isascii()
    assert "Error over time" in ran.out


def test_the_table_of_errors_is_not_cut(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The widest numbers that it may hold, in 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    memory = SimpleNamespace(slow=0.0055, white=0.00017, noise_known=False, bias=-0.0061)
    command = SimpleNamespace(share=0.73, p=0.0, lag=0.0, correlation=(), band=())
    found = SimpleNamespace(
        time=2.63,
        time_std=0.62,
        memory=memory,
        command=command,
        one_step_test=SimpleNamespace(p=0.0),
        verdict=SimpleNamespace(text="yaw errors follow the command"),
    )
    show_residuals({"r": found}, Output())
    head, _, row = capsys.readouterr().out.splitlines()[2:5]
    assert head.split()[-2:] == ["One", "step"]
    assert row.split()[-1] == "coloured"
    assert row.split()[0] == "r"


def test_a_spark_line_rises_with_its_values() -> None:
    assert spark(np.arange(8.0), 8) == "▁▂▃▄▅▆▇█"
    assert spark(np.arange(8.0), 8, ascii_only=True) == "_.:-=+*#"
    assert spark([], 4) == "    "
    assert spark([np.nan, np.nan, 1.0, 2.0], 4) == "  ▁█"
    assert spark([3.0, 3.0], 2) == "▁▁"
    assert spark([1.0, 2.0], 4) == "▁▁██"


def test_errors_start_from_nothing() -> None:
    errors = np.array([-1.0, 1.0, 0.5, -0.5, np.inf, np.nan])
    assert error_spark(errors, 3) == "█▅ "


def test_a_bar_tells_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:

    written = io.StringIO()
    monkeypatch.setattr(written, "isatty", lambda: True)
    monkeypatch.setattr(output.sys, "stderr", written)
    monkeypatch.setattr(output, "_PATIENCE", -1.0)
    screen = Console(force_terminal=True, width=80, file=written)
    monkeypatch.setattr(output, "Console", lambda **settings: screen)
    with output.Output(json=True).progress("learning") as tell:
        for k in range(5):
            tell("learning", 0.2 * k)
    assert "left" in written.getvalue()
    assert "learning" in written.getvalue()


def test_a_bar_appears_in_the_midst_of_a_long_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is read in one step: whoever waits sees what for, though no share of it is told."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(output, "_PATIENCE", 0.05)
    monkeypatch.setattr(sys, "stderr", Terminal())
    with output.Output(json=True).progress("inspecting") as tell:
        tell("reading dive.bag", 0.0)
        end = time.monotonic() + 20.0
        while "reading dive.bag" not in sys.stderr.getvalue() and time.monotonic() < end:
            time.sleep(0.02)
        shown = sys.stderr.getvalue()
    assert "reading dive.bag" in shown
