"""The joint estimator on a stream: the filter, sample by sample, and in its first minutes second looks at what it saw.

A Kalman filter that starts in ignorance linearises about wrong coefficients. So what was seen is kept for a while, and
at times that grow the filter goes over it once more, linearised about what is known by then: about its own
coefficients, about those of least squares (which runs beside it and needs no start), and, where the delay is not given,
about a bank of delays. The likelihood of the innovations chooses among them. Noise and disturbance are levelled anew
each time. Later the filter goes on alone, its anchor following the coefficients.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.estimate import Estimate
from towtank.identification.held_input import HeldInput, held_push
from towtank.identification.joint import bounded, held_of
from towtank.identification.joint_buffer import Buffer
from towtank.identification.joint_kernel import joint_events, joint_step
from towtank.identification.joint_look import bank_of_delays, look, names_now
from towtank.identification.joint_reading import nothing_yet, reading
from towtank.identification.joint_start import (
    prior_information,
    rows_noise,
    start_theta,
    tuning_for,
    usual_disturbance,
)
from towtank.identification.joint_state import (
    C_ROWS,
    C_STARTED,
    O_ADAPT,
    O_FOLLOW,
    JointState,
)
from towtank.identification.learner import Learner, sample_vector
from towtank.identification.log_learning import Levels
from towtank.identification.paper_learner import PaperLearner
from towtank.identification.parameters import DELAY, LAG, FreeParameters, free_parameters
from towtank.identification.samples import N_MEASURED, held_forces, samples_of, with_absent_zero
from towtank.identification.structure import paper_names
from towtank.identification.thrust_scale import with_thrust_scale
from towtank.recording import Recording
from towtank.vehicle import Vehicle, configuration_matrix

__all__ = ["JointLearner"]

_OFTEN = 0.25  # s between two looks at least
_FIRST_LOOK = 0.5  # s of motion
_EARLY, _GROWS_EARLY, _GROWS = 8.0, 1.25, 2.0  # s; from one look to the next, until then and later
_BOTH_STARTS, _STARTS_GROW = 30.0, 2.0  # s: until then looks at doubling times start from least squares too,
_LAST_LOOK = 120.0  # s of samples kept,
_MOST_ROWS = 40_000
_BANK_UNTIL = 5.0  # s: and until then from a bank of delays
_ROUNDS = 1  # pass more of an early look, with the levels that it shows
_ADAPT = 10.0  # s over which the live filter follows the disturbance
_LAG = 0.05  # s, to begin with


class JointLearner(Learner):
    """The joint estimator, streaming.

    Args:
        vehicle: rigid body, thrusters, and values for whatever is not learned.
        method: "joint".
        free: names of the coefficients to learn, `lag` and `gain_<thruster>` among them; by default every inertia, the
            damping terms that the vehicle has (both where it has none), righting moments and net weight.
        delay: from input to force [s]; found where omitted and the inputs are commands.
        prior: a vehicle whose coefficients bear deviations: what is known beforehand.
        paper: further settings of the least squares that runs beside it.

    Raises:
        InputError: an unknown name or setting.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        method: str = "joint",
        *,
        free: Collection[str] | None = None,
        delay: float | None = None,
        prior: Vehicle | None = None,
        **paper: Any,
    ) -> None:
        if method != "joint":
            raise InputError(f'method: found "{method}", expected "joint"')
        if delay is not None and not 0.0 <= delay < np.inf:
            raise InputError(f"delay: found {delay}, expected a number of seconds, 0 or more")
        self.vehicle, self.method, self.prior = vehicle, method, prior
        self._asked = None if free is None else tuple(free)
        if self._asked is not None:
            free_parameters(vehicle, self._asked)  # names are right
            known = [name for name in self._asked if name in paper_names()]
            self._paper: PaperLearner | None = (
                PaperLearner(vehicle, free=known, delay=delay, **paper) if known else None
            )
        else:
            self._paper = PaperLearner(vehicle, delay=delay, **paper)
        self._given_delay = delay
        self._delay = vehicle.command_delay if delay is None else delay
        self._tuning = tuning_for(vehicle)
        self._buffer: Buffer | None = None
        self._early: list[tuple[float, Array]] = []
        self._looking = True
        self._next_look, self._next_start = _FIRST_LOOK, _FIRST_LOOK
        self._seen = 0.0  # s of rows
        self._last_t = -np.inf
        self._levels = Levels(np.full(N_MEASURED, 1e-3), usual_disturbance(vehicle))
        self._free: FreeParameters | None = None
        self._state: JointState | None = None
        self._held: HeldInput | None = None
        self._pushed_t = -np.inf
        self._estimate: Estimate | None = None

    # -- data in

    def update(
        self,
        t: float,
        *,
        pose: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        commands: ArrayLike | None = None,
        wrench: ArrayLike | None = None,
        voltage: float | None = None,
    ) -> bool:
        """Take the sample of time t [s]; see `Learner.update`."""
        p, v = sample_vector(pose, 6, "pose"), sample_vector(velocity, 6, "velocity")
        z = np.concatenate([p, v, sample_vector(acceleration, 3, "acceleration")])
        force: Array | None = None
        if commands is not None:
            c = sample_vector(commands, len(self.vehicle.thrusters), "commands")
            force = held_forces(self.vehicle, c, voltage)
        elif wrench is not None:
            force = with_absent_zero(sample_vector(wrench, 6, "wrench")[None])[0]
        if self._looking and self._paper is not None:
            self._paper.update(
                t, pose=p, velocity=v, acceleration=z[12:], commands=commands, wrench=wrench, voltage=voltage
            )
        return self._take(float(t), z, force, commands=commands is not None)

    def run(self, recording: Recording) -> int:
        """Take a whole recording; see `Learner.run`."""
        samples = samples_of(recording, self.vehicle)
        if self._seen > 0.0:
            self.restart()
        before = self._rows
        pushed = i = 0
        while i < len(samples) and self._looking:
            while pushed < len(samples.input_t) and samples.input_t[pushed] <= samples.t[i]:
                self._input(float(samples.input_t[pushed]), samples.input_force[pushed], commands=samples.commands)
                if self._paper is not None:
                    self._paper.push(
                        float(samples.input_t[pushed]), samples.input_force[pushed], commands=samples.commands
                    )
                pushed += 1
            z = samples.values[i]
            if self._paper is not None:
                self._paper.update(float(samples.t[i]), pose=z[:6], velocity=z[6:12], acceleration=z[12:])
            self._row(float(samples.t[i]), z)
            i += 1
        if i < len(samples) and self._state is not None and self._held is not None:
            joint_events(
                self._state,
                self._held,
                samples.t,
                samples.values,
                samples.input_t,
                samples.input_force,
                True,
                i,
                len(samples),
                pushed,
            )
            self._estimate = None
            self._last_t = float(samples.t[-1])
        return self._rows - before

    def restart(self) -> None:
        """Begin a new stretch; see `Learner.restart`."""
        self._last_t = -np.inf
        if self._buffer is not None:
            self._buffer.break_off()
        if self._paper is not None:
            self._paper.restart()
        if self._state is not None and self._free is not None and self._buffer is not None:
            self._state.clock[C_STARTED] = 0.0
            self._held = self._fresh_held()

    # -- results out

    @property
    def delay(self) -> float:
        """From input to force [s], as far as it is known by now."""
        return self._value(DELAY, self._delay)

    @property
    def lag(self) -> float:
        """Time constant of the thrusters [s] where it is free; NaN where it is not."""
        return float(np.exp(self._value(LAG, np.nan)))

    @property
    def disturbance(self) -> Array:
        """Level (6,) [N, N m] of the random force that the motion shows."""
        return self._levels.sigma.copy() if self._state is None else self._state.sigma.copy()

    @property
    def estimate(self) -> Estimate:
        """What has been learned so far."""
        if self._estimate is None:
            self._estimate = self._assembled()
        return self._estimate

    def model(self) -> Vehicle:
        """Return the vehicle with everything identified so far put in."""
        learned = self.estimate.model(self.vehicle, f"learned by towtank, method {self.method}")
        if self._buffer is not None and self._buffer.commands:
            changes: dict[str, Any] = {"command_delay": max(0.0, self.delay)}
            if np.isfinite(self.lag):
                changes["thrusters"] = tuple(
                    thruster.model_copy(update={"time_constant": self.lag}) for thruster in self.vehicle.thrusters
                )
            learned = learned.model_copy(update=changes)
        return learned

    # -- inside

    @property
    def _rows(self) -> int:
        return 0 if self._state is None else int(self._state.clock[C_ROWS])

    def _value(self, name: str, other: float) -> float:
        if self._state is None or self._free is None or name not in self._free.names:
            return other
        return float(self._state.theta[self._free.names.index(name)])

    def _take(self, t: float, z: Array, force: Array | None, *, commands: bool) -> bool:
        if force is not None:
            self._input(t, force, commands=commands)
        return self._row(t, z) if np.isfinite(z).any() else False

    def _input(self, t: float, force: Array, *, commands: bool) -> None:
        if not (np.isfinite(t) and np.isfinite(force).all()):
            return
        if self._buffer is None:
            shape = configuration_matrix(self.vehicle) if commands else np.eye(6)
            lag = np.array([thruster.time_constant for thruster in self.vehicle.thrusters]) if commands else np.zeros(6)
            self._buffer = Buffer(shape, lag, commands=commands)
            for row in self._early:
                self._buffer.add_row(*row)
            self._early.clear()
        if self._looking:
            self._buffer.add_input(t, force)
        if self._held is not None:
            held_push(self._held, t, force)

    def _row(self, t: float, z: Array) -> bool:
        if not (np.isfinite(t) and t > self._last_t):
            return False
        if np.isfinite(self._last_t):
            self._seen += min(t - self._last_t, 1.0)
        self._last_t = t
        self._estimate = None
        if self._buffer is None:
            self._early = [*self._early[-500:], (t, z)]
            return False
        if self._looking:
            self._buffer.add_row(t, z)
        learned = False
        if self._state is not None and self._held is not None:
            learned = joint_step(self._state, self._held, t, z, True)
        if self._looking and self._seen >= self._next_look:
            self._look()
            grows = _GROWS_EARLY if self._seen < _EARLY else _GROWS
            self._next_look = max(self._seen + _OFTEN, self._seen * grows)
            if self._next_look > _LAST_LOOK or self._buffer.rows > _MOST_ROWS:
                self._looking = False
                if self._state is not None:
                    self._state.options[O_FOLLOW] = 1.0
                self._buffer = Buffer(self._buffer.shape, self._buffer.lag, commands=self._buffer.commands)
        return learned

    def _look(self) -> None:
        """Go over everything once more from each start, and go on with the likeliest."""
        assert self._buffer is not None
        stretches = self._buffer.stretches
        found = None if self._paper is None else self._paper.estimate
        names = names_now(self.vehicle, self._asked, found, with_delay=self._given_delay is None and self._commanded)
        if not any(each.input_t.size for each in stretches) or not names:
            return
        free = free_parameters(self.vehicle, names)
        own, cold = self._starts(free, found)
        longest = max(stretches, key=lambda each: each.t.size)
        starts = [cold] if own is None else []
        if self._next_start <= self._seen < _BOTH_STARTS:
            self._next_start = self._seen * _STARTS_GROW
            starts = [cold]
            if DELAY in free.names and self._seen < _BANK_UNTIL:
                starts += bank_of_delays(free, cold if own is None else own)
        seen = look(
            stretches,
            self.vehicle,
            free,
            own,
            starts,
            Levels(rows_noise(longest.t, longest.values), self._levels.sigma),
            self._tuning,
            delay=self._delay,
            prior=None if self.prior is None else prior_information(self.prior, free),
            rounds=_ROUNDS if self._seen < _EARLY else int(self._seen < 2.0 * _EARLY),
        )
        if seen is None:
            return
        self._free, self._state, self._held, self._levels = free, seen.state, seen.held, seen.levels
        self._state.options[O_ADAPT] = _ADAPT
        self._state.options[O_FOLLOW] = 0.0
        self._state.sigma[:] = self._levels.sigma

    def _starts(self, free: FreeParameters, found: Estimate | None) -> tuple[Array | None, Array]:
        """Return what the filter knows by now (n,), None before it knows anything, and what least squares says (n,)."""
        known = self.vehicle
        if found is not None:
            changes = {each.name: each.value for each in found.coefficients if each.identified}
            known = known.with_coefficients(changes) if changes else known
        cold = start_theta(self.vehicle, known, free, delay=self._delay, lag=_LAG)
        if self._state is None or self._free is None:
            return None, cold
        theta = dict(zip(self._free.names, self._state.theta, strict=True))
        anchor = dict(zip(self._free.names, self._state.anchor, strict=True))
        own = np.array([theta.get(name, cold[k]) for k, name in enumerate(free.names)])
        about = np.array([anchor.get(name, own[k]) for k, name in enumerate(free.names)])
        return bounded(free, own, about, linear=True), cold

    @property
    def _commanded(self) -> bool:
        return self._buffer is not None and self._buffer.commands

    def _fresh_held(self) -> HeldInput:
        assert self._buffer is not None
        assert self._free is not None
        assert self._state is not None
        empty = Buffer(self._buffer.shape, self._buffer.lag, commands=self._buffer.commands)
        empty.add_row(0.0, np.full(N_MEASURED, np.nan))
        return held_of(empty.stretches[0], self._free, self._state.anchor, self._delay)

    def _assembled(self) -> Estimate:
        if self._state is None or self._free is None:
            return self._paper.estimate if self._paper is not None else nothing_yet(self.vehicle, self._asked or ())
        prior = None if self.prior is None else prior_information(self.prior, self._free)[1]
        axes = self._paper.estimate.axes if self._paper is not None and self._looking else ()
        found = reading(self.vehicle, self._free, self._state, self._asked, prior, axes)
        return with_thrust_scale(found, self.vehicle) if self._commanded else found
