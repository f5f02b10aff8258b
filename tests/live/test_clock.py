"""One clock for all sources: lateness that jitters, clocks that drift, stamps that cannot be."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import numpy as np
import pytest

from towtank.live.pipeline import clock as clocks
from towtank.live.pipeline.clock import HostClock, SourceClock, steady_time

DAYS = 5.96 * 86400.0


def errors(offset: float, drift: float, jitter: float, *, seconds: float = 120.0, rate: float = 50.0) -> list[float]:
    """Return by how much each sample's instant is off [s], the quickest message being 1 ms under way."""
    chance = random.Random(3)
    clock = SourceClock()
    out = []
    for k in range(round(seconds * rate)):
        ours = 1.7e9 + k / rate
        stamp = ours * (1.0 - drift) + 1.7e9 * drift - offset
        received = ours + 0.001 + chance.expovariate(1.0 / jitter)
        out.append(clock.ours(stamp, received) - ours - 0.001)
    return out


@pytest.mark.parametrize("drift", [0.0, 2e-5, -1e-4])
def test_the_quickest_messages_lead_from_one_clock_to_the_other(drift: float) -> None:
    off = errors(DAYS, drift, 0.01)
    settled = off[2000:]
    assert max(map(abs, settled)) < 2e-3  # where single messages are 10 ms late on the average, and up to 90
    steps = [abs(b - a) for a, b in pairwise(settled)]
    assert max(steps) < 1e-4  # no instant jumps against its neighbour


def test_stamps_that_cannot_be_are_refused_until_they_insist() -> None:
    clock = SourceClock()
    assert clock.ours(10.0, 1000.0) == 1000.0
    assert math.isnan(clock.ours(50.0, 1001.0))  # 39 s ahead of its receipt
    assert math.isnan(clock.ours(-1e300, 1001.0))
    assert clock.ours(11.0, 1001.0) == pytest.approx(1001.0)
    assert clock.strange == 2
    found = [clock.ours(500.0 + 0.1 * k, 1002.0 + 0.1 * k) for k in range(25)]
    assert all(math.isnan(t) for t in found[:19])
    assert found[19:] == pytest.approx([1002.0 + 0.1 * k for k in range(19, 25)])
    assert clock.restarts == 1


def test_a_source_without_stamps_is_taken_at_its_receipt() -> None:
    clock = SourceClock()
    assert clock.ours(math.nan, 1234.5) == 1234.5
    assert math.isnan(clock.offset)


def test_a_source_that_keeps_our_time_is_believed() -> None:
    assert SourceClock(keeps_time=True).ours(5.0, 1234.5) == 5.0


def test_a_clock_settles_soon_and_follows_quicker_messages_for_a_second() -> None:
    clock = SourceClock()
    assert clock.settled  # nothing to wait for
    told = []
    for k in range(120):
        clock.believes(0.01 * k, 50.0 + 0.01 * k + (0.05 if k < 60 else 0.0))
        told.append(clock.settled)
    assert not any(told[:40])
    assert all(told[42:])
    assert clock.place(1.19, math.nan) == pytest.approx(51.19, abs=1e-6)


def steady(clock: SourceClock, start: float, count: int, offset: float, late: float = 0.0) -> list[float]:
    """Return the instants of stamps that come ten times a second, by clocks `offset` apart."""
    return [clock.ours(start + 0.1 * k, start + 0.1 * k + offset + late) for k in range(count)]


def test_what_a_stalled_link_held_back_keeps_its_times() -> None:
    clock = SourceClock()
    steady(clock, 0.0, 100, 1000.0)
    backlog = [clock.ours(10.0 + 0.1 * k, 1070.0 + 1e-4 * k) for k in range(600)]  # a minute, all at once
    assert backlog == pytest.approx([1010.0 + 0.1 * k for k in range(600)], abs=1e-3)
    assert steady(clock, 70.0, 100, 1000.0) == pytest.approx([1070.0 + 0.1 * k for k in range(100)], abs=1e-3)
    assert (clock.restarts, clock.strange) == (0, 0)


def test_what_a_stalled_link_held_back_may_come_a_little_out_of_order() -> None:
    clock = SourceClock()
    steady(clock, 0.0, 100, 1000.0)
    backlog = [10.0 + 0.1 * (k ^ 3) for k in range(600)]  # four at a time, the last one first
    found = [clock.ours(t, 1070.0 + 1e-4 * k) for k, t in enumerate(backlog)]
    assert found == pytest.approx([1000.0 + t for t in backlog], abs=1e-3)
    assert (clock.restarts, clock.strange) == (0, 0)


