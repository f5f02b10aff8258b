"""What the model as learned makes of the last seconds: a free run from the measured state, driven by the commands.

All that the page computes with is compiled before a session begins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.dashboard.motion import ACCELERATION, COMMANDS, POSE, VELOCITY, WRENCH, Motion
from towtank.errors import InputError
from towtank.identification import Estimate, Learner
from towtank.live.learning import Learnt
from towtank.recording import Grid
from towtank.recording.frames.pose_rates import velocity_of_pose
from towtank.recording.standard import FURTHER
from towtank.validation import predict
from towtank.vehicle import Vehicle

__all__ = ["SECONDS", "FreeRun", "FreeRuns", "Prediction", "free_run", "warm_up"]

SECONDS = 10.0  # s that the free run lasts
_RATE = 25.0  # Hz
_HALF = 5  # steps to either side, for a velocity taken from the pose
_DIVERGED = 1e3  # m/s, rad/s: a model that is hardly known may feed energy in
_LONGEST = 0.3  # s between two samples that are still joined
_LOSS = 0.1  # s/m: thrust that inflow takes, for a vehicle that does not say
_TOP = 98.0  # percentile of the speeds that counts as the largest: a jump of a marker is none


@dataclass(frozen=True)
class FreeRun:
    """Times (n,) [s], velocities measured and predicted (n, 6), and the root mean square (6,) of their difference.

    Attributes:
        derived: which (6,) were not measured themselves, but are the slope of what was.
    """

    t: Array
    measured: Array
    predicted: Array
    rms: Array
    derived: NDArray[np.bool_]


class Prediction:
    """The free run of a session, made anew when that is asked for.

    Attributes:
        motion: signals that came. run: the last one, None where there was none. speeds: the largest (6,) seen so far
            [m/s, rad/s].
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.motion = Motion(vehicle)
        self.run: FreeRun | None = None
        self.speeds = np.zeros(6)

    def renew(self, vehicle: Vehicle, estimate: Estimate, delay: float) -> FreeRun | None:
        """Run once more over what came lately; return the run, None where there is too little to start from."""
        t, rows = self.motion.last(SECONDS)
        run = free_run(vehicle, estimate, delay, t.copy(), rows.copy())
        if run is None:
            return None
        seen = np.abs(np.where(np.isfinite(run.measured), run.measured, 0.0))
        self.run, self.speeds = run, np.maximum(self.speeds, np.percentile(seen, _TOP, axis=0))
        return run


def free_run(
    vehicle: Vehicle, estimate: Estimate, delay: float, t: Array, rows: Array, seconds: float = SECONDS
) -> FreeRun | None:
    """Return the free run of the vehicle with what was learned put in; None where there is too little to start from.

    Args:
        t, rows: signals as of `Motion`, newest last.
    """
    if t.size < 10 or t[-1] - t[0] < 1.0:
        return None
    model = estimate.model(vehicle)
    grid = _grid(vehicle, t, rows, seconds)
    measured = _velocity(grid)
    try:
        found = predict(model, grid, delay=delay if math.isfinite(delay) else None)
    except InputError:
        return None
    predicted = np.where(np.isfinite(measured).any(axis=0), found.states[:, 7:13], np.nan)
    predicted[~(np.abs(predicted) < _DIVERGED)] = np.nan
    away = np.where(np.isfinite(measured), predicted - measured, np.nan)
    count = np.isfinite(away).sum(axis=0)
    rms = np.sqrt(np.nansum(away**2, axis=0) / np.maximum(count, 1))
    derived = np.asarray(np.isfinite(measured).any(axis=0) & ~np.isfinite(grid.velocity).any(axis=0))
    return FreeRun(grid.t, measured, predicted, np.where(count > 0, rms, np.nan), derived)


