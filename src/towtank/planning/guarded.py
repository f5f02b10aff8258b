"""A closed-loop run in a tank: a vehicle that is not quite the one supposed, its poses measured, the guard in the loop.

What comes of it is an ordinary recording of the commands that were really given: `simulate` with these commands, the
same seed and the same vehicle, so that an estimator cannot tell it from any other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.core.layout import I_INFLOW
from towtank.errors import InputError
from towtank.planning.braking import PERIOD
from towtank.planning.guard import LIMITS, Guard, drawn_around
from towtank.planning.observer import Observer
from towtank.planning.space import Space
from towtank.recording.recording import Recording
from towtank.simulation.actuation import HeldDrive, cut_step
from towtank.simulation.inputs import finite_array, initial_states, stream
from towtank.simulation.integration import simulate_pieces, simulate_thrusters
from towtank.simulation.motion import continuous_eulers
from towtank.simulation.sensors.mocap import Mocap
from towtank.simulation.simulate import simulate
from towtank.simulation.water import OrnsteinUhlenbeck
from towtank.vehicle import Vehicle, configuration_matrix, thruster_commands, thruster_forces

__all__ = ["DT", "GuardedRun", "Tank", "guarded_commands", "guarded_run"]

DT = 0.01  # s, of the simulation and of the poses
_DRAWN = 19  # vehicles that the guard reckons with, beside the file's
_GRID = 4097  # steps of force: a twentieth of a newton and less
_STEPS = round(PERIOD / DT)


@dataclass(frozen=True, eq=False)
class GuardedRun:
    """What came of a run of n periods.

    Attributes:
        recording: poses and commands really given. commands: these (n, m), in the units of the curves.
        given, wanted: forces asked of the nominal vehicle's thrusters (n, m) [N].
        shares: of braking, for each of `guard.LIMITS` (n, 6); 0 without a guard.
        eta: true poses (4 n + 1, 6) [m, rad], every DT. nu: true velocities (4 n + 1, 6).
        clearance: true distance from the vehicle's sphere to the nearest wall (4 n + 1,) [m]; below 0 it touches.
        tilt: true angle between the body's z axis and the vertical (4 n + 1,) [rad].
    """

    recording: Recording
    commands: Array
    given: Array
    wanted: Array
    shares: Array
    eta: Array
    nu: Array
    clearance: Array
    tilt: Array

    @property
    def changed(self) -> float:
        """Share of the time in which the guard changed what was wanted."""
        return float(np.mean(self.shares.any(axis=1)))

    @property
    def touch(self) -> tuple[float, tuple[float, float, float]] | None:
        """Time [s] and place (3,) [m] of the body origin where a wall was touched first; None where none was."""
        through = np.flatnonzero(~(self.clearance > 0.0))
        if not through.size:
            return None
        x, y, z = (float(value) for value in self.eta[through[0], :3])
        return float(through[0] * DT), (x, y, z)


def guarded_run(
    guard: Guard,
    truth: Vehicle,
    wanted: Array,
    *,
    disturbance: OrnsteinUhlenbeck | None = None,
    seed: int = 0,
    guarded: bool = True,
) -> GuardedRun:
    """Return a run of the true vehicle from the start of the guard's space, at rest.

    Args:
        truth: the vehicle that is simulated; its thrusters stand where the nominal one's do.
        wanted: forces (n, m) [N], each held for PERIOD, of the nominal vehicle's thrusters.
        disturbance: random wrench on the body. seed: of it, and of the noise of the poses, 1 mm and 1 mrad at 100 Hz.
        guarded: whether the guard may bend what is wanted.

    Raises:
        InputError: `wanted` has a wrong shape, or the true vehicle's thrusters stand elsewhere.
    """
    vehicle = guard.vehicle
    wanted = finite_array("wanted", wanted, ("n", len(vehicle.thrusters)))
    if not np.array_equal(configuration_matrix(truth), configuration_matrix(vehicle)):
        raise InputError(f"{truth.name} has its thrusters elsewhere than {vehicle.name}; keep their places")
    n = len(wanted)
    eta0, sensors = guard.space.eta0, Mocap(rate=1.0 / DT, jump_fraction=0.0)
    push = np.zeros((n * _STEPS, 6)) if disturbance is None else disturbance.sample(n * _STEPS, DT, seed)
    noise = np.hstack(
        [1e-3 * stream(seed, "mocap", part).standard_normal((n * _STEPS + 1, 3)) for part in ("position", "attitude")]
    )  # the very noise that `sensors` will record
    tank = Tank(truth, push, eta0)
    observer = Observer.of(vehicle, eta0)
    guard.reset()
    commands, inverse = thruster_commands(vehicle, wanted), _InverseCurves(guard)
    given, shares = wanted.copy(), np.zeros((n, len(LIMITS)))
    for i in range(n):
        if guarded:
            given[i] = guard.step(observer.state, wanted[i])
            shares[i] = guard.memory.shares
            if shares[i].any():
                commands[i] = inverse(given[i])
        observer.give(i * PERIOD, given[i])
        for row in tank.period(i, thruster_forces(truth, commands[i])):
            observer.see(row * DT, tank.pose(row) + noise[row])
    held = np.repeat(commands, _STEPS, axis=0)
    recording = simulate(truth, commands=held, dt=DT, eta0=eta0, sensors=sensors, disturbance=disturbance, seed=seed)
    q = tank.states[:, 3:7]
    eta = np.hstack([tank.states[:, :3], continuous_eulers(q, eta0[3:])])
    return GuardedRun(
        recording,
        commands,
        given,
        wanted,
        shares,
        eta,
        tank.states[:, 7:],
        guard.space.clearance(tank.states[:, :3], guard.radius),
        2.0 * np.arcsin(np.minimum(np.hypot(q[:, 1], q[:, 2]), 1.0)),
    )


def guarded_commands(
    vehicle: Vehicle,
    space: Space,
    commands: Array,
    *,
    unsure: float = 0.3,
    disturbance: OrnsteinUhlenbeck | None = None,
    seed: int = 0,
) -> GuardedRun:
    """Return a guarded run of commands (n, m), each held for PERIOD, by a vehicle that the guard knows by its file.

    Args:
        unsure: how far off, as a share, the guard takes the file to be.

    Raises:
        InputError: no room in the space; a vehicle that no guard can brake.
    """
    guard = Guard.of(vehicle, space, drawn_around(vehicle, _DRAWN, unsure, seed), seed=seed)
    wanted = np.clip(thruster_forces(vehicle, commands), guard.brake.low, guard.brake.high)
    return guarded_run(guard, vehicle, wanted, disturbance=disturbance, seed=seed)


class _InverseCurves:
    """Commands of forces by a table, fast enough for a loop: the curves' inverse at equal steps of force."""

    def __init__(self, guard: Guard) -> None:
        self._low, self._high = guard.brake.low, guard.brake.high
        grid = np.linspace(self._low, self._high, _GRID)
        self._commands, self._columns = thruster_commands(guard.vehicle, grid), np.arange(grid.shape[1])

    def __call__(self, forces: Array) -> Array:
        """Return the commands (m,) of the forces (m,) [N], to the nearest step."""
        share = (forces - self._low) / (self._high - self._low)
        rows = np.clip(np.rint(share * (_GRID - 1)), 0, _GRID - 1).astype(np.intp)
        return np.asarray(self._commands[rows, self._columns])


