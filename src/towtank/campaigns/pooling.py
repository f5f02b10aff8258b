"""What many vehicles of a class say together: the class, the spread of its vehicles, that of their runs.

A learned model is the posterior of one run: prior and data. What its data say alone is `likelihood`'s.

The pooling is that of `random_effects`: run within vehicle within class. Spreads are of single coefficients and
independent of each other, in the coordinates in which the prior is Gaussian: of total inertias and gains, logarithms.
Motion tells forces only in units of the thrust, so that inertias and forces are pooled as multiples of the mean gain of
the thrusters, in which no run has anything to say of the scale (`per_thrust`); the scale of the class is as uncertain
as the prior has it, however many vehicles there are. Gains are a vehicle's, and do not differ from run to run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.campaigns.fleet import Fleet, FleetClass, Outlier, Pooled
from towtank.campaigns.likelihood import (
    Likelihood,
    Run,
    bare,
    further,
    gains_beside,
    is_inertia,
    likelihood,
    posterior_of,
)
from towtank.campaigns.random_effects import Evidence, Solution, Variances, restricted_maximum, solved
from towtank.core.arrays import Array
from towtank.digits import joined
from towtank.errors import InputError
from towtank.identification.model.parameters import GAIN_PREFIX, IN_GAIN, LAG, FreeParameters
from towtank.identification.model.prior import Prior, prior_of
from towtank.identification.posterior.result import NARROWED
from towtank.vehicle import COEFFICIENTS, Coefficient, Vehicle
from towtank.vehicle.posterior import named, unit_of_unknown

__all__ = ["pool"]

_CHANCE = 0.05  # of naming any run of a class as an outlier where there is none
_SUSPECT, _SUSPECTS = 0.8, 3  # of what an outlier has while it is among those that it is compared with; asked at a time
_MOST_OUTLIERS = 12
_START = 1e-2  # of a variance, in units of what was supposed
_NORMAL_95 = 1.959963984540054


def pool(runs: Sequence[Run]) -> Fleet:
    """Return what runs of vehicles say together, class by class in the order in which classes appear.

    Raises:
        InputError: no run; one whose model has no posterior, or was learned from another vehicle than is said; vehicles
            of a class with other thrusters; a run that is there twice.
    """
    if not runs:
        raise InputError("pool: no run given, expected two at least")
    seen: set[tuple[str, str, str]] = set()
    for run in runs:
        key = (run.klass, run.vehicle, run.label)
        if key in seen:
            raise InputError(f"{run.label}: stands there twice for {run.vehicle}, expected each run once")
        seen.add(key)
    names = dict.fromkeys(run.klass for run in runs)
    return Fleet(tuple(_pooled([run for run in runs if run.klass == name]) for name in names))


@dataclass(frozen=True, eq=False)
class _Spreads:
    """Which spreads (2, p) between vehicles and within them are `asked` for, by which parameters they are `estimated`,
    where all of them `start`, and how many runs and vehicles know the coefficient, `counts` (2, p).
    """

    asked: NDArray[np.bool_]
    estimated: Array
    start: Variances
    counts: NDArray[np.int64]


def _pooled(runs: Sequence[Run]) -> FleetClass:
    """Return what the runs of one class say."""
    own = [likelihood(run) for run in runs]
    base = _base(runs)
    names = dict.fromkeys(name for each in own for name in each.free.names)
    whole = prior_of(base, commands=_driven(runs), more=further(list(names)), beside=runs[0].beside)
    prior = whole.only(tuple(names))
    if not prior.names:
        raise InputError(f"class {runs[0].klass}: no run says anything of any coefficient, so that there is no class")
    vehicles = tuple(dict.fromkeys(run.vehicle for run in runs))
    member = np.array([vehicles.index(run.vehicle) for run in runs])
    points = [_point(prior, run, each, base) for run, each in zip(runs, own, strict=True)]
    centre = np.mean(points, axis=0)
    q, turn = per_thrust(prior.free, centre)
    near, near_covariance = prior.seen_from(centre)
    supposed = q + turn @ (near - centre)
    covariance = turn @ near_covariance @ turn.T
    unit = np.sqrt(np.diag(covariance))
    evidence = _evidence(prior.free, own, points, member, supposed, unit)
    precision = np.linalg.inv(covariance / np.outer(unit, unit))
    spreads = _spreads(evidence, precision, prior.free, unit)
    variances = restricted_maximum(evidence, spreads.estimated, spreads.start, precision)
    found = solved(evidence, variances, precision)
    outliers = _outliers(runs, prior.names, spreads, found, precision)

    theta, back = thrust_undone(prior.free, supposed + unit * found.mean)
    rows = back * unit
    new = _of_a_new_vehicle(found, spreads)
    covariance = rows @ new @ rows.T
    pooled = _coefficients(prior, found, theta, rows, np.sqrt(np.diag(covariance)), spreads)
    return FleetClass(
        name=runs[0].klass,
        vehicles=vehicles,
        runs=tuple(run.label for run in runs),
        coefficients=pooled,
        outliers=outliers,
        base=_whole(base, whole, prior.names),
        prior=prior,
        mean=theta,
        covariance=covariance,
        spread=np.where(spreads.asked[1], unit * np.sqrt(variances.within), 0.0),
    )


def _base(runs: Sequence[Run]) -> Vehicle:
    """Return the vehicle that the class is told by: what the first run was learned from, before any data.

    Raises:
        InputError: another run's vehicle has other thrusters.
    """
    first = runs[0].before
    base = bare(runs[0].model) if first is None or first.posterior is not None else first
    names = {each.name for each in base.thrusters}
    for run in runs:
        other = {each.name for each in run.model.thrusters}
        if other != names:
            raise InputError(
                f"{run.label}: {run.vehicle} has the thrusters {joined(sorted(other) or ['none'])}, but {runs[0].label}"
                f" of the same class {run.klass} has {joined(sorted(names) or ['none'])}; give it a class of its own"
            )
    return base


def _whole(base: Vehicle, supposed: Prior, pooled: Sequence[str]) -> Vehicle:
    """Return the vehicle with what is supposed of the coefficients that no run told, where that is not 0."""
    changes: dict[str, Coefficient | float] = {}
    lines = zip(supposed.names, supposed.values, supposed.value_std, supposed.sources, strict=True)
    for name, value, std, source in lines:
        if name in COEFFICIENTS and name not in pooled and value != 0.0:
            changes[name] = Coefficient(value=float(value), std=float(std), source=source)
    return base.with_coefficients(changes)


def _driven(runs: Sequence[Run]) -> bool:
    """Whether any run was driven by thruster commands."""
    names = [name for run in runs for name in posterior_of(run.model, run.label).names]
    return any(name == LAG or name.startswith(GAIN_PREFIX) for name in names)


def _point(prior: Prior, run: Run, own: Likelihood, base: Vehicle) -> Array:
    """Return theta (n,) that a run's likelihood is told about, of what it does not know the prior's mean."""
    theta = prior.mean.copy()
    before = base if run.before is None else run.before
    gains = gains_beside(before, base, own.free.names)
    for k, name in enumerate(own.free.names):
        theta[prior.names.index(named(name, prior.names))] = own.theta[k] + gains[k]
    return theta


def _evidence(
    free: FreeParameters,
    own: Sequence[Likelihood],
    points: Sequence[Array],
    member: NDArray[np.int64],
    supposed: Array,
    unit: Array,
) -> Evidence:
    """Return what the runs say, per thrust, from what was supposed, in units of its deviation."""
    n, p = len(own), len(free)
    information, score = np.zeros((n, p, p)), np.zeros((n, p))
    for r, (each, theta) in enumerate(zip(own, points, strict=True)):
        if not len(each.free):
            continue
        rows = [free.names.index(named(name, free.names)) for name in each.free.names]
        whole, gradient = np.zeros((p, p)), np.zeros(p)
        whole[np.ix_(rows, rows)], gradient[rows] = each.information, each.gradient
        q, turn = per_thrust(free, theta)
        back = np.linalg.inv(turn)  # d theta / d q
        if each.unscaled:  # but for errors of the first order, which many runs would add up
            share = _gain_share(free)
            back = back @ (np.eye(p) - np.outer(share > 0.0, share))
        back = back * unit
        information[r] = back.T @ whole @ back
        score[r] = back.T @ gradient + information[r] @ ((q - supposed) / unit)
    return Evidence(information, score, member)


def _gain_share(free: FreeParameters) -> Array:
    """Return the share (n,) of each unknown in the logarithm of the scale of thrust; one thruster has no scale."""
    gains = free.codes[:, 0] == IN_GAIN
    return gains / gains.sum() if gains.sum() > 1 else np.zeros(len(free))


def per_thrust(free: FreeParameters, theta: Array) -> tuple[Array, Array]:
    """Return inertias and forces as multiples of the thrusters' mean gain (n,), and d q / d theta (n, n)."""
    share, forces, inertias = _gain_share(free), free.forces, is_inertia(free)
    scale = float(share @ theta)
    shrink = np.where(forces, math.exp(-scale), 1.0)
    q = shrink * theta - np.where(inertias, scale, 0.0)
    return q, np.diag(shrink) - np.outer(np.where(forces, q, 0.0) + inertias, share)


