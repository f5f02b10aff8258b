"""Physical checks: what about a vehicle cannot be true (faults), and what had better be looked at (doubts)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from towtank.core.arrays import Array
from towtank.vehicle import matrices
from towtank.vehicle.names import COEFFICIENTS, COLUMNS, KINDS, ROWS
from towtank.vehicle.posterior import coordinate
from towtank.vehicle.thrusters.curves import Curve, PolynomialCurve

if TYPE_CHECKING:
    from towtank.vehicle.vehicle import Vehicle

__all__ = ["doubts", "faults"]

_ROUNDING = 1e-9
_LARGE_NET_WEIGHT = 0.05
_FAR = 50.0
_SPEED = 1.0  # m/s, rad/s, up to which what differs by direction may not feed energy in
_BEYOND_DOUBT = 3.0  # standard deviations
_SAMPLES = 257
_STALE = 5.0  # deviations that a coefficient may be from its posterior: limits of what is physical move it less


def faults(vehicle: Vehicle) -> tuple[str, ...]:
    """Return what no physical vehicle has, one line each."""
    found = _mass(vehicle) + _added_mass(vehicle) + _damping(vehicle) + _lift(vehicle)
    return tuple(found + _inflow(vehicle) + _inertia(vehicle) + _righting(vehicle))


def doubts(vehicle: Vehicle) -> tuple[str, ...]:
    """Return what is possible and still deserves a look, one line each."""
    return tuple(
        _net_weight(vehicle)
        + _mirrors(vehicle)
        + _munk(vehicle)
        + _outweighed(vehicle)
        + _places(vehicle)
        + _curves(vehicle)
        + _stale(vehicle)
    )


def _negative(matrix: Array) -> float | None:
    """Return the smallest eigenvalue of the symmetric part, scaled to a unit diagonal, where it is below zero.

    Couplings that cancel in the symmetric part leave rounding of their own size there.
    """
    symmetric = 0.5 * (matrix + matrix.T)
    scale = np.sqrt(np.maximum(np.abs(matrix), np.abs(matrix.T)).max(axis=1))
    scale[scale == 0.0] = 1.0
    smallest = float(np.linalg.eigvalsh(symmetric / np.outer(scale, scale))[0])
    return smallest if smallest < -_ROUNDING else None


def _mass(vehicle: Vehicle) -> list[str]:
    row = matrices.singular_row(vehicle.mass_matrix)
    if row is not None:
        return [f"the total mass matrix is singular in row {ROWS[row]}: no motion can be computed with it"]
    if _negative(vehicle.mass_matrix) is None:
        return []
    diagonal = np.diag(vehicle.mass_matrix)
    rows = ", ".join(f"{ROWS[i]} {diagonal[i]:g}" for i in range(6) if diagonal[i] <= 0.0)
    where = f"total inertia of {rows}" if rows else "the couplings are too large for the diagonal"
    return [f"the total mass matrix M_RB + M_A is not positive definite ({where}): motion computed with it is unstable"]


def _added_mass(vehicle: Vehicle) -> list[str]:
    lines = []
    diagonal = np.diag(vehicle.added_mass_matrix)
    for i in range(6):
        if diagonal[i] < 0.0:
            name = f"{ROWS[i]}_{COLUMNS[i]}dot"
            lines.append(f"{name} = {-diagonal[i]:+g} is positive: a negative added mass is not physical")
    if not lines and _negative(vehicle.added_mass_matrix) is not None:
        lines.append("the added-mass matrix is not positive semidefinite: its couplings are too large for its diagonal")
    return lines


def _damping(vehicle: Vehicle) -> list[str]:
    linear = matrices.matrix_of("linear", _values(vehicle))
    lines = []
    for kind, row in KINDS.items():
        drag = np.diag(matrices.matrix_of(kind, _values(vehicle))) if row.damps else np.zeros(6)
        lines += [
            f"{row.name(i, i)} = {drag[i]:+g} is positive: this drag feeds energy in" for i in range(6) if drag[i] > 0.0
        ]
    if not any(np.diag(linear) > 0.0) and _negative(-linear) is not None:
        lines.append(
            "linear damping can feed energy in: the symmetric part of -L is not positive semidefinite"
            f" (couplings {', '.join(_couplings(linear))})"
        )
    return lines


def _lift(vehicle: Vehicle) -> list[str]:
    matrix = matrices.matrix_of("forward", _values(vehicle))
    return [
        f"{ROWS[i]}_u{COLUMNS[i]} = {matrix[i, i]:+g} is positive: it feeds energy in while the vehicle goes ahead"
        for i in range(6)
        if matrix[i, i] > 0.0
    ]


def _munk(vehicle: Vehicle) -> list[str]:
    """Say where the forward-speed terms of a plane feed energy in together, as those that hold the Munk moment do."""
    matrix = matrices.matrix_of("forward", _values(vehicle))
    lines = []
    for plane in ([1, 5], [2, 4]):
        part = matrix[np.ix_(plane, plane)]
        if not np.any(np.diag(part) > 0.0) and _negative(-part) is not None:
            names = ", ".join(f"{ROWS[i]}_u{COLUMNS[j]}" for i in plane for j in plane)
            lines.append(
                f"{names} together can feed energy in while the vehicle goes ahead: if they hold parts of added mass"
                " such as the Munk moment, take these out, they follow from the added mass already"
            )
    return lines


def _inflow(vehicle: Vehicle) -> list[str]:
    value, std = vehicle.coefficient("inflow_loss"), vehicle.deviation("inflow_loss") or 0.0
    if value >= -_BEYOND_DOUBT * std:
        return []
    return [f"inflow_loss = {value:+g} s/m is negative: thrusters that gain from inflow feed energy in"]


def _outweighed(vehicle: Vehicle) -> list[str]:
    """Say where drag feeds energy in one way: |X_u2| above the quadratic drag and the linear one's share of it."""
    linear = matrices.matrix_of("linear", _values(vehicle))
    lines = []
    for row in KINDS.values():
        if row.outweighed_by is None:
            continue
        damping = KINDS[row.outweighed_by]
        for i, j in row.elements:
            name, value = row.name(i, j), vehicle.coefficient(row.name(i, j))
            drag = max(-vehicle.coefficient(damping.name(i, i)), 0.0) + max(-linear[i, i], 0.0) / _SPEED
            if abs(value) > drag * (1.0 + _ROUNDING):
                motion = f"{COLUMNS[i]} = {np.copysign(_SPEED, value):+g} {'m/s' if i < 3 else 'rad/s'}"
                lines.append(f"{name} = {value:+g} outweighs the drag of its axis: at {motion} it feeds energy in")
    return lines


