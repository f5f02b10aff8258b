"""What was learned of the thrusters: their lag, gains of single ones, and the scale of force that all have in common.

Motion tells coefficients only in units of the thrust. Multiply the thrust of every thruster by (1 + e) and the same
motion follows from inertias, damping, righting moment, net weight and constant forces all (1 + e) times as large. So an
unknown e of deviation s adds s^2 g g^T to the covariance, g = d coefficient / d e: the coefficient itself, and for an
added mass, which is the rigid body's less the total, minus the total inertia.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.model.parameters import GAIN_PREFIX, FreeParameters
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.estimate import Estimate, with_covariance
from towtank.vehicle import Vehicle, index
from towtank.vehicle.thrusters.curves import is_of_unit_scale

__all__ = ["learned_gains", "with_gains_of", "with_scale", "with_thrust_scale", "with_thrusters"]

_CURE = "a bench test (towtank vehicle fit-thruster) or a bollard pull fixes the scale"


def with_thrust_scale(estimate: Estimate, vehicle: Vehicle) -> Estimate:
    """Return the estimate with the deviations that the vehicle's `scale_std` adds; unchanged where it gives none.

    For an estimate from thruster commands. Where a prior took part, which knows of the scale too, it is an upper limit.
    """
    if not vehicle.scale_std:
        return estimate
    growth = _growth(estimate, vehicle)
    return with_covariance(estimate, estimate.covariance + vehicle.scale_std**2 * np.outer(growth, growth))


def _growth(estimate: Estimate, vehicle: Vehicle) -> Array:
    """Return d coefficient / d ln scale (n,)."""
    growth = np.array(estimate.values, dtype=np.float64)
    for k, name in enumerate(estimate.names):
        kind, i, j = index(name)
        if kind == "mass":
            growth[k] -= vehicle.rigid_body_matrix[i, j]
    return growth


def scale_remarks(vehicle: Vehicle, free: Collection[str] = ()) -> tuple[str, ...]:
    """Say so where nothing fixes the scale of force of a vehicle learned from its thrusters' commands.

    Args:
        free: names of what was learned beside the vehicle's coefficients, `gain_<thruster>` among them.
    """
    thrusters = vehicle.thrusters
    if not thrusters:
        return ()
    if all(GAIN_PREFIX + thruster.name in free for thruster in thrusters):
        return (f"the gain of every thruster is free, so that only ratios of the coefficients are known; {_CURE}",)
    if vehicle.scale_std is None and all(is_of_unit_scale(thruster.curve) for thruster in thrusters):
        return (
            "the thrusters' curves are of unit scale and name no source, so that force has no known unit and only "
            f"ratios of the coefficients are known; {_CURE}, and scale_std in the vehicle file says how well",
        )
    return ()


def with_scale(learning: LogLearning, free: Collection[str] = ()) -> LogLearning:
    """Return what was learned from logs with the uncertainty of the thrust scale in estimate and model, and remarks.

    Nothing changes where the wrench was recorded, since no curve took part.
    """
    vehicle = learning.vehicle
    names = {thruster.name for thruster in vehicle.thrusters}
    if not names or not all(grid.command_t.size and names <= set(grid.thrusters) for grid in learning.grids):
        return learning
    estimate = with_thrust_scale(learning.estimate, vehicle)
    model = learning.model
    changed = [each for each in estimate.coefficients if each.identified] if estimate is not learning.estimate else []
    if changed:
        known = {**model.hydrodynamics, **{n: c for n, c in model.restoring if c is not None}}
        model = model.with_coefficients(
            {each.name: known[each.name].model_copy(update={"std": each.std}) for each in changed}
        )
    warnings = (*learning.warnings, *scale_remarks(vehicle, free))
    return replace(learning, estimate=estimate, model=model, warnings=warnings)


def learned_gains(vehicle: Vehicle, free: FreeParameters, theta: Array, std: Array) -> dict[str, tuple[float, float]]:
    """Return the gain of each thruster that has one free, and its deviation, as multiples of its curve."""
    before = {each.name: each.gain for each in vehicle.thrusters}
    out = {}
    for k, name in enumerate(free.names):
        if name.startswith(GAIN_PREFIX):
            thruster = name.removeprefix(GAIN_PREFIX)
            gain = before[thruster] * math.exp(float(theta[k]))
            out[thruster] = (gain, gain * float(std[k]))
    return out


def with_thrusters(vehicle: Vehicle, *, lag: float, gains: Mapping[str, tuple[float, float]]) -> Vehicle:
    """Return the vehicle with this lag [s] of all thrusters, unless it is NaN, and these gains."""
    thrusters = []
    for each in vehicle.thrusters:
        changes = {} if math.isnan(lag) else {"time_constant": lag}
        if each.name in gains:
            changes["gain"] = gains[each.name][0]
        thrusters.append(each.model_copy(update=changes))
    return vehicle.model_copy(update={"thrusters": tuple(thrusters)})


def with_gains_of(vehicle: Vehicle, prior: Vehicle) -> tuple[Vehicle, tuple[str, ...]]:
    """Return the vehicle with the gains of those thrusters that the prior has otherwise, and what is to be said of it.

    The prior's inertias and drags were learned with these gains, and mean nothing without them.
    """
    known = {each.name: each.gain for each in prior.thrusters}
    other = {each.name: known[each.name] for each in vehicle.thrusters if known.get(each.name, each.gain) != each.gain}
    if not other:
        return vehicle, ()
    listing = ", ".join(f"{name} {gain:.3g}" for name, gain in other.items())
    changed = with_thrusters(vehicle, lag=math.nan, gains={name: (gain, 0.0) for name, gain in other.items()})
    return changed, (f"gains of thrusters taken from the prior, whose coefficients were learned with them: {listing}",)
