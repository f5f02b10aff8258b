"""What may have changed about a vehicle, by how much at a time, and what increments of information say of it.

A payload or a fouled hull: inertia, drag, weight in water, righting moment, trim (a centre of gravity that moves along
or across, BG_x and BG_y together), in any combination. A thruster that is fouled, worn or dead: its gain, one thruster
at a time. A configuration met before: whether the vehicle has become it. What was hardly known before can not be seen
to change: only what is identified may step.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from towtank.core.arrays import Array
from towtank.core.layout import MOMENT
from towtank.identification.changes.branch import Branch, Kept, Running
from towtank.identification.changes.evidence import InformationIncrement, of_changes
from towtank.identification.model.parameters import DELAY, GAIN_PREFIX, IN_GAIN, LAG, UNTRANSFORMED, FreeParameters
from towtank.identification.model.prior import Prior
from towtank.identification.model.terms import TERMS, Body
from towtank.vehicle import COEFFICIENTS, Vehicle

__all__: list[str] = []

BODY_PARTS = ("inertia", "drag", "weight", "righting", "trim")  # what a payload changes
_KNOWN = 0.5  # deviation up to which a baseline counts, as a share of the prior's; of a gain, as a share of its step
_GAIN_STEP = 0.4  # of the logarithm of a thruster's gain; the steps of coefficients stand in `model.terms`
_TOUCHED = 0.05  # probability of a part from which on it is thought to have changed too,
_ALONG = 0.2  # and the share of its step that any other part of the body may have made: a payload touches all
_REPEATS = 0.01  # share by which a vehicle differs from itself, taken up again
_NO_STD = 0.05  # share by which a coefficient is known that bears no deviation
_NEW = 0.5  # probability, to begin with, that a changed vehicle has not been met before


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What may have changed about a vehicle.

    Attributes:
        parts: of `BODY_PARTS`, or the name of one free gain, as gain_port.
        steps: deviations (n,) of the step of every coordinate, 0 for those that it leaves alone.
        weight: logarithm of its prior probability among all.
    """

    parts: tuple[str, ...]
    steps: Array
    weight: float

    @property
    def thruster(self) -> str | None:
        """Name of the thruster that has changed; None for a change of the body."""
        return self.parts[0].removeprefix(GAIN_PREFIX) if self.parts[0].startswith(GAIN_PREFIX) else None


def steps_of(vehicle: Vehicle, running: Running, wide: Prior) -> Array:
    """Return the deviations (n,) of a change of each coordinate of `wide`; 0 for what may not change.

    That is delay, lag and latencies, and whatever is not identified by now. A damping steps by a share of itself.
    """
    free, size = wide.free, _size_of(vehicle, wide.free)
    std, theta = dict(zip(running.free.names, running.std, strict=True)), dict(_named(running))
    out = np.zeros(len(free))
    for k, name in enumerate(free.names):
        kind, i, j, transform = (int(code) for code in free.codes[k])
        if kind == IN_GAIN:
            out[k] = _GAIN_STEP if std.get(name, 0.0) <= _KNOWN * _GAIN_STEP else 0.0
        elif kind in TERMS and std.get(name, np.inf) <= _KNOWN * wide.reference[k]:
            term = TERMS[kind]
            own = abs(theta[name]) if i == j else 0.0
            out[k] = term.log_step if transform != UNTRANSFORMED else max(term.size_step * size[k], term.log_step * own)
    return out


def _named(running: Running) -> list[tuple[str, float]]:
    return [(name, float(value)) for name, value in zip(running.free.names, running.state.theta, strict=True)]


def _part(code: Array) -> str:
    """Return the part of the body that a coordinate belongs to, "" for none."""
    kind, i = int(code[0]), int(code[1])
    if kind not in TERMS:
        return ""
    return "trim" if kind == MOMENT and i < 2 else TERMS[kind].part


