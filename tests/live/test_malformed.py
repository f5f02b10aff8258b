"""Malformed datagrams: the study's, a few thousand of them."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from fuzz_datagrams import LONGEST, perform


def test_nothing_is_raised_lost_or_left_uncounted() -> None:
    found = perform(4000, seed=2)
    assert found.datagrams == 4000
    assert found.bad > 1000
    assert found.samples > 400
    assert found.slowest_s < LONGEST
    assert not [text for text in found.warnings if "stopped" in text or "failed" in text]
