"""What the Tab key offers, and how a shell is told of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from .commands import process


def offered(words: str, cwd: Path) -> list[str]:
    """Return what the Tab key offers behind some words, as bash asks for it."""
    count = len(words.split()) - (0 if words.endswith(" ") else 1)
    ran = process(cwd=cwd, COMP_WORDS=words, COMP_CWORD=str(count), _TOWTANK_COMPLETE="complete_bash")
    assert ran.err == ""
    return ran.out.split()


def test_the_tab_key_offers_commands_options_vehicles_and_files(tmp_path: Path) -> None:
    folder = tmp_path
    (folder / "mine.toml").write_text("")
    assert offered("towtank le", folder) == ["learn"]
    assert offered("towtank vehicle co", folder) == ["copy"]
    assert offered("towtank learn --veh", folder) == ["--vehicle"]
    assert {"seamor"} == set(offered("towtank learn --vehicle sea", folder))
    assert "mine.toml" in offered("towtank validate m", folder)
    assert offered("towtank learn x --method out", folder) == ["output-error"]
    assert offered("towtank simulate seamor surge-sine --sensors ins", folder) == ["ins", "ins-water"]
    assert "surge-sine" in offered("towtank simulate seamor surge-s", folder)
    assert offered("towtank inspect d", folder) == []  # the shell itself offers files


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_shown_for_every_shell(shell: str, tmp_path: Path) -> None:
    ran = process("--show-completion", shell, cwd=tmp_path, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert ran.code == 0
    assert f"complete_{shell}" in ran.out
    assert "_TOWTANK_COMPLETE" in ran.out
