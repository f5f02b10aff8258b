"""What the joint estimator is to learn from logs and where it starts, by what least squares found and logs hold."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.axes import AXES
from towtank.identification.joint_start import usual_disturbance
from towtank.identification.log_learning import LogLearning
from towtank.identification.samples import Samples
from towtank.identification.structure import not_commanded
from towtank.vehicle import Vehicle

__all__ = ["doubted_inertias", "idle", "known_start", "speeds_of", "wanted_of"]

_IDLE = 0.3  # of the usual disturbance: a commanded force that teaches nothing


def wanted_of(
    vehicle: Vehicle, asked: tuple[str, ...] | None, first: LogLearning
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the names to free and, for those that least squares could not find, why."""
    if asked is not None:
        return asked, {}
    estimate = first.estimate
    names = tuple(name for name, ok in zip(estimate.names, estimate.identified, strict=True) if ok)
    held = {
        name: reason or ""
        for name, ok, reason in zip(estimate.names, estimate.identified, estimate.reasons, strict=True)
        if not ok
    }
    return names, held


def doubted_inertias(names: Collection[str], held: Collection[str]) -> tuple[str, ...]:
    """Return the inertias that least squares could not find on axes whose damping it found."""
    return tuple(a.added_mass for a in AXES if a.added_mass in held and (a.linear in names or a.quadratic in names))


def known_start(vehicle: Vehicle, first: LogLearning) -> Vehicle:
    """Return the vehicle with what least squares found, however unsure, where it is physical."""
    changes = {}
    for learned in first.estimate.coefficients:
        if learned.identified:
            changes[learned.name] = learned.value
    return vehicle.with_coefficients(changes) if changes else vehicle


def speeds_of(first: LogLearning) -> Array:
    """Return root mean square and largest size (6, 2) of the speeds."""
    out = np.zeros((6, 2))
    for i in range(6):
        columns = [grid.velocity[:, i] for grid in first.grids]
        values = np.concatenate([column[np.isfinite(column)] for column in columns])
        if values.size:
            out[i] = np.sqrt(np.mean(values**2)), np.abs(values).max()
    return out


def idle(vehicle: Vehicle, samples: Sequence[Samples]) -> dict[str, str]:
    """Return the inertias and dampings of axes that nothing but the water moved, and what is to be said of them.

    How much they are beside the water's force is told, and of that no size. They are free all the same: the others
    would pay for what they are held at.
    """
    moments, counted = np.zeros((2, 6)), 0
    for each in samples:
        forces = each.input_force[np.isfinite(each.input_force).all(axis=1)]
        moments[0] += each.shape @ forces.sum(axis=0)
        moments[1] += np.einsum("ij,jk,ik->i", each.shape, forces.T @ forces, each.shape)
        counted += len(forces)
    if not counted:
        return {}
    mean, square = moments / counted
    still = square - mean**2 < (_IDLE * usual_disturbance(vehicle)) ** 2
    return {
        name: not_commanded(axis) for axis in AXES for name in (*axis.columns[:2], axis.added_mass) if still[axis.index]
    }
