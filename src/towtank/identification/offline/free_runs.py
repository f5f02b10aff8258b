"""Free runs as the second judge of what the joint filter found: fitted to the same recordings, and compared with it.

The filter is at the bound where its picture of the disturbance is right. On real recordings it may not be: forces that
are no random walk of one time constant, thrusters that answer late, bodies that pull to one side. A free run shows
that, because nothing corrects it. So both run freely over windows of the recordings: the filter's coefficients, which
have seen them all, and output error's, fitted each time to the other windows. Output error takes over where its errors
are smaller all the same, by more than chance; or where what it leaves is white, for then nothing but the sensors' noise
parts the model from the data.

Where nobody said which coefficients to learn, what the first model left out is tried, in this order: constant forces,
thrusters that give more or less than their curves say, the thrusters' lag, the other damping terms, couplings between
the axes, forward-speed terms of a vehicle that goes ahead. A term stays that stands out of its deviation and reduces
the errors over windows that it was not fitted to; gains, which contradict what somebody wrote down, only where chance
does not explain that.

Where they are the better judge, what they leave undetermined is held, until all that is free is determined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.identification.data.samples import Samples
from towtank.identification.model.parameters import (
    CONSTANT,
    DELAY,
    GAIN_PREFIX,
    IN_GAIN,
    LAG,
    UNTRANSFORMED,
    FreeParameters,
    free_parameters,
)
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.model.terms import AXES
from towtank.identification.posterior.assembly import Posterior, judge
from towtank.identification.posterior.identifiability import Criteria, Hold
from towtank.identification.posterior.wording import NOT_DETERMINED, free_runs_remark, least_squares_remark
from towtank.identification.simulation_error.cross_validation import (
    ErrorReduction,
    FreeRuns,
    Prior,
    columns_of,
    error_reduction,
    fit_percent,
)
from towtank.identification.simulation_error.fit import OutputErrorFit
from towtank.identification.simulation_error.segments import CandidateModel, Knowledge
from towtank.recording.frames.rotations import conjugate, rotate
from towtank.vehicle import FORWARD_SPEED, Vehicle, configuration_matrix, index
from towtank.vehicle.names import COLUMNS, ROWS

__all__: list[str] = []

RIGHTING = "BG_z"
_FEWEST = 3  # thrusters, of which most give what their curves say
_COUPLED = {3: (4, 5), 4: (3, 5), 5: (3, 4), 1: (5,), 2: (4,)}  # rows, and the speeds that may act on them
_KEPT = 2.0  # deviations that a term needs which the first model did not have, or a constant force to stay
_TERM, _TERM_WORTH = 0.5, 0.01  # deviations, and share of the square error, that such a term must save
CHANGE, CHANGE_WORTH = 2.0, 0.05  # and that a change of judge must
_LAG = 0.03  # s, to begin with
_GAIN = 0.3  # deviation of ln gain of a thruster, beforehand
_ROOM = 100.0  # usual sizes that an added term may have
_PACE = 0.5  # s between two poses that give the speed ahead
_ROUNDS = 3  # of trying terms, and of holding what is not determined
_LOST = 0.5  # share of the windows in which runs go nowhere
_WIDE = 1e6  # deviation that free runs start from: none


class TermGroups(NamedTuple):
    """Names of terms that are tried together, in the order in which they are tried."""

    constants: tuple[str, ...]
    gains: tuple[str, ...]
    lag: tuple[str, ...]
    damping: tuple[str, ...]
    couplings: tuple[str, ...]
    forward_speed: tuple[str, ...] = ()


def groups_of_terms(
    vehicle: Vehicle, names: Sequence[str], samples: Sequence[Samples], *, find_lag: bool
) -> TermGroups:
    """Return the terms that a model with `names` free may lack; an axis is modelled where its inertia or damping is."""
    axes = [i for i, own in enumerate(AXES) if {own.added_mass, own.linear, own.quadratic} & set(names)]
    measured = np.any([each.measured for each in samples], axis=0)
    fed = [i for i in range(6) if measured[6 + i] or measured[i]]
    constants = [f"{ROWS[i]}_0" for i in axes]
    if "BG_z" in names:
        constants += ["BG_x", "BG_y"]
    damping: list[str] = []
    for i in axes:
        own = (AXES[i].linear, AXES[i].quadratic)
        damping += [name for name in own if vehicle.coefficient(name) != 0.0] or own
    couplings = [f"{ROWS[i]}_{COLUMNS[j]}" for i in axes for j in _coupled(i) if j in axes and j in fed and i in fed]
    lift = [index(name)[1:] for name in FORWARD_SPEED] if 0 in fed and _goes_ahead(samples) else []
    forward = [FORWARD_SPEED[n] for n, (i, j) in enumerate(lift) if {i, j} <= set(axes) and {i, j} <= set(fed)]
    gains = _gains(vehicle, axes, samples) if all(each.commands for each in samples) else ()
    return TermGroups(
        tuple(constants), gains, (LAG,) if find_lag else (), tuple(damping), tuple(couplings), tuple(forward)
    )


def _goes_ahead(samples: Sequence[Samples]) -> bool:
    """Whether the vehicle goes ahead, as forward-speed terms suppose: mean u exceeds its deviation and v, w."""
    speeds = []
    for each in samples:
        speed = each.values[:, 6:9]
        if not np.isfinite(speed).all(axis=1).any():
            posed = np.flatnonzero(np.isfinite(each.values[:, :6]).all(axis=1))
            apart = np.searchsorted(each.t[posed], np.arange(each.t[0], each.t[-1], _PACE))
            rows = np.unique(posed[apart[apart < posed.size]])
            q = quaternions_from_eulers(each.values[rows[:-1], 3:6])
            speed = rotate(conjugate(q), np.diff(each.values[rows, :3], axis=0)) / np.diff(each.t[rows])[:, None]
        speeds.append(speed[np.isfinite(speed).all(axis=1)])
    u, v, w = np.concatenate(speeds).T
    return bool(u.size and u.mean() > max(u.std(), math.sqrt(np.mean(v**2 + w**2))))


def _gains(vehicle: Vehicle, axes: Sequence[int], samples: Sequence[Samples]) -> tuple[str, ...]:
    """Return the gains of the driven thrusters that act along the modelled axes, where they can be compared.

    All forces together have no scale of their own, so one thruster is known beside the others, or not at all.
    """
    acts = np.any(configuration_matrix(vehicle)[list(axes)] != 0.0, axis=0)
    driven = np.any([np.nanmax(each.input_force, axis=0) > np.nanmin(each.input_force, axis=0) for each in samples], 0)
    chosen = [each.name for each, one in zip(vehicle.thrusters, acts & driven, strict=True) if one]
    return tuple(GAIN_PREFIX + name for name in chosen) if len(chosen) >= _FEWEST else ()


def righting(names: Sequence[str], samples: Sequence[Samples]) -> tuple[str, ...]:
    """Return the name of the righting moment where it is not free and the attitude is measured, else nothing.

    A vehicle stays level under its thrusters or tips: that alone shows its righting moment, even where nothing else
    of roll and pitch can be learned, and a free run that tips over is of no use to the other axes.
    """
    measured = np.any([each.measured for each in samples], axis=0)
    return (RIGHTING,) if RIGHTING not in names and measured[3] and measured[4] else ()


def _coupled(i: int) -> tuple[int, ...]:
    both = list(_COUPLED.get(i, ()))
    both += [j for j, others in _COUPLED.items() if i in others and j not in both]
    return tuple(sorted(both))


@dataclass(frozen=True, eq=False)
class Refined:
    """What free runs say.

    Attributes:
        model, covariance: the coefficients, and what is held.
        better: whether free runs are the better judge. white: whether their residuals are.
        saved: share of the square error saved beside the joint filter's coefficients, over windows not seen; None where
            the recordings are too short to say.
        fit_percent, joint_fit_percent: of the speeds over these windows, of either; NaN if there are none.
        added: terms that were not free before.
    """

    model: CandidateModel
    covariance: Array
    better: bool
    white: bool
    saved: ErrorReduction | None
    added: tuple[str, ...]
    fit_percent: float = math.nan
    joint_fit_percent: float = math.nan


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A model whose theta is that of the fit."""

    model: CandidateModel
    fit: OutputErrorFit

    @property
    def names(self) -> tuple[str, ...]:
        return self.model.free.names

    @property
    def white(self) -> bool:
        """Whether nothing but the sensors' noise is left."""
        return self.fit.autocorrelation.white(columns_of(self.names))


