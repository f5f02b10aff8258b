"""The joint estimator over whole recordings: passes of the filter until coefficients and noise levels agree.

A pass starts from wide deviations about the last pass's coefficients, so that what is found owes nothing to them but
the point of linearisation. Between passes the levels follow the data, see `kalman.noise_adaptation`. The likelihood of
the innovations keeps the best pass, should one not converge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.noise import Levels
from towtank.identification.data.samples import Samples
from towtank.identification.data.zero_order_hold import HeldInput, new_held_input
from towtank.identification.kalman.filter import joint_events
from towtank.identification.kalman.noise_adaptation import alike, between, caution, followed, level_merit, refused_share
from towtank.identification.kalman.state import C_DURATION, C_LIKELIHOOD, C_ROWS, JointState, Tuning, new_joint_state
from towtank.identification.model.linearisation import N_FIXED
from towtank.identification.model.parameters import DELAY, IN_DELAY, IN_LAG, LAG, MASS, PLAIN, FreeParameters

__all__ = [
    "JointFit",
    "bounded",
    "cautiously",
    "fit_of",
    "held_of",
    "joint_passes",
    "merit",
    "one_pass",
    "prior_deviation",
    "told_of",
    "uses_biases",
]

_CHUNK = 4096  # rows between two reports of progress
_WIDE = 0.5  # deviation of a logarithm at the start of a pass
_UNTOLD = 0.8  # share of it above which nothing was told
_DELAY_WIDE = 0.03  # s
_PASSES = 8
_WORSE = 1.0  # of the logarithm of the likelihood
_TRIES = 2
_SETTLED = 0.1  # deviations
Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class JointFit:
    """What the passes found.

    Attributes:
        free: the coefficients. theta, covariance: of their coordinates, see `parameters`. likely: the covariance at the
            levels as the data show them.
        levels: as the data show them. likelihood: of the last pass's innovations. passes: how many were run.
        duration, rows: learned from. refused: share of each column's samples that lay beyond the gate (15,).
        whiteness: mean of innovation^2 / S per column (15,), 1 where noise and model are right.
        looks: independent looks at the disturbance of each axis (6,). state: of the filter at the end of the pass.

    The deviations are those at a disturbance above its estimate, see `caution`: how little is known of it is in them.
    """

    free: FreeParameters
    theta: Array
    covariance: Array
    likely: Array
    levels: Levels
    likelihood: float
    passes: int
    duration: float
    rows: int
    refused: Array
    whiteness: Array
    looks: Array
    state: JointState

    @property
    def std(self) -> Array:
        """Deviations of theta (n,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def uses_biases(samples: Sequence[Samples]) -> bool:
    """Whether there is an inertial sensor whose biases can be told: rates beside an attitude, or specific force."""
    measured = np.any([each.measured for each in samples], axis=0)
    return bool(measured[9:12].any() or measured[12:15].any())


def prior_deviation(free: FreeParameters, scale: Array) -> Array:
    """Return the deviations (n,) that a pass starts from; `scale` (n,) is the size of what is no logarithm."""
    out = np.empty(len(free))
    for k in range(len(free)):
        kind, transform = free.codes[k, 0], free.codes[k, 3]
        if kind == IN_DELAY:
            out[k] = _DELAY_WIDE
        elif transform == PLAIN:
            out[k] = scale[k]
        else:
            out[k] = _WIDE
    return out


def told_of(free: FreeParameters, theta: Array, std: Array, start: Array) -> Array:
    """Return theta (n,), but the start (n,) where nothing was told: what is not known must not drift by passes."""
    return np.asarray(np.where((free.codes[:, 3] != PLAIN) & (std > _UNTOLD * _WIDE), start, theta))


def held_of(samples: Samples, free: FreeParameters, theta: Array, delay: float) -> HeldInput:
    """Return the inputs of a recording with the delay and lag of theta."""
    lag = samples.lag
    for k in range(len(free)):
        if free.codes[k, 0] == IN_DELAY:
            delay = max(0.0, float(theta[k]))
        elif free.codes[k, 0] == IN_LAG:
            lag = np.full(samples.lag.size, np.exp(theta[k]))
    return new_held_input(samples.shape.shape[1], lag, delay)


def one_pass(
    samples: Sequence[Samples],
    p: Array,
    free: FreeParameters,
    theta: Array,
    deviation: Array,
    levels: Levels,
    tuning: Tuning,
    *,
    delay: float = 0.0,
    prior: tuple[Array, Array] | None = None,
    told: Progress | None = None,
) -> tuple[JointState, HeldInput]:
    """Run the filter once over all recordings; return its state and the inputs' at the end.

    Args:
        p: kernel parameters (154,) for all that is held. theta: what to linearise about (n,).
        deviation: how wide the pass starts about theta (n,).
        delay: of the inputs [s] where it is not free.
        prior: mean (n,) and information (n, n) known beforehand.
    """
    start, covariance = theta, np.diag(deviation**2)
    if prior is not None:
        mean, information = prior
        precision = np.diag(deviation**-2.0)
        covariance = np.asarray(np.linalg.inv(precision + information), dtype=np.float64)
        start = covariance @ (precision @ theta + information @ mean)
    state: JointState | None = None
    total = max(sum(len(each) for each in samples), 1)
    done = 0
    biases = uses_biases(samples)
    for each in samples:
        if state is None:
            state = new_joint_state(
                p,
                free,
                start,
                covariance,
                each.shape,
                levels.noise,
                levels.sigma,
                levels.rough,
                tuning,
                biases=biases,
                anchor=theta,
            )
        else:
            state = state._replace(shape=each.shape, pushed=np.zeros((3, each.shape.shape[1])))
            state.clock[1] = 0.0
        held = held_of(each, free, theta, delay)
        pushed = 0
        for first in range(0, len(each), _CHUNK):
            last = min(first + _CHUNK, len(each))
            pushed = joint_events(
                state, held, each.t, each.values, each.input_t, each.input_force, True, first, last, pushed
            )
            if told is not None:
                told((done + last) / total)
        done += len(each)
    assert state is not None
    return state, held


def joint_passes(
    samples: Sequence[Samples],
    p: Array,
    free: FreeParameters,
    theta: Array,
    levels: Levels,
    tuning: Tuning,
    *,
    scale: Array,
    delay: float = 0.0,
    prior: tuple[Array, Array] | None = None,
    most: int = _PASSES,
    shown: Array | None = None,
    begin: bool = True,
    cautious: bool = True,
    told: Progress | None = None,
) -> JointFit:
    """Run passes from theta (n,) until nothing moves any more.

    Args:
        scale: size (n,) of coordinates that are no logarithms.
        most: passes at most.
        shown: noise (15,) that the samples show, by default that of `levels`. Others as `one_pass`.
        begin: theta may be far off, so that the first pass follows what it finds; else it comes from an earlier fit.
        cautious: end with a pass for deviations at a level above its estimate.
    """
    shown = levels.noise if shown is None else shown
    deviation = prior_deviation(free, scale)
    best: JointFit | None = None
    anchor = np.array(theta, dtype=np.float64)
    worse = 0
    for k in range(most):
        share = (lambda s, k=k: told((k + s) / most)) if told is not None else None
        way = replace(tuning, follow=begin and k == 0)
        state, _ = one_pass(samples, p, free, anchor, deviation, levels, way, delay=delay, prior=prior, told=share)
        fit = fit_of(free, state, levels, k + 1)
        sound = bool(np.isfinite(fit.theta).all() and np.isfinite(fit.std).all() and np.isfinite(fit.likelihood))
        if not sound or (best is not None and k > begin and merit(fit, tuning) < merit(best, tuning) - _WORSE):
            worse += 1
            if sound and best is not None and _settled(fit, best.theta, best.std) and alike(levels, best.levels):
                break
            if best is None:
                deviation = 0.3 * deviation
            elif worse > _TRIES:
                break
            else:
                anchor = bounded(free, best.theta, best.theta)
                levels = between(levels, best.levels)
            continue
        following = followed(state, levels, tuning, shown, neighbours=True)
        still = (k > 0 or not begin) and _settled(fit, anchor, fit.std)
        best = fit
        if still and alike(following, levels):
            break
        following_anchor = bounded(free, fit.theta, anchor, linear=k > 0 or not begin)
        anchor, levels = told_of(free, following_anchor, fit.std, np.asarray(theta)), following
    if best is None:
        return replace(fit, theta=anchor)
    return cautiously(samples, p, best, tuning, deviation, delay=delay, prior=prior) if cautious else best


def cautiously(
    samples: Sequence[Samples],
    p: Array,
    fit: JointFit,
    tuning: Tuning,
    deviation: Array,
    *,
    delay: float = 0.0,
    prior: tuple[Array, Array] | None = None,
) -> JointFit:
    """Return the fit with deviations at a disturbance above its estimate: one pass more. Arguments as `one_pass`."""
    levels = replace(fit.levels, sigma=fit.levels.sigma * caution(fit.looks))
    about = bounded(fit.free, fit.theta, fit.theta)
    way = replace(tuning, follow=False)
    state, _ = one_pass(samples, p, fit.free, about, deviation, levels, way, delay=delay, prior=prior)
    last = fit_of(fit.free, state, fit.levels, fit.passes + 1)
    sound = bool(np.isfinite(last.std).all() and (last.std > 0.0).all())
    return replace(fit, covariance=last.covariance, passes=last.passes) if sound else fit


def _settled(fit: JointFit, theta: Array, std: Array) -> bool:
    """Whether no coefficient has moved from theta (n,), by its deviations (n,)."""
    return bool(np.all(np.abs(fit.theta - theta) <= _SETTLED * std + 1e-6))


def fit_of(free: FreeParameters, state: JointState, levels: Levels, passes: int) -> JointFit:
    """Return what a filter has found by the end of a pass with these levels."""
    n = len(free)
    block = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n].copy()
    counted = state.stats[:, 4]
    with np.errstate(invalid="ignore", divide="ignore"):
        whiteness = np.where(counted > 0.0, state.stats[:, 2] / counted, np.nan)
    return JointFit(
        free=free,
        theta=state.theta.copy(),
        covariance=block,
        likely=block,
        levels=levels,
        likelihood=float(state.clock[C_LIKELIHOOD]),
        passes=passes,
        duration=float(state.clock[C_DURATION]),
        rows=int(state.clock[C_ROWS]),
        refused=refused_share(state),
        whiteness=whiteness,
        looks=state.level[:, 3].copy(),
        state=state,
    )


def merit(fit: JointFit, tuning: Tuning) -> float:
    """Return the logarithm of the likelihood of what was found, that of the levels under their prior included."""
    return fit.likelihood + level_merit(fit.levels, tuning)


def bounded(free: FreeParameters, theta: Array, anchor: Array, *, linear: bool = False) -> Array:
    """Return the next point to linearise about: logarithms move by 1 at most, a delay is never negative.

    After a `linear` pass the way of a logarithm is bent as in `kalman.filter`: an inertia acts by its inverse.
    """
    out = np.array(theta)
    for k, name in enumerate(free.names):
        if free.codes[k, 3] != PLAIN:
            way = float(theta[k] - anchor[k])
            inertia = free.codes[k, 0] == MASS
            if linear and (way < 0.0) == inertia:
                way = float(np.copysign(np.log1p(abs(way)), way))
            out[k] = anchor[k] + np.clip(way, -1.0, 1.0)
        if name == DELAY:
            out[k] = max(0.0, out[k])
        if name == LAG:
            out[k] = np.clip(out[k], np.log(5e-3), np.log(2.0))
    return out
