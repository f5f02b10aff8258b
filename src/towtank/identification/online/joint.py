"""The joint estimator on a stream: one Kalman filter over motion, disturbance and coefficients, sample by sample.

The estimate of the streaming joint filter, read from its state at any time.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.data.samples import held_forces, samples_of, with_absent_zero
from towtank.identification.kalman.alternatives import current_of
from towtank.identification.kalman.iterated import prior_deviation
from towtank.identification.kalman.noise_adaptation import variance_inflation
from towtank.identification.kalman.state import JointState, coefficient_std
from towtank.identification.learner import Learner, sample_vector
from towtank.identification.model.linearisation import N_FIXED
from towtank.identification.model.parameters import (
    DELAY,
    GAIN_PREFIX,
    LAG,
    LINEAR,
    MASS,
    QUADRATIC,
    FreeParameters,
    free_parameters,
)
from towtank.identification.model.prior import prior_information, size_of
from towtank.identification.model.terms import paper_names
from towtank.identification.online.least_squares import PaperLearner
from towtank.identification.online.stream import JointStream
from towtank.identification.posterior.assembly import Current, assemble, judge
from towtank.identification.posterior.estimate import AxisReport, Estimate
from towtank.identification.posterior.statistics import information_of_data
from towtank.identification.posterior.thrusters import learned_gains, with_thrust_scale, with_thrusters
from towtank.recording import Recording
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["JointLearner"]


def reading(
    vehicle: Vehicle,
    free: FreeParameters,
    state: JointState,
    requested: Sequence[str] | None,
    prior: Array | None,
    axes: Sequence[AxisReport],
    left_out: Mapping[str, str],
) -> Estimate:
    """Return what the filter knows.

    Args:
        asked: names to tell of, None for all. prior: information (n, n) put in.
        left_out: why damping terms are taken as 0.
    """
    n = len(free)
    covariance = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n].copy()
    scale = size_of(vehicle, free)
    deviation = prior_deviation(free, scale)
    covariance = _cautious(covariance, deviation, prior, _grown(free, state))
    findings = judge(free, state.theta, covariance, deviation, scale, prior=prior)
    why = {name: reason for name, reason in findings.reasons.items() if not _is_input(name)}
    why |= left_out
    to_learn = [name for name in (requested or (*free.names, *left_out)) if not _is_input(name)]
    duration, rows = float(state.clock[0].duration), int(state.clock[0].rows)
    return assemble(
        vehicle, free, state.theta, covariance, to_learn, why, tuple(left_out), axes, duration, rows
    ).estimate


def _cautious(covariance: Array, deviation: Array, prior: Array | None, grown: Array) -> Array:
    """Return the covariance (n, n) with what the data told, and that alone, less sure by the factors grown (n,)."""
    before = np.diag(deviation**-2.0) + (0.0 if prior is None else prior)
    told = information_of_data(covariance, before) / np.outer(grown, grown)
    return np.asarray(np.linalg.inv(told + before))


def _grown(free: FreeParameters, state: JointState) -> Array:
    """Return by how much deviations (n,) grow, since the disturbance's level is not known but estimated as well."""
    each = variance_inflation(state.disturbance_statistics["effective_samples"])
    axes = [int(code[1]) if code[0] in (MASS, LINEAR, QUADRATIC) else -1 for code in free.codes]
    used = [axis for axis in axes if axis >= 0] or list(range(6))
    most = float(each[used].max())
    return np.array([each[axis] if axis >= 0 else most for axis in axes])


def _is_input(name: str) -> bool:
    return name in (DELAY, LAG) or name.startswith(GAIN_PREFIX)


def nothing_yet(vehicle: Vehicle, names: Collection[str]) -> Estimate:
    """Return the estimate of one who has seen nothing."""
    known = tuple(name for name in names if not _is_input(name))
    n = len(known)
    return Estimate(
        names=known,
        values=np.array([vehicle.coefficient(name) for name in known]),
        std=np.full(n, np.nan),
        covariance=np.full((n, n), np.nan),
        identified=(False,) * n,
        reasons=("nothing has been learned yet",) * n,
        sums=(),
        axes=(),
        duration=0.0,
        samples=0,
    )


