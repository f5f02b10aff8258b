"""Matrices of the model from named coefficients."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from towtank.core.arrays import Array
from towtank.core.layout import address, pack_parameters
from towtank.vehicle.names import COLUMNS, KINDS, ROWS, Kind, index

__all__ = [
    "GRAVITY",
    "added_mass_matrix",
    "damping_matrices",
    "effective",
    "matrix_of",
    "parameters",
    "singular_row",
    "unlike_mirrors",
]

GRAVITY = 9.81
_SAME = 1e-6
_SINGULAR = 1e-12


"""Acceleration of gravity [m/s^2] in W = m g."""


def _added(values: Mapping[str, float], i: int, j: int) -> float | None:
    """Return the derivative in effect at (i, j): the mean of the two mirrored names, or the one that is given."""
    given = [values[name] for name in {f"{ROWS[i]}_{COLUMNS[j]}dot", f"{ROWS[j]}_{COLUMNS[i]}dot"} if name in values]
    return sum(given) / len(given) if given else None


def added_mass_matrix(values: Mapping[str, float]) -> Array:
    """Return M_A (6, 6), symmetric: M_A_ij = -`{row}_{column}dot`; a name fills its mirror, two are averaged."""
    matrix = np.zeros((6, 6))
    for i in range(6):
        for j in range(i, 6):
            value = _added(values, i, j)
            if value is not None:
                matrix[i, j] = matrix[j, i] = -value
    return matrix


def unlike_mirrors(values: Mapping[str, float]) -> list[tuple[str, str]]:
    """Return the mirrored pairs of added-mass names that are both given and differ by more than 1e-6 (relative)."""
    pairs = []
    for i in range(6):
        for j in range(i + 1, 6):
            upper, lower = f"{ROWS[i]}_{COLUMNS[j]}dot", f"{ROWS[j]}_{COLUMNS[i]}dot"
            if upper in values and lower in values:
                a, b = values[upper], values[lower]
                if abs(a - b) > _SAME * max(abs(a), abs(b)):
                    pairs.append((upper, lower))
    return pairs


def damping_matrices(values: Mapping[str, float]) -> tuple[Array, Array]:
    """Return L and Q (6, 6 each) of SNAME derivatives: force = L nu + Q |nu| nu."""
    return matrix_of("linear", values), matrix_of("quadratic", values)


def matrix_of(kind: Kind, values: Mapping[str, float]) -> Array:
    """Return the coefficients of a kind, each at its row and column (6, 6)."""
    matrix = np.zeros((6, 6))
    for name, value in values.items():
        of, i, j = index(name)
        if of == kind:
            matrix[i, j] = value
    return matrix


def parameters(mass: Array, values: Mapping[str, float], weight: float, moment: Array) -> Array:
    """Return the kernels' vector (170,): the total mass matrix (6, 6), and every other coefficient in its place.

    Args:
        weight: W - B [N]. moment: BG_x, BG_y, BG_z (3,) [N m/rad].
    """
    p = pack_parameters(mass, np.zeros((6, 6)), np.zeros((6, 6)), weight, moment)
    for name, value in values.items():
        kind, i, j = index(name)
        if kind != "mass":
            p[address(KINDS[kind].code, i, j)] = value
    return p


def effective(values: Mapping[str, float], name: str) -> float:
    """Return a hydrodynamic coefficient as the model uses it; 0 where neither it nor its mirror is given."""
    kind, i, j = index(name)
    if kind == "mass":
        return _added(values, i, j) or 0.0
    return values.get(name, 0.0)


def singular_row(mass: Array) -> int | None:
    """Return the row (0..5) that makes a mass matrix singular to working precision; None where it is invertible."""
    if not np.all(np.isfinite(mass)):
        return int(np.argmin(np.isfinite(mass).all(axis=1)))
    norms = np.sqrt(np.abs(mass).max(axis=1))
    if np.any(norms == 0.0):
        return int(np.argmin(norms))
    scaled = mass / np.outer(norms, norms)
    _, values, vectors = np.linalg.svd(scaled)
    return int(np.argmax(np.abs(vectors[-1]))) if values[-1] < _SINGULAR * values[0] else None