class FreeRuns:
    """The free run as it goes on: each call returns the instants that it has reached since the last one.

    Args:
        vehicle: that is learned.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._motion, self._told = vehicle, Motion(vehicle), -math.inf

    def __call__(self, came: Sequence[tuple[float, Mapping[str, Any]]], learnt: Learnt) -> list[tuple[float, Any, Any]]:
        """Return times [s] and velocities (6,), measured and predicted; none where too little has come to start from.

        Args:
            came: instants since the last call, with the learner's arguments. learnt: where learning stands.
        """
        self._motion.add(came)
        t, rows = self._motion.last(SECONDS)
        run = free_run(self._vehicle, learnt.estimate, learnt.delay, t, rows)
        if run is None:
            return []
        until = float(run.t[-1]) - _HALF / _RATE  # to there a velocity can be taken from the pose
        new = (run.t > self._told) & (run.t <= until)
        self._told = max(self._told, until)
        return list(zip(run.t[new].tolist(), run.measured[new], run.predicted[new], strict=True))


def _grid(vehicle: Vehicle, t: Array, rows: Array, seconds: float) -> Grid:
    n = int(min(seconds, t[-1] - t[0]) * _RATE) + 1
    times = t[-1] + (np.arange(n) - (n - 1)) / _RATE
    pose = _between(times, t, rows[:, POSE], turning=True)
    velocity = _between(times, t, rows[:, VELOCITY])
    acceleration = _between(times, t, rows[:, ACCELERATION])
    further = np.full((n, len(FURTHER)), np.nan)
    voltage = _between(times, t, rows[:, -1:])[:, 0]
    commands, wrench = rows[:, COMMANDS:-1], rows[:, WRENCH]
    commanded = np.isfinite(commands).all(axis=1) if commands.shape[1] else np.zeros(t.size, dtype=bool)
    pushed = np.isfinite(wrench).any(axis=1) & ~commanded.any()
    return Grid(
        t=times,
        rate=_RATE,
        pose=pose,
        velocity=velocity,
        acceleration=acceleration,
        further=further,
        fresh=np.isfinite(np.hstack([pose, velocity, acceleration, further])),
        voltage=voltage,
        thrusters=tuple(thruster.name for thruster in vehicle.thrusters),
        command_t=t[commanded],
        command_values=commands[commanded],
        wrench_t=t[pushed],
        wrench_values=wrench[pushed],
        source="the last seconds",
    )


def _between(times: Array, t: Array, columns: Array, *, turning: bool = False) -> Array:
    """Return columns (k, m) of t (k,) at `times` (n,), NaN where the next sample is far; angles are unwrapped."""
    out = np.full((times.size, columns.shape[1]), np.nan)
    for j, column in enumerate(columns.T):
        known = np.isfinite(column)
        if known.sum() < 2:
            continue
        stamps, values = t[known], column[known]
        if turning and j >= 3:
            values = np.unwrap(values)
        after = np.clip(np.searchsorted(stamps, times), 1, stamps.size - 1)
        near = (stamps[after] - stamps[after - 1] <= _LONGEST) & (times >= stamps[0] - 1e-9)
        out[near, j] = np.interp(times, stamps, values)[near]
    return out


def _velocity(grid: Grid) -> Array:
    """Return the measured body velocity (n, 6); where it was not, from the slope of the pose over 0.4 s.

    Roll and pitch that no sensor shows are none: where only the heading is measured, its slope is the yaw rate.
    """
    out = np.array(grid.velocity)
    missing = ~np.isfinite(out).any(axis=0)
    if not missing.any() or len(grid) < 2 * _HALF + 1:
        return out
    steps = np.arange(-_HALF, _HALF + 1)
    weights = steps[::-1] * grid.rate / float(steps @ steps)
    rate = np.full((len(grid), 6), np.nan)
    for j in range(6):
        rate[_HALF:-_HALF, j] = np.convolve(grid.pose[:, j], weights, mode="valid")
    derived = velocity_of_pose(grid.pose, rate, grid.velocity)
    out[:, missing] = derived[:, missing]
    return out


def warm_up(vehicle: Vehicle) -> None:
    """Run two seconds of a vehicle at rest through the free run: with a wrench, and with thrusters that inflow slows.

    What is not compiled here would be while the session runs, and hold everything up for many seconds.
    """
    inputs: dict[str, tuple[Vehicle, Array]] = {"wrench": (vehicle, np.zeros(6))}
    if vehicle.thrusters:
        losing = vehicle.with_coefficients({"inflow_loss": _LOSS})
        inputs["commands"] = losing, np.zeros(len(vehicle.thrusters))
    for name, (driven, values) in inputs.items():
        motion = Motion(driven)
        motion.add([(0.02 * k, {"pose": np.zeros(6), name: values}) for k in range(100)])
        free_run(driven, Learner(vehicle, method="paper").estimate, 0.0, *motion.last(2.0))
