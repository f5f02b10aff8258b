"""The paper's method as a learner: one sample at a time, or a whole recording in one call, with the same result."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import hold_force
from towtank.errors import InputError
from towtank.identification.data.samples import Sources, with_absent_zero
from towtank.identification.learner import Learner, sample_vector
from towtank.identification.least_squares.chain import PaperChain, Settings, Tuning, uses_commands
from towtank.identification.least_squares.solution import (
    AxisInformation,
    AxisSolution,
    absent,
    estimate_of,
    select,
    solve_axis,
)
from towtank.identification.model.terms import AXES, candidates
from towtank.identification.posterior.estimate import Estimate
from towtank.recording import Recording, align, bind_thrusters
from towtank.vehicle import AnyVehicle, Vehicle, thruster_forces, vehicle_of

__all__ = ["PaperLearner"]


class PaperLearner(Learner):
    """The paper's method, streaming: filtered regressors, one axis at a time, recursive least squares.

    Args:
        vehicle: what is known: rigid body, thrusters, and values for whatever is not learned.
        method: "paper".
        free: names of the coefficients to learn; by default every inertia, the damping terms that the vehicle has
            (both where it has none), righting moments and net weight.
        delay: from input to force [s]. Where omitted, commands have the vehicle's own and a wrench, which is what
            acted, none.
        inputs: "held" between their time stamps, as digital commands are, or "smooth".
        tuning: further `Settings` of the method.
            a: filter constant of both sides [1/s], 3.
            lowpass: corner [Hz] where velocity has to be derived from the pose, 4; the thrust passes the same filter.
            forgetting: factor per sample; 1 (the default) never forgets.
            scheme: what is forgotten where `forgetting` is below 1: "directional" (the default, only what the data
                excites, so that hover changes nothing) or "exponential"; see `RecursiveLeastSquares`.
            gap: longest step between samples that is integrated over [s], 0.5.

    Samples go to `update` with all that belongs to one instant; times may be irregular. Out-of-order samples and
    samples that lack a quantity the first ones had are passed over.

    Raises:
        InputError: an unknown method, name or setting.
    """

    def __init__(
        self,
        vehicle: AnyVehicle,
        method: str = "paper",
        *,
        free: Collection[str] | None = None,
        delay: float | None = None,
        inputs: Literal["held", "smooth"] = "held",
        **tuning: Unpack[Tuning],
    ) -> None:
        if method != "paper":
            raise InputError(f'method: found "{method}", expected "paper"')
        if inputs not in ("held", "smooth"):
            raise InputError(f'inputs: found "{inputs}", expected "held" or "smooth"')
        self.vehicle = vehicle_of(vehicle)
        self.method = method
        self.settings = Settings(delay=0.0 if delay is None else float(delay), smooth=inputs == "smooth", **tuning)
        self._own_delay = delay is None
        self.candidates = candidates(self.vehicle, free)
        self._chain: PaperChain | None = None
        self._commands: bool | None = None  # inputs are commands; None until the first one
        self._seen: list[NDArray[np.bool_]] | None = None
        self._last_input: tuple[float, Array] | None = None

    # -- data in

    def _take(
        self, t: float, z: Array, commands: ArrayLike | None, wrench: ArrayLike | None, voltage: float | None
    ) -> bool:
        p, v, s = z[:6], z[6:12], z[12:15]
        forces = self._forces(commands, wrench, voltage)
        if self._chain is None or self._chain.rows == 0:
            self._prepare(p, v, s)
        if self._chain is None:
            if forces is not None:
                self._last_input = (t, forces)
            return False
        return self._chain.step(t, p, v, s, forces) > 0.0

    def push(self, t: float, forces: Array, *, commands: bool) -> None:
        """Take the steady forces (m,) asked for from t [s] on, of the thrusters or (not `commands`) the wrench."""
        if self._commands is None:
            self._commands = commands
        if self._commands != commands:
            return
        self._last_input = (t, forces)
        if self._chain is not None:
            hold_force(self._chain.held, t, forces)

    def _run(self, recording: Recording) -> int:
        """Take a recording, aligned to a common grid."""
        grid = align(bind_thrusters(recording, [thruster.name for thruster in self.vehicle.thrusters]))
        sources = Sources.of(grid.pose, grid.velocity, grid.acceleration)
        commands = uses_commands(self.vehicle, grid)
        chain = self._chain or self._start(sources, commands=commands)
        if chain.sources != sources or chain.commands != commands:
            raise InputError(
                f"{recording.source or 'recording'}: it measures {_measured(sources, commands)}, the ones before "
                f"{_measured(chain.sources, chain.commands)}; learn from recordings of one kind at a time"
            )
        self.restart()
        return chain.run(grid)

    def restart(self) -> None:
        """Begin a new stretch of samples whose times owe nothing to the last one's; what was learned stays."""
        if self._chain is not None:
            self._chain.restart()

    # -- results out

    @property
    def estimate(self) -> Estimate:
        """What has been learned so far."""
        chain = self._chain
        findings = []
        for candidate in self.candidates:
            i = candidate.axis.index
            if chain is None or chain.sources.velocity[i] == "absent":
                reason = f"{candidate.axis.name} speed {candidate.axis.velocity} is not measured"
                findings.append(absent(candidate, reason if chain is not None else "no motion has been seen yet"))
                continue
            information = chain.information(i)

            def solve(
                free: tuple[bool, ...], known: Array, information: AxisInformation = information
            ) -> AxisSolution | None:
                return solve_axis(information, free, known)

            findings.append(
                select(
                    candidate,
                    solve,
                    lambda solution: solution.residual_sum,
                    commanded=information.commanded_share,
                )
            )
        if chain is None:
            return estimate_of(self.vehicle, findings, 0.0, 0)
        return estimate_of(self.vehicle, findings, chain.duration, chain.rows)

    def model(self) -> Vehicle:
        """Return the vehicle with everything identified so far put in."""
        learned = self.estimate.model(self.vehicle, f"learned by towtank, method {self.method}")
        commands = self._chain is not None and self._chain.commands
        if commands:
            learned = learned.model_copy(update={"command_delay": self.settings.delay})
        return learned

    # -- inside

    def _forces(self, commands: ArrayLike | None, wrench: ArrayLike | None, voltage: float | None) -> Array | None:
        """Return the held forces that this sample asks for; the first input decides of which kind they are."""
        if self._commands is None and (commands is not None or wrench is not None):
            self._commands = commands is not None
        if self._commands and commands is not None:
            c = sample_vector(commands, len(self.vehicle.thrusters), "commands")
            return np.ascontiguousarray(thruster_forces(self.vehicle, c, voltage))
        if self._commands is False and wrench is not None:
            return np.ascontiguousarray(with_absent_zero(sample_vector(wrench, 6, "wrench")[None])[0])
        return None

    def _prepare(self, pose: Array, velocity: Array, acceleration: Array) -> None:
        """Choose the sources by all that was seen before the first interval was learned from."""
        found = [np.isfinite(values) for values in (pose, velocity, acceleration)]
        self._seen = found if self._seen is None else [a | b for a, b in zip(self._seen, found, strict=True)]
        if not (self._seen[0].any() or self._seen[1].any()):
            return
        sources = Sources.of(*(np.where(flags, 0.0, np.nan)[None] for flags in self._seen))
        commands = bool(self.vehicle.thrusters) if self._commands is None else self._commands
        chain = self._chain
        if chain is not None and chain.sources == sources and chain.commands == commands:
            return
        chain = self._start(sources, commands=commands)
        if self._last_input is not None and len(self._last_input[1]) == chain.held.force.shape[0]:
            hold_force(chain.held, *self._last_input)

    def _start(self, sources: Sources, *, commands: bool) -> PaperChain:
        free = np.array([candidate.to_learn for candidate in self.candidates], dtype=np.float64)
        known = np.array([candidate.known for candidate in self.candidates])
        if self._own_delay and commands:
            self.settings = replace(self.settings, delay=self.vehicle.command_delay)
        self._chain = PaperChain(self.vehicle, sources, self.settings, free, known, commands=commands)
        return self._chain


def _measured(sources: Sources, commands: bool) -> str:
    names = [axis.velocity for axis in AXES]
    parts = [f"{n} {kind}" for n, kind in zip(names, sources.velocity, strict=True)]
    return f"{', '.join(parts)}, attitude by {sources.attitude}, {'commands' if commands else 'wrenches'}"
