"""Free-running prediction: the model alone, driven by what the thrusters were told, from one measured state.

With a horizon it is set back to the measured state every so many seconds, which is the fair question for a vehicle
that tumbles: small errors of attitude grow without bound and say little about coefficients. When is a matter of the
recording alone: models that answer sooner or later are set back at the same instants.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import eulers_from_quaternions
from towtank.core.rk4 import simulate_run
from towtank.errors import InputError
from towtank.recording import Grid
from towtank.recording.standard import POSE, VELOCITIES
from towtank.validation.inputs import inputs_known_from, mean_wrenches
from towtank.validation.starts import Starts
from towtank.vehicle import Vehicle

__all__ = ["CHANNELS", "Prediction", "predict"]

CHANNELS = ("u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi")
_LONGEST_STEP = 0.02  # s
_BLOCK = 20_000  # steps simulated at once
_STILL = np.zeros(3)
_ANGLES = ("phi", "theta", "psi")


@dataclass(frozen=True, eq=False)
class Prediction:
    """One recording predicted.

    Attributes:
        t: times (n,) [s]. channels: name -> (measured (n,), predicted (n,)); measured is NaN where there was no
            sample. restarts: times at which the prediction was set to the measured state. source: of the recording.
        wrench: mean wrench [N, N m] (n, 6) over the step that ends at each time, body FRD.
        states: predicted states (n, 13) [x y z, quaternion, nu], NaN before the first restart.
    """

    t: Array
    channels: Mapping[str, tuple[Array, Array]]
    restarts: tuple[float, ...]
    source: str = ""
    wrench: Array = field(default_factory=lambda: np.zeros((0, 6)))
    states: Array = field(default_factory=lambda: np.zeros((0, 13)))


def predict(vehicle: Vehicle, grid: Grid, *, horizon: float | None = None, delay: float | None = None) -> Prediction:
    """Predict a recording from its commands (or wrenches) alone.

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
    starts = Starts.of(grid)
    acted = mean_wrenches(vehicle, grid, delay)
    acted = np.vstack([acted[:1], acted])
    wrenches = acted[1:]
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
            run = _run(vehicle, reached, wrenches[begun : min(begun + _BLOCK, end)], grid.dt)
            states[begun + 1 : begun + len(run)] = run[1:]  # the row of a restart is judged by what ends there
            reached = run[-1].copy()
        if not np.isfinite(reached).all():
            reached = np.where(np.isfinite(reached), reached, 0.0)
            reached[3:7] = (1.0, 0.0, 0.0, 0.0)
        row = end
    del starts, wrenches  # room for what follows
    return Prediction(grid.t, _channels(grid, states), tuple(restarts), grid.source, acted, states)


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


def _run(vehicle: Vehicle, state: Array, wrenches: Array, dt: float) -> Array:
    """Return the states (m + 1, 13) of m steps of held wrenches (m, 6), in substeps where the grid is coarse."""
    substeps = max(1, int(np.ceil(dt / _LONGEST_STEP - 1e-9)))
    held = np.repeat(wrenches, substeps, axis=0)[:, None, :]
    with np.errstate(all="ignore"):
        run = simulate_run(vehicle.parameters, state, np.ascontiguousarray(held), dt / substeps, _STILL)
    return run[::substeps]


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