def thrust_undone(free: FreeParameters, q: Array) -> tuple[Array, Array]:
    """Return theta (n,) of q, and d theta / d q (n, n)."""
    share, forces, inertias = _gain_share(free), free.forces, is_inertia(free)
    scale = float(share @ q)
    theta = np.where(forces, math.exp(scale), 1.0) * q + np.where(inertias, scale, 0.0)
    return theta, np.asarray(np.linalg.inv(per_thrust(free, theta)[1]))


def _spreads(evidence: Evidence, prior: Array, free: FreeParameters, unit: Array) -> _Spreads:
    """Return which spreads are asked for, and what the others are taken for.

    A coefficient is known where its deviation is at most half of what was supposed. Two vehicles must know it for a
    spread between them, two runs of one vehicle for one within. Where nobody can say either, each run has its own, as
    far from the class as was supposed of any vehicle: runs that disagree on what none of them knows would bend what
    they do know. So have vehicles their gains, which are the same in all runs of one. Thrusters are of one make: their
    gains spread alike.
    """
    supposed = np.diag(np.linalg.inv(prior))
    by_run = np.diagonal(np.linalg.inv(evidence.information + prior), axis1=1, axis2=2) <= NARROWED**2 * supposed
    whole = np.zeros((evidence.members, *prior.shape))
    np.add.at(whole, evidence.member, evidence.information)
    by_vehicle = np.diagonal(np.linalg.inv(whole + prior), axis1=1, axis2=2) <= NARROWED**2 * supposed
    runs_of = np.zeros((evidence.members, len(free)), dtype=np.int64)
    np.add.at(runs_of, evidence.member, by_run.astype(np.int64))
    gains = free.codes[:, 0] == IN_GAIN
    between, within = by_vehicle.sum(axis=0) >= 2, (runs_of >= 2).any(axis=0) & ~gains
    own = ~between & ~within & (len(evidence.score) > 1)
    start = Variances(
        np.where(between, _START, np.where(own & gains, 1.0, 0.0)),
        np.where(within, _START, np.where(own & ~gains, 1.0, 0.0)),
    )
    asked = np.array([between, within])
    each = np.eye(2 * len(free))[np.concatenate([between & ~gains, within])]
    alike = np.where(between & gains, np.min(unit[gains], initial=np.inf) ** 2 / unit**2, 0.0)
    if alike.any():
        each = np.vstack([each, np.concatenate([alike, np.zeros(len(free))])])
    return _Spreads(asked, each, start, np.array([by_run.sum(axis=0), by_vehicle.sum(axis=0)]))


