"""What no vehicle does, as linear bounds on its coefficients.

Added mass and -L must be positive semidefinite, total inertia positive definite, and quadratic damping must take energy
out, -nu^T Q |nu|nu >= 0. Each of these is v^T A(x) v >= 0 (for Q: a cubic of nu) for all directions, with A affine in
the coefficients x: one direction is one linear bound, and the worst directions are added as they are found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from towtank.core.arrays import Array
from towtank.vehicle import Vehicle
from towtank.vehicle.matrices import damping_matrices
from towtank.vehicle.names import HYDRODYNAMIC

__all__ = ["Family", "families"]

Kind = Literal["added", "inertia", "linear", "quadratic"]

_INSIDE = 1e-7  # of the scaled matrix, that bounds on couplings stay inside
_OUTSIDE = 1e-10  # of the scaled matrix, that counts as a violation
_LEAST_INERTIA = 1e-3  # of the rigid body's own
_DIRECTIONS = 2048
_ANGLES = 64


@dataclass(frozen=True, eq=False)
class Family:
    """One matrix A(x) = base + sum x_k basis_k whose quadratic form (cubic for Q) may not be negative.

    Attributes:
        rows: axes that are checked: their diagonal is free, or known and sound.
        base: (d, d) of these rows. basis: (n, d, d).
    """

    kind: Kind
    rows: tuple[int, ...]
    base: Array
    basis: Array

    @property
    def coupled(self) -> bool:
        """Whether anything stands off the diagonal."""
        off = ~np.eye(len(self.rows), dtype=np.bool_)
        return bool(np.any(self.base[off]) or np.any(self.basis[:, off]))

    def at(self, x: Array) -> Array:
        """Return A (d, d) of coefficients (n,)."""
        return np.asarray(self.base + np.tensordot(x, self.basis, axes=1))

    def diagonal_bounds(self) -> tuple[Array, Array]:
        """Return G (m, n) and h (m,) of A_ii >= 0 for the rows with something free on the diagonal."""
        G = np.einsum("kii->ik", self.basis)
        free = np.any(G != 0.0, axis=1)
        return G[free], -np.diag(self.base)[free]

    def worst_bounds(self, x: Array) -> tuple[Array, Array]:
        """Return G (m, n) and h (m,) of the directions in which A(x) is most negative; m = 0 where it is sound."""
        n = x.size
        if not self.coupled:
            return np.empty((0, n)), np.empty(0)
        A = self.at(x)
        if self.kind == "quadratic":
            nu = self._feeding(A)
            weight = np.einsum("mi,mj->mij", nu, nu * np.abs(nu))
            inside = np.zeros(len(nu))
        else:
            nu, inside = self._negative(A)
            weight = np.einsum("mi,mj->mij", nu, nu)
        return np.einsum("mij,kij->mk", weight, self.basis), inside - np.einsum("mij,ij->m", weight, self.base)

    def sound(self, x: Array) -> bool:
        """Whether A(x) keeps its bounds, but for rounding."""
        G, h = self.diagonal_bounds()
        size = np.abs(G) @ np.abs(x) + np.abs(h)
        return bool(np.all(G @ x - h >= -_OUTSIDE * size)) and not self.worst_bounds(x)[1].size

    def _scale(self, A: Array) -> Array:
        scale = np.maximum(np.abs(np.diag(A)), np.abs(np.diag(self.base)))
        scale = np.maximum(scale, 1e-6 * scale.max(initial=0.0))
        return np.where(scale > 0.0, scale, 1.0)

    def _negative(self, A: Array) -> tuple[Array, Array]:
        root = np.sqrt(self._scale(A))
        values, vectors = np.linalg.eigh(0.5 * (A + A.T) / np.outer(root, root))
        bad = values < -_OUTSIDE
        return (vectors[:, bad] / root[:, None]).T, np.full(int(bad.sum()), _INSIDE)

    def _feeding(self, A: Array) -> Array:
        nu = _directions(len(self.rows)) / np.cbrt(self._scale(A))
        power = np.einsum("mi,ij,mj->m", nu, A, nu * np.abs(nu))
        worst = np.argsort(power, kind="stable")[:8]
        return np.asarray(nu[worst[power[worst] < -_OUTSIDE]])


@cache
def _directions(d: int) -> Array:
    """Return directions (m, d): in every plane of two axes closely, elsewhere at random, always the same ones."""
    found = [np.random.default_rng(0).standard_normal((_DIRECTIONS, d))]
    angle = np.pi * np.arange(_ANGLES) / _ANGLES
    for i in range(d):
        for j in range(i):
            plane = np.zeros((_ANGLES, d))
            plane[:, i], plane[:, j] = np.cos(angle), np.sin(angle)
            found.append(plane)
    out = np.vstack(found)
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def families(vehicle: Vehicle, names: Sequence[str]) -> tuple[Family, ...]:
    """Return the matrices that depend on the coefficients `names` (n,); any that are no hydrodynamic ones do nothing.

    A row of a matrix is left out where its diagonal is neither free nor known, or is unsound in the vehicle itself.
    """
    used = [name for name in names if name in HYDRODYNAMIC]
    zero = _matrices(vehicle, dict.fromkeys(used, 0.0))
    basis = {kind: np.zeros((len(names), 6, 6)) for kind in zero}
    for k, name in enumerate(names):
        if name in used:
            for kind, matrix in _matrices(vehicle, {**dict.fromkeys(used, 0.0), name: 1.0}).items():
                basis[kind][k] = matrix - zero[kind]
    found = []
    for kind, base in zero.items():
        free = np.einsum("kii->ik", basis[kind]).any(axis=1)
        rows = [i for i in range(6) if free[i] or base[i, i] > 0.0]
        family = Family(kind, tuple(rows), base[np.ix_(rows, rows)], basis[kind][:, rows][:, :, rows])
        if family.basis.any():
            found.append(family)
    return tuple(found)


def _matrices(vehicle: Vehicle, changes: dict[str, float]) -> dict[Kind, Array]:
    changed = vehicle.with_coefficients(changes)
    linear, quadratic = damping_matrices({name: each.value for name, each in changed.hydrodynamics.items()})
    least = _LEAST_INERTIA * np.diag(np.diag(vehicle.rigid_body_matrix))
    added = changed.added_mass_matrix
    return {
        "added": added,
        "inertia": vehicle.rigid_body_matrix + added - least,
        "linear": -linear,
        "quadratic": -quadratic,
    }
