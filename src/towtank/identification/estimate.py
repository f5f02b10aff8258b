"""What has been learned: coefficients with their deviations and covariance, sums where only sums are known, reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.identification.axes import AXES, C_MASS, Axis
from towtank.identification.structure import AxisFindings
from towtank.vehicle import Coefficient, Provenance, Vehicle
from towtank.vehicle import unit as unit_of

__all__ = ["AxisReport", "Estimate", "Learned", "SumOfInertias", "estimate_of", "with_shift"]


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
    covariance = estimate.covariance + np.outer(shift, shift)
    std = np.sqrt(np.diag(covariance))
    added = {axis.sum_name: axis.added_mass for axis in AXES}
    sums = tuple(replace(each, std=float(std[estimate.names.index(added[each.name])])) for each in estimate.sums)
    return replace(estimate, covariance=covariance, std=std, sums=sums)


def estimate_of(vehicle: Vehicle, findings: Sequence[AxisFindings], duration: float, samples: int) -> Estimate:
    """Put the findings of the axes together; BG_z, which roll and pitch both see, is their weighted mean."""
    names: list[str] = []
    rows: dict[str, list[tuple[float, float, int, int]]] = {}  # name -> value, std, axis, column
    why: dict[str, str | None] = {}
    held: dict[str, float] = {}
    for found in findings:
        for c in (C_MASS, 0, 1, 2, 3):
            name = _name(found.axis, c)
            if not name or not found.wanted[c]:
                continue
            if name not in names:
                names.append(name)
            solution = found.solution
            if solution is not None and solution.free[c]:
                value = _coefficient(vehicle, found.axis, c, float(solution.values[c]))
                rows.setdefault(name, []).append((value, float(solution.std[c]), found.axis.index, c))
            else:
                why.setdefault(name, found.reasons[c])
                held.setdefault(name, 0.0 if found.zeroed[c] else vehicle.coefficient(name))
    n = len(names)
    values, std = np.zeros(n), np.full(n, np.nan)
    weights: list[Mapping[tuple[int, int], float]] = []
    for i, name in enumerate(names):
        known = rows.get(name, [])
        if not known:
            values[i] = held[name]
            weights.append({})
            continue
        inverse = np.array([1.0 / max(row[1] ** 2, 1e-300) for row in known])
        share = inverse / inverse.sum()
        values[i] = float(share @ [row[0] for row in known])
        weights.append({(row[2], row[3]): float(w) for row, w in zip(known, share, strict=True)})
    covariance = _covariance(findings, weights)
    for i in range(n):
        std[i] = np.sqrt(covariance[i, i])
    identified = tuple(name in rows for name in names)
    return Estimate(
        names=tuple(names),
        values=values,
        std=std,
        covariance=covariance,
        identified=identified,
        reasons=tuple(None if ok else why.get(name) for name, ok in zip(names, identified, strict=True)),
        sums=tuple(_sums(findings)),
        axes=tuple(_reports(findings)),
        duration=duration,
        samples=samples,
    )


def _name(axis: Axis, c: int) -> str:
    return axis.added_mass if c == C_MASS else axis.columns[c]


def _coefficient(vehicle: Vehicle, axis: Axis, c: int, value: float) -> float:
    """Added mass from the sum, by the vehicle's rigid-body inertia; every other column is its coefficient."""
    return float(vehicle.rigid_body_matrix[axis.index, axis.index]) - value if c == C_MASS else value


def _covariance(findings: Sequence[AxisFindings], weights: Sequence[Mapping[tuple[int, int], float]]) -> Array:
    n = len(weights)
    out = np.full((n, n), np.nan)
    solutions = {found.axis.index: found.solution for found in findings}
    for i in range(n):
        for j in range(n):
            if not weights[i] or not weights[j]:
                continue
            total = 0.0
            for (axis, c), w in weights[i].items():
                for (other, d), v in weights[j].items():
                    solution = solutions[axis]
                    if axis == other and solution is not None:
                        sign = -1.0 if (c == C_MASS) != (d == C_MASS) else 1.0
                        total += sign * w * v * float(solution.covariance[c, d])
            out[i, j] = total
    return out


def _sums(findings: Sequence[AxisFindings]) -> list[SumOfInertias]:
    return [
        SumOfInertias(
            found.axis.sum_name,
            float(found.solution.values[C_MASS]),
            float(found.solution.std[C_MASS]),
            found.axis.unit,
        )
        for found in findings
        if found.solution is not None and found.solution.free[C_MASS]
    ]


def _reports(findings: Sequence[AxisFindings]) -> list[AxisReport]:
    return [
        AxisReport(
            name=found.axis.name,
            rows=found.solution.rows,
            condition=found.solution.condition,
            excitation=found.solution.excitation,
            residual=found.solution.residual,
        )
        for found in findings
        if found.solution is not None
    ]