class JointLearner(Learner):
    """The joint estimator, streaming.

    Args:
        vehicle: rigid body, thrusters, and values for whatever is not learned.
        method: "joint".
        free: names of the coefficients to learn, `lag` and `gain_<thruster>` among them; by default every inertia, the
            damping terms that the vehicle has (both where it has none), righting moments and net weight.
        delay: from input to force [s]; found where omitted and the inputs are commands.
        prior: a vehicle whose coefficients bear deviations: what is known beforehand.
        background: second looks run in a thread, so that no sample waits for one; `settle` waits for the last.
        current: of the water, estimated along: where speed over ground or position, and heading, are measured.
        changes: of the vehicle (a payload, a fouled thruster) are watched for, and told of by `events`.
        known: models of configurations that it may become, by name.
        paper: further settings of the least squares that runs beside it.

    Raises:
        InputError: an unknown name or setting.
    """

    keeps_checkpoints = True

    def __init__(
        self,
        vehicle: Vehicle,
        method: str = "joint",
        *,
        free: Collection[str] | None = None,
        delay: float | None = None,
        prior: Vehicle | None = None,
        background: bool = False,
        current: bool = False,
        changes: bool = True,
        known: Mapping[str, Vehicle] | None = None,
        **paper: Any,
    ) -> None:
        if method != "joint":
            raise InputError(f'method: found "{method}", expected "joint"')
        if delay is not None and not 0.0 <= delay < np.inf:
            raise InputError(f"delay: found {delay}, expected a number of seconds, 0 or more")
        self.vehicle, self.method, self.prior, self._current = vehicle, method, prior, current
        self._requested = None if free is None else tuple(free)
        if self._requested is not None:
            free_parameters(vehicle, self._requested)  # names are right
            rows = [name for name in self._requested if name in paper_names()]
            self._paper: PaperLearner | None = PaperLearner(vehicle, free=rows, delay=delay, **paper) if rows else None
        else:
            self._paper = PaperLearner(vehicle, delay=delay, **paper)
        self._stream = JointStream(
            vehicle,
            self._requested,
            delay=delay,
            prior=prior,
            paper=self._paper,
            background=background,
            current=current,
            known=(known or {}) if changes else None,
        )
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
        if self._stream.reestimating and self._paper is not None:
            self._paper.update(
                t, pose=p, velocity=v, acceleration=z[12:], commands=commands, wrench=wrench, voltage=voltage
            )
        self._estimate = None
        if force is not None:
            self._stream.take_input(float(t), force, commands=commands is not None)
        return self._stream.take_row(float(t), z) if np.isfinite(z).any() else False

    def run(self, recording: Recording) -> int:
        """Take a whole recording; see `Learner.run`."""
        samples, stream = samples_of(recording, self.vehicle), self._stream
        if stream.seen > 0.0:
            self.restart()
        before = stream.rows
        self._estimate = None
        pushed = i = 0
        while i < len(samples) and (stream.reestimating or stream.changes.watching):
            while pushed < len(samples.input_t) and samples.input_t[pushed] <= samples.t[i]:
                t, force = float(samples.input_t[pushed]), samples.input_force[pushed]
                stream.take_input(t, force, commands=samples.commands)
                if self._paper is not None and stream.reestimating:
                    self._paper.push(t, force, commands=samples.commands)
                pushed += 1
            z = samples.values[i]
            if self._paper is not None and stream.reestimating:
                self._paper.update(float(samples.t[i]), pose=z[:6], velocity=z[6:12], acceleration=z[12:])
            stream.take_row(float(samples.t[i]), z)
            i += 1
        if i < len(samples):
            stream.take_rows(samples, i, pushed)
        return stream.rows - before

    def restart(self) -> None:
        """Begin a new stretch; see `Learner.restart`."""
        self._stream.break_off()
        if self._paper is not None:
            self._paper.restart()

    def settle(self) -> None:
        """Wait for what runs in the background; see `Learner.settle`."""
        self._stream.settle()
        self._estimate = None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint; see `Learner.save`."""
        from towtank.identification.online.checkpoint import save_learner

        save_learner(self, path)

    # -- results out

    @property
    def delay(self) -> float:
        """From input to force [s], as far as it is known by now."""
        return max(0.0, self._stream.value(DELAY, self._stream.delay))

    @property
    def lag(self) -> float:
        """Time constant of the thrusters [s] where it is free; NaN where it is not."""
        return self._stream.lag

    @property
    def gains(self) -> dict[str, tuple[float, float]]:
        """Gain of each thruster that has one free and its deviation, as multiples of its curve."""
        free, state = self._stream.free, self._stream.state
        if free is None or state is None:
            return {}
        std = coefficient_std(state)
        return learned_gains(self.vehicle, free, state.theta, std)

    @property
    def current(self) -> Current | None:
        """Of the water, where it is estimated and something has been seen."""
        return current_of(self._stream.state) if self._current and self._stream.state is not None else None

    @property
    def noise(self) -> Array:
        """Noise (15,) of each sample of x y z phi theta psi u v w p q r ax ay az, as it is taken to be."""
        return self._stream.levels.noise.copy()

    @property
    def disturbance(self) -> Array:
        """Level (6,) [N, N m] of the random force that the motion shows."""
        state = self._stream.state
        return self._stream.levels.disturbance.copy() if state is None else state.disturbance.copy()

    @property
    def events(self) -> tuple[Event, ...]:
        """What happened to the vehicle; see `Learner.events`."""
        return self._stream.changes.events

    @property
    def likely(self) -> dict[str, float]:
        """Known configurations and how probable each is, since the last change."""
        return self._stream.changes.likely

    @property
    def estimate(self) -> Estimate:
        """What has been learned so far."""
        if self._estimate is None:
            self._estimate = self._assembled()
        return self._estimate

    def model(self) -> Vehicle:
        """Return the vehicle with everything identified so far put in."""
        learned = self.estimate.model(self.vehicle, f"learned by towtank, method {self.method}")
        if self._stream.commanded:
            learned = with_thrusters(learned, lag=self.lag, gains=self.gains)
            learned = learned.model_copy(update={"command_delay": self.delay})
        return learned

    # -- inside

    def _assembled(self) -> Estimate:
        stream = self._stream
        if stream.state is None or stream.free is None:
            return self._paper.estimate if self._paper is not None else nothing_yet(self.vehicle, self._requested or ())
        prior = None if self.prior is None else prior_information(self.prior, stream.free)[1]
        axes = self._paper.estimate.axes if self._paper is not None and stream.reestimating else ()
        found = reading(self.vehicle, stream.free, stream.state, self._requested, prior, axes, stream.left_out)
        return with_thrust_scale(found, self.vehicle) if stream.commanded else found
