"""Limits on processor time: against work that grows wildly, not against a machine that is slow just now."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

_USUAL = 0.06  # s that plain work takes, which is measured where a limit is missed


@contextmanager
def within(seconds: float, what: object = "") -> Iterator[None]:
    """Fail where the block takes longer, by as much longer as the machine is slow."""
    began = time.process_time()
    yield
    took = time.process_time() - began
    assert took < seconds or took < seconds * _slowness(), (took, what)


def _slowness() -> float:
    """Return how many times as long as usual plain work takes at the moment."""
    began = time.process_time()
    total = 0
    for k in range(1_000_000):
        total += k
    return (time.process_time() - began) / _USUAL
