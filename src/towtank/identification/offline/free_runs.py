"""Free runs as the second judge of what the joint filter found, until all that they leave free is determined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples
from towtank.identification.model.parameters import CONSTANT, DELAY, LAG
from towtank.identification.model.prior import size_of
from towtank.identification.posterior.assembly import Posterior, judge
from towtank.identification.posterior.identifiability import Criteria, Hold
from towtank.identification.posterior.wording import NOT_DETERMINED, free_runs_remark, least_squares_remark
from towtank.identification.simulation_error.cross_validation import (
    ErrorReduction,
    FreeRuns,
    Prior,
    columns_of,
    error_reduction,
)
from towtank.identification.simulation_error.problem import CandidateModel
from towtank.identification.simulation_error.refinement import (
    CHANGE,
    CHANGE_WORTH,
    Refined,
    prior_with_terms,
    refine,
    refit,
    righting,
)
from towtank.vehicle import Vehicle

__all__ = ["FreeRunOutcome", "FreeRunTask", "learn_free_runs"]

_ROUNDS = 3
_KEPT = 2.0  # deviations that a constant force needs
_WIDE = 1e6  # deviation that free runs start from: none


@dataclass(frozen=True, eq=False)
class FreeRunTask:
    """What free runs are asked.

    Attributes:
        starts, instead, terms, find_lag: see `refine`; the first start is the joint filter's model.
        least_squares: the model of least squares alone, with the joint filter's coefficients free.
        always: go on even where the joint filter is the better judge.
        speeds: (6, 2) of the run, see `Criteria`.
    """

    starts: Sequence[CandidateModel]
    instead: Sequence[CandidateModel]
    least_squares: CandidateModel
    terms: bool
    find_lag: bool
    always: bool
    speeds: Array | None = None

    @property
    def joint(self) -> CandidateModel:
        """The joint filter's model."""
        return self.starts[0]

    @property
    def names(self) -> set[str]:
        """Names of what any model has free to begin with."""
        return {name for each in (*self.starts, *self.instead) for name in each.free.names}

    def runs_over(
        self, vehicle: Vehicle, samples: Sequence[Samples], noise: Array, attitude: Sequence[Array], prior: Prior
    ) -> FreeRuns:
        """Return recordings prepared for these models; `attitude`: see `FreeRuns`."""
        names = (*self.names, *(righting(self.joint.free.names, samples) if self.terms else ()))
        known = prior_with_terms(vehicle, self.joint.free, prior)
        return FreeRuns.over(vehicle, samples, noise, names, attitude, known)


@dataclass(frozen=True, eq=False)
class FreeRunOutcome:
    """What free runs made of it.

    Attributes:
        refined: coefficients. first: the comparison with the joint filter. remark: it, in plain words.
        reasons: why a coefficient that the filter had free is not determined. set_to_zero: those taken as 0.
        least_squares: whether the runs of least squares have smaller errors than those of what was chosen.
    """

    refined: Refined
    first: Refined
    remark: str
    reasons: dict[str, str]
    set_to_zero: tuple[str, ...]
    least_squares: bool


def learn_free_runs(task: FreeRunTask, runs: FreeRuns, progress: Callable[[float], None]) -> FreeRunOutcome | None:
    """Fit free runs; None where none can be made. `progress` gets the share done."""
    terms = task.terms
    first = refine(runs, task.starts, task.instead, terms=terms, find_lag=task.find_lag, progress=progress)
    if first is None:
        return None
    proved = tuple(name for name in first.added if name not in task.names)  # by windows held out
    compare = terms and not task.always and not first.white and runs.comparable
    if (
        compare
        and not first.better
        and _saved_by_least_squares(task, runs, task.joint)
        and not _saved_by_least_squares(task, runs, first.model)
    ):
        first = replace(first, better=True)  # least squares beats the filter, but not what free runs found
    now, reasons, set_to_zero = first, dict[str, str](), list[str]()
    for _ in range(_ROUNDS if terms and (first.better or task.always) else 0):
        tried = _held(task, runs, now, proved)
        if tried is None:
            break
        for stays in tried.stand_for_two:
            other = _held(task, runs, now, proved, yielding=(*tried.yielding, stays))
            if other is not None and other.has_smaller_errors(runs, tried, columns_of([stays])):
                tried = other
        now = tried.refined
        set_to_zero += [name for name, hold in tried.held.items() if hold == "zero"]
        reasons.update(tried.reasons)
    remark = _remark(task, first, thinned=runs.thinned)
    saved = _saved_by_least_squares(task, runs, now.model if first.better else task.joint) if compare else None
    if saved is not None:
        remark += least_squares_remark((saved.mean, saved.std))
    return FreeRunOutcome(now, first, remark, reasons, tuple(set_to_zero), saved is not None)


