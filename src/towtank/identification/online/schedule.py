"""Re-estimations of a stream: when the next is due, as a job that can run beside the stream, and what it leaves behind.

They come at times that grow, and soon after a coefficient became known late.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import Buffer, NoiseLevels
from towtank.identification.kalman.alternatives import Pair, choose_damping, damping_in_question
from towtank.identification.kalman.iterated import FilterProblem, fit_of, prior_deviation
from towtank.identification.kalman.noise_adaptation import filter_settings
from towtank.identification.kalman.state import JointState
from towtank.identification.model.parameters import DELAY, FreeParameters, free_parameters
from towtank.identification.model.prior import prior_information, size_of
from towtank.identification.online.least_squares import PaperLearner
from towtank.identification.online.reestimation import (
    Reestimation,
    Start,
    Task,
    bank_of_delays,
    begun_later,
    measured_axes,
    names_to_learn,
    noise_levels_of_rows,
    reestimate,
    starting_points,
)
from towtank.vehicle import Vehicle

__all__: list[str] = []

_PASSES = 4  # over what was seen, that a choice of damping terms may cost each time
_EARLY = 8.0  # s of motion until which re-estimations are frequent
_STILL = 30.0  # s of motion until which the water may be taken as still
_OFTEN = 0.25  # s between two re-estimations at least
_FIRST = 0.5  # s of motion
_GROWS_EARLY, _GROWS = 0.25, 1.0  # share of the motion so far to the next one, until `_EARLY` and later
_GROWS_AGAIN, _GROWS_LEAST = 0.6, 0.06  # likewise, once a coefficient has called for one; of all that was seen
_LAST = 120.0  # s of samples kept,
_MOST_ROWS = 40_000
_BOTH_STARTS, _STARTS_GROW = 30.0, 2.0  # s: until then those at doubling times start from least squares too,
_BANK_UNTIL = 5.0  # s: and until then from a bank of delays
_MOST_LEFT_OUT = 1.0  # s
_DAMPING = 7.0  # s of motion from which damping terms are chosen between
_STIRRED = 2  # re-estimations that find the water plainly stirred, after which none asks again


@dataclass(frozen=True, eq=False)
class ReestimationJob:
    """What to go over and from where, see `reestimate`.

    pairs: damping terms to choose between. requested: somebody named the coefficients.
    rows, inputs: how much of the buffer it has seen.
    """

    task: Task
    start: Start
    still: bool
    may_begin_later: bool
    pairs: Sequence[Pair]
    requested: bool
    rows: int
    inputs: int

    def run(self) -> Reestimation | None:
        """Re-estimate, and once more with other damping terms where these are there; None where every pass fails."""
        first = self._reestimated(self.task, self.start)
        if first is None or not self.pairs:
            return first
        task, start = self.task, self.start
        p, deviation = np.array(task.vehicle.parameters), prior_deviation(start.free, size_of(task.vehicle, start.free))
        known, noise = task.prior(start.free), start.levels.noise
        problem = FilterProblem(task.stretches, p, start.free, deviation, known, task.delay, noise)
        choice = choose_damping(
            problem,
            task.vehicle,
            fit_of(start.free, first.state, first.levels, 1),
            self.pairs,
            settings=task.settings,
            prior=task.prior,
            requested=self.requested,
            most=_PASSES,
        )
        if choice is None:
            return first
        last, fit = first, choice.fit
        if fit.free.names != start.free.names:
            without = task.vehicle.with_coefficients(dict.fromkeys(choice.left_out, 0.0))
            other = Start(fit.free, fit.theta, [], fit.levels)
            last = self._reestimated(replace(task, vehicle=without), other) or first
        return replace(last, damping=choice.left_out) if last.free is fit.free else last

    def _reestimated(self, task: Task, start: Start) -> Reestimation | None:
        return reestimate(task, start, still=self.still, may_begin_later=self.may_begin_later)


class Beside:
    """One job at a time, in a thread of its own: the kernels release the interpreter."""

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._job: ReestimationJob | None = None
        self._future: Future[Reestimation | None] | None = None

    @property
    def busy(self) -> bool:
        """Whether a job is running, or done and not yet fetched."""
        return self._future is not None

    def begin(self, job: ReestimationJob) -> None:
        """Start a job."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, thread_name_prefix="towtank-reestimation")
        self._job, self._future = job, self._pool.submit(job.run)

    def fetch(self, *, wait: bool) -> tuple[ReestimationJob, Reestimation | None] | None:
        """Return the job and its result once it is done; None before, unless `wait`."""
        if self._job is None or self._future is None or not (wait or self._future.done()):
            return None
        done = self._job, self._future.result()
        self._job = self._future = None
        return done

    def __getstate__(self) -> dict[str, None]:
        return {"_pool": None, "_job": None, "_future": None}


