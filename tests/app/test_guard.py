"""Exit codes and one-line errors."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from towtank.app.terminal.guard import FAULT, INTERRUPTED, WRONG_INPUT, guarded
from towtank.errors import InputError

from .commands import command, process, refused


def raising(error: BaseException) -> Callable[[], None]:
    def run() -> None:
        raise error

    return run


@pytest.mark.parametrize(
    "error, code, line",
    [
        (InputError("a.csv:3:2: found 'x'"), WRONG_INPUT, "towtank: a.csv:3:2: found 'x'"),
        (ZeroDivisionError("float\ndivision"), FAULT, "towtank: ZeroDivisionError: float division"),
        (MemoryError(), FAULT, "towtank: out of memory"),
        (KeyboardInterrupt(), INTERRUPTED, ""),
        (BrokenPipeError(), FAULT, ""),
    ],
)
def test_every_error_is_one_line(
    error: BaseException, code: int, line: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("towtank.app.terminal.guard.drop_output", lambda: None)
    assert guarded(raising(error)) == code
    err = capsys.readouterr().err
    assert err.startswith(line)
    assert err.count("\n") == (1 if line else 0)
    assert "Traceback" not in err


def test_traceback_on_request(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOWTANK_TRACEBACK", "1")
    assert guarded(raising(ZeroDivisionError("no"))) == FAULT
    assert "Traceback" in capsys.readouterr().err


def test_a_fault_says_how_to_see_more(capsys: pytest.CaptureFixture[str]) -> None:
    guarded(raising(ZeroDivisionError("no")))
    assert "TOWTANK_TRACEBACK=1" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, expected",
    [
        (["vehicl"], 'no such command vehicl; did you mean "vehicle"?'),
        (["vehicle"], "missing command; there are list, show, copy, prior, check, fit-thruster"),
        (["vehicle", "chek", "a.toml"], 'did you mean "check"?'),
        (["simulate", "--sensor", "mocap"], 'no such option --sensor; did you mean "--sensors"?'),
        (["simulate", "seamor", "yaw-sine"], "missing option '--output' / '-o'"),
        (["simulate", "seamor", "yaw-sine", "-o", "a.csv", "--rate", "x"], "invalid value for '--rate'"),
        (["simulate", "seamor", "yaw-sine", "-o", "a.csv", "--seed", "1.5"], "expected a whole number"),
        (["learn", "a.csv"], "missing option '--vehicle'"),
        (["learn", "--vehicle", "seamor"], "missing argument 'LOG"),
        (["validate", "a.toml"], "missing argument 'LOG"),
        (["vehicle", "show", "seamor", "rexrov"], "unexpected extra argument"),
    ],
)
def test_wrong_arguments(words: list[str], expected: str) -> None:
    line = refused(*words)
    assert expected in line
    assert "--help)" in line


def test_without_arguments_help_is_shown() -> None:
    ran = command()
    assert ran.code == 0
    assert ran.out == command("--help").out


def test_version() -> None:
    import towtank

    assert command("--version").out == f"towtank {towtank.__version__}\n"


def test_a_process_of_its_own(tmp_path: Path) -> None:
    ran = process("vehicle", "show", "nothing.toml", cwd=tmp_path)
    assert (ran.code, ran.out) == (2, "")
    assert ran.err == "towtank: nothing.toml: no such file; give a vehicle file (.toml) or a name of the catalog\n"


def test_output_that_nobody_reads(tmp_path: Path) -> None:
    towtank = f"{sys.executable} -m towtank"
    for words in ("vehicle show rexrov", "vehicle show rexrov --json", "--help"):
        run = subprocess.run(
            ["bash", "-c", f"{towtank} {words} | true"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert run.stderr == ""


def test_piped_output_has_no_control_codes_and_fits_80_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    every = [command("vehicle", "list"), command("manoeuvre", "list"), command("learn", "--help")]
    for ran in (*every, process("vehicle", "show", "rexrov", cwd=tmp_path)):
        assert ran.code == 0
        assert "\x1b" not in ran.out
        assert max(map(len, ran.out.splitlines())) <= 80


def test_a_terminal_that_knows_ascii_only(tmp_path: Path) -> None:
    ran = process("vehicle", "show", "seamor", cwd=tmp_path, PYTHONIOENCODING="ascii")
    assert ran.code == 0, ran
    assert ran.out.isascii()


def test_a_librarys_numeric_warning_is_not_the_users_to_read(capsys: pytest.CaptureFixture[str]) -> None:
    import warnings

    from towtank.vehicle import VehicleWarning

    def run() -> None:
        warnings.warn("overflow encountered in square", RuntimeWarning, stacklevel=1)
        warnings.warn("x.toml: drag feeds energy in", VehicleWarning, stacklevel=1)

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert guarded(run) == 0
    assert capsys.readouterr().err == "towtank: warning: x.toml: drag feeds energy in\n"