def _of_a_new_vehicle(found: Solution, spreads: _Spreads) -> Array:
    """Return the covariance (p, p) of a run of a vehicle that was not among these.

    A spread that nothing shows leaves what is supposed of any vehicle. Where few vehicles show it, deviations are as
    much wider as Student's interval is than the normal one, but no wider than before any data for that.
    """
    p = found.mean.size
    shown = np.where(spreads.asked, np.array([found.variances.between, found.variances.within]), 0.0)
    new = found.covariance + np.diag(shown.sum(axis=0))
    new += np.diag(np.where(spreads.asked[0], 0.0, np.maximum(1.0 - np.diag(new), 0.0)))
    _, degrees = found.deviations(np.eye(p), spreads.asked.astype(np.float64))
    plain = np.sqrt(np.diag(new))
    wider = np.maximum(np.minimum(_student(degrees) / _NORMAL_95, 1.0 / plain), 1.0)
    return np.asarray(new * np.outer(wider, wider))


def _coefficients(
    prior: Prior,
    found: Solution,
    theta: Array,
    rows: Array,
    wide: Array,
    asked: _Spreads,
) -> tuple[Pooled, ...]:
    """Return what is said of each coefficient, in its own unit."""
    variance, degrees = found.deviations(rows)
    std, values, slopes = np.sqrt(variance), prior.free.values(theta), np.abs(prior.free.slopes(theta))
    reach = _student(degrees) * std
    ends = np.sort([prior.free.values(theta - reach), prior.free.values(theta + reach)], axis=0)
    own = slopes * np.abs(np.diag(rows))
    spreads = (own * np.sqrt(found.variances.between), own * np.sqrt(found.variances.within))
    inertias = is_inertia(prior.free)
    out = []
    for k, name in enumerate(prior.names):
        if name not in COEFFICIENTS:
            continue
        between, within = (float(spreads[e][k]) if asked.asked[e, k] else None for e in (0, 1))
        out.append(
            Pooled(
                name=name,
                unit=unit_of_unknown(name),
                value=float(values[k]),
                std=float(slopes[k] * std[k]),
                low=float(ends[0, k]),
                high=float(ends[1, k]),
                between=between,
                within=within,
                size=float(slopes[k] if inertias[k] else abs(values[k])),
                next_std=float(slopes[k] * wide[k]),
                prior=float(prior.values[k]),
                prior_std=float(prior.value_std[k]),
                runs=int(asked.counts[0, k]),
                vehicles=int(asked.counts[1, k]),
            )
        )
    return tuple(out)