def refine(
    runs: FreeRuns,
    starts: Sequence[CandidateModel],
    instead: Sequence[CandidateModel] = (),
    *,
    terms: bool,
    find_lag: bool,
    progress: Callable[[float], None],
) -> Refined | None:
    """Fit free runs to recordings and say whether they are the better judge; None where they cannot be made.

    Args:
        starts: what is free and where it begins: the joint filter's coefficients, those of least squares; with the same
            things held, and the same delay.
        instead: the same with the damping terms that least squares chose, where the filter chose others: they take
            their place where their errors are smaller over windows not seen, by more than the deviation of that.
        terms: whether others may be added, of which the prior of the runs then says something too (`prior_with_terms`).
        find_lag: whether the thrusters' lag may. progress: gets the share done.
    """
    joint = starts[0]
    begun, others = _begun(runs, starts, terms=terms), _begun(runs, instead, terms=terms)
    if not begun:
        begun, others = others, []
    if not begun:
        return None
    if not runs.comparable:
        best = _without_early_delay(runs, begun[0])
        return _refined(best, joint, best.white, None)
    progress(0.2)
    columns = columns_of(joint.free.names)
    best, errors = _steady(runs, begun)
    if others and not best.white:
        other, theirs = _steady(runs, others)
        if error_reduction(theirs, errors, columns).beyond(1.0, 0.0):
            best, errors = other, theirs
    white = best.white
    if terms and not white:
        groups = groups_of_terms(runs.vehicle, joint.free.names, runs.samples, find_lag=find_lag)
        for k, group in enumerate(groups):
            progress(0.3 + 0.6 * k / len(groups))
            longer = _tried(runs, best, [name for name in group if name not in best.names])
            if longer is not None:
                now = runs.errors_unseen(longer.model)
                needed = CHANGE if group[0].startswith(GAIN_PREFIX) else _TERM
                if error_reduction(now, errors, columns_of(longer.names)).beyond(needed, _TERM_WORTH):
                    best, errors = longer, now
    progress(0.9)
    before = runs.errors(joint)
    saved = error_reduction(errors, before, columns)
    spread = runs.spread()
    return replace(
        _refined(best, joint, white, saved),
        fit_percent=fit_percent(errors, spread, columns),
        joint_fit_percent=fit_percent(before, spread, columns),
    )


