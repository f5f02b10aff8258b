"""A look of the streaming filter as a job: everything that it needs, so that it can run beside the stream."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

from towtank.core.arrays import Array
from towtank.identification.joint import fit_of
from towtank.identification.joint_damping import Pair, Prior, choose_damping
from towtank.identification.joint_look import Look, look
from towtank.identification.joint_state import Tuning
from towtank.identification.log_learning import Levels
from towtank.identification.parameters import FreeParameters
from towtank.identification.samples import Samples
from towtank.vehicle import Vehicle

__all__ = ["Beside", "LookJob"]

_PASSES = 4  # over what was seen, that a choice of damping terms may cost each time


@dataclass(frozen=True, eq=False)
class LookJob:
    """What to look at and from where, see `look`.

    pairs: damping terms to choose between. asked: somebody named the coefficients.
    rows, inputs: how much of the buffer it has seen.
    """

    stretches: Sequence[Samples]
    vehicle: Vehicle
    free: FreeParameters
    own: Array | None
    starts: Sequence[Array]
    levels: Levels
    tuning: Tuning
    delay: float
    prior: Prior
    reserve: Array
    still: bool
    may_begin_later: bool
    pairs: Sequence[Pair]
    asked: bool
    rows: int
    inputs: int

    def run(self) -> Look | None:
        """Look, and once more with other damping terms where these are what is there; None where every pass fails."""
        seen = self._look(self.vehicle, self.free, self.own, self.starts, self.levels)
        if seen is None or not self.pairs:
            return seen
        choice = choose_damping(
            self.stretches,
            self.vehicle,
            fit_of(self.free, seen.state, seen.levels, 1),
            self.pairs,
            tuning=self.tuning,
            delay=self.delay,
            prior=self.prior,
            shown=self.levels.noise,
            asked=self.asked,
            most=_PASSES,
        )
        if choice is None:
            return seen
        free = choice.fit.free
        if free.names != self.free.names:
            without = self.vehicle.with_coefficients(dict.fromkeys(choice.left_out, 0.0))
            seen = self._look(without, free, choice.fit.theta, [], choice.fit.levels) or seen
        return replace(seen, damping=choice.left_out) if seen.free is free else seen

    def _look(
        self, vehicle: Vehicle, free: FreeParameters, own: Array | None, starts: Sequence[Array], levels: Levels
    ) -> Look | None:
        return look(
            self.stretches,
            vehicle,
            free,
            own,
            starts,
            levels,
            self.tuning,
            delay=self.delay,
            prior=self.prior(free),
            reserve=self.reserve if free is self.free else None,
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
