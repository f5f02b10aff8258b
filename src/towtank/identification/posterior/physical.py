"""Physical consistency of what was learned: the likeliest physical model, and what pulled it out of bounds.

Added mass and -L must be positive semidefinite, total inertia positive definite, and quadratic damping must take energy
out, -nu^T Q |nu|nu >= 0, on each axis both ways: -X_uu >= |X_u2|. Each of these is v^T A(x) v >= 0 (for Q: a cubic of
nu) for all directions, with A affine in the coefficients x: one direction is one linear bound, and the worst directions
are added as they are found (cutting planes). Where coefficients x0 with covariance C break a bound, the likeliest x
within all bounds minimises (x - x0)^T C^-1 (x - x0): the correlated coefficients move along, as they would had the
bound been known. Every bound that was broken is reported with how far and which way, for such a pull is a sign of
something else that is wrong.

Forward-speed terms bear no bound: they take energy out ahead and feed it in astern, and a wing may feed it in ahead.

An estimator that iterates stays in this region on its way (`Region`): linearised about an impossible vehicle, a mass
matrix that is nearly singular say, what data tell is worth nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np

from towtank.core.arrays import Array
from towtank.core.layout import MASS
from towtank.errors import InputError
from towtank.identification.model.parameters import IN_DELAY, IN_GAIN, IN_LAG, FreeParameters
from towtank.identification.posterior.statistics import conditional_covariance, nearest_point, square_root
from towtank.identification.posterior.wording import coupling, diagonal, follows, unreachable
from towtank.vehicle import Vehicle
from towtank.vehicle.matrices import added_mass_matrix, matrix_of
from towtank.vehicle.names import HYDRODYNAMIC, KINDS

__all__ = ["Region"]

_INSIDE = 1e-5  # of the scaled matrix, that bounds on couplings stay inside: the nearer, the more of them it takes
_OUTSIDE = 1e-10  # of the scaled matrix, that counts as a violation
_NOTHING = 1e-9  # deviations
_LEAST_INERTIA = 1e-3  # of the rigid body's own
_DIRECTIONS = 2048
_ANGLES = 64
_ROUNDS = 100
_HALVINGS = 30
_GONE = 1e-10  # of the variance, that is left of a coefficient held by a bound
_TAKES_PART = 0.05  # of the largest part in a direction


@dataclass(frozen=True, eq=False)
class Family:
    """One matrix A(x) = base + sum x_k basis_k whose quadratic form (cubic for Q) may not be negative.

    Attributes:
        kind: "added", "inertia", "ahead", "astern", "loss", "input", or the kind of damping.
        rows: axes that are checked: their diagonal is free, or known and sound.
        base: (d, d) of these rows. basis: (n, d, d).
    """

    kind: str
    rows: tuple[int, ...]
    base: Array
    basis: Array

    @cached_property
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
        if not self.coupled:
            return np.empty((0, x.size)), np.empty(0)
        if self.kind != "quadratic":
            return self._alone.worst_bounds(x)[1:]
        A = self.at(x)
        nu = self._feeding(A)
        weight = np.einsum("mi,mj->mij", nu, nu * np.abs(nu))
        return np.einsum("mij,kij->mk", weight, self.basis), -np.einsum("mij,ij->m", weight, self.base)

    @cached_property
    def _alone(self) -> Coupled:
        return Coupled([self], len(self.basis))

    def sound(self, x: Array) -> bool:
        """Whether A(x) keeps its bounds, but for rounding."""
        G, h = self.diagonal_bounds()
        size = np.abs(G) @ np.abs(x) + np.abs(h)
        return bool(np.all(G @ x - h >= -_OUTSIDE * size)) and not self.worst_bounds(x)[1].size

    def _feeding(self, A: Array) -> Array:
        scale = np.maximum(np.abs(np.diag(A)), np.abs(np.diag(self.base)))
        scale = np.maximum(scale, 1e-6 * scale.max(initial=0.0))
        nu = _directions(len(self.rows)) / np.cbrt(np.where(scale > 0.0, scale, 1.0))
        power = np.einsum("mi,ij,mj->m", nu, A, nu * np.abs(nu))
        worst = np.argsort(power, kind="stable")[:8]
        return np.asarray(nu[worst[power[worst] < -_OUTSIDE]])


class Coupled:
    """The matrices whose worst directions are eigenvectors, in one stack: base (f, 6, 6), basis (f, n, 36).

    One of fewer rows is filled up with zeros.
    """

    def __init__(self, found: Sequence[Family], n: int) -> None:
        self.families = [family for family in found if family.coupled and family.kind != "quadratic"]
        self.others = [family for family in found if family.coupled and family.kind == "quadratic"]
        self.base = np.zeros((len(self.families), 6, 6))
        basis = np.zeros((len(self.families), n, 6, 6))
        for k, family in enumerate(self.families):
            d = len(family.rows)
            self.base[k, :d, :d] = family.base
            basis[k, :, :d, :d] = family.basis
        self.basis = basis.reshape(len(self.families), n, 36)

    def worst_bounds(self, x: Array, without: Sequence[Family] = ()) -> tuple[list[Family], Array, Array]:
        """Return the families (m,) of the directions in which they are most negative, G (m, n) and h (m,)."""
        A = self.base + (x @ self.basis).reshape(-1, 6, 6)
        scale = np.maximum(*np.abs(np.einsum("kfii->kfi", np.array([A, self.base]))))
        scale = np.maximum(scale, 1e-6 * scale.max(axis=1, initial=0.0)[:, None])
        root = np.sqrt(np.where(scale > 0.0, scale, 1.0))
        values, vectors = np.linalg.eigh(0.5 * (A + A.transpose(0, 2, 1)) / (root[:, :, None] * root[:, None, :]))
        asked = np.array([family not in without for family in self.families], dtype=np.bool_)
        which, k = np.nonzero((values < -_OUTSIDE) & asked[:, None])
        nu = vectors[which, :, k] / root[which]
        weight = (nu[:, :, None] * nu[:, None, :]).reshape(-1, 36)
        G = (self.basis[which] @ weight[:, :, None])[:, :, 0]
        h = _INSIDE - (weight * self.base[which].reshape(-1, 36)).sum(axis=1)
        owners = [self.families[f] for f in which]
        for family in () if owners else [each for each in self.others if each not in without]:  # slow to look through
            more = family.worst_bounds(x)
            G, h = np.vstack([G, more[0]]), np.concatenate([h, more[1]])
            owners += [family] * more[1].size
        return owners, G, h


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


@lru_cache(16)
def families(vehicle: Vehicle, names: tuple[str, ...]) -> tuple[Family, ...]:
    """Return the matrices that depend on the coefficients `names` (n,); any that are no hydrodynamic ones do nothing.

    A row of a matrix is left out where its diagonal is neither free nor known, or is unsound in the vehicle itself.
    """
    used = [name for name in names if name in HYDRODYNAMIC]
    without = vehicle.with_coefficients(dict.fromkeys(used, 0.0)).hydrodynamics
    held = {name: each.value for name, each in without.items() if name in used or each.value != 0.0}
    rigid = vehicle.rigid_body_matrix
    zero = _matrices(rigid, held)
    basis = {kind: np.zeros((len(names), 6, 6)) for kind in zero}
    for k, name in enumerate(names):
        if name in used:
            for kind, matrix in _matrices(rigid, held | {name: 1.0}).items():
                basis[kind][k] = matrix - zero[kind]
    found = []
    for kind, base in zero.items():
        free = np.einsum("kii->ik", basis[kind]).any(axis=1)
        rows = [i for i in range(6) if free[i] or base[i, i] > 0.0]
        family = Family(kind, tuple(rows), base[np.ix_(rows, rows)], basis[kind][:, rows][:, :, rows])
        if family.basis.any():
            found.append(family)
    return tuple(found)


def _matrices(rigid: Array, values: dict[str, float]) -> dict[str, Array]:
    damping = {kind: matrix_of(kind, values) for kind, row in KINDS.items() if row.damps}
    quadratic = np.diag(damping["quadratic"])
    one_way = sum(np.diag(matrix_of(kind, values)) for kind, row in KINDS.items() if row.outweighed_by == "quadratic")
    least = _LEAST_INERTIA * np.diag(np.diag(rigid))
    added = added_mass_matrix(values)
    return {
        "added": added,
        "inertia": rigid + added - least,
        **{kind: -matrix for kind, matrix in damping.items()},
        "ahead": -np.diag(quadratic + one_way),
        "astern": -np.diag(quadratic - one_way),
        "loss": np.diag([values.get("inflow_loss", 0.0), 0.0, 0.0, 0.0, 0.0, 0.0]),
    }


class Region:
    """Where all unknowns of an estimator are physical together: coefficients as above, delay and lag within theirs.

    Whether damping takes energy out does not hang on the common scale of force, the mean of the logarithms of gains: a
    drag that is off by its sign is so at any scale. To first order about such a point it would seem to, and the scale
    would go along by a third. So only what is compared with the rigid body, added inertia, moves the scale; everything
    else is made physical at that scale.
    """

    def __init__(self, vehicle: Vehicle, free: FreeParameters) -> None:
        """Args: vehicle: what is not free. free: the unknowns (n,), in whose coordinates points are given."""
        self.free, self.inertia = free, free.codes[:, 0] == MASS
        self.families = (*families(vehicle, free.names), *_of_inputs(free))
        self.masses = tuple(family for family in self.families if family.kind in ("added", "inertia"))
        self.coupled, self.coupled_masses = (Coupled(each, len(free)) for each in (self.families, self.masses))

    def nearest(self, theta: Array, covariance: Array) -> Array:
        """Return the likeliest physical theta (n,) of a Gaussian of this mean and covariance (n, n)."""
        free = self.free
        x = np.where(self.inertia, free.values(theta), theta)
        if all(family.sound(x) for family in self.families):
            return theta
        slopes = np.where(self.inertia, free.slopes(theta), 1.0)
        C = np.asarray(covariance * np.outer(slopes, slopes), dtype=np.float64)
        gains = free.codes[:, 0] == IN_GAIN
        if gains.sum() > 1:
            x = _projected(x, C, self.masses, self.coupled_masses)
            C = conditional_covariance(C, gains[None, :] / gains.sum())
        x = _projected(x, C, self.families, self.coupled)
        x[np.abs(x) < _NOTHING * np.sqrt(np.maximum(np.diag(C), 0.0))] = 0.0  # on a bound, but for rounding
        return np.asarray(np.where(self.inertia, free.thetas(x), x))


def _projected(x: Array, covariance: Array, found: Sequence[Family], coupled: Coupled) -> Array:
    projection = _Projection(x, square_root(covariance), found, coupled)
    projection.run()
    return projection.x


def _of_inputs(free: FreeParameters) -> tuple[Family, ...]:
    """Return the bounds of delay and lag."""
    out = []
    for k in np.flatnonzero(np.isin(free.codes[:, 0], (IN_DELAY, IN_LAG))):
        for bound, sign in zip((each[k] for each in free.bounds), (1.0, -1.0), strict=True):
            if np.isfinite(bound):
                basis = np.zeros((len(free), 1, 1))
                basis[k] = sign
                out.append(Family("input", (0,), np.array([[-sign * bound]]), basis))
    return tuple(out)


@dataclass(frozen=True)
class Violation:
    """A bound that the estimate broke.

    Attributes:
        names: coefficients in it. deviations: by how many standard deviations it is broken, inf where these are 0.
        text: one line for a person.
    """

    names: tuple[str, ...]
    deviations: float
    text: str


@dataclass(frozen=True)
class Consistency:
    """The likeliest physical coefficients.

    Attributes:
        values: (n,). covariance: (n, n), what is left of it where the bounds that press are exact; NaN where it was.
        held: names that a bound holds, so that they have no deviation of their own.
        distance: how far the whole estimate had to move, in deviations (Mahalanobis).
        violations: in the order of the matrices; empty where the estimate was physical.
    """

    values: Array
    covariance: Array
    held: tuple[str, ...]
    distance: float
    violations: tuple[Violation, ...]

    @property
    def messages(self) -> tuple[str, ...]:
        """The violations as lines."""
        return tuple(violation.text for violation in self.violations)


def consistent(vehicle: Vehicle, names: Sequence[str], values: Array, covariance: Array) -> Consistency:
    """Return the likeliest physical values.

    Args:
        vehicle: the rigid body, and the coefficients that are not among the names.
        names: SNAME coefficients (n,); other parameters may be among them and only move along.
        values: (n,) as in a vehicle's file: added masses, not total ones.
        covariance: (n, n); may be singular. A coefficient whose variance is NaN does not move.

    Raises:
        InputError: shapes that do not fit together, or a value that is not finite.
    """
    x0, C = np.array(values, dtype=np.float64), np.array(covariance, dtype=np.float64)
    n = len(names)
    if x0.shape != (n,) or C.shape != (n, n):
        raise InputError(f"physical: {n} names, found arrays of shapes {x0.shape} and {C.shape}")
    if not np.isfinite(x0).all():
        raise InputError(f"physical: {names[int(np.argmin(np.isfinite(x0)))]} is not a finite number")
    unknown = ~np.isfinite(np.diag(C))
    C[unknown] = 0.0
    C[:, unknown] = 0.0
    C = np.nan_to_num(0.5 * (C + C.T))
    found = families(vehicle, tuple(names))
    projection = _Projection(x0, square_root(C), found, Coupled(found, n))
    projection.run()
    x, pressing = projection.x, projection.pressing()
    left = conditional_covariance(C, pressing)
    before, after = np.diag(C), np.diag(left)
    held = (before > 0.0) & (after <= _GONE * before)
    left[held] = 0.0
    left[:, held] = 0.0
    report = _Report(tuple(names), x0, x, C, np.sqrt(np.maximum(before, 0.0)))
    violations = report.violations(found, projection.dropped)
    left[unknown] = np.nan
    left[:, unknown] = np.nan
    held_names = tuple(name for name, flag in zip(names, held, strict=True) if flag)
    return Consistency(x, left, held_names, projection.distance, violations)


class _Projection:
    """The cutting planes so far, and the nearest point within them."""

    def __init__(self, x0: Array, root: Array, found: Sequence[Family], coupled: Coupled) -> None:
        self.x0, self.x, self.root, self.coupled = x0, x0.copy(), root, coupled
        self.found = list(found)
        self.dropped: list[Family] = []
        bounds = [family.diagonal_bounds() for family in found]
        self.owners = [family for family, (_, h) in zip(found, bounds, strict=True) for _ in h]
        self.G = np.vstack([np.empty((0, x0.size)), *(G for G, _ in bounds)])
        self.h = np.concatenate([np.empty(0), *(h for _, h in bounds)])
        self.multipliers = np.empty(0)

    def run(self) -> None:
        self._solve()
        for _ in range(_ROUNDS):
            owners, G, h = self.coupled.worst_bounds(self.x, self.dropped)
            if not h.size:
                break
            self.owners += owners
            self.G, self.h = np.vstack([self.G, G]), np.concatenate([self.h, h])
            self._solve()
        for k in np.flatnonzero((self.multipliers > 0.0) | (self.G @ self.x < self.h)):
            hit = np.flatnonzero(self.G[k])
            if hit.size == 1:  # a bound on one coefficient is met exactly, without rounding
                self.x[hit[0]] = self.h[k] / self.G[k, hit[0]] + 0.0
        for family in self.found:
            self._shrink_couplings(family)

    def _shrink_couplings(self, family: Family) -> None:
        """Bring the couplings inside where the cutting planes, ever smaller, stopped short of it."""
        off = family.basis.any(axis=(1, 2)) & ~np.einsum("kii->ik", family.basis).any(axis=0)
        off &= (self.root != 0.0).any(axis=1)
        whole, low, high = self.x, 0.0, 1.0
        if family.sound(whole) or not family.sound(np.where(off, 0.0, whole)):
            return
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if family.sound(np.where(off, middle * whole, whole)) else (low, middle)
        self.x = np.where(off, low * whole, whole)

    def _solve(self) -> None:
        while self.found:
            nearest = nearest_point(self.x0, self.root, self.G, self.h)
            if nearest.reachable:
                self.x, self.multipliers = nearest.x, nearest.multipliers
                return
            lost = [family for family in self.found if not self._reachable(family)] or self.found[-1:]
            self.dropped += lost
            self.found = [family for family in self.found if family not in lost]
            kept = [family not in lost for family in self.owners]
            self.owners = [family for family in self.owners if family not in lost]
            self.G, self.h = self.G[kept], self.h[kept]
        self.x, self.multipliers = self.x0.copy(), np.empty(0)

    def _reachable(self, family: Family) -> bool:
        own = [each is family for each in self.owners]
        return nearest_point(self.x0, self.root, self.G[own], self.h[own]).reachable

    def pressing(self) -> Array:
        """Return the rows (m, n) of the bounds that press."""
        return self.G[: self.multipliers.size][self.multipliers > 0.0]

    @property
    def distance(self) -> float:
        """|y| of x = x0 + S y."""
        return float(np.linalg.norm(self.root.T @ (self.G.T @ self.multipliers))) if self.multipliers.size else 0.0


@dataclass(frozen=True)
class _Report:
    """What was broken at x0 (n,), and where x (n,) went."""

    names: tuple[str, ...]
    x0: Array
    x: Array
    C: Array
    std: Array

    def violations(self, found: Sequence[Family], dropped: Sequence[Family]) -> tuple[Violation, ...]:
        out: list[Violation] = []
        for family in found:
            named = {name for violation in out for name in violation.names}
            lost = family in dropped or not family.sound(self.x)
            new = self._diagonals(family, lost) or self._couplings(family, lost)
            if lost and not new:  # broken only by what the others asked for
                names = tuple(self.names[k] for k in np.flatnonzero(family.basis.any(axis=(1, 2))))
                new = [Violation(names, 0.0, unreachable(names))]
            if family.kind in ("inertia", "ahead", "astern"):  # added mass or drag below zero has said so already
                new = [violation for violation in new if named.isdisjoint(violation.names)]
            out += new
        named = {name for violation in out for name in violation.names}
        return (*out, *self._followers(found, named))

    def _diagonals(self, family: Family, lost: bool) -> list[Violation]:
        out = []
        for place, row in enumerate(family.rows):
            g = family.basis[:, place, place]
            lack = -float(family.at(self.x0)[place, place])
            if not g.any() or lack <= 0.0:
                continue
            k, away = int(np.flatnonzero(g)[-1]), self._deviations(lack, g)
            name, value, std = self.names[k], float(self.x0[k]), float(self.std[k])
            text = diagonal(family.kind, row, name, value, std, away, float(self.x[k]))
            involved = tuple(self.names[j] for j in np.flatnonzero(g))
            out.append(Violation(involved, away, unreachable(involved) if lost else text))
        return out

    def _couplings(self, family: Family, lost: bool) -> list[Violation]:
        G, h = family.worst_bounds(self.x0)
        if not h.size:
            return []
        away = self._deviations(float(h[0] - G[0] @ self.x0), G[0])
        part = np.abs(G[0]) * self.std
        involved = np.flatnonzero((G[0] != 0.0) & (part >= _TAKES_PART * part.max()))
        names = tuple(self.names[k] for k in involved)
        text = coupling(family.kind, names, self.x0[involved], self.x[involved], away)
        return [Violation(names, away, unreachable(names) if lost else text)]

    def _followers(self, found: Sequence[Family], named: set[str]) -> list[Violation]:
        """Those that were within their bound and end on it because others move."""
        on_diagonal = np.zeros(len(self.names), dtype=np.bool_)
        for family in found:
            if family.kind not in ("inertia", "ahead", "astern"):
                on_diagonal |= np.einsum("kii->ik", family.basis).any(axis=0)
        out = []
        for k in np.flatnonzero(on_diagonal & (self.x == 0.0) & (self.x0 != 0.0)):
            if (name := self.names[k]) not in named:
                out.append(Violation((name,), 0.0, follows(name, float(self.x0[k]), float(self.std[k]))))
        return out

    def _deviations(self, lack: float, g: Array) -> float:
        std = max(float(g @ self.C @ g), 0.0) ** 0.5
        return lack / std if std > 0.0 else float("inf")
