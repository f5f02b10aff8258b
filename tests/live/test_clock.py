"""One clock for all sources: lateness that jitters, clocks that drift, stamps that cannot be."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest

from towtank.live.pipeline.clock import SourceClock

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


def test_a_clock_settles_within_a_second() -> None:
    clock = SourceClock()
    assert clock.settled  # nothing to wait for
    told = []
    for k in range(120):
        clock.believes(0.01 * k, 50.0 + 0.01 * k + (0.05 if k < 60 else 0.0))
        told.append(clock.settled)
    assert not any(told[:100])
    assert all(told[102:])
    assert clock.place(1.19, math.nan) == pytest.approx(51.19, abs=1e-6)