def hypotheses(free: FreeParameters, steps: Array) -> tuple[Hypothesis, ...]:
    """Return every hypothesis: each combination of the parts of the body that are free, and each gain that is."""
    part = [_part(code) if step > 0.0 else "" for code, step in zip(free.codes, steps, strict=True)]
    there = [name for name in BODY_PARTS if name in part]
    body = [chosen for count in range(1, len(there) + 1) for chosen in itertools.combinations(there, count)]
    gains = [k for k in range(len(free)) if free.codes[k, 0] == IN_GAIN and steps[k] > 0.0]
    families = bool(body) + bool(gains)
    out = []
    for chosen in body:
        taken = np.array([name in chosen for name in part])
        out.append(Hypothesis(chosen, np.where(taken, steps, 0.0), -float(np.log(families * len(body)))))
    for k in gains:
        alone = np.zeros(len(free))
        alone[k] = steps[k]
        out.append(Hypothesis((free.names[k],), alone, -float(np.log(families * len(gains)))))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class Verdict:
    """What increments of several beginnings say.

    Attributes:
        evidence: log Bayes factor of any change against none, of the increment that has the largest.
        best: index of the one that what is blamed fits best: it began where the change did.
        parts: of the body, with the probability that each changed, given that the body did.
        thruster: the one that is blamed, None where it is the body.
        clear: log odds of what is blamed, the body or that one gain, against all else.
        steps: deviations (n,) of what changed by the likelier family.
        changed: log evidence of any change in that increment, on the scale of `InformationIncrement.evidence`.
    """

    evidence: float
    best: int
    parts: dict[str, float]
    thruster: str | None
    clear: float
    steps: Array
    changed: float


def judged(increments: Sequence[InformationIncrement], hypotheses: Sequence[Hypothesis], factor: float) -> Verdict:
    """Weigh every hypothesis of a change at the beginning of every increment by its evidence, `tempered` by a factor.

    What came before one began is the same under all hypotheses, so that increments compare as they are.
    """
    scores = of_changes(increments, [each.steps for each in hypotheses], factor) + [each.weight for each in hypotheses]
    total = np.asarray(logsumexp(scores, axis=1))
    thrusters = np.array([each.thruster is not None for each in hypotheses])
    body = float(logsumexp(scores[:, ~thrusters])) if not thrusters.all() else -np.inf
    gain = {int(k): float(logsumexp(scores[:, k])) for k in np.flatnonzero(thrusters)}
    best = max(gain, key=lambda k: gain[k]) if gain else None
    if best is not None and gain[best] <= body:
        best = None
    blamed = ~thrusters if best is None else np.arange(len(hypotheses)) == best
    blame = float(logsumexp(scores[:, blamed]))
    clear = blame - (float(logsumexp(scores[:, ~blamed])) if not blamed.all() else -np.inf)
    begun = int(np.argmax(logsumexp(scores[:, blamed], axis=1)))
    parts = _parts(hypotheses, scores[begun], ~thrusters)
    before = increments[begun].tempered(factor)
    return Verdict(
        evidence=float(total.max()),
        best=begun,
        parts=parts,
        thruster=None if best is None else hypotheses[best].thruster,
        clear=clear,
        steps=hypotheses[best].steps if best is not None else _union(hypotheses, parts, increments[begun].score.size),
        changed=float(total[begun]) + before.evidence(before.P0),
    )


def _parts(hypotheses: Sequence[Hypothesis], scores: Array, body: Array) -> dict[str, float]:
    """Return the probability of each part of the body, given that the body changed."""
    out: dict[str, float] = {}
    if body.any():
        among = float(logsumexp(scores[body]))
        for k in (int(each) for each in np.flatnonzero(body)):
            for part in hypotheses[k].parts:
                out[part] = out.get(part, 0.0) + float(np.exp(scores[k] - among))
    return out


