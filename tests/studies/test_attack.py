"""Short forms of the attacks on links and recordings."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import attack_disk
import attack_kills
import attack_links


@pytest.mark.parametrize("kind", attack_links.LINKS)
def test_what_is_rejected_does_not_change_the_estimate(kind: str) -> None:
    row = attack_links.hostile(kind, 2000, seed=1)
    assert row.good, row


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("starts anew", "MAVLink"),
        ("stalls for a minute", "JSON"),
        ("clock set by +3 h", "DDS"),
        ("another vehicle, same number", "MAVLink"),
    ],
)
def test_the_estimate_does_not_jump(name: str, kind: str) -> None:
    row = attack_links.case(name, kind, seed=1)
    assert row.good, row


def test_a_flood_is_counted_and_does_not_fill_the_disk() -> None:
    row = attack_links.flood(2.0, seed=2)
    assert row.good, row


def test_this_computers_clock_may_be_set() -> None:
    row = attack_links.computer_clock(seed=2)
    assert row.good, row


@pytest.mark.parametrize("name", ["full", "fills", "emptied", "two-sessions", "SIGHUP", "SIGPIPE"])
def test_a_recording_outlives(name: str) -> None:
    blow = attack_disk.run_case(name, attack_disk.messages(9.0))
    if isinstance(blow, str):
        pytest.skip(blow)
    assert blow.good, blow
    assert not blow.wrong


def test_a_session_that_is_killed_loses_less_than_a_second(tmp_path: Path) -> None:
    run = attack_kills.killed(attack_disk.messages(8.0), tmp_path / "a.mcap", [4.0])
    assert run.missing <= attack_kills.MISSING
    assert run.unread == 0
    assert run.recorded >= 0.8 * run.sent
