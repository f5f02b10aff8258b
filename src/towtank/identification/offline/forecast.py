"""What a recording will make known: what a learning of its liveliest stretches by the joint filter knows.

Deviations fall with the time learned from, so the whole recording makes known at least as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.identification.data.samples import held_forces
from towtank.identification.least_squares.chain import uses_commands
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.estimate import Learned
from towtank.identification.posterior.wording import phrase, role, will_be_known
from towtank.recording import Grid
from towtank.vehicle import Vehicle, configuration_matrix, index, unit

__all__ = ["MOST_ROWS", "PredictedAccuracy", "best_excited", "predicted_accuracies"]

MOST_ROWS = 9_000  # of a recording that are used,
_STRETCHES = 6  # cut into so many where there are more
_MAY_BE_NOTHING = 25.0  # %, above which a term that may as well be 0 is given in its own unit


@dataclass(frozen=True)
class PredictedAccuracy:
    """One coefficient: to how many percent it will be known (inf: not), its deviation in its own unit, a sentence."""

    percent: float
    std: float
    unit: str
    text: str


def predicted_accuracies(learning: LogLearning) -> dict[str, PredictedAccuracy]:
    """Return the accuracies of what was identified; an added inertia counts with the rigid body's."""
    known = [each for each in learning.estimate.coefficients if each.identified]
    return {each.name: _accuracy(learning.vehicle, each, [other.name for other in known]) for each in known}


def _accuracy(vehicle: Vehicle, known: Learned, names: list[str]) -> PredictedAccuracy:
    kind, i, j = index(known.name)
    size = abs(float(vehicle.rigid_body_matrix[i, j]) - known.value if kind == "mass" else known.value)
    percent = 100.0 * known.std / size if size > 0.0 else np.inf
    text = will_be_known(phrase(known.name, names), percent)
    if percent > _MAY_BE_NOTHING and role(known.name).kind in ("restoring", "constant", "coupling"):
        text = f"{phrase(known.name)} will be known to {known.std:.2g} {unit(known.name)}"
    return PredictedAccuracy(percent, known.std, unit(known.name), text)


def best_excited(grid: Grid, vehicle: Vehicle, rows: int = MOST_ROWS) -> tuple[tuple[float, float], ...]:
    """Return the stretches (start, end) [s], of so many rows in all, in which the thrusters do the most on each axis;
    one that spans the grid where it has no more rows than that.
    """
    n = len(grid)
    if n <= rows:
        return ((float(grid.t[0]), float(grid.t[-1])),)
    wrench = grid.wrench
    if uses_commands(vehicle, grid):
        wrench = held_forces(vehicle, grid.commands, None) @ configuration_matrix(vehicle).T
    long = rows // _STRETCHES
    done = np.vstack([np.zeros(6), np.cumsum(np.nan_to_num(wrench) ** 2, axis=0)])
    inside = done[long:] - done[:-long]
    taken: list[int] = []
    for axis in range(6):
        free = np.all([np.abs(np.arange(len(inside)) - first) >= long for first in taken], axis=0)
        score = np.where(free, inside[:, axis], -1.0)[: n - long]
        if score.max() > 0.0:
            taken.append(int(np.argmax(score)))
    return tuple((float(grid.t[first]), float(grid.t[first + long])) for first in sorted(taken or [0]))
