"""What the joint estimator is to learn from logs and where it starts, by what least squares found and logs hold."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.identification.axes import AXES
from towtank.identification.estimate import Estimate
from towtank.identification.identifiability_words import HELD
from towtank.identification.joint_start import usual_disturbance
from towtank.identification.log_learning import LogLearning
from towtank.identification.samples import Samples
from towtank.identification.structure import not_commanded
from towtank.recording import Grid
from towtank.recording.rotations import conjugate, multiply, rotate
from towtank.vehicle import Vehicle

__all__ = ["SURE", "doubted_by_least_squares", "doubted_inertias", "idle", "known_start", "speeds_of", "wanted_of"]

_PACE = 0.5  # s between two poses that tell a speed
SURE = 0.025  # deviation of an inertia that least squares cannot tell: on real water the filter's are too small
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


def doubted_by_least_squares(first: LogLearning, found: Estimate) -> tuple[str, ...]:
    """Return a warning for each inertia that was asked for and found, though least squares could not tell it.

    The filter's deviation is that under a slow random force; least squares supposes nothing of what disturbs.
    """
    doubts = []
    for axis in AXES:
        name = axis.added_mass
        if name not in found or name not in first.estimate:
            continue
        learned, plain = found[name], first.estimate[name]
        total = next((each for each in found.sums if each.name == axis.sum_name), None)
        if plain.identified or not learned.identified or total is None or total.std <= SURE * total.value:
            continue
        why = (plain.reason or "not determined").removesuffix(HELD)
        doubts.append(
            f"{name}: least squares cannot tell it ({why}); its deviation of {total.std:.2g} {total.unit} holds if "
            "what disturbs the vehicle is a slow random force, and may be far too small if it is not"
        )
    return tuple(doubts)


def known_start(vehicle: Vehicle, first: LogLearning) -> Vehicle:
    """Return the vehicle with what least squares found, however unsure, where it is physical."""
    changes = {}
    for learned in first.estimate.coefficients:
        if learned.identified:
            changes[learned.name] = learned.value
    return vehicle.with_coefficients(changes) if changes else vehicle


def speeds_of(first: LogLearning) -> Array:
    """Return root mean square and largest size (6, 2) of the speeds, measured or from pose to pose; NaN if unknown."""
    out = np.full((6, 2), np.nan)
    between = [_paces(grid) for grid in first.grids]
    for i in range(6):
        columns = [grid.velocity[:, i] for grid in first.grids]
        columns = [v if np.isfinite(v).any() else pace[:, i] for v, pace in zip(columns, between, strict=True)]
        values = np.concatenate([column[np.isfinite(column)] for column in columns])
        if values.size:
            out[i] = np.sqrt(np.mean(values**2)), np.abs(values).max()
    return out


def _paces(grid: Grid) -> Array:
    """Return mean body velocities (k, 6) from pose to pose, `_PACE` apart: noise and jumps matter little."""
    step = max(2, round(_PACE / grid.dt))
    pose = grid.pose[::step]
    q, middle = quaternions_from_eulers(pose[:, 3:]), quaternions_from_eulers(grid.pose[step // 2 :: step, 3:])
    moved = rotate(conjugate(middle[: len(q) - 1]), np.diff(pose[:, :3], axis=0))
    turn = multiply(conjugate(q[:-1]), q[1:])
    size = np.linalg.norm(turn[:, 1:], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.where(size > 0.0, 2.0 * np.arctan2(size, np.abs(turn[:, 0])) / size, 2.0) * np.sign(turn[:, 0])
    return np.asarray(np.hstack([moved, turn[:, 1:] * angle[:, None]]) / (step * grid.dt))


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
