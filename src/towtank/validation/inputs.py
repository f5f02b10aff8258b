"""The wrench that a model's thrusters gave over every step of a grid: held commands, delay and lag, exactly."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.errors import InputError
from towtank.identification.chain import uses_commands
from towtank.identification.held_input import HeldInput, held_integral_into, held_push, new_held_input
from towtank.identification.samples import with_absent_zero
from towtank.recording import Grid
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

__all__ = ["inputs_known_from", "mean_wrenches"]

_FORGOTTEN = 3.0  # time constants, after which 5 % of a force is left
_LONGEST = 0.1  # of a recording, that is spent on that


@kernel
def _means(held: HeldInput, shape: Array, t: Array, stamps: Array, forces: Array) -> Array:
    """Return the mean wrench (n - 1, 6) over each interval of t (n,) of forces (k, m) held from stamps (k,) on."""
    n, m = t.shape[0], forces.shape[1]
    out = np.zeros((n - 1, 6))
    total = np.empty(m)
    event = 0
    for i in range(n):
        while event < stamps.shape[0] and stamps[event] <= t[i]:
            held_push(held, stamps[event], forces[event])
            event += 1
        held_integral_into(held, t[i], total)
        if i > 0:
            for a in range(6):
                for j in range(m):
                    out[i - 1, a] += shape[a, j] * total[j] / (t[i] - t[i - 1])
    return out


def mean_wrenches(vehicle: Vehicle, grid: Grid, delay: float | None = None) -> Array:
    """Return the mean wrench [N, N m] (n - 1, 6) over each step of the grid, body FRD; before the first command, it.

    Args:
        delay: from input to force [s]; where omitted the vehicle's for commands and none for a recorded wrench, which
            is what acted.

    Raises:
        InputError: the grid has neither this vehicle's commands nor a wrench.
    """
    if uses_commands(vehicle, grid):
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
    return _means(
        new_held_input(shape.shape[1], lag, delay),
        np.ascontiguousarray(shape),
        grid.t,
        stamps,
        np.ascontiguousarray(forces),
    )


def inputs_known_from(vehicle: Vehicle, grid: Grid, delay: float | None = None) -> float:
    """Return the time [s] from which on the recorded inputs act: before it nobody knows what the thrusters did.

    Thrusters that lag still remember for a few time constants what came before the recording. No more than a tenth of
    what is left is spent on that.

    Args as `mean_wrenches`.
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
