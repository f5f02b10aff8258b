"""Re-estimation of a stream: passes of the joint filter over what was seen so far, from the prior, as from a log.

A filter that starts in ignorance is linearised about wrong coefficients. So what was seen is kept, and gone over once
more at times that grow. The filter of the last pass then goes on with what comes. What is kept is bounded: before rows
go, the posterior that they give becomes the prior of the rest.

A stream may begin while a marker is where it does not belong. What is taken for the first speed then is none, and the
filter, sure of it, rejects what comes: the first half second goes where far less is rejected without it.

When a stream is gone over is a `Schedule`; the thread in which that runs beside it is `Beside`.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.changes.branch import Kept, Running
from towtank.identification.data.samples import Buffer, Samples
from towtank.identification.kalman.filter import take_all
from towtank.identification.kalman.noise_adaptation import filter_settings
from towtank.identification.kalman.passes import joint_fit, next_recording, one_pass, since_last
from towtank.identification.kalman.problem import JointProblem, inputs_of, latencies_of, settings_for
from towtank.identification.kalman.rivals import apart_from, likeliest_rival
from towtank.identification.kalman.state import healthy_snapshot
from towtank.identification.model.measurements import LEAST_NOISE, TYPICAL_NOISE
from towtank.identification.model.parameters import FURTHER, told
from towtank.identification.model.prior import Prior, further_unknowns, prior_of
from towtank.recording.consistency.wander import noise_of_smooth_speeds, smooth_speeds
from towtank.recording.noise import noise_of_rows
from towtank.vehicle import Vehicle

__all__ = ["Beside", "Found", "Question", "Reestimation", "Schedule", "begun_anew", "caught_up", "is_full"]

_FROM_PRIOR = 60.0  # s until which passes begin at the prior's mean, whatever is known, and ask about waves
_FIRST, _DOUBLES, _GROWS = 0.5, 2.0, 1.5  # s; the time learned from doubles, but grows so from here to `_FROM_PRIOR`
_OFTEN, _OFTEN_SHARE = 1.0, 0.1  # s, and share of the time learned from, between two re-estimations at least
_MOST_ROWS, _LATEST = 40_000, 2000  # rows kept; that show the noise
_ADAPT = 10.0  # s over which the live filter follows the disturbance
_REST = 0.05  # share of a steady pace of learning below which the live filter only considers a coefficient
_FALSE_START, _LONG_ENOUGH = 0.5, 1.5  # s that are left out; of the first stretch, for that
_REJECTED = 0.02  # share of a sensor's samples beyond the gate from which the beginning is doubted
_FEW = 20  # rows that a job leaves to the stream's own thread


@dataclass(frozen=True, eq=False)
class Question:
    """What a stream is to learn.

    Attributes:
        vehicle: what is known. free: names to learn, None for everything plausible.
        delay: of the inputs [s] where it is given. beside: a vehicle that counts where it says something.
    """

    vehicle: Vehicle
    free: tuple[str, ...] | None
    delay: float | None
    beside: Vehicle | None

    def whole(self, kept: Kept | None, *, commands: bool, more: Sequence[str] = ()) -> Prior:
        """Return what is supposed of every plausible coefficient, with what was learned from rows that are gone."""
        known = () if kept is None else kept.names
        names = [name for name in FURTHER if name in more or name in known]
        whole = prior_of(self.vehicle, commands=commands, more=names, beside=self.beside)
        return whole if kept is None else _gone_on(whole, kept)

    def prior(self, whole: Prior, kept: Kept | None) -> Prior:
        """Return what is supposed of the unknowns."""
        more = () if kept is None else kept.names
        free = None if self.free is None else [*self.free, *(name for name in more if name not in self.free)]
        return whole.narrowed_to(free, delay_given=self.delay is not None)

    def base(self, whole: Prior) -> Vehicle:
        """Return the vehicle with the prior's mean of every plausible coefficient."""
        return self.vehicle.with_coefficients(whole.vehicle_values)


