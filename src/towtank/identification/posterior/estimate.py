"""What has been learned: coefficients with their deviations and covariance, sums where only sums are known, reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.identification.model.terms import AXES
from towtank.vehicle import Coefficient, Provenance, Vehicle
from towtank.vehicle import unit as unit_of

__all__ = ["AxisReport", "Estimate", "Learned", "SumOfInertias", "with_shift"]


@dataclass(frozen=True)
class Learned:
    """One coefficient: value and standard deviation (NaN where not identified), unit, and why it is not identified."""

    name: str
    value: float
    std: float
    unit: str
    identified: bool
    reason: str | None = None


@dataclass(frozen=True)
class SumOfInertias:
    """A rigid-body inertia less its added inertia, `I_z - N_rdot`: the only thing that motion can tell."""

    name: str
    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class AxisReport:
    """How one axis was learned.

    Attributes:
        name: surge .. yaw. rows: samples used. condition: of the regressors, each scaled to unit size.
        excitation: smallest eigenvalue of the scaled regressors' mean outer product; 0 is no persistence of excitation.
        residual: standard deviation of the filtered residual, in the units of the axis' velocity.
    """

    name: str
    rows: float
    condition: float
    excitation: float
    residual: float


@dataclass(frozen=True)
class Estimate:
    """Coefficients learned so far, in the order of `names`.

    Attributes:
        values, std: (n,); a coefficient that is not identified has the value that the model keeps and std NaN.
        covariance: (n, n), NaN in the rows of those not identified.
        identified: (n,). reasons: why not, None where it is.
        sums: inertias as they are really known. axes: how each axis was learned.
        duration: time learned from [s]. samples: how many.
    """

    names: tuple[str, ...]
    values: Array
    std: Array
    covariance: Array
    identified: tuple[bool, ...]
    reasons: tuple[str | None, ...]
    sums: tuple[SumOfInertias, ...]
    axes: tuple[AxisReport, ...]
    duration: float
    samples: int

    def __repr__(self) -> str:
        return f"<Estimate: {sum(self.identified)} of {len(self.names)} coefficients known, {self.samples} samples>"

    def __getitem__(self, name: str) -> Learned:
        if name not in self.names:
            raise InputError(f'no coefficient "{name}" was learned{nearest(name, self.names)}')
        i = self.names.index(name)
        return Learned(
            name, float(self.values[i]), float(self.std[i]), unit_of(name), self.identified[i], self.reasons[i]
        )

    def __contains__(self, name: object) -> bool:
        return name in self.names

    @property
    def coefficients(self) -> tuple[Learned, ...]:
        """Every coefficient as a record."""
        return tuple(self[name] for name in self.names)

    def model(self, vehicle: Vehicle, source: str = "learned by towtank", notes: Sequence[str] = ()) -> Vehicle:
        """Return `vehicle` with what was identified put in, and a damping term that another stands for taken out."""
        changes: dict[str, Coefficient | float] = {}
        for learned in self.coefficients:
            if learned.identified:
                changes[learned.name] = Coefficient(value=learned.value, std=learned.std, source=source)
            elif learned.value != vehicle.coefficient(learned.name):
                changes[learned.name] = Coefficient(value=learned.value, source=f"{source}: {learned.reason}")
        kept = vehicle.provenance.notes
        notes = (*(kept if isinstance(kept, tuple) else (kept,) if kept else ()), *notes)
        return vehicle.with_coefficients(changes, provenance=Provenance(source=source, notes=notes))


def with_covariance(estimate: Estimate, covariance: Array) -> Estimate:
    """Return the estimate with this covariance (n, n), and the deviations that follow from it."""
    std = np.sqrt(np.diag(covariance))
    added = {axis.sum_name: axis.added_mass for axis in AXES}
    sums = tuple(replace(each, std=float(std[estimate.names.index(added[each.name])])) for each in estimate.sums)
    return replace(estimate, covariance=covariance, std=std, sums=sums)


def with_shift(estimate: Estimate, shifted: Estimate) -> Estimate:
    """Return the estimate with the deviations that a common cause adds, such as a delay that is not known exactly.

    Args:
        shifted: the estimate where that cause is one deviation off.
    """
    shift = np.array(
        [
            shifted[name].value - value if known and name in shifted and shifted[name].identified else 0.0
            for name, value, known in zip(estimate.names, estimate.values, estimate.identified, strict=True)
        ]
    )
    return with_covariance(estimate, estimate.covariance + np.outer(shift, shift))
