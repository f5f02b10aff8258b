"""When a stream is gone over once more, and a thread in which that runs beside it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from towtank.identification.online.reestimation import Found, Reestimation

__all__ = ["Beside", "Schedule"]

_FIRST, _DOUBLES, _GROWS = 0.5, 2.0, 1.5  # s; factor to the time learned from until `_DOUBLES` [s] 2, later this
_FROM_PRIOR = 60.0  # s until which passes begin at the prior's mean, whatever is known, and ask about waves
_OFTEN, _OFTEN_SHARE = 1.0, 0.1  # s, and share of the time learned from, between two re-estimations at least


@dataclass
class Schedule:
    """Times [s] of motion: of the next re-estimation, of the last; when the vehicle became what it is."""

    next: float = _FIRST
    last: float = 0.0
    began: float = 0.0

    def done(self, seen: float) -> None:
        """Set the next re-estimation after one at `seen`."""
        span = seen - self.began
        self.last, self.next = seen, self.began + span * (_GROWS if span >= _DOUBLES else 2.0)

    def call(self, seen: float) -> None:
        """Re-estimate soon: something has become known far from where the motion is linearised."""
        if seen > self.last + max(_OFTEN, (self.last - self.began) * _OFTEN_SHARE):
            self.next = min(self.next, seen)

    def anew(self, seen: float) -> None:
        """Begin again with a vehicle that has changed."""
        self.began = self.last = seen
        self.next = seen + _DOUBLES

    def behind(self, seen: float) -> bool:
        """Whether one is due, or the last one saw far less than has been seen by now."""
        return seen >= min(self.next, max(_FIRST, self.began + 1.25 * (self.last - self.began)))

    def from_prior(self, seen: float) -> bool:
        """Whether passes begin at the prior's mean."""
        return seen - self.began < _FROM_PRIOR


class Beside:
    """One job at a time, in a thread of its own: the kernels release the interpreter."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._future: Future[Found | None] | None = None

    @property
    def busy(self) -> bool:
        """Whether a job is running, or done and not yet fetched."""
        return self._future is not None

    def begin(self, job: Reestimation) -> None:
        """Start a job."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, thread_name_prefix="towtank-reestimation")
        self._future = self._pool.submit(job.run)

    @property
    def done(self) -> bool:
        """Whether a job is done and not yet fetched."""
        return self._future is not None and self._future.done()

    def fetch(self) -> Found | None:
        """Return the result of the job, waited for; None where it found nothing."""
        future, self._future = self._future, None
        return None if future is None else future.result()

    def forget(self) -> None:
        """Let go of a job that runs: what it finds is of no use any more."""
        self._future = None

    def __getstate__(self) -> dict[str, None]:
        return {"_pool": None, "_future": None}
