"""Short forms of the attacks on links and recordings."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from towtank.app.cli import app

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import attack_disk
import attack_kills
import attack_links
import link_tapes

LITTLE = ("--free", attack_disk.FREE, "--no-changes")  # is learned: these sessions are about files


@pytest.fixture(scope="module", autouse=True)
def short_tapes() -> Iterator[None]:
    """Tapes of links are of 20 s."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(attack_links, "SECONDS", 20.0)
        patch.setattr(attack_links.usual, "__defaults__", (20.0,))
        yield


@pytest.fixture
def short_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases of recordings take 2 s before and after their blow, at 50 Hz; a session that is refused runs here."""
    for study in (attack_disk, attack_kills):
        monkeypatch.setattr(study, "RATE", 50.0)
    monkeypatch.setattr(attack_disk, "_TOLD", 2.0)
    monkeypatch.setattr(attack_disk, "_refused", refused)


def refused(target: Path, *options: str) -> attack_disk.Blow:
    """Return what comes of a session that is to be refused in one line."""
    words = ["live", f"json:127.0.0.1:{attack_disk.free_port()}", "--vehicle", attack_disk.VEHICLE]
    ran = CliRunner().invoke(app, [*words, "--record", str(target), "--json-lines", *LITTLE, *options])
    lines = [line for line in ran.stderr.splitlines() if line.startswith("towtank: ") and str(target) in line]
    return attack_disk.Blow(ran.exit_code, 2, wrong=[] if len(lines) == 1 else [f"{len(lines)} lines"])


@pytest.mark.parametrize("kind", attack_links.LINKS)
def test_what_is_rejected_does_not_change_the_estimate(kind: str) -> None:
    row = attack_links.hostile(kind, 2000, seed=1)
    assert row.good, row


@pytest.mark.parametrize(
    ("name", "kind", "rate"),
    [
        ("starts anew", "MAVLink", 50.0),
        ("stalls for a minute", "JSON", 25.0),
        ("clock set by +3 h", "DDS", 50.0),
        ("another vehicle, same number", "MAVLink", 50.0),
    ],
)
def test_the_estimate_does_not_jump(name: str, kind: str, rate: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_tapes, "RATE", rate)
    row = attack_links.case(name, kind, seed=1)
    assert row.good, row


def test_a_flood_is_counted_and_does_not_fill_the_disk() -> None:
    row = attack_links.flood(2.0, seed=2)
    assert row.good, row


def test_this_computers_clock_may_be_set() -> None:
    row = attack_links.computer_clock(seed=2)
    assert row.good, row


@pytest.mark.parametrize("name", ["full", "fills", "emptied", "two-sessions", "SIGHUP", "SIGPIPE"])
@pytest.mark.usefixtures("short_cases")
def test_a_recording_outlives(name: str) -> None:
    blow = attack_disk.run_case(name, attack_disk.messages(5.0))
    if isinstance(blow, str):
        pytest.skip(blow)
    assert blow.good, blow
    assert not blow.wrong


@pytest.mark.usefixtures("short_cases")
def test_a_session_that_is_killed_loses_less_than_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attack_kills, "Live", lambda *words: attack_disk.Live(*words, *LITTLE))
    soon = [1.2, 2.4]  # after it has begun, and gone on
    run = attack_kills.killed(attack_disk.messages(6.0), tmp_path / "a.mcap", soon)
    assert run.missing <= attack_kills.MISSING
    assert run.unread == 0
    assert run.recorded >= 0.8 * run.sent
