"""Many vehicles, or many variants of one, through the same or different experiments at once, on all cores."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.core.layout import N_PARAMETERS
from towtank.core.rk4 import simulate_runs
from towtank.errors import InputError
from towtank.simulation.inputs import finite_array, initial_states, positive
from towtank.simulation.motion import continuous_eulers
from towtank.vehicle import AnyVehicle, Vehicle, vehicle_of

__all__ = ["Batch", "simulate_batch"]

_VEHICLE = (Vehicle, str, os.PathLike)


@dataclass(frozen=True, eq=False)
class Batch:
    """The motion of r runs. A run that grew beyond all bounds holds NaN or infinity; the others are not touched by it.

    Attributes:
        t: time of the final states () or of all states (n + 1,) [s].
        eta: x y z phi theta psi (r, 6) or (r, n + 1, 6) [m, rad], NED; over time roll and yaw do not jump.
        nu: velocity over ground, the same shape [m/s, rad/s], body FRD.
    """

    t: Array
    eta: Array
    nu: Array

    def __len__(self) -> int:
        return int(self.eta.shape[0])


def simulate_batch(
    vehicles: AnyVehicle | Sequence[AnyVehicle] | ArrayLike,
    *,
    wrench: ArrayLike,
    dt: float = 0.01,
    eta0: ArrayLike | None = None,
    nu0: ArrayLike | None = None,
    current: ArrayLike = (0.0, 0.0, 0.0),
    keep: Literal["final", "all"] = "final",
) -> Batch:
    """Simulate r runs in parallel, each over n steps of dt [s].

    Args:
        vehicles: one vehicle for all runs, r vehicles (or names or paths of them), or kernel parameters (r, 170)
            (`Vehicle.parameters`).
        wrench: held X Y Z K M N [N, N m]: (n, 6) shared, or (r, n, 6). A vehicle's `inflow_loss` takes nothing of it.
        eta0, nu0: start, (6,) shared or (r, 6); default zero.
        current: velocity of the water (3,) [m/s], NED.
        keep: "final" states, or "all" of them (about 200 bytes per step and run while it works).

    Raises:
        InputError: an argument is wrong, or the numbers of runs do not agree.
    """
    dt = positive("dt", dt)
    if keep not in ("final", "all"):
        raise InputError(f'keep: found "{keep}", expected "final" or "all"')
    tau = finite_array("wrench", wrench, ("n", 6), ("r", "n", 6))
    tau = tau[None] if tau.ndim == 2 else tau
    pose = finite_array("eta0", np.zeros(6) if eta0 is None else eta0, (6,), ("r", 6))
    velocity = finite_array("nu0", np.zeros(6) if nu0 is None else nu0, (6,), ("r", 6))
    water = finite_array("current", current, (3,))
    p = _parameters(vehicles)
    counts = {"vehicles": p.shape[0], "wrench": tau.shape[0], "eta0": len(pose) if pose.ndim == 2 else 1}
    counts["nu0"] = len(velocity) if velocity.ndim == 2 else 1
    runs = max(counts.values())
    if any(count not in (1, runs) for count in counts.values()):
        found = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise InputError(f"simulate_batch: the numbers of runs do not agree: {found}; expected 1 or {runs} of each")

    p = np.array(np.broadcast_to(p, (runs, N_PARAMETERS)), order="C")  # writable: one type, one compilation
    pose, velocity = np.broadcast_to(pose, (runs, 6)), np.broadcast_to(velocity, (runs, 6))
    state0 = initial_states(pose, velocity)
    n = tau.shape[1]
    states = simulate_runs(p, state0, tau, dt, water, max(n, 1) if keep == "final" else 1)
    if keep == "all" or n == 0:
        states = np.concatenate([state0[:, None], states], axis=1)
    t = np.array(n * dt) if keep == "final" else np.arange(n + 1) * dt
    angles = continuous_eulers(states[..., 3:7], pose[:, 3:] if keep == "all" else None)
    eta, nu = np.concatenate([states[..., :3], angles], axis=-1), np.ascontiguousarray(states[..., 7:])
    if keep == "final":
        eta, nu = eta[:, 0], nu[:, 0]
    for array in (t, eta, nu):
        array.flags.writeable = False
    return Batch(t, eta, nu)


def _parameters(vehicles: AnyVehicle | Sequence[AnyVehicle] | ArrayLike) -> Array:
    """Return kernel parameters (r, 170)."""
    if isinstance(vehicles, _VEHICLE):
        return np.array(vehicle_of(vehicles).parameters)[None]
    if isinstance(vehicles, Sequence) and len(vehicles) and isinstance(vehicles[0], _VEHICLE):
        others = [type(v).__name__ for v in vehicles if not isinstance(v, _VEHICLE)]
        if others:
            raise InputError(f"vehicles: found {others[0]} among them, expected vehicles only")
        return np.array([vehicle_of(v).parameters for v in vehicles if isinstance(v, _VEHICLE)])
    parameters = finite_array("parameters", vehicles, ("r", N_PARAMETERS))  # type: ignore[arg-type]
    if not len(parameters):
        raise InputError("vehicles: found none, expected at least one")
    return parameters
