"""Which tests run a line of the source, and how long each takes.

The tests are run once with coverage, one context a test. Loaded into pytest (`-p covering_tests`) the module itself
writes the outcome and the seconds of each test to the file that `TEST_OUTCOMES` names.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import json
import os
import pkgutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from coverage import CoverageData

__all__ = ["OUTCOMES", "PYTEST", "CoveringTests", "collect"]

OUTCOMES, _MEASURED = "TEST_OUTCOMES", "TEST_MEASURED"
PYTEST = ("-m", "pytest", "-q", "--import-mode=importlib", "--hypothesis-seed=1", "--benchmark-disable")
PYTEST += ("-p", "no:cacheprovider", "-p", "covering_tests")


class _Recorder:
    """A plugin of pytest: what came of each test."""

    def __init__(self, target: Path) -> None:
        self._target = target
        self._seconds: dict[str, float] = defaultdict(float)
        self._failed: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._seconds[report.nodeid] += report.duration
        if report.failed:
            self._failed.append(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        self._target.write_text(json.dumps({"seconds": self._seconds, "failed": self._failed}))


def pytest_configure(config: pytest.Config) -> None:
    if OUTCOMES in os.environ:
        config.pluginmanager.register(_Recorder(Path(os.environ[OUTCOMES])))


def pytest_collection_finish() -> None:
    """Import what is measured before any test does: what runs with an import is no test's, whichever is the first."""
    for package in os.environ.get(_MEASURED, "").split():
        found = importlib.import_module(f"towtank.{package}")
        for module in pkgutil.walk_packages(found.__path__, f"{found.__name__}."):
            with contextlib.suppress(ImportError):  # of an extra
                importlib.import_module(module.name)


@dataclass(frozen=True)
class CoveringTests:
    """Tests by the lines that they run.

    Attributes:
        lines: file -> line -> names of tests. seconds: by the name of a test. failed: tests that fail without a mutant;
            they are among no lines.
    """

    lines: Mapping[str, Mapping[int, frozenset[str]]]
    seconds: Mapping[str, float]
    failed: frozenset[str]

    def of(self, file: str, source: str, line: int) -> list[str]:
        """Return the tests that run the statement at a line, quick ones first.

        What runs as a module is imported belongs to no test: tests of the function stand for its defaults and
        decorators, those of the class for its fields, those of the whole file for its tables, and for functions that
        make them.
        """
        covered = self.lines.get(file, {})
        scopes = _scopes(source, line)
        if any(at in covered for first, last in scopes for at in range(first, last + 1)):
            scopes.append((1, len(source.splitlines())))
        for first, last in scopes:
            found = {name for at in range(first, last + 1) for name in covered.get(at, ())}
            if found:
                return sorted(found, key=lambda name: (self.seconds.get(name, 0.0), name))
        return []

    def __add__(self, other: CoveringTests) -> CoveringTests:
        lines = {
            file: {
                at: self.lines.get(file, {}).get(at, frozenset()) | other.lines.get(file, {}).get(at, frozenset())
                for at in self.lines.get(file, {}).keys() | other.lines.get(file, {}).keys()
            }
            for file in self.lines.keys() | other.lines.keys()
        }
        return CoveringTests(lines, {**self.seconds, **other.seconds}, self.failed | other.failed)


def collect(root: Path, tests: Iterable[str], packages: Sequence[str], environment: Mapping[str, str]) -> CoveringTests:
    """Run tests of a tree with coverage and return which of them run which lines.

    Raises:
        RuntimeError: pytest did not get through.
    """
    outcomes, data = root / "outcomes.json", root / ".coverage"
    for each in (outcomes, data):
        each.unlink(missing_ok=True)
    covered = [f"--cov=towtank.{each}" for each in packages]
    words = [sys.executable, *PYTEST, *covered, "--cov-context=test", "--cov-report=", *tests]
    variables = {**environment, OUTCOMES: str(outcomes), _MEASURED: " ".join(packages), "COVERAGE_FILE": str(data)}
    ran = subprocess.run(words, cwd=root, env=variables, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if ran.returncode not in (0, 1) or not outcomes.is_file():
        raise RuntimeError(f"pytest ended with {ran.returncode} before there was a mutant:\n{ran.stdout[-2000:]}")
    read = json.loads(outcomes.read_text())
    failed = frozenset(read["failed"])
    found = CoverageData(basename=str(data))
    found.read()
    lines = {  # of no test where it is run with the import alone
        Path(file).resolve().relative_to(root.resolve()).as_posix(): {
            at: frozenset(each.rpartition("|")[0] for each in contexts if each) - failed
            for at, contexts in found.contexts_by_lineno(file).items()
        }
        for file in found.measured_files()
    }
    return CoveringTests(lines, read["seconds"], failed)


def _scopes(source: str, line: int) -> list[tuple[int, int]]:
    """Return ranges of lines whose tests may notice a change at a line, the narrowest first."""
    around = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.stmt) and _first(node) <= line <= (node.end_lineno or node.lineno)
    ]
    around.sort(key=lambda node: (node.end_lineno or node.lineno) - _first(node))
    statement = around[0] if around else None
    if statement is None:
        return []
    definitions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    inside_a_function = any(isinstance(each, definitions[:2]) for each in around if each is not statement)
    if inside_a_function or isinstance(statement, definitions[:2]):
        if isinstance(statement, definitions):  # its header, which is run with the import: whoever runs the body
            return [(statement.body[0].lineno, statement.end_lineno or statement.lineno)]
        body = [each for name in ("body", "handlers") for each in _children(statement, name)]
        last = _first(body[0]) - 1 if body else statement.end_lineno or statement.lineno
        return [(_first(statement), max(last, line))]
    classes = [(_first(each), each.end_lineno or each.lineno) for each in around if isinstance(each, ast.ClassDef)]
    return [*classes, (1, len(source.splitlines()))]


def _first(node: ast.stmt | ast.excepthandler) -> int:
    """The line where a statement begins, with its decorators."""
    return min([node.lineno, *(each.lineno for each in _children(node, "decorator_list"))])


def _children(node: ast.AST, name: str) -> list[ast.stmt]:
    return list(dict(ast.iter_fields(node)).get(name, ()))