def test_a_stamp_is_of_a_clock_that_is_as_late_as_usual_or_near_the_newest() -> None:
    clock = SourceClock()
    assert not clock.is_of(10.0, 1010.0)  # nothing is known of it
    steady(clock, 0.0, 100, 1000.0)
    assert clock.is_of(11.0, 1011.5)
    assert clock.is_of(11.0, 1070.0)  # a link had held it up
    assert clock.is_of(300.0, 1300.0)  # after a silence
    assert not clock.is_of(300.0, 1070.0)
    assert not clock.is_of(-1e6, 1011.0)


@pytest.mark.parametrize("step", [-10_800.0, -5.0, 0.5, 10_800.0])
def test_a_clock_that_is_set_is_followed_at_once(step: float) -> None:
    clock = SourceClock()
    steady(clock, 20_000.0, 100, 1000.0)
    after = steady(clock, 20_010.0 + step, 100, 1000.0 - step)
    assert clock.restarts == 1
    assert after[30:] == pytest.approx([21_010.0 + 0.1 * k for k in range(30, 100)], abs=1e-3)


def test_a_clock_that_is_set_back_by_less_is_found_by_all_being_late() -> None:
    clock = SourceClock()
    steady(clock, 0.0, 100, 1000.0)
    after = steady(clock, 9.5, 300, 1000.5)
    assert clock.restarts == 1
    assert after[-100:] == pytest.approx([1010.0 + 0.1 * k for k in range(200, 300)], abs=1e-3)


def test_a_clock_that_was_set_back_in_a_silence_is_found_by_all_being_late() -> None:
    clock = SourceClock()
    steady(clock, 0.0, 100, 1000.0)
    after = steady(clock, 45.0, 300, 1030.0)  # 65 s of silence, in which it was set back by 30 s
    assert clock.restarts == 1
    assert after[-100:] == pytest.approx([1075.0 + 0.1 * k for k in range(200, 300)], abs=1e-3)


def test_single_messages_that_are_late_do_not_set_a_clock() -> None:
    clock = SourceClock()
    for k in range(1000):
        clock.believes(0.1 * k, 1000.0 + 0.1 * k)
        clock.believes(0.1 * k - 2.0, 1000.0 + 0.1 * k)  # an acoustic fix tells of two seconds ago
    assert (clock.restarts, clock.strange) == (0, 0)


@pytest.mark.parametrize("step", [10_800.0, -10_800.0])
def test_setting_this_computers_clock_moves_no_time(step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    honest, watch = clocks.time.time, HostClock()
    before = steady_time()
    assert watch.stepped() == 0.0
    monkeypatch.setattr(clocks.time, "time", lambda: honest() + step)
    assert 0.0 <= steady_time() - before < 60.0
    assert watch.stepped() == pytest.approx(step, abs=0.5)
    assert watch.stepped() == 0.0


def test_what_comes_at_an_even_pace_is_placed_by_its_quickest_message_whatever_the_stamps_are() -> None:
    """Stamps from zero, of 1970 and of now: a block of them is a second either way."""
    rng = np.random.default_rng(1)
    for start in (0.0, -5.0, 1.7e9):
        clock = SourceClock()
        late = 0.02 + rng.exponential(0.01, 3000)
        placed = [clock.ours(start + 0.01 * k, start + 100.0 + 0.01 * k + late[k]) for k in range(3000)]
        off = np.array(placed) - (start + 100.0 + 0.01 * np.arange(3000))
        assert off[-1] == pytest.approx(0.02, abs=2e-3), start
        assert abs(clock.drift) < 1e-4
        assert np.abs(np.diff(off[200:])).max() < 1.1e-5
        assert len(clock._blocks) >= 25


def test_a_clock_is_settled_soon_where_nothing_contradicts_it() -> None:
    clock = SourceClock()
    assert clock.settled
    for k in range(40):
        clock.ours(0.01 * k, 50.0 + 0.01 * k)
        assert not clock.settled
    clock.ours(0.41, 50.41)
    assert clock.settled
    assert not clock.believes(9.0, 50.42)
    assert clock.strange == 1
    assert not clock.settled
    assert clock.believes(1.03, 51.03)
    assert clock.settled
