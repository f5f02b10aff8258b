"""The joint estimator on a stream: one Kalman filter over motion, disturbance and coefficients, sample by sample.

Its estimate is read from the filter's state at any time.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.data.samples import held_forces, prepared, samples_of, with_absent_zero
from towtank.identification.learner import Learner, sample_vector
from towtank.identification.model.measurements import TYPICAL_NOISE
from towtank.identification.model.parameters import DELAY, LAG, LATENCIES
from towtank.identification.model.prior import Prior
from towtank.identification.model.terms import DISTURBANCE
from towtank.identification.online.reestimation import Question
from towtank.identification.online.stream import JointStream
from towtank.identification.posterior.assembly import Current
from towtank.identification.posterior.estimate import Estimate
from towtank.identification.posterior.result import estimate_of, model_of, with_posterior
from towtank.identification.posterior.thrusters import learned_gains
from towtank.recording import Recording
from towtank.recording.event import Event
from towtank.vehicle import AnyVehicle, Vehicle, vehicle_of

__all__ = ["JointLearner"]

_CURRENT = slice(18, 21)  # of the filter's errors


@dataclass(frozen=True)
class JointSettings:
    """Settings of the joint method, see `JointLearner`."""

    free: Collection[str] | None = None
    delay: float | None = None
    prior: AnyVehicle | None = None
    background: bool = False
    changes: bool = True
    known: Mapping[str, AnyVehicle] | None = None

    def __post_init__(self) -> None:
        if self.delay is not None and not 0.0 <= self.delay < np.inf:
            raise InputError(f"delay: found {self.delay}, expected a number of seconds, 0 or more")


_SETTINGS = frozenset(each.name for each in fields(JointSettings))


class JointLearner(Learner):
    """The joint estimator, streaming.

    Args:
        vehicle: the prior: rigid body, thrusters, and values with their deviations as far as they are known.
        method: "joint".
        free: names of the coefficients to learn, `lag` and `gain_<thruster>` among them, all else stays at the prior's
            mean; by default everything plausible.
        delay: from input to force [s]; found where omitted.
        prior: a vehicle that counts, beside the first, where it says something.
        background: re-estimations run in a thread, so that no sample waits for one; `settle` waits for the last.
        changes: of the vehicle (a payload, a fouled thruster) are watched for, and reported by `events`.
        known: models of configurations that it may become, by name.
        settings: these (`JointSettings`).

    Raises:
        InputError: an unknown name or setting.
    """

    keeps_checkpoints = True

    def __init__(self, vehicle: AnyVehicle, method: str = "joint", **settings: Any) -> None:
        if method != "joint":
            raise InputError(f'method: found "{method}", expected "joint"')
        for name in settings:
            if name not in _SETTINGS:
                raise InputError(f'settings: found "{name}", expected one of {", ".join(sorted(_SETTINGS))}')
        own = JointSettings(**settings)
        self.vehicle, self.method, self._settings = vehicle_of(vehicle), method, own
        prior = None if own.prior is None else vehicle_of(own.prior)
        question = Question(self.vehicle, None if own.free is None else tuple(own.free), own.delay, prior)
        self._supposed = question.whole(None, commands=bool(self.vehicle.thrusters))
        self._question, self._prior = question, question.prior(self._supposed, None)
        known = {name: vehicle_of(each) for name, each in (own.known or {}).items()} if own.changes else None
        self._stream = JointStream(question, background=own.background, known=known)
        self._estimate: Estimate | None = None
        self._model: Vehicle | None = None

    # -- data in

    def _take(
        self, t: float, z: Array, commands: ArrayLike | None, wrench: ArrayLike | None, voltage: float | None
    ) -> bool:
        force: Array | None = None
        if commands is not None:
            c = sample_vector(commands, len(self.vehicle.thrusters), "commands")
            force = held_forces(self.vehicle, c, voltage)
        elif wrench is not None:
            force = with_absent_zero(sample_vector(wrench, 6, "wrench")[None])[0]
        self._estimate = self._model = None
        if force is not None:
            self._stream.take_input(t, force, commands=commands is not None)
        return self._stream.take_row(t, z) if np.isfinite(z).any() else False

    def _run(self, recording: Recording) -> int:
        samples, stream = samples_of(prepared(recording, self.vehicle), self.vehicle), self._stream
        if stream.begun:
            self.restart()
        before, pushed = stream.rows, 0
        self._estimate = self._model = None
        for i in range(len(samples)):
            while pushed < len(samples.input_t) and samples.input_t[pushed] <= samples.t[i]:
                t, force = float(samples.input_t[pushed]), samples.input_force[pushed]
                stream.take_input(t, force, commands=samples.commands)
                pushed += 1
            stream.take_row(float(samples.t[i]), samples.values[i])
        return stream.rows - before

    def restart(self) -> None:
        """Begin a new stretch; see `Learner.restart`."""
        self._stream.break_off()

    def settle(self) -> None:
        """Wait for what runs in the background; see `Learner.settle`."""
        self._stream.settle()
        self._estimate = self._model = None

    def to_arrays(self) -> dict[str, Any]:
        """Return all that it knows; see `Learner.to_arrays`."""
        own, (plain, arrays) = self._settings, self._stream.to_arrays()
        about = {"free": self._question.free, "delay": own.delay, "stream": plain}
        return {"learner": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8), **arrays}

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, Any],
        vehicle: AnyVehicle,
        *,
        prior: Vehicle | None = None,
        background: bool = False,
        known: Mapping[str, Vehicle] | None = None,
    ) -> JointLearner:
        """Return a learner that goes on; see `Learner.from_arrays`."""
        about = json.loads(arrays["learner"].tobytes())
        learner = cls(
            vehicle,
            free=about["free"],
            delay=about["delay"],
            prior=prior,
            background=background,
            changes=about["stream"]["watching"],
            known=known,
        )
        learner._stream.restore(about["stream"], arrays)
        return learner

    # -- results out

    @property
    def delay(self) -> float:
        """From input to force [s], as far as it is known by now."""
        return max(0.0, self._value(DELAY, self._settings.delay or 0.0)[0])

    @property
    def lag(self) -> float:
        """Time constant of the thrusters [s]; NaN where the inputs are no commands."""
        return float(np.maximum(self._value(LAG, np.nan)[0], 0.0))

    @property
    def gains(self) -> dict[str, tuple[float, float]]:
        """Gain of each thruster and its deviation, as multiples of its curve; empty before anything was learned."""
        running = self._stream.running
        if running is None:
            return {}
        return learned_gains(self.vehicle, running.free, running.state.theta, running.std)

    @property
    def latency(self) -> dict[str, tuple[float, float]]:
        """Latency of each sensor whose clock is not that of the others, and its deviation [s]."""
        running = self._stream.running
        names = [] if running is None else [name for name in LATENCIES if name in running.free.names]
        return {name.removeprefix("latency_"): self._value(name, 0.0) for name in names}

    @property
    def current(self) -> Current | None:
        """Of the water, where position or speed over ground tells it."""
        running = self._stream.running
        if running is None or not running.state.settings[0].current_walk > 0.0:
            return None
        variance = np.diag(running.state.P)[_CURRENT]
        return Current(running.state.current.copy(), np.sqrt(np.maximum(variance, 0.0)))

    @property
    def noise(self) -> Array:
        """Noise (18,) of each sample of x y z phi theta psi u v w p q r ax ay az, as it is taken to be."""
        running = self._stream.running
        return np.array(TYPICAL_NOISE) if running is None else running.state.noise.copy()

    @property
    def disturbance(self) -> Array:
        """Level (6,) [N, N m] of the random force that the motion shows."""
        running = self._stream.running
        level = np.array(DISTURBANCE) if running is None else running.state.disturbance
        return np.asarray(level * np.diag(self.model().mass_matrix))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What contradicts it; see `Learner.remarks`."""
        return () if self._stream.running is None else self._stream.running.remarks

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
        """What has been learned so far; what is supposed where nothing has been yet."""
        if self._estimate is None:
            whole, prior, theta, covariance = self._posterior()
            running = self._stream.running
            duration = 0.0 if running is None else float(running.state.clock[0].duration)
            base = self._question.base(whole)
            learned, undoubted = (None, None) if running is None else (running.state.learns > 0.0, running.undoubted)
            rows = self._stream.rows
            self._estimate, _ = estimate_of(base, prior, theta, covariance, duration, rows, learned, undoubted)
        return self._estimate

    def model(self) -> Vehicle:
        """Return the vehicle with everything that was free at the posterior's mean, and the posterior itself."""
        if self._model is None:
            whole, prior, theta, covariance = self._posterior()
            source = f"learned by towtank, method {self.method}"
            commanded = self._stream.commanded is not False
            model = model_of(
                self._question.base(whole),
                self.estimate,
                source,
                delay=self.delay if commanded else self.vehicle.command_delay,
                lag=self.lag,
                gains=self.gains,
            )
            self._model = with_posterior(model, prior, theta, covariance)
        return self._model

    # -- inside

    def _posterior(self) -> tuple[Prior, Prior, Array, Array]:
        """Return what was supposed of everything and of the unknowns, mean (n,) and covariance (n, n) by now."""
        running = self._stream.running
        if running is None:
            return self._supposed, self._prior, self._prior.mean, self._prior.covariance
        return running.whole, running.prior, *running.told

    def _value(self, name: str, other: float) -> tuple[float, float]:
        """Return an unknown's coordinate and its deviation, `other` and NaN where it is none."""
        _, prior, theta, covariance = self._posterior()
        if name not in prior.names:
            return other, np.nan
        k = prior.names.index(name)
        return float(theta[k]), float(np.sqrt(covariance[k, k]))
