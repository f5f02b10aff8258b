"""Other pictures of the same data, and how far they contradict the one that speaks.

The filter's disturbance stands for a slow random force of the water, and forces follow commands through one delay and
one lag. What a model lacks may be otherwise. Then inertias and lags stand for it, wrong by more than they state, and
differently in each recording. Windows of the data need not contradict each other: what all of them share shows in none.
So the question is asked once more in other ways, each where the data may speak for it:

quick   a disturbance that changes within a fifth of a second, where windows contradict each other, or one pass speaks
        for it: motors that reverse in two steps, drag of another shape, a frame that gives, water that forgets sooner.
late    a share of each axis' force that acts later than the rest, or too soon where it is negative; asked by one pass,
        and by as many as it takes where that one speaks for it.
forbidden
        what data and prior come to, where physics allows only another answer.

One picture is chosen where it is likelier, since it is as good physics (`as_looked_at`): a logger that looks at outputs
ten times in a second tells what they were then, not what they did meanwhile. Whoever takes them for held until the next
look has forces come half a period late, so that delay and lag end at nothing, and inertias make up for the rest.

A rival that is likelier is no better for that: likelihood looks at the next sample, and what predicts that best is not
what runs on freely best. But the same data have come to two answers with the same prior, which must agree within what
both state. Where they do not, whoever speaks states too little.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import NoiseLevels, Samples
from towtank.identification.kalman.passes import FAR_LIKELIER, joint_fit, one_pass
from towtank.identification.kalman.problem import JointFit, JointProblem
from towtank.identification.model.parameters import DELAY, IN_GAIN, FreeParameters
from towtank.identification.model.prior import Prior
from towtank.identification.model.terms import AXES, LOG
from towtank.recording.grids.grid import held_at
from towtank.recording.grids.stretches import spread

__all__ = [
    "CONTRADICTED",
    "Rival",
    "apart_from",
    "as_looked_at",
    "forbidden_rival",
    "late_rival",
    "likeliest_rival",
    "quick_rival",
]

CONTRADICTED = 1.3  # factor by which windows differ more than they state, from which the filter is doubted
_QUICK = 0.2  # s: time constant of a quick disturbance
_LATER, _SHARE = (0.1, 0.25), 0.3  # s by which a share of the force is late; deviation of the share, before any data
_UNIT = 1e-3  # N or N m of a late force's unit, so small that what is lost to inflow does not count
_EITHER = 0.5  # weight of a rival beside the picture that speaks
_SAID = 0.5  # common deviations of the coefficient farthest away, below which a rival is not worth a word
_LOST = 1000.0  # of it, that one pass loses only where it has lost the motion


class Rival(NamedTuple):
    """The likelier posterior of another picture, of the same unknowns (n,), and that picture in words."""

    fit: JointFit
    theta: Array
    std: Array
    picture: str


def as_looked_at(problem: JointProblem, fit: JointFit) -> tuple[JointProblem, JointFit] | None:
    """Return problem and posterior of inputs that were looked at, where that is likelier by far than held ones are.

    Held inputs come half a period later, for which the delay made up as far as it could. A delay that somebody gave
    counts from stamps at which inputs were given.
    """
    other = problem.between_looks()
    if other is problem or DELAY not in problem.free.names:
        return None
    few, known = _few(problem, fit)
    looked, later = few.between_looks(), fit.theta.copy()
    later[problem.free.names.index(DELAY)] += 0.5 * float(np.median([each.input_period for each in few.samples]))
    gained, begun = max((_by_one_pass(looked, x, fit.levels) - known, k) for k, x in enumerate((fit.theta, later)))
    if not gained > FAR_LIKELIER:
        return None
    found = joint_fit(other, since=((fit.theta, later)[begun], fit.levels))
    found = replace(found, passes=fit.passes + found.passes)
    return (other, found) if found.likelihood > fit.likelihood + FAR_LIKELIER else None


def likeliest_rival(problem: JointProblem, fit: JointFit) -> Rival | None:
    """Return the likeliest of all rivals; None where none is likelier than what was found.

    That is so likely as a pass about it is: where passes did not settle, one on the way may have been likelier by far.
    """
    few, known = _few(problem, fit)
    asked = (quick_rival(few, fit, known), late_rival(few, fit, known), forbidden_rival(fit, known))
    return max(filter(None, asked), key=lambda each: each.fit.likelihood, default=None)


def forbidden_rival(fit: JointFit, known: float) -> Rival | None:
    """Return what data and prior come to, where that is likelier by far than what physics allows of it."""
    if not fit.forbidden > FAR_LIKELIER:
        return None
    found = replace(fit, likelihood=known + fit.forbidden)
    return Rival(found, fit.mean, fit.std, "the data are likelier with what physics forbids")


def quick_rival(few: JointProblem, fit: JointFit, known: float) -> Rival | None:
    """Return the rival with a quick disturbance, where it is likelier; else None."""
    quick, slow = replace(few, settings=replace(few.settings, time_constant=_QUICK)), few.settings.time_constant
    if fit.disagreement < CONTRADICTED and not _by_one_pass(quick, fit.theta, fit.levels) > known + FAR_LIKELIER:
        return None
    found = joint_fit(quick, since=(fit.theta, replace(quick.rough, waves=fit.levels.waves)))
    picture = f"a disturbance that changes within {_QUICK:g} s is likelier than one within {slow:g} s"
    return Rival(found, found.theta, found.std, picture) if found.likelihood > known else None


def late_rival(few: JointProblem, fit: JointFit, known: float) -> Rival | None:
    """Return the rival with late shares of the forces, where it is likelier; else None."""
    pushed = np.any([np.any(each.input_force @ each.B.T != 0.0, axis=0) for each in few.samples], axis=0)
    axes = np.flatnonzero(pushed & few.moving).tolist()
    if not axes:
        return None
    n, more = len(fit.free), len(_LATER) * len(axes)
    samples = [_with_late_forces(each, axes) for each in few.samples]
    late = replace(few, samples=samples, prior=_LatePrior.of(few.prior, few.samples[0].B.shape[1], axes))
    about = np.concatenate([fit.theta, np.zeros(more)])
    if -_LOST < _by_one_pass(late, about, fit.levels) - known < FAR_LIKELIER:
        return None
    found = joint_fit(late, since=(about, fit.levels))
    if not found.likelihood > known + FAR_LIKELIER:
        return None
    shares = np.expm1(found.theta[n:]).reshape(len(_LATER), len(axes))
    sure = np.abs(shares) / found.std[n:].reshape(shares.shape)
    k, i = np.unravel_index(int(sure.argmax()), shares.shape)
    share, axis = float(shares[k, i]), AXES[axes[i]].name
    size, when = f"{100.0 * abs(share):.0f} %", f"{_LATER[k]:g} s"
    what = f"{size} of it {when} late" if share > 0.0 else f"{size} more for the first {when}"
    return Rival(found, found.theta[:n], found.std[:n], f"what pushes in {axis} is likelier to act with {what}")


def apart_from(problem: JointProblem, fit: JointFit, rival: Rival) -> tuple[Array, list[str]]:
    """Return d (n,), by which a posterior is less sure because of how far a rival lies off, and what to say of it.

    Either picture may be nearer to the truth: beside the covariance C of one stands that between both, d d^T, d being
    the way between them over the root of 2 (the law of total covariance with equal weights, about the one that speaks).
    What both agree about stays as sure as it was, and no coefficient is moved apart by more than the prior's deviation.
    """
    away = np.where(problem.learned, fit.theta - rival.theta, 0.0)
    apart = np.abs(away) / np.sqrt(np.diag(fit.covariance) + rival.std**2)
    most = int(apart.argmax())
    name = fit.prior.names[most]
    text = (
        f"{rival.picture}, so the model lacks something: {name} would come out {apart[most]:.1f} common deviations "
        "away, others less, and deviations are widened by such differences"
    )
    return np.clip(away, -fit.prior.std, fit.prior.std) * math.sqrt(_EITHER), [text] if apart[most] > _SAID else []


def _few(problem: JointProblem, fit: JointFit) -> tuple[JointProblem, float]:
    """Return the question of as few rows as do, in the waves that were found, and the log likelihood of the answer."""
    settings = replace(problem.settings, wave_period=fit.wave_period)
    few = replace(problem, samples=spread(problem.samples), settings=settings)
    whole = sum(map(len, few.samples)) == sum(map(len, problem.samples))
    return few, fit.likelihood if whole and fit.still else _by_one_pass(few, fit.theta, fit.levels)


def _by_one_pass(problem: JointProblem, about: Array, levels: NoiseLevels) -> float:
    return float(one_pass(problem, about, levels, windows=1)[0].clock[0].log_likelihood)


def _with_late_forces(samples: Samples, axes: Sequence[int]) -> Samples:
    """Return samples whose inputs have, after the thrusters' own (m,), what late ones differ by from these along each
    of some axes: for each time that they are late first with a gain, then against it, so that a gain of 1 is nothing.
    """
    stamps = np.unique(np.concatenate([samples.input_t, *(samples.input_t + late for late in _LATER)]))
    now = held_at(samples.input_t, samples.input_force, stamps)
    unit = _UNIT * np.eye(6)[:, axes]
    forces, B = [now], [samples.B]
    for late in _LATER:
        before = np.maximum(stamps - late, samples.input_t[0])
        differs = ((held_at(samples.input_t, samples.input_force, before) - now) @ samples.B.T)[:, axes]
        forces += [differs / _UNIT, -differs / _UNIT]
        B += [unit, unit]
    lag = np.full(2 * len(_LATER) * len(axes), samples.lag.mean())
    return replace(
        samples,
        input_t=stamps,
        input_force=np.ascontiguousarray(np.column_stack(forces)),
        B=np.ascontiguousarray(np.column_stack(B)),
        lag=np.concatenate([samples.lag, lag]),
    )


@dataclass(frozen=True, eq=False)
class _LatePrior(Prior):
    """A prior with the late shares of forces behind its own unknowns, which say nothing of the scale of force."""

    own: Prior

    @classmethod
    def of(cls, own: Prior, inputs: int, axes: Sequence[int]) -> _LatePrior:
        """Return it for late forces along some axes, that stand behind so many inputs."""
        n, kinds, places = len(own.free), range(len(_LATER)), range(len(axes))
        names = [f"late_{AXES[axes[i]].name}_{_LATER[k]:g}" for k in kinds for i in places]
        columns = [inputs + 2 * len(axes) * k + i for k in kinds for i in places]
        codes = np.array([(IN_GAIN, column, 0, LOG) for column in columns], dtype=np.int64)
        rigid = np.concatenate([own.free.rigid, np.zeros(len(names))])
        free = FreeParameters((*own.names, *names), np.vstack([own.free.codes, codes]), rigid)
        covariance = np.zeros((len(free), len(free)))
        covariance[:n, :n] = own.covariance
        covariance[range(n, len(free)), range(n, len(free))] = _SHARE**2
        return cls(
            free,
            np.concatenate([own.mean, np.zeros(len(names))]),
            covariance,
            (*own.sources, *("late forces" for _ in names)),
            np.concatenate([own.reference, np.full(len(names), _SHARE)]),
            own,
        )

    def seen_from(self, theta: Array) -> tuple[Array, Array]:
        """Return mean (n,) and covariance (n, n) as they are close to theta (n,)."""
        n, covariance = len(self.own.mean), self.covariance.copy()
        mean, covariance[:n, :n] = self.own.seen_from(theta[:n])
        return np.concatenate([mean, self.mean[n:]]), covariance
