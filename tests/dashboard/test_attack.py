"""The attack on page, report and terminal, cut short: strings that would be commands are shown, and do nothing."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from towtank.app.cli import app

from .rig import Rig, needs_browser, needs_page

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import attack_page


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    rig = attack_page.hostile_rig(tmp_path_factory.mktemp("hostile"))
    rig.start()
    yield rig
    rig.close()


def wrong(checks: Iterable[attack_page.Check], least: int) -> list[str]:
    """Return what was wrong, of at least so many checks."""
    found = list(checks)
    assert len(found) >= least
    return [f"{each.what}: {each.wrong}" for each in found if each.wrong]


@needs_browser
def test_hostile_strings_in_a_report_are_shown_and_do_nothing(browser: Any, tmp_path: Path) -> None:
    assert wrong(attack_page.report_checks(browser, tmp_path), 40) == []
    assert "&lt;script&gt;" in (tmp_path / "learned.html").read_text(encoding="utf-8")


@needs_page
@needs_browser
def test_hostile_strings_on_the_page_are_shown_and_do_nothing(browser: Any, hostile: Rig) -> None:
    assert wrong(attack_page.page_checks(browser, hostile), 18) == []


@needs_page
def test_a_name_bound_anew_and_a_foreign_page_get_nothing_and_the_token_stays_unsaid(hostile: Rig) -> None:
    assert wrong(attack_page.foreign_checks(hostile), 35) == []


@needs_page
def test_malformed_frames_and_requests_are_refused_and_nothing_else_happens(hostile: Rig) -> None:
    assert wrong(attack_page.fire_checks(hostile, 60, 60, np.random.default_rng(7)), 3) == []


def in_this_process(words: Sequence[str]) -> tuple[int, bytes]:
    """Run a command without a terminal; return its exit code and all that it says."""
    ran = CliRunner().invoke(app, words)
    return ran.exit_code, ran.stdout_bytes + ran.stderr_bytes


def test_no_command_hands_a_terminal_what_a_log_would_have_it_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a terminal each command has a process of its own; without one it runs here. The log is of 5 s."""
    made = attack_page.hostile_recording
    monkeypatch.setattr(attack_page, "hostile_recording", lambda *words: made(*words).window(0.0, 5.0))
    paths = attack_page.file_names(tmp_path)[-1:]
    assert wrong(attack_page.command_checks(tmp_path, paths, in_this_process), 17) == []


def test_the_look_for_raw_bytes_sees_them() -> None:
    assert attack_page.raw_in("\x1b[1mbold\x1b[0m\r\n", terminal=True) == ""
    assert attack_page.raw_in("\x1b[2Jgone \x1b]0;title\x07 \u202e", terminal=True)
    assert attack_page.raw_in("\x1b[1mbold\x1b[0m", terminal=False)
