"""Where a second look of the streaming filter begins: coefficients by what is known, levels by what rows show."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.estimate import Estimate
from towtank.identification.joint import bounded, told_of
from towtank.identification.joint_start import rows_noise, rows_rough, start_theta
from towtank.identification.joint_state import JointState
from towtank.identification.log_learning import Levels
from towtank.identification.parameters import FreeParameters
from towtank.identification.samples import Samples
from towtank.identification.transition import N_FIXED
from towtank.vehicle import Vehicle

__all__ = ["look_levels", "look_starts"]

_LAG = 0.05  # s, to begin with


def look_starts(
    vehicle: Vehicle,
    known: tuple[FreeParameters, JointState] | None,
    free: FreeParameters,
    found: Estimate | None,
    delay: float,
) -> tuple[Array | None, Array]:
    """Return what the filter knows by now (n,), None before it knows anything, and what least squares says (n,).

    Args:
        known: coordinates of the filter by now, and the filter. free: coordinates (n,) of the look.
        found: by least squares. delay: [s] where it is not free.
    """
    rough = vehicle
    if found is not None:
        changes = {each.name: each.value for each in found.coefficients if each.identified}
        rough = vehicle.with_coefficients(changes) if changes else vehicle
    cold = start_theta(vehicle, rough, free, delay=delay, lag=_LAG)
    if known is None:
        return None, cold
    names, state = known[0].names, known[1]
    theta = dict(zip(names, state.theta, strict=True))
    anchor = dict(zip(names, state.anchor, strict=True))
    own = np.array([theta.get(name, cold[k]) for k, name in enumerate(free.names)])
    about = np.array([anchor.get(name, own[k]) for k, name in enumerate(free.names)])
    std = dict(zip(names, np.sqrt(np.diag(state.P)[N_FIXED:]), strict=False))
    known_std = np.array([std.get(name, np.inf) for name in free.names])
    return told_of(free, bounded(free, own, about, linear=True), known_std, cold), cold


def look_levels(rows: Samples, levels: Levels, *, first: bool) -> Levels:
    """Return the levels that a look starts with: noise as the rows show it, the rest as found before."""
    noise, rough = rows_noise(rows.t, rows.values), levels.rough
    beside = rows.measured[6:12] if not first else np.zeros(6, dtype=bool)
    noise[:6] = np.where(beside, np.maximum(noise[:6], levels.noise[:6]), noise[:6])
    unknown = np.isnan(rough)
    if unknown.any():
        rough = np.where(unknown, rows_rough(rows.t, rows.values), rough)
    return Levels(noise, levels.sigma, rough)