@dataclass
class Schedule:
    """Times [s] of motion: of the next re-estimation, the last, the next from other starts; since when all move."""

    next: float = _FIRST
    last: float = 0.0
    starts: float = _FIRST
    began: float = 0.0

    def done(self, seen: float) -> None:
        """Set the next re-estimation after one at `seen`."""
        span = seen - self.began
        early = _GROWS_EARLY if self.began == 0.0 else _GROWS_AGAIN
        self.last = seen
        self.next = seen + max(_OFTEN, span * (early if span < _EARLY else _GROWS), seen * _GROWS_LEAST)

    def call(self, seen: float, *, at_once: bool = False) -> None:
        """Re-estimate now, and often for a while: an axis that was still has begun to move."""
        if at_once or seen > self.last + max(_OFTEN, self.last * _GROWS_LEAST):
            self.next = min(self.next, seen)
            self.began = self.last

    def behind(self, seen: float) -> bool:
        """Whether one is due, or the last one saw far less than has been seen by now."""
        return seen >= min(self.next, max(_FIRST, (1.0 + _GROWS_EARLY) * self.last))

    def other_starts(self, seen: float) -> bool:
        """Whether this one begins elsewhere too."""
        due = self.starts <= seen < _BOTH_STARTS
        if due:
            self.starts = seen * _STARTS_GROW
        return due

    def bank(self, seen: float) -> bool:
        """Whether it begins from a bank of delays too."""
        return seen < _BANK_UNTIL

    def over(self, rows: int) -> bool:
        """Whether there are no more, with so many rows kept."""
        return self.next > _LAST or rows > _MOST_ROWS


