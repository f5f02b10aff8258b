"""Samples of several links in order of time, and what comes too late for it."""

from __future__ import annotations

import math
import random

from towtank.live.links.source import Sample
from towtank.live.pipeline.sorter import Arrival, Sorter


def arrival(t: float, came: float, rank: int = 0) -> Arrival:
    return Arrival(t, came, rank, Sample("json", "a", t, t, ("x",), (t,)))


def gone(sorter: Sorter, now: float) -> list[float]:
    return [each.t for each, _ in sorter.ready(now)]


def test_late_samples_within_the_window_find_their_place() -> None:
    chance = random.Random(1)
    sorter = Sorter(0.1, 2)
    stamps = [0.01 * k for k in range(1000)]
    events = sorted((t + chance.uniform(0.0, 0.09), t, k % 2) for k, t in enumerate(stamps))
    out: list[float] = []
    for came, t, rank in events:
        sorter.put(arrival(t, came, rank))
        out += gone(sorter, came)
    out += gone(sorter, math.inf)
    assert out == stamps
    assert sorter.late == 0


def test_a_sample_waits_no_longer_than_the_window() -> None:
    sorter = Sorter(0.1, 2)
    sorter.put(arrival(1.0, 5.0))
    assert gone(sorter, 5.09) == []  # the other link may still send something earlier
    assert 0.0 < sorter.wait(5.09) < 0.011
    assert gone(sorter, 5.1) == [1.0]


def test_nothing_waits_once_every_link_is_further() -> None:
    sorter = Sorter(0.1, 2)
    sorter.put(arrival(1.0, 5.0, 0))
    sorter.put(arrival(1.2, 5.0, 1))
    sorter.put(arrival(1.2, 5.0, 0))
    assert gone(sorter, 5.0) == [1.0]


def test_what_comes_after_the_window_is_counted_and_refused() -> None:
    sorter = Sorter(0.1, 1)
    sorter.put(arrival(1.0, 5.0))
    assert gone(sorter, 5.2) == [1.0]
    sorter.put(arrival(0.9, 5.2))
    assert gone(sorter, math.inf) == []
    assert sorter.late == 1


def test_links_that_can_wait_are_merged_whatever_the_clock_says() -> None:
    sorter = Sorter(0.0, 2, patient=True)
    for k in range(5):
        sorter.put(arrival(0.2 * k, 1.0, 0))
    assert gone(sorter, 100.0) == []
    sorter.put(arrival(0.5, 1.0, 1))
    assert gone(sorter, 100.0) == [0.0, 0.2, 0.4, 0.5]
    sorter.ended(1)
    assert gone(sorter, 100.0) == [0.6000000000000001, 0.8]
