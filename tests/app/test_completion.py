"""What the Tab key offers, and how a shell is told of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from towtank.app.cli import app

from .commands import process


def asked(words: str) -> dict[str, str]:
    """Return the environment in which bash asks for what comes behind some words."""
    count = len(words.split()) - (0 if words.endswith(" ") else 1)
    return {"COMP_WORDS": words, "COMP_CWORD": str(count), "_TOWTANK_COMPLETE": "complete_bash"}


def offered(words: str) -> list[str]:
    """Return what the Tab key offers behind some words, here and now."""
    ran = CliRunner().invoke(app, [], env=asked(words), prog_name="towtank")
    assert ran.stderr == ""
    return ran.stdout.split()


def test_a_shell_asks_by_starting_the_program(tmp_path: Path) -> None:
    ran = process(cwd=tmp_path, **asked("towtank learn --vehicle sea"))
    assert (ran.out.split(), ran.err) == (["seamor"], "")


def test_the_tab_key_offers_commands_options_vehicles_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text("")
    assert offered("towtank le") == ["learn"]
    assert offered("towtank vehicle co") == ["copy"]
    assert offered("towtank learn --veh") == ["--vehicle"]
    assert {"seamor"} == set(offered("towtank learn --vehicle sea"))
    assert "mine.toml" in offered("towtank validate m")
    assert offered("towtank learn x --method out") == ["output-error"]
    assert offered("towtank simulate seamor surge-sine --sensors ins") == ["ins", "ins-water"]
    assert "surge-sine" in offered("towtank simulate seamor surge-s")
    assert offered("towtank inspect d") == []  # the shell itself offers files


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_shown_for_every_shell(shell: str, tmp_path: Path) -> None:
    ran = process("--show-completion", shell, cwd=tmp_path, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert ran.code == 0
    assert f"complete_{shell}" in ran.out
    assert "_TOWTANK_COMPLETE" in ran.out