def _union(hypotheses: Sequence[Hypothesis], parts: dict[str, float], size: int) -> Array:
    """Return the deviations of every part that may well have changed, and a share of those of all others."""
    steps = np.zeros(size)
    for each in hypotheses:
        if each.thruster is None:
            touched = all(parts[part] > _TOUCHED for part in each.parts)
            steps = np.maximum(steps, each.steps if touched else _ALONG * each.steps)
    return steps


@dataclass(frozen=True, eq=False)
class Known:
    """A configuration in the coordinates of a filter: its name, theta (n,), covariance (n, n)."""

    name: str
    theta: Array
    covariance: Array


def known_as(name: str, model: Vehicle, vehicle: Vehicle, free: FreeParameters, theta0: Array, P0: Array) -> Known:
    """Return a stored model as a configuration. What is not in it is as before: theta0 (n,), P0 (n, n)."""
    n = len(free)
    theta = free.theta(model, delay=model.command_delay, lag=0.05)
    slopes, size = np.abs(free.slopes(theta)), _size_of(vehicle, free)
    gains = {each.name: each.gain for each in model.thrusters}
    before = {each.name: each.gain for each in vehicle.thrusters}
    std = np.zeros(n)
    given = np.zeros(n, dtype=bool)
    for k, coefficient in enumerate(free.names):
        if free.codes[k, 0] == IN_GAIN:
            thruster = coefficient.removeprefix(GAIN_PREFIX)
            theta[k] = np.log(max(gains.get(thruster, before[thruster]) / before[thruster], 1e-3))
            std[k], given[k] = _REPEATS, True
            continue
        if coefficient in (DELAY, LAG) or coefficient not in COEFFICIENTS or not np.isfinite(theta[k]):
            continue
        value = abs(model.coefficient(coefficient))
        deviation = model.deviation(coefficient)
        untransformed = free.codes[k, 3] == UNTRANSFORMED
        if value == 0.0 and deviation is None and not untransformed:
            continue  # it has none in the file
        scale = max(value, 0.1 * size[k]) if untransformed else slopes[k]
        std[k] = np.hypot(deviation if deviation is not None else _NO_STD * scale, _REPEATS * scale) / slopes[k]
        given[k] = True
    covariance = np.where(np.outer(given, given), np.diag(std**2), 0.0)
    covariance = np.where(np.outer(~given, ~given), P0, covariance)
    return Known(name, np.where(given, theta, theta0), covariance)


def likeness(increment: InformationIncrement, known: Sequence[Known], otherwise: float) -> Array:
    """Return the probability of each configuration and, last, of none of them (k + 1,).

    Args:
        otherwise: log evidence of a vehicle that has not been met before, on the same scale as those.
    """
    each = -np.log(max(len(known), 1)) + np.log1p(-_NEW)
    scores = [each + increment.evidence(one.covariance, one.theta - increment.theta0) for one in known]
    scores.append(float(np.log(_NEW)) + otherwise)
    return np.asarray(np.exp(np.array(scores) - np.logaddexp.reduce(scores)))


@dataclass(eq=False)
class ConfigurationMatch:
    """A branch that goes on beside the filter after a change, to compare it with known configurations.

    Attributes:
        hypotheses, steps: of the change. kept: the prior of what followed it. until: when it ends [s].
        taken: name of the configuration that is the prior by now. known: the configurations.
    """

    branch: Branch
    hypotheses: tuple[Hypothesis, ...]
    kept: Kept
    steps: Array
    until: float
    taken: str | None = None
    known: list[Known] = field(default_factory=list)


def _size_of(vehicle: Vehicle, free: FreeParameters) -> Array:
    """Return the size (n,) of the coefficients that are no logarithms; 1 for all others."""
    body = Body(vehicle)
    out = np.ones(len(free))
    for k in range(len(free)):
        kind, i, j, transform = (int(c) for c in free.codes[k])
        if transform == UNTRANSFORMED and kind in TERMS:
            out[k] = TERMS[kind].size(body, i, j)
    return out
