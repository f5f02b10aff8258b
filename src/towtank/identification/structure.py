"""Which coefficients an axis can carry, and which of them this data supports.

Linear and quadratic damping are alike at low speed: both are kept only where both dissipate and each is five times its
deviation; otherwise the one that explains the data better stands for both and the other is said to be inseparable.
Restoring and constant terms stay while they are twice their deviation. A coefficient that the data does not determine
is held at the vehicle's value, never reported as found.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.identification.axes import AXES, C_CONSTANT, C_LINEAR, C_MASS, C_QUADRATIC, C_RESTORING, Axis
from towtank.identification.axis_solution import AxisSolution
from towtank.vehicle import Vehicle

__all__ = [
    "AxisFindings",
    "Candidates",
    "absent",
    "by_gradient",
    "candidates",
    "not_commanded",
    "paper_names",
    "select",
]

_BOTH = 5.0  # deviations that each damping term needs where both are kept
_KEPT = 2.0  # deviations that any other term needs
_INERTIA = 4.0  # deviations that an inertia needs to be called identified
_COMMANDED = 0.1  # share of the force that must be commanded, or else
_EXPLAINED = 0.999  # the share of the motion that the couplings alone must explain

Solve = Callable[[tuple[bool, ...], Array], AxisSolution | None]
Cost = Callable[[AxisSolution], float]


@dataclass(frozen=True)
class Candidates:
    """Coefficients of one axis that may be free, (5,) in the order linear, quadratic, restoring, constant, mass.

    Attributes:
        wanted: may be free. asked: named by the user, so never dropped for another. known: the vehicle's values.
    """

    axis: Axis
    wanted: tuple[bool, ...]
    asked: bool
    known: Array


@dataclass(frozen=True)
class AxisFindings:
    """Outcome of one axis: the solution and, for each wanted column not identified, why (5,)."""

    axis: Axis
    solution: AxisSolution | None
    wanted: tuple[bool, ...]
    reasons: tuple[str | None, ...]
    zeroed: tuple[bool, ...]  # left out of the model: 0, not the vehicle's value


def paper_names() -> tuple[str, ...]:
    """Names of all coefficients that the paper's method can identify."""
    names: list[str] = []
    for axis in AXES:
        names += [axis.added_mass, *(name for name in axis.columns if name and name not in names)]
    return tuple(names)


def candidates(vehicle: Vehicle, free: Collection[str] | None = None) -> tuple[Candidates, ...]:
    """Return what may be free on each axis.

    By default: every inertia, the damping terms that the vehicle's file has (both where it has none), righting
    moments, net weight and constant forces. With `free`, exactly those names.

    Raises:
        InputError: a name that the method cannot identify.
    """
    names = paper_names()
    for name in free or ():
        if name not in names:
            raise InputError(
                f'free: found "{name}", expected one of {", ".join(names)}{nearest(name, names)} '
                "(the paper's method takes one axis at a time, so no off-diagonal coefficients)"
            )
    found = []
    for axis in AXES:
        i = axis.index
        known = np.array([vehicle.coefficient(name) if name else 0.0 for name in (*axis.columns, "")])
        known[C_MASS] = vehicle.mass_matrix[i, i]
        if free is None:
            terms = known[[C_LINEAR, C_QUADRATIC]] != 0.0
            damping = (True, True) if not terms.any() else (bool(terms[0]), bool(terms[1]))
            wanted: tuple[bool, ...] = (*damping, bool(axis.restoring), bool(axis.constant), True)
        else:
            wanted = (*(name in free for name in axis.columns), axis.added_mass in free)
        found.append(Candidates(axis, wanted, free is not None, known))
    return tuple(found)


def select(candidate: Candidates, solve: Solve, cost: Cost, *, commanded: float = 1.0) -> AxisFindings:
    """Choose among the candidate's columns and solve.

    Args:
        solve: solves for given free flags (5,) and held values (5,).
        cost: how badly a solution explains the data, smaller is better; compares linear with quadratic damping.
        commanded: root-mean-square of the commanded force over that of the whole force on this axis.
    """
    axis, known = candidate.axis, candidate.known.copy()
    reasons: list[str | None] = [None] * 5
    zeroed = [False] * 5
    free = list(candidate.wanted)
    if not any(free):
        return AxisFindings(axis, None, (False,) * 5, (None,) * 5, (False,) * 5)
    whole = solve(tuple(free), known)
    if whole is None:
        free = list(_without_idle_columns(tuple(free), known, solve))
        whole = solve(tuple(free), known) if any(free) else None
    if whole is not None and not candidate.asked and commanded < _COMMANDED and whole.explained < _EXPLAINED:
        whole = None
    if whole is None or (free[C_MASS] and not whole.values[C_MASS] > 0.0 and not _rescued(free, known, solve)):
        return absent(candidate, _unexcited(axis, commanded))
    if free[C_LINEAR] and free[C_QUADRATIC] and not candidate.asked:
        kept, reason = _damping(axis, whole, free, known, solve, cost)
        for c in (C_LINEAR, C_QUADRATIC):
            if c not in kept:
                free[c], known[c], reasons[c], zeroed[c] = False, 0.0, reason, True
    solution = solve(tuple(free), known)
    while solution is not None and (unfit := _unfit(axis, solution)) is not None:
        c, reasons[c] = unfit
        free[c] = False
        if c == C_CONSTANT:
            known[c], zeroed[c] = 0.0, True
        solution = solve(tuple(free), known) if any(free) else None
    solved = solution.free if solution is not None else (False,) * 5
    for c, other in ((C_LINEAR, C_QUADRATIC), (C_QUADRATIC, C_LINEAR)):
        if zeroed[c] and not solved[other]:
            zeroed[c], reasons[c] = False, _neither(axis)
    for c in range(5):
        if candidate.wanted[c] and not solved[c] and reasons[c] is None:
            reasons[c] = _unexcited(axis, commanded)
    return AxisFindings(axis, solution, candidate.wanted, tuple(reasons), tuple(zeroed))


def by_gradient(findings: AxisFindings, theta: Array) -> AxisFindings:
    """Return the findings with the values of the normalised gradient estimator (5,) in place of least squares'.

    The gradient has no deviations of its own; which coefficients are identified is least squares' judgement.
    """
    solution = findings.solution
    if solution is None or not solution.free[C_MASS] or not theta[C_MASS] > 0.0:
        return findings
    values = solution.values.copy()
    for c in range(C_MASS):
        if solution.free[c]:
            values[c] = theta[c] / theta[C_MASS]
    values[C_MASS] = 1.0 / theta[C_MASS]
    return replace(findings, solution=replace(solution, values=values))


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
        held = known.copy()
        other = C_QUADRATIC if c == C_LINEAR else C_LINEAR
        held[other] = 0.0
        flags = tuple(flag and i != other for i, flag in enumerate(free))
        solution = solve(flags, held)
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
    """Return the reason of an axis that nothing moves by intent."""
    return f"{axis.name} was not commanded: the thrusters gave no {axis.wrench} to speak of, so nothing tells it"


def _unexcited(axis: Axis, commanded: float) -> str:
    if commanded < _COMMANDED:
        return not_commanded(axis)
    return f"{axis.name} was not excited enough: {axis.wrench} and {axis.velocity} do not determine it in this run"


def absent(candidate: Candidates, reason: str) -> AxisFindings:
    """Return the findings of an axis that cannot be learned at all, for one reason."""
    reasons = tuple(reason if wanted else None for wanted in candidate.wanted)
    return AxisFindings(candidate.axis, None, candidate.wanted, reasons, (False,) * 5)