def _begun(runs: FreeRuns, starts: Sequence[CandidateModel], *, terms: bool) -> list[_Fitted]:
    """Return the fits from all starts, those first whose runs come nearest."""
    begun = list(starts)
    if terms and begun and (level := righting(begun[0].free.names, runs.samples)):
        begun += [_extended(runs.vehicle, each, list(level)) for each in begun]
    fits = [each for each in (_fitted(runs, start) for start in begun) if each is not None]
    columns = sorted({j for each in fits for j in columns_of(each.names)})
    return sorted(fits, key=lambda each: _miss(each.fit, columns))


def _steady(runs: FreeRuns, begun: Sequence[_Fitted]) -> tuple[_Fitted, Array]:
    """Return the nearest fit whose runs go somewhere over windows not seen, too, and its errors (w, 18) there."""
    tried = []
    for each in begun:
        fitted = _without_early_delay(runs, each)
        errors = runs.errors_unseen(fitted.model)
        tried.append((fitted, errors))
        if np.mean(np.isposinf(errors).any(axis=1)) < _LOST:
            return fitted, errors
    return tried[0]


def refit(runs: FreeRuns, model: CandidateModel, refined: Refined) -> Refined | None:
    """Return what was found with fewer coefficients free, the others held as the model has them."""
    fitted = _fitted(runs, model)
    if fitted is None:
        return None
    again = _without_early_delay(runs, fitted)
    return replace(refined, model=again.model, covariance=again.fit.covariance)


def _refined(fitted: _Fitted, joint: CandidateModel, white: bool, saved: ErrorReduction | None) -> Refined:
    added = tuple(name for name in fitted.names if name not in joint.free.names)
    better = white or (saved is not None and saved.beyond(CHANGE, CHANGE_WORTH))
    return Refined(fitted.model, fitted.fit.covariance, better, white, saved, added)


def _miss(fit: OutputErrorFit, columns: Sequence[int]) -> float:
    """Return how far the runs are from the data: the mean logarithm of what they miss."""
    missed = fit.residual_std[list(columns)]
    known = missed[np.isfinite(missed) & (missed > 0.0)]
    return float(np.mean(np.log(known))) if known.size else np.inf


def _fitted(runs: FreeRuns, start: CandidateModel) -> _Fitted | None:
    fit = runs.fit(start)
    return None if fit is None else _Fitted(replace(start, theta=fit.theta), fit)


