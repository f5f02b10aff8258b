"""The joint filter on a stream, and in its first minutes second looks at what it saw.

A Kalman filter that starts in ignorance linearises about wrong coefficients. So what was seen is kept for a while, and
at times that grow the filter goes over it once more, linearised about what is known by then: about its own
coefficients, about those of least squares (which runs beside it and needs no start), and, where the delay is not given,
about a bank of delays. The likelihood of the innovations chooses among them. Noise and disturbance are levelled anew
each time. Between two looks the filter stays linear; a coefficient that becomes known far from where it was linearised
calls for the next one. Later the filter goes on alone, its anchor following the coefficients, and coefficients of which
the motion tells next to nothing rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.changes.detector import ChangeTracker
from towtank.identification.data.noise import NoiseLevels
from towtank.identification.data.samples import N_MEASURED, Buffer, Samples
from towtank.identification.data.zero_order_hold import ZeroOrderHold, hold_force
from towtank.identification.kalman.filter import joint_events, joint_step, rows_of, take_all
from towtank.identification.kalman.iterated import inputs_of
from towtank.identification.kalman.state import HealthySnapshot, JointState, has_moved, healthy_snapshot, recovered
from towtank.identification.model.parameters import LAG, FreeParameters
from towtank.identification.model.prior import usual_disturbance
from towtank.identification.online.least_squares import PaperLearner
from towtank.identification.online.reestimation import Reestimation
from towtank.identification.online.schedule import ReestimationJob, ReestimationSchedule
from towtank.vehicle import Vehicle, configuration_matrix

__all__ = ["JointStream"]

_ADAPT = 10.0  # s over which the live filter follows the disturbance
_REST = 0.05  # share of a steady pace of learning below which a coefficient rests
_CHECKED, _CHECKED_EARLY = 1.0, 0.25  # s from one check of the filter's health to the next, and while it looks back
_CHUNK = 1000  # rows, likewise, of a recording


class JointStream:
    """The filter with what it needs to look again.

    Args:
        vehicle: what is known. asked: names to learn, None for all that can be.
        delay: of the inputs [s] where it is given. prior: a vehicle whose coefficients bear deviations.
        paper: the least squares that runs beside it, fed by the caller while `reestimating`.
        background: looks run beside the stream, in a thread; the stream does not wait for them.
        current: of the water, estimated along.
        known: configurations that the vehicle may become, by name; None: changes are not watched for.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        requested: tuple[str, ...] | None,
        *,
        delay: float | None,
        prior: Vehicle | None,
        paper: PaperLearner | None,
        background: bool = False,
        current: bool = False,
        known: Mapping[str, Vehicle] | None = None,
    ) -> None:
        self.vehicle, self.requested, self.given_delay = vehicle, requested, delay
        self.delay = vehicle.command_delay if delay is None else delay
        self.reestimating = True
        self.seen = 0.0  # s of rows
        self.free: FreeParameters | None = None
        self.state: JointState | None = None
        self.levels = NoiseLevels(np.full(N_MEASURED, 1e-3), usual_disturbance(vehicle), np.full(6, np.nan))
        self.looks = ReestimationSchedule(
            vehicle,
            requested,
            delay=delay,
            prior=prior,
            levels=self.levels,
            paper=paper,
            background=background,
            current=current,
        )
        self.mended = 0
        self._buffer: Buffer | None = None
        self._early: list[tuple[float, Array]] = []
        self._held: ZeroOrderHold | None = None
        self._next_check, self._last_t = 0.0, -np.inf
        self._sound: HealthySnapshot | None = None
        self.changes = ChangeTracker(vehicle, known)

    # -- data in

    def take_input(self, t: float, force: Array, *, commands: bool) -> None:
        """Take the forces (m,) that the thrusters are asked for from t [s] on."""
        if not (np.isfinite(t) and np.isfinite(force).all()):
            return
        if self._buffer is None:
            shape = configuration_matrix(self.vehicle) if commands else np.eye(6)
            lag = np.array([thruster.time_constant for thruster in self.vehicle.thrusters]) if commands else np.zeros(6)
            self._buffer = Buffer(shape, lag, commands=commands)
            for row in self._early:
                self._buffer.add_row(*row)
            self._early.clear()
        if self.reestimating:
            self._buffer.add_input(t, force)
        if self._held is not None:
            hold_force(self._held, t, force)
            self.changes.take_input(t, force)

    def take_row(self, t: float, z: Array) -> bool:
        """Take the measurements z (15,) of time t [s]; return whether they taught anything."""
        if not (np.isfinite(t) and t > self._last_t):
            return False
        if np.isfinite(self._last_t):
            self.seen += min(t - self._last_t, 1.0)
        self._last_t = t
        if self._buffer is None:
            self._early = [*self._early[-500:], (t, z)]
            return False
        if self.reestimating:
            self._buffer.add_row(t, z)
        learned = False
        if self.state is not None and self._held is not None:
            learned = joint_step(self.state, self._held, t, z)
            if self.changes.watching:
                self._look_for_change(t, z)
            if self.seen >= self._next_check:
                self._next_check = self.seen + (_CHECKED_EARLY if self.reestimating else _CHECKED)
                self._check()
        if self.reestimating:
            self._reestimate()
        return learned

    def take_rows(self, samples: Samples, first: int, pushed: int) -> None:
        """Take rows of a recording from `first` on, its inputs from `pushed` on, once there are no looks any more."""
        if self.state is None or self._held is None:
            return
        for start in range(first, len(samples), _CHUNK):
            end = min(start + _CHUNK, len(samples))
            pushed = joint_events(self.state, self._held, rows_of(samples), start, end, pushed)
            self._check()
        self._last_t = float(samples.t[-1])

    def break_off(self) -> None:
        """Begin a new stretch: motion is not drawn across to it."""
        self._last_t = -np.inf
        if self._buffer is not None:
            self._buffer.break_off()
        if self.state is not None and self.free is not None:
            self.state.clock["started"] = 0.0
            self._held = self._fresh_held(self.free, self.state.linearised_at)
        self.changes.restart()

    # -- what is known

    @property
    def rows(self) -> int:
        """Rows that taught something."""
        return 0 if self.state is None else int(self.state.clock[0].rows)

    @property
    def busy(self) -> bool:
        """Whether a look runs beside."""
        return self.looks.busy

    @property
    def _known(self) -> tuple[FreeParameters, JointState] | None:
        return None if self.state is None or self.free is None else (self.free, self.state)

    @property
    def commanded(self) -> bool:
        """Whether the inputs are commands of thrusters."""
        return self._buffer is not None and self._buffer.commands

    @property
    def left_out(self) -> dict[str, str]:
        """Damping terms that are taken as 0, and why."""
        names = () if self.free is None else self.free.names
        return {name: why for name, why in self.looks.damping.items() if why and name not in names}

    def value(self, name: str, other: float) -> float:
        """Return the coordinate of a free parameter, `other` where it is not free."""
        if self.state is None or self.free is None or name not in self.free.names:
            return other
        return float(self.state.theta[self.free.names.index(name)])

    # -- inside

    def settle(self) -> None:
        """Wait for a look that runs beside; look once more where the stream has left looks behind."""
        if not self.reestimating or self._buffer is None:
            return
        self._fetch(wait=True)
        job = self.looks.one_more(self.seen, self._buffer, self._known, self.delay)
        if job is not None:
            self._adopt(job, job.run())

    def _fetch(self, *, wait: bool = False) -> None:
        done = self.looks.fetch(wait=wait)
        if done is not None:
            self._adopt(*done)

    def _reestimate(self) -> None:
        """Fetch a look that is done, begin the next one when it is due, and end with the last."""
        assert self._buffer is not None
        self._fetch()
        job = self.looks.due(self.seen, self._buffer, self._known, self.delay)
        if job is not None:
            self._adopt(job, job.run())
        if self.looks.last_one and not self.busy:
            self._go_on_alone()

    def _adopt(self, job: ReestimationJob, seen: Reestimation | None) -> None:
        """Go on with the likeliest, and catch up with what came while the look ran beside."""
        assert self._buffer is not None
        if seen is None:
            return
        self.free, self.state, self._held = seen.free, seen.state, seen.held
        self.levels = seen.levels
        self.looks.took(seen)
        self.state.settings["adapt"] = _ADAPT
        self.state.settings["relinearise"] = 0.0
        self.state.disturbance[:] = self.levels.disturbance
        self.changes.restart()
        for new, each in self._buffer.since(job.rows, job.inputs):
            if new:
                self.state.clock["started"] = 0.0
                self._held = self._fresh_held(self.free, self.state.linearised_at)
            take_all(self.state, self._held, each)
        self._sound = healthy_snapshot(self.state)

    def _go_on_alone(self) -> None:
        assert self._buffer is not None
        self.reestimating = False
        if self.state is not None:
            self.state.settings["relinearise"], self.state.settings["considered_share"] = 1.0, _REST
        self._buffer = self._buffer.fresh()
        self.looks.end()

    def _check(self) -> None:
        """Mend a filter that has lost itself; look soon where a coefficient has left its point of linearisation."""
        if self.state is None or self.free is None:
            return
        found = healthy_snapshot(self.state)
        if found is None:
            self._mend(self.state, self.free)
            return
        self._sound = found
        if self.reestimating and has_moved(self.state, found):
            self.looks.schedule.call(self.seen)

    def _mend(self, state: JointState, free: FreeParameters) -> None:
        assert self._sound is not None  # every look leaves one
        self.mended += 1
        self.state = recovered(state, self._sound, free, self.looks.settings)
        self._held = self._fresh_held(free, self.state.linearised_at)
        self.changes.recovered(self._last_t)

    def _look_for_change(self, t: float, z: Array) -> None:
        """Go on with the filter that saw a change, where one did."""
        assert self._buffer is not None
        assert self.state is not None
        assert self._held is not None
        assert self.free is not None
        known = self.free, self.state, self._held
        found = self.changes.take_row(t, z, self.seen, known, self._buffer, may_reestimate=self.reestimating)
        if found is None:
            if self.changes.requested == t:
                self.looks.schedule.call(self.seen, at_once=True)
            return
        self.free, self.state, self._held = found.free, found.state, found.held
        self.state.settings["considered_share"] = _REST
        self._sound = healthy_snapshot(self.state) or self._sound
        if self.reestimating:
            self._go_on_alone()

    def _fresh_held(self, free: FreeParameters, theta: Array) -> ZeroOrderHold:
        assert self._buffer is not None
        empty = self._buffer.fresh()
        empty.add_row(0.0, np.full(N_MEASURED, np.nan))
        return inputs_of(empty.stretches[0], free, theta, self.delay)

    @property
    def lag(self) -> float:
        """Time constant of the thrusters [s] where it is free; NaN where it is not."""
        return float(np.exp(self.value(LAG, np.nan)))
