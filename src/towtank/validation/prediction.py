"""Free-running prediction: the model alone, driven by what the thrusters were told, from one measured state.

With a horizon it is set back to the measured state every so many seconds, which is the fair question for a vehicle
that tumbles: small errors of attitude grow without bound and say little about coefficients. When is a matter of the
recording alone: models that answer sooner or later are set back at the same instants.

The state that a prediction starts from, out of what was measured there.

The wrench that a model's thrusters gave over every step of a grid: held commands, delay and lag, exactly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import eulers_from_quaternions, quaternion_from_euler, rotation_from_quaternion
from towtank.core.rk4 import simulate_run
from towtank.core.zero_order_hold import (
    ZeroOrderHold,
    force_integral_into,
    hold_force,
    new_zero_order_hold,
)
from towtank.errors import InputError
from towtank.identification.data.samples import Sources, with_absent_zero
from towtank.identification.least_squares.chain import uses_commands
from towtank.identification.least_squares.velocity import gravity_directions
from towtank.identification.model.parameters import DVL_PLACE, MARKER_PLACE
from towtank.recording import Grid
from towtank.recording.frames.lever_arm import origin_motion
from towtank.recording.standard import POSE, VELOCITIES
from towtank.simulation.integration import simulate_thrusters
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces
from towtank.vehicle.posterior import surely_placed

__all__ = ["CHANNELS", "Prediction", "predict"]

_WINDOW = 0.2  # s to either side, for a velocity taken from the pose,
_EDGE = 0.6  # s on the one side there is, at the start and the end of a recording
_FORGOTTEN = 3.0  # time constants, after which 5 % of a force is left
_LONGEST = 0.1  # of a recording, that is spent on that
CHANNELS = ("u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi")
_LONGEST_STEP = 0.02  # s
_BLOCK = 20_000  # steps simulated at once
_STILL = np.zeros(3)
_ANGLES = ("phi", "theta", "psi")


@dataclass(frozen=True)
class Starts:
    """Measured states of one grid. What was not measured keeps the value that the prediction has reached."""

    grid: Grid
    sources: Sources
    gravity: Array

    @classmethod
    def of(cls, grid: Grid) -> Starts:
        """Prepare the states of a grid."""
        sources = Sources.of(grid.pose, grid.velocity, grid.acceleration)
        return cls(grid, sources, gravity_directions(grid, sources))

    def known(self, row: int) -> bool:
        """Whether everything that the grid measures at all is measured in this row."""
        grid, sources = self.grid, self.sources
        measured = [i for i in range(6) if sources.velocity[i] == "measured"]
        if not np.isfinite(grid.velocity[row, measured]).all():
            return False
        if "derived" in sources.velocity and not np.isfinite(grid.pose[row, self._pose]).all():
            return False
        return bool(np.isfinite(self.gravity[row]).all())

    def state(self, row: int, reached: Array) -> Array:
        """Return the state (13,) at a row; `reached` (13,) supplies what was not measured."""
        out = reached.copy()
        pose = self.grid.pose[row]
        for j in range(3):
            if np.isfinite(pose[j]):
                out[j] = pose[j]
        k = self.gravity[row]
        phi, theta = np.arctan2(k[1], k[2]), np.arctan2(-k[0], np.hypot(k[1], k[2]))
        psi = pose[5] if np.isfinite(pose[5]) else _heading(reached[3:7])
        out[3:7] = quaternion_from_euler(float(phi), float(theta), float(psi))
        derived = self._derived(row) if "derived" in self.sources.velocity else None
        for i, kind in enumerate(self.sources.velocity):
            if kind == "measured":
                out[7 + i] = self.grid.velocity[row, i]
            elif kind == "derived" and derived is not None:
                out[7 + i] = derived[i]
        return out

    @property
    def _pose(self) -> slice:
        """Columns of the pose that velocities are derived from: of rates alone the angles."""
        return slice(0 if "derived" in self.sources.velocity[:3] else 3, 6)

    def _derived(self, row: int) -> Array:
        """Return the body velocity (6,) from a quadratic through the poses around a row; 0 where no pose tells it."""
        grid, told = self.grid, self._pose
        for window in (_WINDOW, _EDGE):
            first = np.searchsorted(grid.t, grid.t[row] - window - 1e-9)
            last = np.searchsorted(grid.t, grid.t[row] + window + 1e-9, side="right")
            near = first + np.flatnonzero(np.isfinite(grid.pose[first:last, told]).all(axis=1))
            s = grid.t[near] - grid.t[row]
            if near.size and s[0] < -0.5 * window and s[-1] > 0.5 * window:
                break
        out = np.zeros(6)
        if near.size < 3:
            return out
        rate = np.zeros(6)
        powers = np.column_stack([np.ones_like(s), s, s * s])
        rate[told] = np.linalg.lstsq(powers, grid.pose[near, told], rcond=None)[0][1]
        phi, theta, psi = grid.pose[row, 3:]
        R = rotation_from_quaternion(np.array(quaternion_from_euler(float(phi), float(theta), float(psi))))
        out[:3] = R.T @ rate[:3]
        s1, c1, s2, c2 = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
        out[3] = rate[3] - s2 * rate[5]
        out[4] = c1 * rate[4] + s1 * c2 * rate[5]
        out[5] = -s1 * rate[4] + c1 * c2 * rate[5]
        return out


def _heading(q: Array) -> float:
    w, x, y, z = q
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


class Acted(NamedTuple):
    """What acted over each of the n - 1 steps of a grid.

    Attributes:
        wrench: mean wrench [N, N m] (n - 1, 6), body FRD, without what thrusters lose with inflow.
        forces: mean force of each thruster [N] (n - 1, m), where inflow takes some of it; None where it does not.
    """

    wrench: Array
    forces: Array | None = None


@kernel
def _means(
    held: ZeroOrderHold, shape: Array, t: Array, stamps: Array, forces: Array, each: bool
) -> tuple[Array, Array]:
    """Return means over each interval of t (n,) of forces (k, m) held from stamps (k,) on: of the wrench (n - 1, 6),

    and where wanted of `each` force (n - 1, m).
    """
    n, m = t.shape[0], forces.shape[1]
    out, means = np.zeros((n - 1, 6)), np.empty((n - 1 if each else 0, m))
    total = np.empty(m)
    event = 0
    for i in range(n):
        while event < stamps.shape[0] and stamps[event] <= t[i]:
            hold_force(held, stamps[event], forces[event])
            event += 1
        force_integral_into(held, t[i], total)
        if i > 0:
            for a in range(6):
                for j in range(m):
                    out[i - 1, a] += shape[a, j] * total[j] / (t[i] - t[i - 1])
        if each and i > 0:
            for j in range(m):
                means[i - 1, j] = total[j] / (t[i] - t[i - 1])
    return out, means


def acted(vehicle: Vehicle, grid: Grid, delay: float | None = None) -> Acted:
    """Return what acted over each step of the grid; before the first command, it.

    Args:
        delay: from input to force [s]; where omitted the vehicle's for commands and none for a recorded wrench, which
            is what acted.

    Raises:
        InputError: the grid has neither this vehicle's commands nor a wrench.
    """
    losing = False
    if uses_commands(vehicle, grid):
        losing = vehicle.coefficient("inflow_loss") != 0.0
        stamps = np.array(grid.command_t)
        voltage = np.interp(stamps, grid.t, grid.voltage) if np.isfinite(grid.voltage).any() else None
        forces = np.ascontiguousarray(thruster_forces(vehicle, grid.command_values, voltage))
        shape = configuration_matrix(vehicle)
        lag = np.array([thruster.time_constant for thruster in vehicle.thrusters])
        delay = vehicle.command_delay if delay is None else delay
    elif grid.wrench_t.size:
        stamps, forces = np.array(grid.wrench_t), with_absent_zero(np.array(grid.wrench_values))
        shape, lag, delay = np.eye(6), np.zeros(6), 0.0 if delay is None else delay
    else:
        raise InputError(
            f"{grid.source or 'recording'}: neither thruster commands nor a wrench is recorded, so nothing can be "
            "predicted; map the thrusters' columns (--map) or record X Y Z K M N"
        )
    finite = np.isfinite(forces).all(axis=1)
    if not finite.all():
        stamps, forces = stamps[finite], forces[finite]
    if not stamps.size:
        raise InputError(f"{grid.source or 'recording'}: no row has a command for every thruster")
    wrench, means = _means(
        new_zero_order_hold(shape.shape[1], lag, delay),
        np.ascontiguousarray(shape),
        grid.t,
        stamps,
        np.ascontiguousarray(forces),
        losing,
    )
    return Acted(wrench, means if losing else None)


def inputs_known_from(vehicle: Vehicle, grid: Grid, delay: float | None = None) -> float:
    """Return the time [s] from which on the recorded inputs act: before it nobody knows what the thrusters did.

    Thrusters that lag still remember for a few time constants what came before the recording. No more than a tenth of
    what is left is spent on that.

    Args as `acted`.
    """
    if uses_commands(vehicle, grid):
        values, stamps = grid.command_values, grid.command_t
        delay = vehicle.command_delay if delay is None else delay
        memory = _FORGOTTEN * max(thruster.time_constant for thruster in vehicle.thrusters)
    else:
        values, stamps = with_absent_zero(np.array(grid.wrench_values)), grid.wrench_t
        delay, memory = 0.0 if delay is None else delay, 0.0
    known = stamps[np.isfinite(values).all(axis=1)]
    if not known.size:
        return float(grid.t[0])
    acts = float(known[0]) + delay - 1e-9
    return acts + min(memory, max(0.0, _LONGEST * (float(grid.t[-1]) - acts)))


@dataclass(frozen=True, eq=False)
class Prediction:
    """One recording predicted.

    Attributes:
        t: times (n,) [s]. channels: name -> (measured (n,), predicted (n,)); measured is NaN where there was no
            sample. restarts: times at which the prediction was set to the measured state. source: of the recording.
        wrench: mean wrench [N, N m] (n, 6) over the step that ends at each time, body FRD, without what thrusters
            lose with inflow.
        states: predicted states (n, 13) [x y z, quaternion, nu], NaN before the first restart.
    """

    t: Array
    channels: Mapping[str, tuple[Array, Array]]
    restarts: tuple[float, ...]
    source: str = ""
    wrench: Array = field(default_factory=lambda: np.zeros((0, 6)))
    states: Array = field(default_factory=lambda: np.zeros((0, 13)))

    def __repr__(self) -> str:
        return f"<Prediction of {self.source or 'a recording'}: {len(self.t)} instants of {' '.join(self.channels)}>"


def predict(vehicle: Vehicle, grid: Grid, *, horizon: float | None = None, delay: float | None = None) -> Prediction:
    """Predict a recording from its commands (or wrenches) alone.

    Where the vehicle has an `inflow_loss`, commands come to less in water that meets the thrusters; a wrench does not.

    Args:
        horizon: seconds after which the prediction is set back to the measured state; never where omitted.
        delay: from input to force [s]; where omitted the vehicle's for commands, none for a wrench.

    Raises:
        InputError: no commands or wrench, no row in which the motion is known, or a horizon that is not positive.
    """
    if horizon is not None and not horizon > 0.0:
        raise InputError(f"horizon: found {horizon}, expected a number of seconds above 0")
    if horizon == np.inf:
        horizon = None
    grid = _of_origin(vehicle, grid)
    starts = Starts.of(grid)
    over = acted(vehicle, grid, delay)
    n = len(grid)
    begin = inputs_known_from(vehicle, grid, delay)
    origin = next((i for i in range(n - 1) if starts.known(i)), n)
    first = next((i for i in range(origin, n - 1) if grid.t[i] >= begin and starts.known(i)), None)
    if first is None:
        raise InputError(f"{grid.source or 'recording'}: there is no instant at which all that is measured is known")
    states = np.full((n, 13), np.nan)
    reached = np.zeros(13)
    reached[3] = 1.0
    restarts: list[float] = []
    row = first
    while row < n - 1:
        reached = starts.state(row, reached)
        restarts.append(float(grid.t[row]))
        end = _next_start(grid, starts, origin, row, horizon)
        if row == first:
            states[row] = reached
        for begun in range(row, end, _BLOCK):
            run = _run(vehicle, reached, over, slice(begun, min(begun + _BLOCK, end)), grid.dt)
            states[begun + 1 : begun + len(run)] = run[1:]  # the row of a restart is judged by what ends there
            reached = run[-1].copy()
        if not np.isfinite(reached).all():
            reached = np.where(np.isfinite(reached), reached, 0.0)
            reached[3:7] = (1.0, 0.0, 0.0, 0.0)
        row = end
    wrench = np.vstack([over.wrench[:1], over.wrench])
    del starts, over  # room for what follows
    return Prediction(grid.t, _channels(grid, states), tuple(restarts), grid.source, wrench, states)


def _of_origin(vehicle: Vehicle, grid: Grid) -> Grid:
    """Return a recording with position and velocity of the body origin, where a vehicle is sure of the places."""
    learned = vehicle.posterior
    sure = {} if learned is None else surely_placed(learned.names, learned.mean, learned.std)
    dvl, marker = (np.array([sure.get(name, (0.0, 0.0))[0] for name in place]) for place in (DVL_PLACE, MARKER_PLACE))
    if not (dvl.any() or marker.any()):
        return grid
    position, eulers, v, omega = grid.pose[:, :3], grid.pose[:, 3:], grid.velocity[:, :3], grid.velocity[:, 3:]
    position, v = origin_motion(position, v, eulers, omega, marker, dvl)
    return replace(grid, pose=np.column_stack([position, eulers]), velocity=np.column_stack([v, omega]))


def _next_start(grid: Grid, starts: Starts, origin: int, row: int, horizon: float | None) -> int:
    """Return the row at which this stretch ends: a whole number of horizons after `origin`, or soon after."""
    last = len(grid) - 1
    if horizon is None:
        return last
    rows = max(1, round(horizon * grid.rate))
    end = origin + rows * ((row - origin) // rows + 1)
    while end < last and not starts.known(end):
        end += 1
    return min(end, last)


def _run(vehicle: Vehicle, state: Array, over: Acted, steps: slice, dt: float) -> Array:
    """Return the states (m + 1, 13) of m steps of what acted, each held, in substeps where the grid is coarse."""
    substeps = max(1, int(np.ceil(dt / _LONGEST_STEP - 1e-9)))
    p = np.array(vehicle.parameters)  # for one that cannot be written the kernels would be compiled again
    with np.errstate(all="ignore"):
        if over.forces is None:
            held = np.repeat(over.wrench[steps], substeps, axis=0)[:, None, :]
            run = simulate_run(p, state, held, dt / substeps, _STILL)
            return run[::substeps]
        forces = np.repeat(np.repeat(over.forces[steps, None], substeps, axis=0), 3, axis=1)
        B, pieces = configuration_matrix(vehicle), np.full(substeps, dt / substeps)
        return np.asarray(simulate_thrusters(p, state, np.zeros((len(forces), 6)), forces, B, pieces, _STILL))


def _channels(grid: Grid, states: Array) -> dict[str, tuple[Array, Array]]:
    """Return measured and predicted values of every channel that was measured."""
    angles = eulers_from_quaternions(np.ascontiguousarray(states[:, 3:7]))
    predicted = dict(zip(CHANNELS, [*states[:, 7:13].T, *states[:, :3].T, *angles.T], strict=True))
    measured = dict(zip(POSE + VELOCITIES, [*grid.pose.T, *grid.velocity.T], strict=True))
    fresh = dict(zip(POSE + VELOCITIES, grid.fresh.T[:12], strict=True))
    out = {}
    for name in CHANNELS:
        y = measured[name]
        if not fresh[name].all():  # else nothing to copy
            y = np.where(fresh[name], y, np.nan)
        if not np.isfinite(y).any():
            continue
        yhat = predicted[name]
        if name in _ANGLES:
            turns = np.round((yhat - y) / (2.0 * np.pi))
            np.subtract(yhat, 2.0 * np.pi * turns, out=yhat, where=np.isfinite(turns))
        out[name] = (y, yhat)
    return out
