"""The second looks of a stream: when the next is due, what it begins with, and what it leaves for the one after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from towtank.core.arrays import Array
from towtank.identification.joint_begin import look_levels, look_starts
from towtank.identification.joint_buffer import Buffer
from towtank.identification.joint_damping import Pair, damping_in_question
from towtank.identification.joint_job import Beside, LookJob
from towtank.identification.joint_look import Look, axes_seen, bank_of_delays, begun_later, names_now
from towtank.identification.joint_schedule import STILL, Schedule
from towtank.identification.joint_start import prior_information, tuning_for
from towtank.identification.joint_state import JointState
from towtank.identification.log_learning import Levels
from towtank.identification.paper_learner import PaperLearner
from towtank.identification.parameters import DELAY, FreeParameters, free_parameters
from towtank.vehicle import Vehicle

__all__ = ["Looks"]

_MOST_LEFT_OUT = 1.0  # s
_DAMPING = 7.0  # s of motion from which looks choose between damping terms
_STIRRED = 2  # looks that find the water plainly stirred, after which none asks again


class Looks:
    """All looks of one stream.

    Args:
        vehicle: what is known. asked: names to learn, None for all that can be.
        delay: of the inputs [s] where it is given. prior: a vehicle whose coefficients bear deviations.
        levels: that the first look tries.
        paper: the least squares that runs beside the stream.
        background: looks run in a thread of their own.
        current: of the water, estimated along.

    Attributes:
        schedule: when. levels: that the next look tries. stirred: looks so far that found the water stirred.
        last_one: whether there are no more. left_out: seconds at the beginning that looks do not go over.
        damping: damping terms that were chosen, and why others are left out: "" for the former.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        asked: tuple[str, ...] | None,
        *,
        delay: float | None,
        prior: Vehicle | None,
        levels: Levels,
        paper: PaperLearner | None,
        background: bool,
        current: bool,
    ) -> None:
        self.schedule, self.levels, self.stirred, self.last_one = Schedule(), levels, 0, False
        self.left_out = 0.0
        self.damping: dict[str, str] = {}
        self.tuning = replace(tuning_for(vehicle), current=current)
        self._vehicle, self._asked, self._prior, self._paper = vehicle, asked, prior, paper
        self._delay = delay
        self._beside = Beside() if background else None

    @property
    def busy(self) -> bool:
        """Whether one runs beside."""
        return self._beside is not None and self._beside.busy

    def due(
        self, seen: float, buffer: Buffer, known: tuple[FreeParameters, JointState] | None, delay: float
    ) -> LookJob | None:
        """Return the look that is due after `seen` seconds and has to be waited for; begin one that has not.

        Args:
            buffer: what was seen. known: the filter by now. delay: of the inputs [s] where it is not free.
        """
        if self.busy or self.last_one or seen < self.schedule.next:
            return None
        job = self._job(seen, buffer, known, delay)
        self.schedule.looked(seen)
        self.last_one = self.schedule.over(buffer.rows)
        if job is not None and self._beside is not None:
            self._beside.begin(job)
            return None
        return job

    def one_more(
        self, seen: float, buffer: Buffer, known: tuple[FreeParameters, JointState] | None, delay: float
    ) -> LookJob | None:
        """Return a look where looks beside have been left behind by the stream. Arguments as `due`."""
        if self._beside is None or not self.schedule.behind(seen):
            return None
        job = self._job(seen, buffer, known, delay)
        if job is not None:
            self.schedule.looked(seen)
        return job

    def fetch(self, *, wait: bool = False) -> tuple[LookJob, Look | None] | None:
        """Return a look that ran beside, once it is done; None before, unless told to wait."""
        return self._beside.fetch(wait=wait) if self._beside is not None else None

    def took(self, seen: Look) -> None:
        """Go on from what a look saw."""
        self.levels = seen.next
        self.stirred += seen.stirred
        self.left_out += seen.left_out
        if seen.damping is not None:
            both = [name for pair in self._pairs(seen.free.names) for name in pair]
            self.damping = {name: seen.damping.get(name, "") for name in both}

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
        pairs = damping_in_question(self._vehicle, names, asked=self._asked is not None)
        return [pair for pair in pairs if not any(self._vehicle.coefficient(name) for name in pair)]

    def _known_before(self, free: FreeParameters) -> tuple[Array, Array] | None:
        return None if self._prior is None else prior_information(self._prior, free)

    def _job(
        self, seen: float, buffer: Buffer, known: tuple[FreeParameters, JointState] | None, delay: float
    ) -> LookJob | None:
        """Return a look over everything once more from each start; None where there is nothing to learn yet."""
        stretches = buffer.stretches
        found = None if self._paper is None else self._paper.estimate
        find_delay = self._delay is None and buffer.commands
        names = names_now(self._vehicle, self._asked, found, axes_seen(stretches), with_delay=find_delay)
        names = [name for name in names if not self.damping.get(name)]
        names += [name for name, why in self.damping.items() if not why and name not in names]
        if not any(each.input_t.size for each in stretches) or not names:
            return None
        stretches = begun_later(stretches, self.left_out)
        free = free_parameters(self._vehicle, names)
        own, cold = look_starts(self._vehicle, known, free, found, delay)
        elsewhere = self.schedule.other_starts(seen)
        starts = [cold] if own is None or elsewhere else []
        if elsewhere and DELAY in free.names and self.schedule.bank(seen):
            starts += bank_of_delays(free, cold if own is None else own)
        longest = max(stretches, key=lambda each: each.t.size)
        return LookJob(
            stretches,
            self.without(self._vehicle),
            free,
            own,
            starts,
            look_levels(longest, self.levels, first=own is None),
            self.tuning,
            delay=delay,
            prior=self._known_before,
            reserve=cold,
            still=seen < STILL and self.stirred < _STIRRED,
            may_begin_later=elsewhere and self.left_out < _MOST_LEFT_OUT,
            pairs=self._pairs(names) if seen >= _DAMPING else (),
            asked=self._asked is not None,
            rows=buffer.rows,
            inputs=buffer.inputs,
        )
