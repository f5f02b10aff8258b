"""Malformed MAVLink: the study's datagrams, a few thousand of them."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from fuzz_mavlink import LONGEST, perform


def test_nothing_is_raised_and_sense_is_understood_again() -> None:
    found = perform(4000, seed=3)
    assert found.bad > 1000
    assert found.slowest_s < LONGEST
    assert found.samples_after > 0