def _saved_by_least_squares(task: FreeRunTask, runs: FreeRuns, model: CandidateModel) -> ErrorReduction | None:
    """Return what least squares saves beside a model; None where it does not stand out."""
    errors, beside = runs.errors(task.least_squares), runs.errors(model)
    saved = error_reduction(errors, beside, columns_of(task.joint.free.names))
    return saved if saved.beyond(CHANGE, CHANGE_WORTH) else None


@dataclass(frozen=True, eq=False)
class _Held:
    """A fit with less free: what is held, and why.

    stand_for_two: damping terms whose mate is taken as 0. yielding: see `Criteria`.
    """

    refined: Refined
    held: dict[str, Hold]
    reasons: dict[str, str]
    stand_for_two: tuple[str, ...]
    yielding: tuple[str, ...]

    def has_smaller_errors(self, runs: FreeRuns, other: _Held, columns: Sequence[int]) -> bool:
        """Whether the errors are smaller than with the other choice, in some columns."""
        one, two = (runs.errors(each.refined.model) for each in (self, other))
        return error_reduction(one, two, columns).mean > 0.0


def _held(
    task: FreeRunTask, runs: FreeRuns, refined: Refined, proved: Sequence[str], *, yielding: tuple[str, ...] = ()
) -> _Held | None:
    """Return the fit without what these recordings do not determine; None where they do, or nothing would be left.

    proved: names that stay, since they reduced the errors over windows not seen. yielding: see `Criteria`.
    """
    model, free = refined.model, refined.model.free
    posterior, criteria = Posterior(free, model.theta, refined.covariance), Criteria(task.speeds, yielding)
    findings = judge(posterior, np.full(len(free), _WIDE), size_of(runs.vehicle, free), criteria=criteria)
    kept = (DELAY, LAG, *proved, *(name for name in free.names if _stands_out(refined, name)))
    held = {name: hold for name, hold in findings.held.items() if name not in kept}
    if not held or len(held) == len(free):
        return None
    left = [k for k, name in enumerate(free.names) if name not in held]
    smaller = replace(
        model,
        vehicle=model.vehicle.with_coefficients({name: 0.0 for name, hold in held.items() if hold == "zero"}),
        free=free.subset([free.names[k] for k in left]),
        theta=model.theta[left],
    )
    again = refit(runs, smaller, refined)
    if again is None:
        return None
    reasons = {name: findings.reasons.get(name, NOT_DETERMINED) for name in held}
    stay = [each.partner for each in findings.findings if held.get(each.name) == "zero" and each.partner]
    return _Held(again, held, reasons, tuple(stay), yielding)


def _stands_out(refined: Refined, name: str) -> bool:
    """Whether a constant force stands out, however roughly its size is known: without it the rest is off."""
    free, theta, covariance = refined.model.free, refined.model.theta, refined.covariance
    k = free.names.index(name)
    return bool(free.codes[k, 0] == CONSTANT and abs(theta[k]) > _KEPT * np.sqrt(covariance[k, k]))


def _remark(task: FreeRunTask, first: Refined, *, thinned: bool) -> str:
    saved = None if first.saved is None else (first.saved.mean, first.saved.std)
    verdict = "white" if first.white else "better" if first.better else "worse"
    fits = (first.fit_percent, first.joint_fit_percent)
    return free_runs_remark(verdict, saved, fits, first.added, thinned=thinned, requested=task.always)
