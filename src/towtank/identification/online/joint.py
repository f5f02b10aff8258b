"""The joint estimator on a stream: one Kalman filter over motion, disturbance and coefficients, sample by sample.

Its estimate is read from the filter's state at any time.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.data.samples import held_forces, prepared, samples_of, with_absent_zero
from towtank.identification.kalman.alternatives import current_of
from towtank.identification.kalman.iterated import prior_deviation
from towtank.identification.kalman.noise_adaptation import variance_inflation
from towtank.identification.kalman.state import JointState, coefficient_std
from towtank.identification.learner import Learner, sample_vector
from towtank.identification.model.parameters import (
    DELAY,
    GAIN_PREFIX,
    LAG,
    N_FIXED,
    FreeParameters,
    free_parameters,
)
from towtank.identification.model.prior import prior_information, size_of
from towtank.identification.model.terms import TERMS, paper_names
from towtank.identification.online.least_squares import PaperLearner
from towtank.identification.online.stream import JointStream
from towtank.identification.posterior.assembly import Current, Outcome, Posterior, assemble, judge
from towtank.identification.posterior.estimate import AxisReport, Estimate
from towtank.identification.posterior.statistics import information_of_data
from towtank.identification.posterior.thrusters import learned_gains, with_thrust_scale, with_thrusters
from towtank.recording import Recording
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["JointLearner"]


def estimate_of(
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
        requested: names to report, None for all. prior: information (n, n) put in.
        left_out: why damping terms are taken as 0.
    """
    n = len(free)
    covariance = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n].copy()
    scale = size_of(vehicle, free)
    deviation = prior_deviation(free, scale)
    covariance = _inflated(covariance, deviation, prior, _inflation(free, state))
    posterior = Posterior(free, state.theta, covariance)
    findings = judge(posterior, deviation, scale, prior=prior)
    why = {name: reason for name, reason in findings.reasons.items() if not _is_input(name)}
    why |= left_out
    to_learn = [name for name in (requested or (*free.names, *left_out)) if not _is_input(name)]
    duration, rows = float(state.clock[0].duration), int(state.clock[0].rows)
    return assemble(vehicle, Outcome(posterior, to_learn, why, tuple(left_out), axes, duration, rows)).estimate


def _inflated(covariance: Array, deviation: Array, prior: Array | None, inflation: Array) -> Array:
    """Return the covariance (n, n) with what the data say, and that alone, less sure by factors `inflation` (n,)."""
    before = np.diag(deviation**-2.0) + (0.0 if prior is None else prior)
    of_data = information_of_data(covariance, before) / np.outer(inflation, inflation)
    return np.asarray(np.linalg.inv(of_data + before))


def _inflation(free: FreeParameters, state: JointState) -> Array:
    """Return by how much deviations (n,) grow, since the disturbance's level is not known but estimated as well."""
    each = variance_inflation(state.disturbance_statistics["effective_samples"])
    axes = [int(code[1]) if int(code[0]) in TERMS and TERMS[int(code[0])].by_motion else -1 for code in free.codes]
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


@dataclass(frozen=True)
class JointSettings:
    """Settings of the joint method, see `JointLearner`."""

    free: Collection[str] | None = None
    delay: float | None = None
    prior: Vehicle | None = None
    background: bool = False
    current: bool = False
    changes: bool = True
    known: Mapping[str, Vehicle] | None = None

    def __post_init__(self) -> None:
        if self.delay is not None and not 0.0 <= self.delay < np.inf:
            raise InputError(f"delay: found {self.delay}, expected a number of seconds, 0 or more")


_SETTINGS = frozenset(each.name for each in fields(JointSettings))