class ReestimationSchedule:
    """All re-estimations of one stream.

    Args:
        vehicle: what is known. requested: names to learn, None for all that can be.
        delay: of the inputs [s] where it is given. prior: a vehicle whose coefficients bear deviations.
        levels: that the first one tries.
        paper: the least squares that runs beside the stream.
        background: they run in a thread of their own.
        current: of the water, estimated along.

    Attributes:
        schedule: when. levels: that the next one tries. stirred: how many so far found the water stirred.
        last_one: whether there are no more. left_out: seconds at the beginning that they do not go over.
        damping: damping terms that were chosen, and why others are left out: "" for the former.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        requested: tuple[str, ...] | None,
        *,
        delay: float | None,
        prior: Vehicle | None,
        levels: NoiseLevels,
        paper: PaperLearner | None,
        background: bool,
        current: bool,
    ) -> None:
        self.schedule, self.levels, self.stirred, self.last_one = Schedule(), levels, 0, False
        self.left_out = 0.0
        self.damping: dict[str, str] = {}
        self.settings = replace(filter_settings(vehicle), current=current)
        self._vehicle, self._requested, self._prior, self._paper = vehicle, requested, prior, paper
        self._delay = delay
        self._beside = Beside() if background else None

    @property
    def busy(self) -> bool:
        """Whether one runs beside."""
        return self._beside is not None and self._beside.busy

    def due(
        self, seen: float, buffer: Buffer, known: tuple[FreeParameters, JointState] | None, delay: float
    ) -> ReestimationJob | None:
        """Return the job that is due after `seen` seconds and has to be waited for; begin one that has not.

        Args:
            buffer: what was seen. known: coordinates of the filter by now, and the filter.
            delay: of the inputs [s] where it is not free.
        """
        if self.busy or self.last_one or seen < self.schedule.next:
            return None
        job = self._job(seen, buffer, known, delay)
        self.schedule.done(seen)
        self.last_one = self.schedule.over(buffer.rows)
        if job is not None and self._beside is not None:
            self._beside.begin(job)
            return None
        return job

    def one_more(
        self, seen: float, buffer: Buffer, known: tuple[FreeParameters, JointState] | None, delay: float
    ) -> ReestimationJob | None:
        """Return a job where those beside have been left behind by the stream. Arguments as `due`."""
        if self._beside is None or not self.schedule.behind(seen):
            return None
        job = self._job(seen, buffer, known, delay)
        if job is not None:
            self.schedule.done(seen)
        return job

    def fetch(self, *, wait: bool = False) -> tuple[ReestimationJob, Reestimation | None] | None:
        """Return a job that ran beside and its result, once it is done; None before, unless `wait`."""
        return self._beside.fetch(wait=wait) if self._beside is not None else None

    def adopt(self, result: Reestimation) -> None:
        """Go on from what a re-estimation found."""
        self.levels = result.next
        self.stirred += result.stirred
        self.left_out += result.left_out
        if result.damping is not None:
            both = [name for pair in self._pairs(result.free.names) for name in pair]
            self.damping = {name: result.damping.get(name, "") for name in both}

    def plain(self, seen: float) -> dict[str, Any]:
        """Return all but the levels as plain data; one that runs beside is begun anew by who goes on from it."""
        anew = {"next": seen, "starts": seen} if self.busy else {}
        return {
            "last_one": self.last_one and not self.busy,
            "stirred": self.stirred,
            "left_out": self.left_out,
            "damping": self.damping,
            "schedule": {**asdict(self.schedule), **anew},
        }

    def restore(self, plain: Mapping[str, Any], levels: NoiseLevels) -> None:
        """Go on with what `plain` and `levels` of another one were."""
        self.last_one, self.stirred = bool(plain["last_one"]), int(plain["stirred"])
        self.left_out, self.damping = float(plain["left_out"]), dict(plain["damping"])
        self.schedule, self.levels = Schedule(**plain["schedule"]), levels

    def end(self) -> None:
        """Let go of what still runs beside: it is of no use any more."""
        self._beside = None

    def without(self, vehicle: Vehicle) -> Vehicle:
        """Return a vehicle with the damping terms that are left out taken as 0."""
        left_out = {name: 0.0 for name, why in self.damping.items() if why}
        return vehicle.with_coefficients(left_out) if left_out else vehicle

    def _pairs(self, names: Sequence[str]) -> list[Pair]:
        """Return the damping terms to choose between: of axes of which the vehicle's file has none.

        On real water the filter's likelihood is no sure judge between two, and a stream has no other.
        """
        pairs = damping_in_question(self._vehicle, names, requested=self._requested is not None)
        return [pair for pair in pairs if not any(self._vehicle.coefficient(name) for name in pair)]

    def _known_before(self, free: FreeParameters) -> tuple[Array, Array] | None:
        return None if self._prior is None else prior_information(self._prior, free)

    def _job(
        self, seen: float, buffer: Buffer, known: tuple[FreeParameters, JointState] | None, delay: float
    ) -> ReestimationJob | None:
        """Return a re-estimation of everything from each start; None where there is nothing to learn yet."""
        stretches = buffer.stretches
        regression = None if self._paper is None else self._paper.estimate
        find_delay = self._delay is None and buffer.commands
        measured = measured_axes(stretches)
        names = names_to_learn(self._vehicle, self._requested, regression, measured, with_delay=find_delay)
        names = [name for name in names if not self.damping.get(name)]
        names += [name for name, why in self.damping.items() if not why and name not in names]
        if not any(each.input_t.size for each in stretches) or not names:
            return None
        stretches = begun_later(stretches, self.left_out)
        free = free_parameters(self._vehicle, names)
        own, cold = starting_points(self._vehicle, known, free, regression, delay)
        elsewhere = self.schedule.other_starts(seen)
        starts = [cold] if own is None or elsewhere else []
        if elsewhere and DELAY in free.names and self.schedule.bank(seen):
            starts += bank_of_delays(free, cold if own is None else own)
        longest = max(stretches, key=lambda each: each.t.size)
        levels = noise_levels_of_rows(longest, self.levels, first=own is None)
        return ReestimationJob(
            Task(stretches, self.without(self._vehicle), self.settings, delay, self._known_before),
            Start(free, own, starts, levels, reserve=cold),
            still=seen < _STILL and self.stirred < _STIRRED,
            may_begin_later=elsewhere and self.left_out < _MOST_LEFT_OUT,
            pairs=self._pairs(names) if seen >= _DAMPING else (),
            requested=self._requested is not None,
            rows=buffer.rows,
            inputs=buffer.inputs,
        )