class Tank:
    """The true vehicle, advanced period by period exactly as `simulate` does."""

    def __init__(self, truth: Vehicle, push: Array, eta0: Array) -> None:
        lags = np.array([thruster.time_constant for thruster in truth.thrusters])
        self._forces = np.zeros((len(push), lags.size))
        self._pieces = cut_step(DT, delay=truth.command_delay, lags=lags)
        self._matrix, self._p, self._push = configuration_matrix(truth), np.array(truth.parameters), push
        self._drive = HeldDrive(self._forces, self._pieces, self._matrix, lags)
        self.states = np.empty((len(push) + 1, 13))
        self.states[0] = initial_states(eta0, np.zeros(6))

    def period(self, i: int, forces: Array) -> range:
        """Advance by period i under the forces (m,) [N] asked for from its start on; return the rows of the states."""
        first, last = i * _STEPS, (i + 1) * _STEPS
        self._forces[first:last] = forces
        stages = self._drive.stages(first, last)
        lengths, still = self._pieces.lengths, np.zeros(3)
        push, part = np.repeat(self._push[first:last], lengths.size, axis=0), slice(first, last + 1)
        if stages.forces is None or self._p[I_INFLOW] == 0.0:
            tau = stages.wrench + push[:, None, :]
            self.states[part] = simulate_pieces(self._p, self.states[first], tau, lengths, still)
        else:
            self.states[part] = simulate_thrusters(
                self._p, self.states[first], push, stages.forces, self._matrix, lengths, still
            )
        return range(first + 1, last + 1)

    def pose(self, row: int) -> Array:
        """Return the true pose (6,) [m, rad]."""
        state = self.states[row]
        return np.concatenate([state[:3], continuous_eulers(state[None, 3:7])[0]])
