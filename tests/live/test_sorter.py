"""Samples of several links in order of time, and what comes too late for it."""

from __future__ import annotations

import math
import random

import pytest

from towtank.live.links.source import Sample
from towtank.live.pipeline.sorter import Arrival, Preference, Sorter


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


def test_the_moment_from_which_a_sample_might_have_gone_is_told() -> None:
    sorter = Sorter(0.1, 2)
    sorter.put(arrival(1.0, 5.0, 0))
    sorter.put(arrival(1.05, 5.02, 1))
    assert [moment for _, moment in sorter.ready(5.3)] == [5.1, pytest.approx(5.12)]  # it has waited for the window
    sorter.put(arrival(2.0, 6.0, 0))
    sorter.put(arrival(2.2, 6.01, 0))
    sorter.put(arrival(2.15, 6.03, 1))
    assert [moment for _, moment in sorter.ready(6.04)] == [6.04]  # both links are further
    sorter = Sorter(0.1, 1)
    sorter.put(arrival(1.0, 5.0))
    sorter.put(arrival(1.3, 5.3))
    assert next(sorter.ready(9.0))[1] == 5.1


def test_a_link_that_has_ended_is_waited_for_no_longer() -> None:
    sorter = Sorter(0.1, 2)
    sorter.put(arrival(1.0, 5.0, 0))
    sorter.put(arrival(1.2, 5.0, 0))
    assert gone(sorter, 5.0) == []
    sorter.ended(1)
    assert gone(sorter, 5.0) == [1.0]
    assert len(sorter) == 1


def test_where_nothing_is_held_there_is_nothing_to_wait_for() -> None:
    sorter, patient = Sorter(0.1, 1), Sorter(0.1, 1, patient=True)
    assert sorter.wait(5.0) == math.inf
    for each in (sorter, patient):
        each.put(arrival(1.0, 5.0))
    assert (sorter.wait(5.0), sorter.wait(6.0), patient.wait(5.0)) == (pytest.approx(0.1), 0.0, math.inf)


def test_what_was_held_to_the_end_is_no_later_than_it_came() -> None:
    sorter = Sorter(0.1, 1)
    for t in (3.0, 1.0, 2.0, 2.0):
        sorter.put(arrival(t, 5.0))
    assert gone(sorter, math.inf) == [1.0, 2.0, 2.0, 3.0]
    sorter.put(arrival(3.0, 6.0))
    assert sorter.late == 0
    sorter.put(arrival(2.9, 6.0))
    assert sorter.late == 1


def named(names: tuple[str, ...], t: float, rank: int) -> Arrival:
    return Arrival(t, t, rank, Sample("json", "a", t, t, names, tuple(float(k) for k in range(len(names)))))


def test_a_channel_stays_with_the_link_named_first_while_that_sends() -> None:
    preference = Preference()
    assert preference.source_of("u") is None
    assert preference.taken(named(("u", "v"), 1.0, 1)) == {"u": 0.0, "v": 1.0}
    assert preference.taken(named(("v", "w"), 1.1, 2)) == {"w": 1.0}
    assert list(preference.doubled) == ["v"]
    assert (preference.source_of("v"), preference.source_of("w")) == (1, 2)
    assert preference.taken(named(("v",), 1.2, 0)) == {"v": 0.0}  # one that is named earlier takes over
    assert preference.taken(named(("v",), 1.3, 1)) == {}
    assert preference.taken(named(("v",), 60.0, 1)) == {"v": 0.0}  # and leaves it when it falls silent
    assert list(preference.doubled) == ["v"]
