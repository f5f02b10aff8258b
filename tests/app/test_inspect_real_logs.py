"""Every log of an ArduSub vehicle that there is, inspected whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from .commands import command, document

LOGS = {
    "ardusub_samples/small.BIN": 0,
    "ardusub_samples/small.tlog": 4,
    "ardusub_samples/2023-04-18_11-03-34.tlog": 1967,
    "bluerov2_dvl_sea_2026/orig/00000029_filtered.BIN": 0,
}


@pytest.mark.parametrize("name", LOGS)
def test_inspected(data: Path, name: str) -> None:
    found = document("inspect", data / name)
    assert found["repairs"]["damaged"] == LOGS[name]
    assert {"p", "q", "r", "phi", "z", "cmd_1"} <= {channel["name"] for channel in found["channels"]}
    assert sum(bool(content["used"]) for content in found["contents"]) >= 5


def test_what_a_folder_holds_beside(data: Path) -> None:
    """A text that is no log is refused in one line."""
    ran = command("inspect", data / "ardusub_samples" / "README.md")
    assert ran.code == 2
    assert len(ran.err.splitlines()) == 1
