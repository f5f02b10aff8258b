"""What drives the vehicle in one simulation: a wrench or commands, held or continuous, checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording.standard import COMMAND_PREFIX
from towtank.simulation.actuation import Drive, FunctionDrive, HeldDrive, cut_step
from towtank.simulation.inputs import finite_array, step_count
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

__all__ = ["drive_of"]


def drive_of(
    vehicle: Vehicle,
    wrench: ArrayLike | Callable[[Array], Array] | None,
    commands: ArrayLike | None,
    voltage: ArrayLike | None,
    dt: float,
    duration: float | None,
    delay: float | None,
    substeps: int,
    later: Sequence[tuple[int, Vehicle]] = (),
) -> tuple[Drive, int, dict[str, Array]]:
    """Return what drives the vehicle, the number of steps, and the input channels (n,) by name.

    Args:
        later: the vehicle whose thrusters they are from a step on; positions and directions must not change.
    """
    if wrench is not None and commands is not None:
        raise InputError("simulate: give a wrench or commands, not both")
    if voltage is not None and commands is None:
        raise InputError("voltage: it acts through the thrusters; give commands")
    late = (vehicle.command_delay if commands is not None else 0.0) if delay is None else float(delay)
    if not (math.isfinite(late) and late >= 0.0):
        raise InputError(f"delay: found {late} s, expected 0 or more")
    if commands is None and (wrench is None or callable(wrench)):
        if duration is None:
            raise InputError("duration: needed where the input is not held; give it in seconds")
        if late:
            raise InputError("delay: a function of time is not delayed; shift the time inside it")
        n = step_count(duration, dt)
        pieces = cut_step(dt, substeps=substeps)
        if callable(wrench):
            return FunctionDrive(wrench, dt, pieces), n, {}
        return HeldDrive(np.zeros((n, 6)), np.eye(6), np.zeros(6), pieces), n, {}
    if commands is None:
        values = finite_array("wrench", cast(ArrayLike, wrench), ("n", 6))
        n = _steps(values, duration, dt, "wrench")
        pieces = cut_step(dt, delay=late, substeps=substeps)
        return HeldDrive(values[:n], np.eye(6), np.zeros(6), pieces), n, {}
    m = len(vehicle.thrusters)
    if m == 0:
        raise InputError(f"{vehicle.name} has no thrusters; add [[thrusters]] to its file or give a wrench instead")
    orders = finite_array("commands", commands, ("n", m))
    n = _steps(orders, duration, dt, "commands")
    given = {f"{COMMAND_PREFIX}{thruster.name}": orders[:n, k] for k, thruster in enumerate(vehicle.thrusters)}
    supply = None
    if voltage is not None:
        supply = finite_array("voltage", voltage, (), (len(orders),))
        supply = np.full(n, float(supply)) if supply.ndim == 0 else supply[:n]
        given["voltage"] = supply
    lags = np.array([thruster.time_constant for thruster in vehicle.thrusters])
    pieces = cut_step(dt, delay=late, substeps=substeps, lags=lags)
    forces = thruster_forces(vehicle, orders[:n], supply)
    for first, other in later:
        if not np.array_equal(configuration_matrix(other), configuration_matrix(vehicle)):
            raise InputError(
                f"changes: {other.name} has its thrusters elsewhere than {vehicle.name}; keep their places"
            )
        forces[first:] = thruster_forces(other, orders[first:n], None if supply is None else supply[first:])
    return HeldDrive(forces, configuration_matrix(vehicle), lags, pieces), n, given


def _steps(values: Array, duration: float | None, dt: float, name: str) -> int:
    """Return how many steps to take with a held input: all its rows, or those within `duration`."""
    rows = values.shape[0]
    n = rows if duration is None else step_count(duration, dt)
    if n < 1 or n > rows:
        wanted = "at least one row" if n < 1 else f"at least {n} rows for a duration of {duration:g} s"
        raise InputError(f"{name}: found {rows} rows of {dt:g} s, expected {wanted}")
    return n
