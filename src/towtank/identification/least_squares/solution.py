"""From the information of one axis to its coefficients: which it can carry, their values, and an honest covariance.

Least squares takes Theta from the QR triangle; with instruments Z it solves Z^T P Theta = Z^T Y from the block sums.
Either way Cov(Theta) = A^-1 S A^-T with A = Z^T P and S the long-run covariance of the scores z e, a prewhitened
Bartlett sum over blocks of time (Newey and West, 1987): the filter 1/(s + a) and slow disturbances make neighbouring
residuals alike, and the plain formula would promise several times too much. Physical values by division, their
covariance by the delta method: M = 1/Theta_n, c = Theta_c/Theta_n, J as in the covariance of a ratio.

Linear and quadratic damping are alike at low speed: both are kept only where both dissipate and each is five times its
deviation; otherwise the one that explains the data better stands for both and the other is said to be inseparable.
Restoring and constant terms stay while they are twice their deviation. A coefficient that the data does not determine
keeps the vehicle's value, and is never reported as found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.model.terms import (
    C_CONSTANT,
    C_FORCE,
    C_LHS,
    C_LINEAR,
    C_MASS,
    C_QUADRATIC,
    C_RESTORING,
    N_COLUMNS,
    Axis,
    Candidates,
)
from towtank.identification.posterior.estimate import AxisReport, Estimate, SumOfInertias
from towtank.identification.posterior.statistics import long_run
from towtank.vehicle import Vehicle

__all__ = [
    "AxisFindings",
    "AxisInformation",
    "AxisSolution",
    "absent",
    "estimate_of",
    "merge_information",
    "not_commanded",
    "select",
    "solve_axis",
]

_SPAN = 2.0  # s, least span over which residuals are taken to be alike
_SINGULAR = 1e-12  # smallest over largest singular value of the scaled regressors, below which nothing is determined
_STILL = 1e-9  # m/s or rad/s: an axis that moved less was not excited, its numbers are rounding
_BOTH = 5.0  # deviations that each damping term needs where both are kept
_KEPT = 2.0  # deviations that any other term needs
_INERTIA = 4.0  # deviations that an inertia needs to be called identified
_COMMANDED = 0.1  # share of the force that must be commanded, or else
_EXPLAINED = 0.999  # the share of the motion that the couplings alone must explain


@dataclass(frozen=True)
class AxisInformation:
    """What the samples say about one axis.

    Attributes:
        triangle: square root of the information (6, 6), R^T R = sum z z^T, z = [4 columns, force, left-hand side].
        blocks: sums of instrument x row over blocks of time (b, 6, 6).
        block_length: length of a block [s].
        rows: number of samples absorbed, those forgotten discounted.
        systematic: relative error that no averaging removes (low-passes take the mean of the square for its square).
        a: filter constant [1/s].
        commanded, forced: integrals of the squared commanded and whole force.
    """

    triangle: Array
    blocks: Array
    block_length: float
    rows: float
    a: float
    commanded: float = 0.0
    forced: float = 0.0
    systematic: float = 0.0

    @property
    def commanded_share(self) -> float:
        """Root-mean-square of the commanded force over that of the whole force, 0 .. about 1."""
        return float(np.sqrt(self.commanded / self.forced)) if self.forced > 0.0 else 0.0


@dataclass(frozen=True)
class AxisSolution:
    """Estimate of one axis; the order is linear, quadratic, restoring, constant, mass.

    Attributes:
        values: (5,), fixed coefficients at their fixed value.
        covariance: (5, 5), zero where fixed.
        free: (5,) True where estimated.
        residual: standard deviation of the filtered residual, in the units of the velocity.
        residual_sum: sum of squared filtered residuals.
        rows: samples used.
        condition: condition number of the regressors, each scaled to unit size.
        excitation: smallest eigenvalue of their mean outer product: 0 not excited, 1/n.. perfectly.
        correlation: (5, 5) of the estimates.
        block_residuals: sums of squared residuals (b,) over the blocks of time, for least squares.
        explained: share of the filtered left-hand side's square that the regression explains.
    """

    values: Array
    covariance: Array
    free: tuple[bool, ...]
    residual: float
    residual_sum: float
    rows: float
    condition: float
    excitation: float
    correlation: Array
    block_residuals: Array
    explained: float

    @property
    def std(self) -> Array:
        """Standard deviations (5,)."""
        return np.sqrt(np.diag(self.covariance))


def merge_information(parts: Sequence[AxisInformation]) -> AxisInformation:
    """Return the information of several stretches of data taken together."""
    stacked = np.vstack([part.triangle for part in parts])
    return AxisInformation(
        triangle=np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64),
        blocks=np.concatenate([part.blocks for part in parts]),
        block_length=max(part.block_length for part in parts),
        rows=sum(part.rows for part in parts),
        a=parts[0].a,
        commanded=sum(part.commanded for part in parts),
        forced=sum(part.forced for part in parts),
        systematic=max(part.systematic for part in parts),
    )


def solve_axis(
    information: AxisInformation, free: Sequence[bool], known: Array, *, instruments: bool = False
) -> AxisSolution | None:
    """Solve one axis for its free coefficients; None where the data does not determine them at all.

    Args:
        free: (5,) linear, quadratic, restoring, constant, mass.
        known: (5,) values of the fixed ones.
        instruments: use the block sums' instruments rather than least squares.
    """
    known = np.asarray(known, dtype=np.float64)
    regressors, target = _regression(free, known)
    if regressors.shape[1] == 0:
        return None
    R = information.triangle @ regressors
    scale = np.linalg.norm(R, axis=0)
    moved = float(np.linalg.norm(information.triangle[:, C_LHS]))
    if not np.all(scale > 0.0) or information.rows <= regressors.shape[1] or moved <= _STILL * information.rows**0.5:
        return None
    T = regressors / scale
    singular = np.linalg.svd(R / scale, compute_uv=False)
    if singular[-1] < _SINGULAR * singular[0]:
        return None
    summed = information.blocks.sum(axis=0)
    if instruments:
        A = T.T @ summed @ T
        try:
            theta = np.linalg.solve(A, T.T @ summed @ target)
        except np.linalg.LinAlgError:
            return None
    else:
        A = T.T @ information.triangle.T @ information.triangle @ T
        theta = np.linalg.lstsq(R / scale, information.triangle @ target, rcond=None)[0]
    error = target - T @ theta  # residual of a row z is z . error
    residual_sum = float(np.sum((information.triangle @ error) ** 2))
    covariance = _covariance(information, A, T, error, residual_sum, len(theta))
    theta = theta / scale
    covariance = covariance / np.outer(scale, scale)
    values, covariance = _physical(theta, covariance, free, known)
    covariance += np.diag((information.systematic * values) ** 2 * np.asarray(free, dtype=np.float64))
    std = np.sqrt(np.diag(covariance))
    safe = np.where(std > 0.0, std, 1.0)
    return AxisSolution(
        values=values,
        covariance=covariance,
        free=tuple(bool(flag) for flag in free),
        residual=float(np.sqrt(residual_sum / information.rows)),
        residual_sum=residual_sum,
        rows=information.rows,
        condition=float(singular[0] / singular[-1]),
        excitation=float(singular[-1] ** 2 / len(theta)),
        correlation=covariance / np.outer(safe, safe),
        block_residuals=np.einsum("i,bij,j->b", error, information.blocks, error),
        explained=1.0 - residual_sum / max(float(np.sum((information.triangle @ target) ** 2)), 1e-300),
    )


def _regression(free: Sequence[bool], known: Array) -> tuple[Array, Array]:
    """Return (T, t): the regressors are z T and the target z t, fixed coefficients moved where they belong."""
    identity = np.eye(N_COLUMNS)
    columns = [identity[c] for c in range(4) if free[c]]
    force = identity[C_FORCE] + sum((known[c] * identity[c] for c in range(4) if not free[c]), np.zeros(N_COLUMNS))
    if free[C_MASS]:
        return np.array([*columns, force]).T, identity[C_LHS]
    if not columns:
        return np.zeros((N_COLUMNS, 0)), identity[C_LHS]
    return np.array(columns).T, known[C_MASS] * identity[C_LHS] - force


def _covariance(
    information: AxisInformation, A: Array, T: Array, error: Array, residual_sum: float, unknowns: int
) -> Array:
    """Return the covariance of theta (scaled): the larger, per coefficient, of the long-run and the plain one."""
    filled = information.blocks[np.any(information.blocks != 0.0, axis=(1, 2))]
    scores = filled @ error @ T  # (b, n)
    count = len(scores)
    inverse = np.linalg.inv(A)
    plain = (
        residual_sum
        / max(information.rows - unknowns, 1.0)
        * inverse
        @ (T.T @ information.triangle.T @ information.triangle @ T)
        @ inverse.T
    )
    if count < 2 * unknowns + 2:
        return plain
    S = long_run(scores, round(max(_SPAN, 2.0 / information.a) / information.block_length))
    honest = inverse @ S @ inverse.T * count / (count - unknowns)
    variance, least = np.diag(honest).copy(), np.diag(plain)
    grow = np.sqrt(np.maximum(1.0, least / np.where(variance > 0.0, variance, np.inf)))
    return np.where(variance.min() > 0.0, honest * np.outer(grow, grow), plain)


def _physical(theta: Array, covariance: Array, free: Sequence[bool], known: Array) -> tuple[Array, Array]:
    """Return values (5,) and covariance (5, 5) of the physical coefficients by the delta method."""
    places = [c for c in range(5) if free[c]]
    values = known.copy()
    J = np.zeros((5, len(places)))
    if free[C_MASS]:
        inverse_mass = theta[-1]
        for j, c in enumerate(places[:-1]):
            values[c] = theta[j] / inverse_mass
            J[c, j] = 1.0 / inverse_mass
            J[c, -1] = -theta[j] / inverse_mass**2
        values[C_MASS] = 1.0 / inverse_mass
        J[C_MASS, -1] = -1.0 / inverse_mass**2
    else:
        values[places] = theta
        J[places, range(len(places))] = 1.0
    return values, J @ covariance @ J.T


Solve = Callable[[tuple[bool, ...], Array], AxisSolution | None]
Cost = Callable[[AxisSolution], float]


@dataclass(frozen=True)
class AxisFindings:
    """Outcome of one axis: the solution and, for each requested column not identified, why (5,)."""

    axis: Axis
    solution: AxisSolution | None
    to_learn: tuple[bool, ...]
    reasons: tuple[str | None, ...]
    set_to_zero: tuple[bool, ...]  # left out of the model: 0, not the vehicle's value


def select(candidate: Candidates, solve: Solve, cost: Cost, *, commanded: float = 1.0) -> AxisFindings:
    """Choose among the candidate's columns and solve.

    Args:
        solve: solves for given free flags (5,) and fixed values (5,).
        cost: how badly a solution explains the data, smaller is better; compares linear with quadratic damping.
        commanded: root-mean-square of the commanded force over that of the whole force on this axis.
    """
    axis, known = candidate.axis, candidate.known.copy()
    reasons: list[str | None] = [None] * 5
    set_to_zero = [False] * 5
    free = list(candidate.to_learn)
    if not any(free):
        return AxisFindings(axis, None, (False,) * 5, (None,) * 5, (False,) * 5)
    whole = solve(tuple(free), known)
    if whole is None:
        free = list(_without_idle_columns(tuple(free), known, solve))
        whole = solve(tuple(free), known) if any(free) else None
    if whole is not None and not candidate.requested and commanded < _COMMANDED and whole.explained < _EXPLAINED:
        whole = None
    if whole is None or (free[C_MASS] and not whole.values[C_MASS] > 0.0 and not _rescued(free, known, solve)):
        return absent(candidate, _unexcited(axis, commanded))
    if free[C_LINEAR] and free[C_QUADRATIC] and not candidate.requested:
        kept, reason = _damping(axis, whole, free, known, solve, cost)
        for c in (C_LINEAR, C_QUADRATIC):
            if c not in kept:
                free[c], known[c], reasons[c], set_to_zero[c] = False, 0.0, reason, True
    solution = solve(tuple(free), known)
    while solution is not None and (unfit := _unfit(axis, solution)) is not None:
        c, reasons[c] = unfit
        free[c] = False
        if c == C_CONSTANT:
            known[c], set_to_zero[c] = 0.0, True
        solution = solve(tuple(free), known) if any(free) else None
    solved = solution.free if solution is not None else (False,) * 5
    for c, other in ((C_LINEAR, C_QUADRATIC), (C_QUADRATIC, C_LINEAR)):
        if set_to_zero[c] and not solved[other]:
            set_to_zero[c], reasons[c] = False, _neither(axis)
    for c in range(5):
        if candidate.to_learn[c] and not solved[c] and reasons[c] is None:
            reasons[c] = _unexcited(axis, commanded)
    return AxisFindings(axis, solution, candidate.to_learn, tuple(reasons), tuple(set_to_zero))


def _unfit(axis: Axis, solution: AxisSolution) -> tuple[int, str] | None:
    """Return the next coefficient to give up, and why; None where all are sound."""
    free, values = solution.free, solution.values
    weak = [c for c in (C_RESTORING, C_CONSTANT) if free[c] and _strength(solution, c) < _KEPT]
    if weak:
        c = min(weak, key=lambda c: _strength(solution, c))
        return c, f"{axis.columns[c]} is {values[c]:.3g} +- {solution.std[c]:.2g} here, not different from 0"
    if free[C_MASS] and not values[C_MASS] > 0.0:
        return C_MASS, (
            f"{axis.sum_name} came out negative in this run: {axis.wrench} does not explain {axis.velocity}; "
            "held at the vehicle's value"
        )
    if free[C_MASS] and _strength(solution, C_MASS) < _INERTIA:
        share = 100.0 * solution.std[C_MASS] / values[C_MASS]
        return C_MASS, (
            f"{axis.sum_name} is known to +-{share:.0f} % only in this run: too little acceleration in {axis.name}; "
            "held at the vehicle's value"
        )
    for c in (C_LINEAR, C_QUADRATIC):
        if free[c] and (values[c] > 0.0 or _strength(solution, c) < _KEPT):
            return c, _undamped(axis, c, solution)
    return None


def _strength(solution: AxisSolution, c: int) -> float:
    """Value over deviation."""
    std = solution.std[c]
    return float(abs(solution.values[c]) / std) if std > 0.0 else np.inf


def _without_idle_columns(free: tuple[bool, ...], known: Array, solve: Solve) -> tuple[bool, ...]:
    """Drop the columns without which the rest can be solved: constant first, then restoring."""
    for drop in ((C_CONSTANT,), (C_RESTORING,), (C_CONSTANT, C_RESTORING), (C_CONSTANT, C_RESTORING, C_LINEAR)):
        fewer = tuple(flag and c not in drop for c, flag in enumerate(free))
        if fewer != free and any(fewer) and solve(fewer, known) is not None:
            return fewer
    return free


def _rescued(free: list[bool], known: Array, solve: Solve) -> bool:
    """Whether the inertia becomes positive with one damping term only."""
    for c in (C_LINEAR, C_QUADRATIC):
        single = [flag and (i != c) for i, flag in enumerate(free)]
        found = solve(tuple(single), known) if free[C_LINEAR] and free[C_QUADRATIC] else None
        if found is not None and found.values[C_MASS] > 0.0:
            return True
    return False


def _damping(
    axis: Axis, whole: AxisSolution, free: list[bool], known: Array, solve: Solve, cost: Cost
) -> tuple[set[int], str | None]:
    """Return the damping columns to keep and, for the one dropped, the reason."""
    both = (C_LINEAR, C_QUADRATIC)
    dissipates = all(whole.values[c] < 0.0 for c in both) and whole.values[C_MASS] > 0.0
    if dissipates and all(_strength(whole, c) >= _BOTH for c in both):
        return set(both), None
    trials: dict[int, float] = {}
    for c in both:
        fixed = known.copy()
        other = C_QUADRATIC if c == C_LINEAR else C_LINEAR
        fixed[other] = 0.0
        flags = tuple(flag and i != other for i, flag in enumerate(free))
        solution = solve(flags, fixed)
        if solution is not None and solution.values[c] < 0.0 and solution.values[C_MASS] > 0.0:
            trials[c] = cost(solution)
    if not trials:
        return {C_LINEAR}, _inseparable(axis, whole, C_LINEAR)
    kept = min(trials, key=lambda c: trials[c])
    return {kept}, _inseparable(axis, whole, kept)


def _inseparable(axis: Axis, whole: AxisSolution, kept: int) -> str:
    names = {C_LINEAR: axis.linear, C_QUADRATIC: axis.quadratic}
    return (
        f"{axis.linear} and {axis.quadratic} cannot be told apart in this run (correlation "
        f"{whole.correlation[C_LINEAR, C_QUADRATIC]:+.3f}); {names[kept]} stands for both, a wider range of "
        f"{axis.velocity} would separate them"
    )


def _neither(axis: Axis) -> str:
    return f"neither {axis.linear} nor {axis.quadratic} can be determined in this run; held at the vehicle's values"


def _undamped(axis: Axis, c: int, solution: AxisSolution) -> str:
    name = axis.columns[c]
    if solution.values[c] > 0.0:
        return (
            f"{name} came out as {solution.values[c]:+.3g} +- {solution.std[c]:.2g}, which would feed energy in; "
            "held at the vehicle's value"
        )
    share = 100.0 * solution.std[c] / abs(solution.values[c])
    return f"{name} is known to +-{share:.0f} % only in this run; held at the vehicle's value"


def not_commanded(axis: Axis) -> str:
    """Return the reason for an axis that nothing moves by intent."""
    return f"{axis.name} was not commanded: the thrusters gave no {axis.wrench} to speak of, so nothing tells it"


def _unexcited(axis: Axis, commanded: float) -> str:
    if commanded < _COMMANDED:
        return not_commanded(axis)
    return f"{axis.name} was not excited enough: {axis.wrench} and {axis.velocity} do not determine it in this run"


def absent(candidate: Candidates, reason: str) -> AxisFindings:
    """Return the findings of an axis that cannot be learned at all, for one reason."""
    reasons = tuple(reason if to_learn else None for to_learn in candidate.to_learn)
    return AxisFindings(candidate.axis, None, candidate.to_learn, reasons, (False,) * 5)


class _Part(NamedTuple):
    """What one axis says of a coefficient."""

    value: float
    std: float
    axis: int
    column: int


def estimate_of(vehicle: Vehicle, findings: Sequence[AxisFindings], duration: float, samples: int) -> Estimate:
    """Put the findings of the axes together; BG_z, which roll and pitch both see, is their weighted mean."""
    names: list[str] = []
    rows: dict[str, list[_Part]] = {}
    why: dict[str, str | None] = {}
    fixed: dict[str, float] = {}
    for found in findings:
        for c in (C_MASS, C_LINEAR, C_QUADRATIC, C_RESTORING, C_CONSTANT):
            name = _name(found.axis, c)
            if not name or not found.to_learn[c]:
                continue
            if name not in names:
                names.append(name)
            solution = found.solution
            if solution is not None and solution.free[c]:
                value = _coefficient(vehicle, found.axis, c, float(solution.values[c]))
                rows.setdefault(name, []).append(_Part(value, float(solution.std[c]), found.axis.index, c))
            else:
                why.setdefault(name, found.reasons[c])
                fixed.setdefault(name, 0.0 if found.set_to_zero[c] else vehicle.coefficient(name))
    n = len(names)
    values, std = np.zeros(n), np.full(n, np.nan)
    weights: list[Mapping[tuple[int, int], float]] = []
    for i, name in enumerate(names):
        known = rows.get(name, [])
        if not known:
            values[i] = fixed[name]
            weights.append({})
            continue
        inverse = np.array([1.0 / max(part.std**2, 1e-300) for part in known])
        share = inverse / inverse.sum()
        values[i] = float(share @ [part.value for part in known])
        weights.append({(part.axis, part.column): float(w) for part, w in zip(known, share, strict=True)})
    covariance = _covariance_of_axes(findings, weights)
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


def _covariance_of_axes(findings: Sequence[AxisFindings], weights: Sequence[Mapping[tuple[int, int], float]]) -> Array:
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
