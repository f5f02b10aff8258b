"""How the demo's estimate comes along: what is learned, its truth, and its curve over time."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import numpy as np

from towtank.core.arrays import Array
from towtank.identification import Estimate
from towtank.identification.model.terms import AXES
from towtank.identification.offline.convergence import Convergence
from towtank.recording.event import Event
from towtank.vehicle import Vehicle, index, unit

__all__ = ["SETTLED", "SETTLING", "WAITING", "LearningCurve", "Quantity", "convergence_of", "quantities", "readings"]

WAITING, SETTLING, SETTLED = "waiting", "settling", "settled"
_LOOK_BACK = 5.0  # s over which a settled value must have kept still
_SURE = 0.05  # relative deviation of a settled value
_RIGHTING, _WEIGHT = "BG_z", "W_minus_B"


@dataclass(frozen=True)
class Quantity:
    """One thing that is learned: `m - X_udot`, `X_uu`, .., `BG_z`.

    Attributes:
        name: as above. coefficient: the SNAME name in it. axes: of surge .. yaw, those whose motion tells it.
        kind: "inertia", "drag", "moment" or "weight". unit: SI. truth: value in the simulator.
    """

    name: str
    coefficient: str
    axes: tuple[str, ...]
    kind: str
    unit: str
    truth: float

    @property
    def axis(self) -> str:
        """The first of its axes."""
        return self.axes[0]


def quantities(truth: Vehicle, *, weight: bool = False) -> tuple[Quantity, ...]:
    """Return what the demo learns, axis by axis, and the righting moment at the end; and the net weight where asked."""
    found = []
    for axis in AXES:
        inertia = float(truth.mass_matrix[axis.index, axis.index])
        found.append(Quantity(axis.sum_name, axis.added_mass, (axis.name,), "inertia", axis.unit, inertia))
        drag = truth.coefficient(axis.quadratic)
        found.append(Quantity(axis.quadratic, axis.quadratic, (axis.name,), "drag", unit(axis.quadratic), drag))
    righting = truth.coefficient(_RIGHTING)
    found.append(Quantity(_RIGHTING, _RIGHTING, ("roll", "pitch"), "moment", unit(_RIGHTING), righting))
    if weight:
        found.append(Quantity(_WEIGHT, _WEIGHT, ("heave",), "weight", unit(_WEIGHT), truth.coefficient(_WEIGHT)))
    return tuple(found)


def readings(estimate: Estimate, learned: tuple[Quantity, ...]) -> tuple[Array, Array]:
    """Return value and standard deviation (n,) of each quantity; NaN where it is not identified.

    Before the inertia of an axis is known, only the ratios of its other coefficients to the inertia are: they wait.
    """
    known = {each.name: (each.value, each.std) for each in estimate.sums}
    moving = {quantity.axis for quantity in learned if quantity.kind == "inertia" and quantity.name in known}
    known |= {each.name: (each.value, each.std) for each in estimate.coefficients if each.identified}
    nothing = (np.nan, np.nan)
    pairs = np.array([known.get(q.name, nothing) if moving.issuperset(q.axes) else nothing for q in learned])
    return pairs[:, 0], pairs[:, 1]


@dataclass
class LearningCurve:
    """Estimates over time, one row for each reading.

    Attributes:
        learned: the quantities, with the truth of now.
        t: times of the readings [s]. values, std: each (n,) per reading.
        events: what the learner noticed.
    """

    learned: tuple[Quantity, ...]
    t: list[float] = field(default_factory=list)
    values: list[Array] = field(default_factory=list)
    std: list[Array] = field(default_factory=list)
    events: tuple[Event, ...] = ()

    def read(self, t: float, estimate: Estimate) -> None:
        """Add the estimate of time t [s]."""
        values, std = readings(estimate, self.learned)
        self.t.append(t)
        self.values.append(values)
        self.std.append(std)

    def state(self, i: int) -> str:
        """Return whether quantity i is still waited for, is settling, or has settled.

        Settled: known to 5 % by its own deviation, and moved by less than one deviation during the last 5 s.
        """
        if not self.t or not np.isfinite(self.values[-1][i]):
            return WAITING
        value, std = self.values[-1][i], self.std[-1][i]
        before = max(int(np.searchsorted(self.t, self.t[-1] - _LOOK_BACK, side="right")) - 1, 0)
        moved = abs(value - self.values[before][i])
        sure = std <= _SURE * abs(value)
        return SETTLED if sure and self.t[-1] - self.t[before] >= 0.9 * _LOOK_BACK and moved <= std else SETTLING

    @property
    def states(self) -> tuple[str, ...]:
        """State of every quantity."""
        return tuple(self.state(i) for i in range(len(self.learned)))

    def latest(self) -> Iterator[tuple[Quantity, float, float]]:
        """Yield each quantity with its latest value and deviation, NaN where it is not identified."""
        nothing = np.full(len(self.learned), np.nan)
        values, std = (self.values[-1], self.std[-1]) if self.t else (nothing, nothing)
        for quantity, value, deviation in zip(self.learned, values, std, strict=True):
            yield quantity, float(value), float(deviation)


def convergence_of(curve: LearningCurve, known: Vehicle, names: Collection[str] | None = None) -> Convergence:
    """Return the curve as that of coefficients: of the inertias without the rigid body's.

    Args:
        known: the vehicle with that rigid body. names: of the coefficients; all by default.
    """
    shape = len(curve.t), len(curve.learned)
    values, std = np.array(curve.values).reshape(shape), np.array(curve.std).reshape(shape)
    rigid = np.diag(known.rigid_body_matrix)
    for k, quantity in enumerate(curve.learned):
        if quantity.kind == "inertia":
            values[:, k] = rigid[index(quantity.coefficient)[1]] - values[:, k]
    kept = [k for k, quantity in enumerate(curve.learned) if names is None or quantity.coefficient in names]
    chosen = tuple(curve.learned[k].coefficient for k in kept)
    return Convergence(chosen, np.array(curve.t), values[:, kept], std[:, kept])
