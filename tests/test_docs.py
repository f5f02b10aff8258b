"""The documentation is true: every Python sample in it runs, those in docstrings too."""

from __future__ import annotations

import doctest
import importlib
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PAGES = sorted([*REPOSITORY.glob("*.md"), *REPOSITORY.glob("docs/**/*.md")])
SAMPLE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def samples(page: Path) -> str:
    """Return the Python samples of `page` as one script, each on the line where the page has it."""
    text = page.read_text(encoding="utf-8")
    script = ""
    for sample in SAMPLE.finditer(text):
        first_line = text.count("\n", 0, sample.start(1))
        script += "\n" * (first_line - script.count("\n")) + sample[1]
    return script


WITH_SAMPLES = [page for page in PAGES if samples(page)]


@pytest.mark.parametrize("page", WITH_SAMPLES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_samples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The samples of one page run in order, in one namespace, in an empty folder."""
    assert WITH_SAMPLES
    monkeypatch.chdir(tmp_path)
    exec(compile(samples(page), str(page), "exec"), {"__name__": "__main__"})


def with_examples() -> list[str]:
    """Return the modules of the package that hold an example in a docstring."""
    source = REPOSITORY / "src"
    files = [path for path in sorted(source.rglob("*.py")) if ">>> " in path.read_text(encoding="utf-8")]
    return [".".join(path.relative_to(source).with_suffix("").parts) for path in files]


@pytest.mark.parametrize("module", with_examples())
def test_examples_in_docstrings_print_what_they_say(module: str) -> None:
    result = doctest.testmod(importlib.import_module(module))
    assert result.attempted > 0
    assert result.failed == 0
