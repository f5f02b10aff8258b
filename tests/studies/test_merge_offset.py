"""The study of clock offsets, cut short: what it makes is found again, within what is told."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from towtank.recording.merging.offset import clock_offset

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import merge_offset_study


@pytest.mark.parametrize("name", ["the same, 20 s", "attitude of 10 Hz", "depth 10 Hz"])
def test_offsets_are_found_within_what_is_told(name: str) -> None:
    [case] = [each for each in merge_offset_study.CASES if each.name.startswith(name) and not each.drift]
    rng = np.random.default_rng(5)
    beyond = []
    for _ in range(10):
        first, second, offset = merge_offset_study.pair(case, rng)
        found = clock_offset(first, second)
        beyond.append(abs(found.offset - offset) / found.std)
    assert max(beyond) < 5.0
    assert sum(each < 1.96 for each in beyond) >= 7
