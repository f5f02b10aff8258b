"""A look of the streaming filter as a job: everything that it needs, so that it can run beside the stream."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from towtank.core.arrays import Array
from towtank.identification.joint_look import Look, look
from towtank.identification.joint_state import Tuning
from towtank.identification.log_learning import Levels
from towtank.identification.parameters import FreeParameters
from towtank.identification.samples import Samples
from towtank.vehicle import Vehicle

__all__ = ["Beside", "LookJob"]


@dataclass(frozen=True, eq=False)
class LookJob:
    """What to look at and from where, see `look`; rows, inputs: how much of the buffer it has seen."""

    stretches: Sequence[Samples]
    vehicle: Vehicle
    free: FreeParameters
    own: Array | None
    starts: Sequence[Array]
    levels: Levels
    tuning: Tuning
    delay: float
    prior: tuple[Array, Array] | None
    reserve: Array
    still: bool
    may_begin_later: bool
    rows: int
    inputs: int

    def run(self) -> Look | None:
        """Look; None where every pass fails."""
        return look(
            self.stretches,
            self.vehicle,
            self.free,
            self.own,
            self.starts,
            self.levels,
            self.tuning,
            delay=self.delay,
            prior=self.prior,
            reserve=self.reserve,
            still=self.still,
            may_begin_later=self.may_begin_later,
        )


class Beside:
    """One job at a time, in a thread of its own: the kernels release the interpreter."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._job: LookJob | None = None
        self._future: Future[Look | None] | None = None

    @property
    def busy(self) -> bool:
        """Whether a job is running, or done and not yet fetched."""
        return self._future is not None

    def begin(self, job: LookJob) -> None:
        """Start a job."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, thread_name_prefix="towtank-look")
        self._job, self._future = job, self._pool.submit(job.run)

    def fetch(self, *, wait: bool) -> tuple[LookJob, Look | None] | None:
        """Return the job and what it saw once it is done; None before, unless told to wait."""
        if self._job is None or self._future is None or not (wait or self._future.done()):
            return None
        done = self._job, self._future.result()
        self._job = self._future = None
        return done

    def __getstate__(self) -> dict[str, None]:
        return {"_pool": None, "_job": None, "_future": None}