def _outliers(
    runs: Sequence[Run],
    names: Sequence[str],
    spreads: _Spreads,
    pooled: Solution,
    prior: Array,
) -> tuple[Outlier, ...]:
    """Return the runs that are out of line, each asked with the variances that the others have without it.

    One after the other, the gravest first: two of a kind would hide each other.
    """
    evidence, variances, tested = pooled.evidence, pooled.variances, spreads.asked[1]
    if not tested.any():
        return ()
    found: list[Outlier] = []
    out = np.zeros(len(runs), dtype=np.bool_)
    level = _CHANCE / (len(runs) * int(tested.sum()))
    while len(found) < _MOST_OUTLIERS:
        kept = evidence.without(out)
        away = np.where(out[:, None] | ~tested, 0.0, np.abs(_away(solved(kept, variances, prior))))
        degrees = np.maximum(np.sum(np.diagonal(kept.information, axis1=1, axis2=2) > 1.0, axis=0) - kept.members, 2)
        far = _quantile(level, degrees - 1)
        suspect = (away / (far * np.sqrt(degrees / (degrees - 1 + far**2)))).max(axis=1)
        candidates = []
        for r in np.argsort(-suspect)[:_SUSPECTS]:
            if suspect[r] < _SUSPECT:
                continue
            alone = out.copy()
            alone[r] = True
            others = restricted_maximum(evidence.without(alone), spreads.estimated, variances, prior)
            score = np.where(tested, _away(solved(kept, others, prior))[r], 0.0)
            k = int(np.argmax(np.abs(score) / far))
            if abs(score[k]) > far[k]:
                candidates.append((abs(float(score[k])), int(r), k, float(score[k]), others))
        if not candidates:
            break
        _, r, k, deviations, variances = max(candidates, key=lambda each: each[0])
        out[r] = True
        found.append(Outlier(runs[r].vehicle, runs[r].label, names[k], deviations))
    return tuple(sorted(found, key=lambda each: -abs(each.deviations)))


def _away(solution: Solution) -> Array:
    """Return how many deviations (n, p) each run's effect is out of line."""
    variance = np.einsum("nii->ni", solution.run_pull_covariance)
    large = variance > 1e-9 * np.maximum(variance.max(axis=0), 1e-300)
    return np.asarray(np.where(large, solution.run_pull / np.sqrt(np.where(large, variance, 1.0)), 0.0))


def _student(degrees: Array) -> Array:
    """Return the 97.5 % quantile of Student's t."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(degrees, 0.975))


def _quantile(level: float, degrees: NDArray[np.int64]) -> Array:
    """Return how many deviations of Student's t are exceeded, either way, with a chance of `level`."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(degrees, 1.0 - 0.5 * level))