def _gone_on(whole: Prior, kept: Kept) -> Prior:
    rows = [whole.names.index(name) for name in kept.names]
    mean, covariance = whole.mean.copy(), whole.covariance.copy()
    mean[rows], _, known = told(whole.free.subset(kept.names), kept.about, kept.mean, kept.mean, kept.covariance)
    covariance[rows] = 0.0
    covariance[:, rows] = 0.0
    covariance[np.ix_(rows, rows)] = known
    return replace(whole, mean=mean, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Found:
    """The filter that goes on, and what is kept.

    Attributes:
        running: it has taken the first `rows` and `inputs` of the buffer. kept: what older rows have said.
        gone: how many rows of the buffer go.
    """

    running: Running
    kept: Kept | None
    gone: int
    rows: int
    inputs: int


@dataclass(frozen=True, eq=False)
class Reestimation:
    """One re-estimation, which may run beside the stream.

    Attributes:
        buffer: what was seen, of it `rows` and `inputs` by now. kept: what older rows have said.
        last: the filter so far, whose coefficients the first pass is linearised about; None: about the prior's mean.
    """

    question: Question
    buffer: Buffer
    rows: int
    inputs: int
    kept: Kept | None
    last: Running | None

    @classmethod
    def of(cls, question: Question, buffer: Buffer, kept: Kept | None, last: Running | None) -> Reestimation:
        """Return the re-estimation of what a buffer has by now."""
        return cls(question, buffer, buffer.rows, buffer.inputs, kept, last)

    def run(self) -> Found | None:
        """Go over it; None where there is nothing to learn from, or every pass fails."""
        stretches = [each for _, each in self.buffer.until(self.rows, self.inputs) if len(each)]
        if not any(each.input_t.size for each in stretches):
            return None
        whole, problem = self._problem(stretches)
        last, about = self.last, self._about(problem)
        if last is not None and about is not None:
            problem = replace(problem, settings=last.settings)
        means = problem.in_steps()
        since = None
        if last is not None and about is not None:
            since = about, replace(last.levels, noise=last.levels.noise * means.quieter)
        fit = joint_fit(means, since=since)
        gone = 0
        if since is None and fit.rejected.max() > _REJECTED and stretches[0].duration > _LONG_ENOUGH:
            gone = int(np.searchsorted(stretches[0].t, stretches[0].t[0] + _FALSE_START))
            later = problem.over([stretches[0].stretch(gone, len(stretches[0])), *stretches[1:]])
            other = joint_fit(later.in_steps())
            if other.rejected.max() < 0.5 * fit.rejected.max():
                fit, problem, means = other, later, later.in_steps()
            else:
                gone = 0
        problem = replace(problem, settings=replace(problem.settings, wave_period=fit.wave_period))
        levels = replace(fit.levels, noise=fit.levels.noise / means.quieter)
        state, held, *_ = one_pass(problem, fit.theta, levels)
        if healthy_snapshot(state) is None:
            return None
        wider, apart = fit.wider, np.zeros(fit.theta.size)
        said = [*(one.said for one in smooth_speeds([each.recorded for each in problem.samples])), *levels.heading_said]
        rival = likeliest_rival(means, fit)
        if rival is not None:
            apart, texts = apart_from(problem, fit, rival)
            said += texts
        if self.kept is not None:  # nor does what has gone tell more than it told
            before = dict(zip(self.kept.names, zip(self.kept.disagreement, self.kept.apart, strict=True), strict=True))
            was = np.array([before.get(name, (1.0, 0.0)) for name in problem.prior.names])
            wider = np.maximum(wider, was[:, 0])
            apart = max(apart, was[:, 1], key=lambda each: np.abs(each / problem.prior.std).max(initial=0.0))
        kept = self.kept
        if self.rows - gone > _MOST_ROWS:
            oldest = self.rows - gone - _MOST_ROWS // 2
            gone += oldest
            old, *_ = one_pass(problem.over(_first(problem.samples, oldest)), fit.theta, levels)
            known = healthy_snapshot(old)
            if known is None:
                return None
            kept = Kept(problem.prior.names, known.theta, known.covariance, old.linearised_at, wider, apart)
        state.settings["adapt"], state.settings["considered_share"] = _ADAPT, _REST
        running = Running(whole, problem.prior, state, held, wider, apart, problem.settings, levels, tuple(said))
        rows, inputs = self.rows, self.inputs
        while self.buffer.rows - rows > _FEW:
            after = self.buffer.rows, self.buffer.inputs
            running = caught_up(running, self.buffer, (rows, inputs), after, problem.delay)
            rows, inputs = after
        return Found(running, kept, gone, rows, inputs)

    def _problem(self, stretches: Sequence[Samples]) -> tuple[Prior, JointProblem]:
        question = self.question
        whole = question.whole(self.kept, commands=self.buffer.commands, more=further_unknowns(stretches))
        longest = max(stretches, key=len)
        noise = noise_of_rows(longest.t, longest.values, TYPICAL_NOISE, LEAST_NOISE, _LATEST)
        noise = np.maximum(noise, noise_of_smooth_speeds([each.recorded for each in stretches]))
        problem = JointProblem(
            stretches,
            question.base(whole),
            question.prior(whole, self.kept),
            settings_for(stretches, filter_settings()),
            noise,
            question.delay or 0.0,
            session=True,
        )
        return whole, problem

    def _about(self, problem: JointProblem) -> Array | None:
        """Return what the first pass is linearised about: where the last filter is; None for the prior's mean."""
        last = self.last
        if last is None or replace(problem.settings, wave_period=last.settings.wave_period) != last.settings:
            return None
        known = dict(zip(last.free.names, last.told[0], strict=True))
        if {*FURTHER} & {*problem.prior.names} - {*known} and not last.levels.waves.any():
            return None  # a sensor is heard for the first time: it may show waves
        return np.array([known.get(*each) for each in zip(problem.prior.names, problem.prior.mean, strict=True)])


def is_full(buffer: Buffer) -> bool:
    """Whether rows have to go."""
    return buffer.rows > _MOST_ROWS


def _first(stretches: Sequence[Samples], rows: int) -> list[Samples]:
    """Return the first rows of stretches that follow each other."""
    out: list[Samples] = []
    for each in stretches:
        if rows > 0:
            out.append(each.stretch(0, min(rows, len(each))))
        rows -= len(each)
    return out


def begun_anew(running: Running, empty: Samples, delay: float, elapsed: float | None = None) -> Running:
    """Return the filter before a new stretch: its motion and its inputs begin anew.

    Args:
        elapsed: since the last row [s], where the water is the same.
    """
    state = next_recording(running.state, empty, elapsed)
    return running._replace(state=state, held=inputs_of(empty, running.free, state.linearised_at, delay))


def caught_up(
    running: Running, buffer: Buffer, since: tuple[int, int], until: tuple[int, int], delay: float
) -> Running:
    """Return the filter after the rows and inputs of the buffer from so many to so many."""
    latency = latencies_of(running.free, running.state.linearised_at)
    for new, each in buffer.until(*until, since=since):
        if new:
            running = begun_anew(running, buffer.fresh().whole, delay, since_last(running.state, each.t))
        take_all(running.state, running.held, each.shifted(latency))
    return running


@dataclass
class Schedule:
    """Times [s] of motion: of the next re-estimation, of the last; when the vehicle became what it is; none earlier."""

    next: float = _FIRST
    last: float = 0.0
    began: float = 0.0
    not_before: float = 0.0

    def done(self, seen: float) -> None:
        """Set the next re-estimation after one at `seen`."""
        span = seen - self.began
        self.last, self.next = seen, self.began + span * (_GROWS if _DOUBLES <= span < _FROM_PRIOR else 2.0)

    def call(self, seen: float) -> None:
        """Re-estimate soon: something has become known far from where the motion is linearised."""
        if seen > self.last + max(_OFTEN, (self.last - self.began) * _OFTEN_SHARE):
            self.next = min(self.next, max(seen, self.not_before))

    def anew(self, seen: float, first: float) -> None:
        """Begin again with a vehicle, or water, that has changed; first re-estimate after so long [s]."""
        self.began = self.last = seen
        self.next = seen + first
        self.not_before = self.next if first > _DOUBLES else seen

    @property
    def settled(self) -> bool:
        """Whether passes have told how the water moves, since it began to move otherwise."""
        return self.not_before <= self.began

    def settle(self) -> None:
        """Take note that they have."""
        self.not_before = self.began

    def behind(self, seen: float) -> bool:
        """Whether one is due, or the last one saw far less than has been seen by now."""
        return seen >= self.not_before and seen >= min(
            self.next, max(_FIRST, self.began + 1.25 * (self.last - self.began))
        )

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
