"""The study of mutants: what is drawn, what is not, and that mutants are told apart."""

from __future__ import annotations

import ast
import json
import shutil
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

pytest.importorskip("cosmic_ray", reason="mutants are made by cosmic-ray")
pytest.importorskip("pytest_cov", reason="the tests that run a line are found with pytest-cov")

import covering_tests
import mutants
import mutation_score

SOURCE = '''"""Adds 1 + 1."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["a" + "b"]

Said = Callable[[str], None] | None
LIMIT = 3


@kernel
def compiled(x: float) -> float:
    return x + 1.0


def over(x: int | None, limit: int | float = 4) -> int | None:
    """Return x - 1 if x < limit."""
    note: str | None = "λ"
    if x is None or not note:
        return None
    return x - 1 if x < limit else None
'''


def drawn(number: int = 100, seed: int = 1) -> list[mutants.Mutant]:
    class Folder:
        """A tree of one file."""

        def __truediv__(self, file: str) -> Folder:
            return self

        def read_text(self, encoding: str) -> str:
            return SOURCE

    return mutants.draw(Folder(), ["over.py"], number, seed)


def test_what_changes_nothing_is_not_drawn():
    lines = {place.begin[0] for place in mutants.places("over.py", SOURCE)}
    first = SOURCE.splitlines().index("def over(x: int | None, limit: int | float = 4) -> int | None:") + 1
    assert lines == {10, first, first + 3, first + 5}
    (default,) = [place for place in mutants.places("over.py", SOURCE) if place.begin[0] == first]
    assert default.kind == "number by one"


def test_every_place_is_drawn_once_and_every_mutant_is_python_that_differs():
    found = drawn()
    assert [each.place for each in sorted(found, key=lambda each: (each.place.begin, each.place.kind))] == (
        mutants.places("over.py", SOURCE)
    )
    for each in found:
        assert ast.dump(ast.parse(each.source)) != ast.dump(ast.parse(SOURCE))
        changed = [(a, b) for a, b in zip(SOURCE.splitlines(), each.source.splitlines(), strict=True) if a != b]
        assert [(a.strip(), b.strip()) for a, b in changed] == [(each.before, each.after)]


def test_marks_of_a_signature_and_checks_of_equal_lengths_are_not_drawn():
    source = "def pairs(a, /, b, *, c=3):\n    return [x * c for x in zip(a, b, strict=True)]\n"
    assert [(place.begin, place.kind) for place in mutants.places("a.py", source)] == [
        ((1, 24), "number by one"),
        ((2, 14), "arithmetic"),
    ]


def test_a_decorator_left_out_leaves_its_line_out():
    source = "class A:\n    @property\n    def size(self) -> int:\n        return self.n\n"
    (place,) = mutants.places("a.py", source)
    assert (place.kind, place.begin) == ("decorator removed", (2, 4))


def test_a_seed_draws_the_same_again_and_another_seed_does_not():
    assert drawn(4) == drawn(4)
    assert drawn(4) != drawn(4, seed=2)
    assert drawn(4) == drawn()[:4]


def test_tests_of_a_line_are_those_that_run_its_statement_and_quick_ones_come_first():
    lines = SOURCE.splitlines()
    condition = lines.index("    if x is None or not note:") + 1
    covered = {condition: frozenset({"slow", "quick"}), condition + 1: frozenset({"none"})}
    tests = covering_tests.CoveringTests({"over.py": covered}, {"slow": 2.0, "quick": 0.1, "none": 1.0}, frozenset())
    assert tests.of("over.py", SOURCE, condition) == ["quick", "slow"]
    assert tests.of("over.py", SOURCE, condition + 1) == ["none"]
    assert tests.of("over.py", SOURCE, condition + 2) == []
    default, table = lines.index("def over(x: int | None, limit: int | float = 4) -> int | None:") + 1, 10
    assert tests.of("over.py", SOURCE, default) == ["quick", "none", "slow"]
    assert tests.of("over.py", SOURCE, table) == ["quick", "none", "slow"]
    assert tests.of("other.py", SOURCE, condition) == []


def small_tree(root: Path) -> Path:
    """A tree with one module of two functions, of which tests know one well and the other hardly."""
    studies = Path(mutation_score.__file__).parent
    for name in ("src/towtank/readers", "tests/readers", "tests/recording", "tests/live", "examples", "benchmarks"):
        (root / name).mkdir(parents=True)
    shutil.copytree(studies, root / "benchmarks" / "studies")
    for name in ("README.md", "CHANGELOG.md", "src/towtank/__init__.py", "src/towtank/readers/__init__.py"):
        (root / name).write_text("")
    (root / "pyproject.toml").write_text("[tool.pytest.ini_options]\n")
    (root / "src/towtank/readers/speed.py").write_text(
        "def known(x):\n    return 2 * x\n\n\ndef unknown(x):\n    return 3 * x\n"
    )
    (root / "tests/readers/test_speed.py").write_text(
        "from towtank.readers.speed import known\n\n\ndef test_known():\n"
        "    assert [known(x) for x in (0, 1, 3)] == [0, 2, 6]\n"
    )
    (root / "tests/live/test_nothing.py").write_text("def test_nothing():\n    pass\n")
    return root


def test_the_study_tells_what_tests_notice_and_leaves_the_tree_as_it_is(tmp_path, monkeypatch, capsys):
    root = small_tree(tmp_path / "tree")
    before = {path: path.read_bytes() for path in root.rglob("*.py")}
    monkeypatch.setattr(mutation_score, "ROOT", root)
    monkeypatch.setattr(mutation_score, "_GROUPS", (("tests/readers",), ("tests/live",)))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    words = ["--mutants", "20", "--packages", "readers", "--workers", "1"]
    code = mutation_score.main([*words, "--output", str(tmp_path / "found.json")])
    found = json.loads((tmp_path / "found.json").read_text())
    outcomes = {(each["line"], each["outcome"]) for each in found["verdicts"]}
    assert (6, "no test") in outcomes
    assert {outcome for line, outcome in outcomes if line == 6} == {"no test"}
    assert (2, "killed") in outcomes
    killed = sum(each["outcome"] in ("killed", "hung") for each in found["verdicts"])
    assert found["killed"] == pytest.approx(killed / found["mutants"], abs=1e-5)
    assert code == (0 if killed >= 0.8 * found["mutants"] else 1) == 1
    assert {path: path.read_bytes() for path in root.rglob("*.py")} == before
    assert not list(tmp_path.glob("mutants-*"))
    assert "What survived" in capsys.readouterr().out