def _values(vehicle: Vehicle) -> dict[str, float]:
    return {name: coefficient.value for name, coefficient in vehicle.hydrodynamics.items()}


def _couplings(matrix: Array) -> list[str]:
    return [f"{ROWS[i]}_{COLUMNS[j]}" for i in range(6) for j in range(6) if i != j and matrix[i, j] != 0.0]


def _inertia(vehicle: Vehicle) -> list[str]:
    moments = np.linalg.eigvalsh(vehicle.rigid_body.tensor)
    text = ", ".join(f"{moment:g}" for moment in moments)
    if moments[0] <= 0.0:
        return [f"rigid_body.inertia has the principal moments {text} kg m^2, of which not all are above 0"]
    if moments[0] + moments[1] < moments[2] * (1.0 - _ROUNDING):
        return [
            f"rigid_body.inertia has the principal moments {text} kg m^2"
            ": no body has one larger than the sum of the others"
        ]
    return []


def _righting(vehicle: Vehicle) -> list[str]:
    BG_z = vehicle.restoring_moment[2]
    if BG_z >= 0.0:
        return []
    return [
        f"BG_z = {BG_z:g} N m/rad is negative: the centre of buoyancy lies below the centre of gravity (z points down)"
        " and upright is unstable"
    ]


def _net_weight(vehicle: Vehicle) -> list[str]:
    net, weight = vehicle.weight_minus_buoyancy, vehicle.weight
    if abs(net) <= _LARGE_NET_WEIGHT * weight:
        return []
    way = "sinks" if net > 0.0 else "rises"
    return [f"W - B = {net:.4g} N is {abs(net) / weight:.0%} of the weight {weight:.4g} N: the vehicle {way} fast"]


def _mirrors(vehicle: Vehicle) -> list[str]:
    values = _values(vehicle)
    return [
        f"{a} = {values[a]:g} and {b} = {values[b]:g} differ: added mass is symmetric, their mean is used"
        for a, b in matrices.unlike_mirrors(values)
    ]


def _places(vehicle: Vehicle) -> list[str]:
    return [
        f'thruster "{thruster.name}": position {list(thruster.position)} m is far away; is it in millimetres?'
        for thruster in vehicle.thrusters
        if max(abs(x) for x in thruster.position) > _FAR
    ]


def _curves(vehicle: Vehicle) -> list[str]:
    """Group equal remarks, so that six equal thrusters give one line."""
    remarks: dict[str, list[str]] = {}
    for thruster in vehicle.thrusters:
        for remark in _curve(thruster.curve):
            remarks.setdefault(remark, []).append(thruster.name)
    return [f"thruster {', '.join(names)}: {remark}" for remark, names in remarks.items()]


def _curve(curve: Curve) -> list[str]:
    remarks = []
    if curve.fitted_range is not None:
        low, high = curve.fitted_range
        furthest = np.inf if curve.limits is None else max(abs(limit - curve.rest) for limit in curve.limits)
        if furthest > high:
            reach = "any command" if np.isinf(furthest) else f"{furthest:g}"
            remarks.append(
                f"the curve was fitted for commands of {low:g} to {high:g} from neutral"
                f"; up to {reach} it is extrapolated"
            )
    if isinstance(curve, PolynomialCurve) and curve.limits is not None and _dips(curve):
        remarks.append("the polynomial does not rise all the way to its limits; more command then gives less force")
    return remarks


def _dips(curve: PolynomialCurve) -> bool:
    """Return whether a branch falls back by more than a hundredth of its largest force outside the dead band."""
    for limit in curve.limits or ():
        side = 1.0 if limit > curve.rest else -1.0
        a = np.linspace(curve.dead_band, abs(limit - curve.rest), _SAMPLES)
        if a[-1] <= a[0]:
            continue
        size = np.abs(curve.static(curve.rest + side * a))
        if np.any(np.maximum.accumulate(size) - size > 0.01 * size.max()):
            return True
    return False


def _stale(vehicle: Vehicle) -> list[str]:
    """Say which coefficients are not those that the posterior belongs to, as after an edit by hand."""
    posterior = vehicle.posterior
    if posterior is None:
        return []
    far = [
        name
        for name, mean, std in zip(posterior.names, posterior.mean, posterior.std, strict=True)
        if name in COEFFICIENTS
        and vehicle.coefficient(name) != 0.0  # that may be a bound, which the mean lies beyond
        and not abs(coordinate(vehicle, name) - mean) <= _STALE * std
    ]
    if not far:
        return []
    return [f"posterior: it belongs to other values of {', '.join(far)}; learn anew, or take the table out"]