class JointLearner(Learner):
    """The joint estimator, streaming.

    Args:
        vehicle: rigid body, thrusters, and values for whatever is not learned.
        method: "joint".
        free: names of the coefficients to learn, `lag` and `gain_<thruster>` among them; by default every inertia, the
            damping terms that the vehicle has (both where it has none), righting moments and net weight.
        delay: from input to force [s]; found where omitted and the inputs are commands.
        prior: a vehicle whose coefficients bear deviations: what is known beforehand.
        background: re-estimations run in a thread, so that no sample waits for one; `settle` waits for the last.
        current: of the water, estimated along: where speed over ground or position, and heading, are measured.
        changes: of the vehicle (a payload, a fouled thruster) are watched for, and reported by `events`.
        known: models of configurations that it may become, by name.
        settings: these (`JointSettings`), and further ones of the least squares that runs beside it.

    Raises:
        InputError: an unknown name or setting.
    """

    keeps_checkpoints = True

    def __init__(self, vehicle: Vehicle, method: str = "joint", **settings: Any) -> None:
        if method != "joint":
            raise InputError(f'method: found "{method}", expected "joint"')
        own = JointSettings(**{name: value for name, value in settings.items() if name in _SETTINGS})
        paper = {name: value for name, value in settings.items() if name not in _SETTINGS}
        self.vehicle, self.method, self._settings = vehicle, method, own
        self._requested = None if own.free is None else tuple(own.free)
        rows: list[str] | None = None
        if self._requested is not None:
            free_parameters(vehicle, self._requested)  # names are right
            rows = [name for name in self._requested if name in paper_names()]
        beside = rows is None or bool(rows)
        self._paper = PaperLearner(vehicle, free=rows, delay=own.delay, **paper) if beside else None
        self._stream = JointStream(
            vehicle,
            self._requested,
            delay=own.delay,
            prior=own.prior,
            paper=self._paper,
            background=own.background,
            current=own.current,
            known=(own.known or {}) if own.changes else None,
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
        water_velocity: ArrayLike | None = None,
        commands: ArrayLike | None = None,
        wrench: ArrayLike | None = None,
        voltage: float | None = None,
    ) -> bool:
        """Take the sample of time t [s]; see `Learner.update`."""
        p, v = sample_vector(pose, 6, "pose"), sample_vector(velocity, 6, "velocity")
        a, w = sample_vector(acceleration, 3, "acceleration"), sample_vector(water_velocity, 3, "water_velocity")
        z = np.concatenate([p, v, a, w])
        force: Array | None = None
        if commands is not None:
            c = sample_vector(commands, len(self.vehicle.thrusters), "commands")
            force = held_forces(self.vehicle, c, voltage)
        elif wrench is not None:
            force = with_absent_zero(sample_vector(wrench, 6, "wrench")[None])[0]
        if self._stream.reestimating and self._paper is not None:
            self._paper.update(t, pose=p, velocity=v, acceleration=a, commands=commands, wrench=wrench, voltage=voltage)
        self._estimate = None
        if force is not None:
            self._stream.take_input(float(t), force, commands=commands is not None)
        return self._stream.take_row(float(t), z) if np.isfinite(z).any() else False

    def run(self, recording: Recording) -> int:
        """Take a whole recording; see `Learner.run`."""
        samples, stream = samples_of(prepared(recording, self.vehicle), self.vehicle), self._stream
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
                self._paper.update(float(samples.t[i]), pose=z[:6], velocity=z[6:12], acceleration=z[12:15])
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

    def to_arrays(self) -> dict[str, Any]:
        """Return all that it knows; see `Learner.to_arrays`."""
        own, (plain, arrays) = self._settings, self._stream.to_arrays()
        about = {"requested": self._requested, "delay": own.delay, "current": own.current, "stream": plain}
        return {"learner": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8), **arrays}

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, Any],
        vehicle: Vehicle,
        *,
        prior: Vehicle | None = None,
        background: bool = False,
        known: Mapping[str, Vehicle] | None = None,
    ) -> JointLearner:
        """Return a learner that goes on; see `Learner.from_arrays`."""
        about = json.loads(arrays["learner"].tobytes())
        learner = cls(
            vehicle,
            free=about["requested"],
            delay=about["delay"],
            prior=prior,
            background=background,
            current=about["current"],
            changes=about["stream"]["watching"],
            known=known,
        )
        learner._stream.restore(about["stream"], arrays)
        learner._feed_paper()
        return learner

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
        running = self._stream.running
        if running is None:
            return {}
        return learned_gains(self.vehicle, running.free, running.state.theta, coefficient_std(running.state))

    @property
    def current(self) -> Current | None:
        """Of the water, where it is estimated and something has been seen."""
        running = self._stream.running
        return current_of(running.state) if self._settings.current and running is not None else None

    @property
    def noise(self) -> Array:
        """Noise (18,) of each sample of x y z phi theta psi u v w p q r ax ay az, as it is taken to be."""
        return self._stream.levels.noise.copy()

    @property
    def disturbance(self) -> Array:
        """Level (6,) [N, N m] of the random force that the motion shows."""
        running = self._stream.running
        return (self._stream.levels if running is None else running.state).disturbance.copy()

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

    def _feed_paper(self) -> None:
        """Give the least squares that runs beside what the stream goes over; of that alone it is made anew."""
        if self._paper is None or not self._stream.reestimating:
            return
        for k, samples in enumerate(self._stream.stretches):
            pushed = 0
            if k:
                self._paper.restart()
            for t, z in zip(samples.t, samples.values, strict=True):
                while pushed < samples.input_t.size and samples.input_t[pushed] <= t:
                    force = samples.input_force[pushed]
                    self._paper.push(float(samples.input_t[pushed]), force, commands=samples.commands)
                    pushed += 1
                self._paper.update(float(t), pose=z[:6], velocity=z[6:12], acceleration=z[12:15])

    def _assembled(self) -> Estimate:
        stream, running = self._stream, self._stream.running
        if running is None:
            return self._paper.estimate if self._paper is not None else nothing_yet(self.vehicle, self._requested or ())
        free, state = running.free, running.state
        before = self._settings.prior
        prior = None if before is None else prior_information(before, free)[1]
        axes = self._paper.estimate.axes if self._paper is not None and stream.reestimating else ()
        estimate = estimate_of(self.vehicle, free, state, self._requested, prior, axes, stream.left_out)
        return with_thrust_scale(estimate, self.vehicle) if stream.commanded else estimate
