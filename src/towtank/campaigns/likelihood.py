"""What the data of one run say by themselves: its posterior with the prior taken back out.

The prior was the same in all runs and may count once only, so each run's own likelihood is taken back out of its
posterior, as information,

    L = C^-1 - C_0^-1,    L x = C^-1 m - C_0^-1 m_0

with m, C of the posterior and m_0, C_0 of the prior, in the coordinates in which the prior is of unit covariance, where
a direction of which the run says nothing is one of an eigenvalue 1 and is left at no information. What belongs to a
single run (`_OF_A_RUN`: delay, latencies, constant forces) is integrated out before that, each with its own prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.layout import N_KINDS
from towtank.digits import short
from towtank.errors import InputError
from towtank.identification.model.parameters import (
    DELAY,
    FURTHER,
    GAIN_PREFIX,
    LAG,
    LATENCIES,
    PLACES,
    UNTRANSFORMED,
    FreeParameters,
)
from towtank.identification.model.prior import Prior, prior_of
from towtank.vehicle import COEFFICIENTS, Vehicle, index
from towtank.vehicle.posterior import Posterior, named

__all__ = [
    "Likelihood",
    "Run",
    "bare",
    "further",
    "gains_beside",
    "is_inertia",
    "likelihood",
    "posterior_of",
]

_OF_A_RUN = (DELAY, *LATENCIES, *PLACES)  # and constant forces
_ROUNDED = 4e-3  # of the prior's information: what the digits of a learned file may add
_FARTHEST = 3.0  # deviations
_SAME = 1e-6  # share by which a deviation that was kept may differ
_SAME_PRIOR = 0.01


@dataclass(frozen=True)
class Run:
    """What one run taught of one vehicle.

    Attributes:
        vehicle: which one it was. klass: its class: vehicles built to one drawing. label: of the run.
        model: learned, with its posterior. before: the vehicle that it was learned from; None: one of which nothing is
            known but rigid body and thrusters. beside: the one given by `--prior`.
    """

    vehicle: str
    klass: str
    label: str
    model: Vehicle
    before: Vehicle | None = None
    beside: Vehicle | None = None


@dataclass(frozen=True, eq=False)
class Likelihood:
    """What a run's data say, about theta (n,): the information (n, n) and the gradient (n,) of the log likelihood.

    `unscaled`: all forces were unknown, so that the data say nothing of the scale of thrust.
    """

    free: FreeParameters
    theta: Array
    information: Array
    gradient: Array
    unscaled: bool = True


def likelihood(run: Run) -> Likelihood:
    """Return what a run's data say of what is not the run's alone, the prior taken out."""
    posterior = posterior_of(run.model, run.label)
    before = bare(run.model) if run.before is None else run.before
    prior = _prior_before(run, before, posterior)
    place = {name: k for k, name in enumerate(prior.names)}
    rows = np.array([place[named(name, place)] for name in posterior.names])
    gains = gains_beside(run.model, before, prior.names)
    signs, rigid = prior.free.signs[rows], prior.free.rigid[rows]
    mean = np.where(signs < 0.0, rigid - np.array(posterior.mean), np.array(posterior.mean)) + gains[rows]
    covariance = posterior.covariance * np.outer(signs, signs)
    supposed = prior.std[rows]
    theta = prior.mean.copy()
    theta[rows] = mean
    theta = _physical(run.model, prior, theta)
    near, near_covariance = prior.seen_from(theta)
    kept = np.array([not _of_a_run(prior.names[row]) for row in rows])
    kept &= np.abs(np.array(posterior.std) / supposed - 1.0) > _SAME  # else nothing in the run shows it
    if not kept.any():
        return Likelihood(prior.free.subset(()), np.empty(0), np.empty((0, 0)), np.empty(0))
    some = rows[kept]
    information, gradient = _taken_out(
        (mean[kept], covariance[np.ix_(kept, kept)]), (near[some], near_covariance[np.ix_(some, some)]), theta[some]
    )
    order = np.argsort(some)
    free = prior.free.subset([prior.names[row] for row in some])
    unscaled = bool(
        (prior.free.forces | is_inertia(prior.free))[np.setdiff1d(np.arange(len(prior.free)), rows)].sum() == 0
    )
    return Likelihood(free, theta[some][order], information[np.ix_(order, order)], gradient[order], unscaled)


def _taken_out(posterior: tuple[Array, Array], prior: tuple[Array, Array], theta: Array) -> tuple[Array, Array]:
    """Return information (n, n) and gradient (n,) at theta of the likelihood that makes a posterior of a prior.

    Of a direction whose variance a run narrows to a share d of the prior's, the mean lies y from the prior's mean, y of
    variance 1 - d, and the likelihood itself at y / (1 - d). But learning widens deviations by what windows of a run
    contradict each other, and leaves the mean where it went; with the d that is stated, the likelihood of such a run
    would lie many times too far. Where y is more than three of its deviations, the run is taken to have narrowed the
    direction as much as makes y three, before it was widened; its information is what it states.
    """
    root = np.linalg.cholesky(prior[1])
    white = np.linalg.solve(root, np.linalg.solve(root, posterior[1]).T)
    shares, axes = np.linalg.eigh(0.5 * (white + white.T))
    told = np.maximum(1.0 / np.maximum(shares, 1e-300) - 1.0, 0.0)
    told[told < _ROUNDED] = 0.0
    away = axes.T @ np.linalg.solve(root, posterior[0] - prior[0])
    narrowed = np.where(told > 0.0, np.maximum(1.0 - shares, np.minimum((away / _FARTHEST) ** 2, 1.0)), 1.0)
    says = told * away / narrowed
    says -= told * (axes.T @ np.linalg.solve(root, theta - prior[0]))
    back = np.linalg.solve(root.T, axes)
    return (back * told) @ back.T, back @ says


def posterior_of(model: Vehicle, label: str) -> Posterior:
    """Return the posterior of a learned model. Raises InputError where there is none."""
    if model.posterior is None:
        raise InputError(f"{label}: its model has no [posterior], expected one learned by method joint or output-error")
    return model.posterior


def bare(model: Vehicle) -> Vehicle:
    """Return a vehicle of which nothing is known but rigid body, thrusters and what was stated in [prior]."""
    thrusters = tuple(each.model_copy(update={"gain": 1.0, "time_constant": 0.0}) for each in model.thrusters)
    empty = Vehicle(name=model.name, rigid_body=model.rigid_body, buoyancy=model.buoyancy, thrusters=thrusters)
    return empty.model_copy(update={"prior": model.prior, "scale_std": model.scale_std})


def _prior_before(run: Run, before: Vehicle, posterior: Posterior) -> Prior:
    """Return what was supposed when a run was learned from.

    Raises:
        InputError: it is not what the run's posterior says was supposed.
    """
    commands = any(name == LAG or name.startswith(GAIN_PREFIX) for name in posterior.names)
    prior = prior_of(before, commands=commands, more=further(posterior.names), beside=run.beside)
    for name, std in zip(posterior.names, posterior.prior_std, strict=True):
        own = named(name, prior.names)
        found = float(prior.reference[prior.names.index(own)]) if own in prior.names else math.nan
        if not abs(found / std - 1.0) <= _SAME_PRIOR:
            said = "no vehicle was given" if run.before is None else f"{before.name} has {short(found)}"
            raise InputError(
                f"{run.label}: {name} was learned from a prior deviation of {short(std)}, but {said}; "
                "give the vehicle file, and --prior, that the run was learned with"
            )
    return prior


def further(names: Sequence[str]) -> list[str]:
    """Return those that a prior has only where it is asked: latencies, places, forward-speed terms."""
    return [name for name in names if name in FURTHER]


def _physical(model: Vehicle, prior: Prior, theta: Array) -> Array:
    """Return theta (n,) with the coefficients that the model has, the likeliest that physics allows."""
    values = prior.free.values(theta)
    for k, name in enumerate(prior.names):
        if name in COEFFICIENTS:
            values[k] = model.coefficient(name)
    return prior.free.thetas(values)


def gains_beside(model: Vehicle, before: Vehicle, names: Sequence[str]) -> Array:
    """Return the logarithms (n,) of the model's gains as multiples of what they were before, 0 of other unknowns."""
    there = {each.name: each.gain for each in before.thrusters}
    own = {GAIN_PREFIX + each.name: math.log(each.gain / there.get(each.name, each.gain)) for each in model.thrusters}
    return np.array([own.get(name, 0.0) for name in names])


def _of_a_run(name: str) -> bool:
    """Whether an unknown belongs to a run, not to its vehicle."""
    return name in _OF_A_RUN or (name in COEFFICIENTS and index(name)[0] == "constant")


def is_inertia(free: FreeParameters) -> NDArray[np.bool_]:
    """Return which (n,) are logarithms of total inertias."""
    kind = free.codes[:, 0]
    return np.asarray((kind < N_KINDS) & (free.codes[:, 3] != UNTRANSFORMED))