def _tried(runs: FreeRuns, best: _Fitted, names: list[str]) -> _Fitted | None:
    """Return the fit with as many of the names as stand out of their deviations, None where none does."""
    gains = [name for name in names if name.startswith(GAIN_PREFIX)]
    for _ in range(_ROUNDS if names else 0):
        longer = _fitted(runs, _extended(runs.vehicle, best.model, names))
        if longer is None:
            return None
        kept = [name for name in names if _stands_out(longer, name, gains)]
        if kept == names:
            return _without_early_delay(runs, longer)
        names = kept
        if not names:
            return None
    return None


def _stands_out(fitted: _Fitted, name: str, gains: Sequence[str]) -> bool:
    """Whether a term differs from 0 by its deviations, a gain from the usual one: the median of all, held ones too."""
    free, fit = fitted.model.free, fitted.fit
    pick = np.zeros(len(free))
    k = free.names.index(name)
    pick[k] = 1.0
    if name in gains:
        theta = dict(zip(free.names, fit.theta, strict=True))
        usual = sorted(gains, key=lambda each: theta.get(each, 0.0))[len(gains) // 2]
        if usual in free.names:
            pick[free.names.index(usual)] -= 1.0
    size = abs(float(pick @ fit.theta)) if free.codes[k, 3] == UNTRANSFORMED or name in gains else 1.0
    return bool(size > _KEPT * max(float(pick @ fit.covariance @ pick), 0.0) ** 0.5)


def _extended(vehicle: Vehicle, model: CandidateModel, names: list[str]) -> CandidateModel:
    """Return the model with `names` free too."""
    free = free_parameters(vehicle, (*model.free.names, *names))
    now = dict(zip(model.free.names, model.theta, strict=True))
    usual = start_theta(vehicle, model.vehicle, free, delay=model.delay, lag=_LAG)
    size = size_of(vehicle, free)
    theta = np.array([now.get(name, usual[k]) for k, name in enumerate(free.names)])
    if LAG in names and DELAY in now:
        k = free.names.index(DELAY)
        theta[k] = max(0.0, float(theta[k]) - _LAG)
    if RIGHTING in names:
        k = free.names.index(RIGHTING)
        theta[k] = max(float(theta[k]), float(size[k]))
    return replace(model, free=free, theta=theta)


def prior_with_terms(vehicle: Vehicle, first: FreeParameters, prior: Prior) -> Prior:
    """Return what is known beforehand: the prior, and a usual size for the terms that `first` has not."""

    def known(free: FreeParameters) -> Knowledge:
        n = len(free)
        mean, information = prior(free) or (np.zeros(n), np.zeros((n, n)))
        information = np.array(information)
        scale = size_of(vehicle, free)
        for k, name in enumerate(free.names):
            if name in first.names:
                continue
            if free.codes[k, 3] == UNTRANSFORMED and name != DELAY:
                information[k, k] += (_ROOM * scale[k]) ** -2.0
            elif free.codes[k, 0] == IN_GAIN:
                information[k, k] += _GAIN**-2.0
        return mean, information

    return known


def _without_early_delay(runs: FreeRuns, fitted: _Fitted) -> _Fitted:
    """Return the fit with no delay where thrusters would have to act before they are commanded."""
    model = fitted.model
    if DELAY not in model.free.names:
        return fitted
    k = model.free.names.index(DELAY)
    if model.theta[k] >= 0.0:
        return fitted
    free = model.free.subset([name for name in model.free.names if name != DELAY])
    if not len(free):
        return fitted
    prompt = replace(model, free=free, theta=np.delete(model.theta, k), delay=0.0)
    again = _fitted(runs, prompt)
    if again is not None:
        return again
    left = np.delete(np.delete(fitted.fit.covariance, k, axis=0), k, axis=1)
    return _Fitted(prompt, replace(fitted.fit, theta=prompt.theta, covariance=left))


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
    kept = (DELAY, LAG, *proved, *(name for name in free.names if _is_needed(refined, name)))
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


def _is_needed(refined: Refined, name: str) -> bool:
    """Whether a constant force stands out, however roughly its size is known: without it the rest is off."""
    free, theta, covariance = refined.model.free, refined.model.theta, refined.covariance
    k = free.names.index(name)
    return bool(free.codes[k, 0] == CONSTANT and abs(theta[k]) > _KEPT * np.sqrt(covariance[k, k]))


def _remark(task: FreeRunTask, first: Refined, *, thinned: bool) -> str:
    saved = None if first.saved is None else (first.saved.mean, first.saved.std)
    verdict = "white" if first.white else "better" if first.better else "worse"
    fits = (first.fit_percent, first.joint_fit_percent)
    return free_runs_remark(verdict, saved, fits, first.added, thinned=thinned, requested=task.always)
