"""What becomes of segments that nobody steers: many vehicles that it may be, each pushed about by a force of its own.

From this come the probability of leaving the space, of each segment and of all together, and the tank that would do.
Every segment begins at rest at the start: between two of them somebody brings the vehicle back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.planning.forecast import RATE, Outlook, draws_of
from towtank.planning.segments import Segment, commands_of
from towtank.planning.space import Space
from towtank.simulation import OrnsteinUhlenbeck, stream
from towtank.simulation.actuation import HeldDrive, cut_step
from towtank.simulation.inputs import initial_states
from towtank.simulation.integration import simulate_thrusters
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

__all__ = ["Unsteered", "unsteered"]

_VEHICLES, _FORCES = 1500, 1  # drawn, forces that each of them meets: an error of 0.013 at most; 400 times 3: 0.024
_SUBSTEPS = 2
_SURE = 0.95  # share of the runs that a tank must hold


@dataclass(frozen=True, eq=False)
class Unsteered:
    """The runs.

    Attributes:
        paths: of each segment, places (r, n + 1, 3) of the body origin [m], NED. space: None in open water, where the
            paths begin at the origin. radius: of the vehicle's sphere [m].
    """

    paths: tuple[Array, ...]
    space: Space | None
    radius: float

    @property
    def left(self) -> NDArray[np.bool_]:
        """Whether each segment (s, r) touched a wall; a run that grew beyond all bounds did."""
        if self.space is None:
            return np.zeros((len(self.paths), len(self.paths[0])), dtype=np.bool_)
        near = [self.space.clearance(each, self.radius).min(axis=1) for each in self.paths]
        return ~(np.array(near) >= 0.0)

    @property
    def leaves(self) -> tuple[float, ...]:
        """The probability that each segment leaves the space."""
        return tuple(float(share) for share in self.left.mean(axis=1))

    @property
    def whole(self) -> float:
        """The probability that one of them does, by the same vehicle."""
        return float(self.left.any(axis=0).mean())

    def room(self, share: float = _SURE) -> tuple[float, float, float]:
        """Return length, width and depth [m] of the least tank, begun in its middle, that holds this share of the runs.

        Infinite where more runs than that grew beyond all bounds.
        """
        away = np.array([np.abs(each - each[:, :1]).max(axis=1) for each in self.paths]).max(axis=0)
        away = np.where(np.isfinite(away), away, np.inf)
        order = np.sort(away, axis=0)
        for rank in range(int(np.ceil(share * len(away))) - 1, len(away)):
            if (away <= order[rank]).all(axis=1).mean() >= share:
                break
        x, y, z = (float(2.0 * (each + self.radius)) for each in order[rank])
        return x, y, z


def unsteered(
    outlook: Outlook,
    segments: Sequence[Segment],
    space: Space | None,
    *,
    vehicles: int = _VEHICLES,
    forces: int = _FORCES,
    seed: int = 0,
) -> Unsteered:
    """Return what becomes of segments, each from rest at the start of the space, with random force.

    Args:
        vehicles: that are drawn from what is known. forces: that each of them meets.

    Raises:
        InputError: the vehicle has no room in the space.
    """
    radius = 0.0 if space is None else space.require_room(outlook.vehicle)
    drawn = draws_of(outlook, vehicles, seed)
    levels = np.array(outlook.disturbance) * np.diag(outlook.vehicle.mass_matrix)
    push = OrnsteinUhlenbeck(std=tuple(levels.tolist()), time_constant=outlook.correlation)
    seeds = stream(seed, "unsteered", "forces").integers(2**31, size=(len(segments), vehicles, forces))
    start = initial_states(np.zeros(6) if space is None else space.eta0, np.zeros(6))
    paths = []
    for segment, own in zip(segments, seeds, strict=True):
        commands = commands_of(segment, outlook.vehicle)
        unit = thruster_forces(_of_unit_gain(outlook.vehicle), commands)  # draws differ in gains, not in curves
        pushes = [[push.sample(len(unit), 1.0 / RATE, int(each)) for each in row] for row in own]
        runs = [_paths(each, unit, start, row) for each, row in zip(drawn, pushes, strict=True)]
        paths.append(np.concatenate(runs))
    return Unsteered(tuple(paths), space, radius)


def _of_unit_gain(vehicle: Vehicle) -> Vehicle:
    thrusters = tuple(each.model_copy(update={"gain": 1.0}) for each in vehicle.thrusters)
    return vehicle.model_copy(update={"thrusters": thrusters})


def _paths(truth: Vehicle, unit: Array, start: Array, pushes: Sequence[Array]) -> Array:
    """Return the places (r, n + 1, 3) [m] of one vehicle under its thrusters' forces of unit gain (n, m) at `RATE` and
    each of r forces (n, 6).

    Exactly as `simulate` does, without its sensors: delay, lags, and the thrust that is lost to inflow.
    """
    lags = np.array([thruster.time_constant for thruster in truth.thrusters])
    pieces = cut_step(1.0 / RATE, delay=truth.command_delay, substeps=_SUBSTEPS, lags=lags)
    matrix, parameters = configuration_matrix(truth), np.array(truth.parameters)
    gains = np.array([each.gain for each in truth.thrusters])
    thrust = HeldDrive(gains * unit, pieces, matrix, lags).stages(0, len(unit)).forces
    if thrust is None:
        thrust = np.zeros((len(unit) * pieces.lengths.size, 3, len(lags)))
    out = []
    for push in pushes:
        held = np.repeat(push, pieces.lengths.size, axis=0)
        out.append(simulate_thrusters(parameters, start, held, thrust, matrix, pieces.lengths, np.zeros(3))[:, :3])
    return np.array(out)
