"""The joint filter on a stream, and in its first minutes re-estimations from what it saw.

A Kalman filter that starts in ignorance linearises about wrong coefficients. So what was seen is kept for a while, and
at times that grow the filter goes over it once more, linearised about what is known by then: about its own
coefficients, about those of least squares (which runs beside it and needs no start), and, where the delay is not given,
about a bank of delays. The likelihood of the innovations chooses among them. Noise and disturbance are levelled anew
each time. Between two re-estimations the filter stays linear; a coefficient that becomes known far from where it was
linearised calls for the next one. Later the filter goes on alone, its point of linearisation following the
coefficients, and coefficients of which the motion says next to nothing are only considered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import ZeroOrderHold, hold_force, restored_hold
from towtank.identification.changes.detector import ChangeTracker
from towtank.identification.data.samples import N_MEASURED, Buffer, NoiseLevels, Samples
from towtank.identification.kalman.filter import joint_events, joint_step, rows_of, take_all
from towtank.identification.kalman.iterated import inputs_of
from towtank.identification.kalman.state import (
    HealthySnapshot,
    JointState,
    has_moved,
    healthy_snapshot,
    recovered,
    restored_state,
)
from towtank.identification.model.parameters import LAG, FreeParameters, free_parameters
from towtank.identification.model.terms import DISTURBANCE
from towtank.identification.online.least_squares import PaperLearner
from towtank.identification.online.reestimation import Reestimation
from towtank.identification.online.schedule import ReestimationJob, ReestimationSchedule
from towtank.recording.event import Event
from towtank.vehicle import Vehicle, configuration_matrix

__all__: list[str] = []

_ADAPT = 10.0  # s over which the live filter follows the disturbance
_REST = 0.05  # share of a steady pace of learning below which a coefficient is only considered
_CHECKED, _CHECKED_EARLY = 1.0, 0.25  # s from one check of the filter's health to the next, and while it re-estimates
_CHUNK = 1000  # rows, likewise, of a recording
_MOST_EARLY = 500  # rows kept before the first input


class Running(NamedTuple):
    """The filter that runs: its free coefficients, itself, the inputs that it is given."""

    free: FreeParameters
    state: JointState
    held: ZeroOrderHold


class JointStream:
    """The filter with what it needs to re-estimate.

    Args:
        vehicle: what is known. requested: names to learn, None for all that can be.
        delay: of the inputs [s] where it is given. prior: a vehicle whose coefficients bear deviations.
        paper: the least squares that runs beside it, fed by the caller while `reestimating`.
        background: re-estimations run beside the stream, in a thread; the stream does not wait for them.
        current: of the water, estimated along.
        known: configurations that the vehicle may become, by name; None: changes are not watched for.

    Attributes:
        running: the filter, None before the first re-estimation. levels: of noise, as they are taken to be.
        delay: of the inputs [s] where it is not free. seen: rows [s]. recoveries: how often the filter had to recover.
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
        self.vehicle, self.delay = vehicle, vehicle.command_delay if delay is None else delay
        self.reestimating = True
        self.seen = 0.0
        self.running: Running | None = None
        self.levels = NoiseLevels(np.full(N_MEASURED, 1e-3), np.array(DISTURBANCE), np.full(6, np.nan))
        self.reestimations = ReestimationSchedule(
            vehicle,
            requested,
            delay=delay,
            prior=prior,
            levels=self.levels,
            paper=paper,
            background=background,
            current=current,
        )
        self.recoveries = 0
        self._buffer: Buffer | None = None  # from the first input on
        self._early: list[tuple[float, Array]] = []
        self._next_check, self._last_t = 0.0, -np.inf
        self._healthy: HealthySnapshot | None = None
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
        if self.running is not None:
            hold_force(self.running.held, t, force)
            self.changes.take_input(t, force)

    def take_row(self, t: float, z: Array) -> bool:
        """Take the measurements z (18,) of time t [s]; return whether anything was learned from them."""
        if not (np.isfinite(t) and t > self._last_t):
            return False
        if np.isfinite(self._last_t):
            self.seen += min(t - self._last_t, 1.0)
        self._last_t = t
        buffer = self._buffer
        if buffer is None:
            self._early = [*self._early[-_MOST_EARLY:], (t, z)]
            return False
        if self.reestimating:
            buffer.add_row(t, z)
        learned = False
        if self.running is not None:
            learned = joint_step(self.running.state, self.running.held, t, z)
            if self.changes.watching:
                self._detect_change(buffer, self.running, t, z)
            if self.seen >= self._next_check:
                self._next_check = self.seen + (_CHECKED_EARLY if self.reestimating else _CHECKED)
                self._check(buffer, self.running)
        if self.reestimating:
            self._reestimate(buffer)
        return learned

    def take_rows(self, samples: Samples, first: int, pushed: int) -> None:
        """Take rows of a recording from `first` on, its inputs from `pushed` on, after the last re-estimation."""
        for start in range(first, len(samples), _CHUNK):
            if self.running is None or self._buffer is None:
                return
            end = min(start + _CHUNK, len(samples))
            pushed = joint_events(self.running.state, self.running.held, rows_of(samples), start, end, pushed)
            self._check(self._buffer, self.running)
        self._last_t = float(samples.t[-1])

    def break_off(self) -> None:
        """Begin a new stretch: motion is not drawn across to it."""
        self._last_t = -np.inf
        if self._buffer is not None:
            self._buffer.break_off()
            if self.running is not None:
                self.running = self._begun_anew(self._buffer, self.running.free, self.running.state)
        self.changes.restart()

    # -- what is known

    @property
    def rows(self) -> int:
        """Rows that something was learned from."""
        return 0 if self.running is None else int(self.running.state.clock[0].rows)

    @property
    def _known(self) -> tuple[FreeParameters, JointState] | None:
        return None if self.running is None else (self.running.free, self.running.state)

    @property
    def commanded(self) -> bool:
        """Whether the inputs are commands of thrusters."""
        return self._buffer is not None and self._buffer.commands

    @property
    def left_out(self) -> dict[str, str]:
        """Damping terms that are taken as 0, and why."""
        names = () if self.running is None else self.running.free.names
        return {name: why for name, why in self.reestimations.damping.items() if why and name not in names}

    def value(self, name: str, other: float) -> float:
        """Return the coordinate of a free parameter, `other` where it is not free."""
        if self.running is None or name not in self.running.free.names:
            return other
        return float(self.running.state.theta[self.running.free.names.index(name)])

    @property
    def lag(self) -> float:
        """Time constant of the thrusters [s] where it is free; NaN where it is not."""
        return float(np.exp(self.value(LAG, np.nan)))

    @property
    def stretches(self) -> list[Samples]:
        """What a re-estimation would go over; views, not copies."""
        return [] if self._buffer is None else self._buffer.stretches

    # -- to a file and back

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return what it knows: plain data, and arrays by name.

        A re-estimation that runs beside is not waited for: the stream that is made of them begins it anew.
        """
        running, buffer = self.running, self._buffer
        plain: dict[str, Any] = {
            "free": None if running is None else running.free.names,
            "reestimating": self.reestimating,
            "seen": self.seen,
            "recoveries": self.recoveries,
            "watching": self.changes.watching,
            "overdispersion": self.changes.overdispersion,
            "events": [[each.t, each.kind, each.text, dict(each.details)] for each in self.changes.events],
            "next_check": self._next_check,
            "last_t": self._last_t if np.isfinite(self._last_t) else None,
            "reestimations": self.reestimations.plain(self.seen),
            "buffer": None if buffer is None else {"commands": buffer.commands, "starts": buffer.starts},
        }
        groups: dict[str, dict[str, Any]] = {
            "levels": _arrays_of(self.levels),
            "next": _arrays_of(self.reestimations.levels),
        }
        if buffer is not None:
            whole = buffer.whole
            rows = {"t": whole.t, "values": whole.values, "input_t": whole.input_t, "input_force": whole.input_force}
            groups["buffer"] = {"B": buffer.B, "lag": buffer.lag, **rows}
        if running is not None:
            groups |= {"state": running.state._asdict(), "held": running.held._asdict()}
        return plain, {f"{group}.{name}": value for group, each in groups.items() for name, value in each.items()}

    def restore(self, plain: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        """Go on with what `to_arrays` of another stream of the same vehicle and settings gave."""

        def group(name: str) -> dict[str, Any]:
            return {key.removeprefix(f"{name}."): array for key, array in arrays.items() if key.startswith(f"{name}.")}

        events = [Event(t, kind, text, details) for t, kind, text, details in plain["events"]]
        self.changes.restore(events, plain["overdispersion"])
        self.reestimating = bool(plain["reestimating"])
        self.reestimations.restore(plain["reestimations"], NoiseLevels(**group("next")))
        self.seen, self.recoveries = float(plain["seen"]), int(plain["recoveries"])
        self._next_check = float(plain["next_check"])
        self._last_t = -np.inf if plain["last_t"] is None else float(plain["last_t"])
        self.levels = NoiseLevels(**group("levels"))
        if plain["buffer"] is not None:
            rows = group("buffer")
            self._buffer = Buffer(rows.pop("B"), rows.pop("lag"), commands=bool(plain["buffer"]["commands"]))
            self._buffer.restore(**rows, starts=plain["buffer"]["starts"])
        if plain["free"] is not None:
            free = free_parameters(self.vehicle, plain["free"])
            self.running = Running(free, restored_state(arrays, "state."), restored_hold(arrays, "held."))
            self._healthy = healthy_snapshot(self.running.state)

    # -- inside

    def settle(self) -> None:
        """Wait for a re-estimation that runs beside; begin one more where the stream has left them behind."""
        buffer = self._buffer
        if not self.reestimating or buffer is None:
            return
        self._fetch(buffer, wait=True)
        job = self.reestimations.one_more(self.seen, buffer, self._known, self.delay)
        if job is not None:
            self._adopt(buffer, job, job.run())

    def _fetch(self, buffer: Buffer, *, wait: bool = False) -> None:
        done = self.reestimations.fetch(wait=wait)
        if done is not None:
            self._adopt(buffer, *done)

    def _reestimate(self, buffer: Buffer) -> None:
        """Fetch a re-estimation that is done, begin the next one when it is due, and end with the last."""
        self._fetch(buffer)
        job = self.reestimations.due(self.seen, buffer, self._known, self.delay)
        if job is not None:
            self._adopt(buffer, job, job.run())
        if self.reestimations.last_one and not self.reestimations.busy:
            self._go_on_alone(buffer)

    def _adopt(self, buffer: Buffer, job: ReestimationJob, result: Reestimation | None) -> None:
        """Go on with the likeliest, and catch up with what came while the job ran beside."""
        if result is None:
            return
        self.levels = result.levels
        self.reestimations.adopt(result)
        free, state, held = running = Running(result.free, result.state, result.held)
        state.settings["adapt"] = _ADAPT
        state.settings["relinearise"] = 0.0
        state.disturbance[:] = self.levels.disturbance
        self.changes.restart()
        for new, each in buffer.since(job.rows, job.inputs):
            if new:
                free, state, held = running = self._begun_anew(buffer, free, state)
            take_all(state, held, each)
        self.running = running
        self._healthy = healthy_snapshot(state) or self._healthy

    def _go_on_alone(self, buffer: Buffer) -> None:
        self.reestimating = False
        if self.running is not None:
            state = self.running.state
            state.settings["relinearise"], state.settings["considered_share"] = 1.0, _REST
        self._buffer = buffer.fresh()
        self.reestimations.end()

    def _check(self, buffer: Buffer, running: Running) -> None:
        """Let a filter that has lost itself recover; re-estimate soon where a coefficient has moved far."""
        snapshot = healthy_snapshot(running.state)
        if snapshot is None:
            if self._healthy is not None:
                self._recover(buffer, running, self._healthy)
            return
        self._healthy = snapshot
        if self.reestimating and has_moved(running.state, snapshot):
            self.reestimations.schedule.call(self.seen)

    def _recover(self, buffer: Buffer, running: Running, healthy: HealthySnapshot) -> None:
        self.recoveries += 1
        state = recovered(running.state, healthy, running.free, self.reestimations.settings)
        self.running = Running(running.free, state, self._fresh_held(buffer, running.free, state.linearised_at))
        self.changes.recovered(self._last_t)

    def _detect_change(self, buffer: Buffer, running: Running, t: float, z: Array) -> None:
        """Go on with the filter that saw a change, where one did."""
        found = self.changes.take_row(t, z, self.seen, running, buffer, may_reestimate=self.reestimating)
        if found is None:
            if self.changes.requested == t:
                self.reestimations.schedule.call(self.seen, at_once=True)
            return
        self.running = Running(found.free, found.state, found.held)
        found.state.settings["considered_share"] = _REST
        self._healthy = healthy_snapshot(found.state) or self._healthy
        if self.reestimating:
            self._go_on_alone(buffer)

    def _begun_anew(self, buffer: Buffer, free: FreeParameters, state: JointState) -> Running:
        """Return the filter before a new stretch: its motion and its inputs begin anew."""
        state.clock["started"] = 0.0
        return Running(free, state, self._fresh_held(buffer, free, state.linearised_at))

    def _fresh_held(self, buffer: Buffer, free: FreeParameters, theta: Array) -> ZeroOrderHold:
        empty = buffer.fresh()
        empty.add_row(0.0, np.full(N_MEASURED, np.nan))
        return inputs_of(empty.stretches[0], free, theta, self.delay)


def _arrays_of(levels: NoiseLevels) -> dict[str, Array]:
    return {each.name: getattr(levels, each.name) for each in fields(levels)}
