"""`make demo` and `make test` make every part once and say what fails; stand-ins for all tools write calls down."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
NPM = """#!/bin/bash
echo "npm $1" >> "$CALLS"
if [ "$1" = run ]; then {build}; fi
"""
PYTHON = """#!/bin/bash
echo "compile ${@: -1}" >> "$CALLS"
[ "${@: -1}" != "$FAILING" ] || { echo "ValueError: no such kernel" >&2; exit 1; }
"""
TOWTANK = """#!/bin/bash
echo "towtank $1" >> "$CALLS"
"""
CHECK = """#!/bin/bash
echo "${0##*/}" >> "$CALLS"
[ "${0##*/}" != "$FAILING" ] || { echo "${0##*/} has found something"; exit 1; }
"""
LOCKS = ("requirements-run.lock", "requirements.lock")
CHECKS = ("ruff", "mypy", "lint-imports", "sphinx-build")
PARTS = ["compile filter", "compile rest", "npm ci", "npm run"]
PYTEST, PLAIN = "compile worksteal", "compile tests/identification/test_output_error_kernel.py"  # their last words
BUILT = "mkdir -p ../src/towtank/dashboard/static; touch ../src/towtank/dashboard/static/index.html"


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with the Makefile, an environment that is ready, and nothing built."""
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    shutil.copy(REPOSITORY / "Makefile", tmp_path)
    for name in ("pyproject.toml", *LOCKS, "src/towtank/a.py", "web/package.json"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    executable(tmp_path / "bin/npm", NPM.replace("{build}", BUILT))
    executable(tmp_path / ".venv/bin/python", PYTHON)
    executable(tmp_path / ".venv/bin/towtank", TOWTANK)
    executable(tmp_path / "bin/chromium", CHECK)
    for name in CHECKS:
        executable(tmp_path / ".venv/bin" / name, CHECK)
    for name in (".runs", ".ready"):
        (tmp_path / ".venv" / name).touch()
    return tmp_path


def executable(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


def make(clone: Path, *words: str, failing: str = "") -> tuple[int, str, list[str]]:
    """Run `make WORDS` and return its exit code, what it printed, and which parts were called."""
    calls = clone / "calls"
    calls.unlink(missing_ok=True)
    known = {"PATH": f"{clone / 'bin'}:/usr/bin:/bin", "CALLS": str(calls), "FAILING": failing}
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")} | known
    done = subprocess.run(
        ["make", *words], cwd=clone, env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    return done.returncode, done.stdout, calls.read_text().splitlines()


def make_demo(clone: Path, *options: str, failing: str = "") -> tuple[str, list[str]]:
    """Run `make demo` and return what it printed, and which parts were called."""
    code, out, calls = make(clone, *options, "demo", failing=failing)
    assert code == 0, out
    return out, calls


@pytest.mark.parametrize("options", [(), ("-j",)], ids=["one after the other", "jobs beside each other"])
def test_every_part_is_made_once(clone: Path, options: tuple[str, ...]) -> None:
    out, calls = make_demo(clone, *options)
    assert sorted(calls[:-1]) == PARTS
    assert calls[-1] == "towtank demo"
    assert out.count("the live page (npm)") == out.count("kernels, compiled") == 1
    assert out.count("ok ") == 2
    assert make_demo(clone, *options)[1] == ["towtank demo"]  # nothing has changed since


def test_a_demo_installs_what_runs_and_no_more(clone: Path) -> None:
    for name in (".runs", ".ready"):
        (clone / ".venv" / name).unlink()
    _, calls = make_demo(clone, "PYTHON=.venv/bin/python")
    assert calls[1:5] == ["compile .venv", "compile requirements-run.lock", "compile .", "compile src"]
    assert sorted(calls[5:]) == sorted([*PARTS, "towtank demo"])
    assert "compile requirements-run.lock" not in make_demo(clone)[1]


@pytest.mark.parametrize("options", [(), ("-j",)], ids=["one after the other", "jobs beside each other"])
def test_kernels_are_compiled_while_the_checks_are_installed(clone: Path, options: tuple[str, ...]) -> None:
    (clone / ".venv/.ready").unlink()
    code, out, calls = make(clone, *options, "test")
    assert code == 0, out
    installed = ["compile requirements.lock", "compile src"]
    assert sorted(calls[: calls.index("ruff")]) == sorted(["compile filter", "compile rest", *installed])
    assert out.count("kernels, compiled meanwhile") == 1
    assert {PYTEST, PLAIN, "compile free-runs", "compile others", "npm ci"} <= set(calls)
    assert "compile requirements.lock" not in make(clone, *options, "test")[2]


def test_libraries_that_cannot_be_installed_are_told(clone: Path) -> None:
    (clone / ".venv/.ready").unlink()
    code, out, calls = make(clone, "test", failing="requirements.lock")
    assert code != 0
    assert "FAILED after" in out
    assert "ruff" not in calls
    assert "compile requirements.lock" in make(clone, "test")[2]


def test_what_runs_is_of_what_checks() -> None:
    run, whole = ((REPOSITORY / name).read_text().splitlines() for name in LOCKS)
    pinned = [line for line in run if "==" in line]
    assert len(pinned) > 40
    assert set(pinned) <= set(whole)


@pytest.mark.parametrize("options", [(), ("-j",)], ids=["one after the other", "jobs beside each other"])
def test_a_page_that_cannot_be_built_is_tried_once(clone: Path, options: tuple[str, ...]) -> None:
    executable(clone / "bin/npm", NPM.replace("{build}", "exit 1"))
    out, calls = make_demo(clone, *options)
    assert calls.count("npm ci") == out.count("there is no live page") == 1
    assert calls[-1] == "towtank demo"


def test_kernels_that_cannot_be_compiled_are_told_and_tried_again(clone: Path) -> None:
    out, calls = make_demo(clone, failing="rest")
    [line] = [each for each in out.splitlines() if "kernels, compiled" in each]
    assert "FAILED after" in line
    assert "ok" not in line
    assert "ValueError: no such kernel" in out
    assert calls[-1] == "towtank demo"
    assert "compile rest" in make_demo(clone)[1]


@pytest.mark.parametrize("options", [(), ("-j",)], ids=["one after the other", "jobs beside each other"])
def test_every_check_runs_once_after_every_part(clone: Path, options: tuple[str, ...]) -> None:
    code, out, calls = make(clone, *options, "test")
    assert code == 0, out
    assert calls[0] == "ruff"
    assert sorted(calls[1:5]) == PARTS
    assert sorted(calls[5:]) == sorted(["compile free-runs", "compile others", PYTEST, PLAIN, *CHECKS[1:]])
    assert {*calls[5:7]} == {"compile free-runs", "compile others"}
    assert out.count("ok ") == 6


@pytest.mark.parametrize("failing", ["mypy", "lint-imports", "sphinx-build", PYTEST, PLAIN])
def test_a_check_that_fails_fails_all_and_stops_no_other(clone: Path, failing: str) -> None:
    code, out, calls = make(clone, "test", failing=failing.removeprefix("compile "))
    assert code != 0
    assert {PYTEST, PLAIN, "mypy", "lint-imports", "sphinx-build"} <= set(calls)
    assert out.count("FAILED") == (failing in CHECKS)
    assert (f"{failing} has found something" in out) == (failing in CHECKS)


def test_where_the_style_is_wrong_nothing_else_begins(clone: Path) -> None:
    code, out, calls = make(clone, "test", failing="ruff")
    assert code != 0
    assert "ruff has found something" in out
    assert calls == ["ruff"]


def test_a_page_that_cannot_be_built_is_tried_once_for_all_checks(clone: Path) -> None:
    executable(clone / "bin/npm", NPM.replace("{build}", "exit 1"))
    code, out, calls = make(clone, "test")
    assert code == 0
    assert calls.count("npm ci") == out.count("there is no live page") == 1
    assert {PYTEST, "sphinx-build"} <= set(calls)
