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
from towtank.identification.data.noise import NoiseLevels
from towtank.identification.data.samples import Samples
from towtank.identification.data.zero_order_hold import ZeroOrderHold, new_zero_order_hold
from towtank.identification.kalman.filter import joint_events
from towtank.identification.kalman.noise_adaptation import (
    adapt_noise,
    converged,
    log_prior_of_levels,
    midpoint,
    rejected_share,
    variance_inflation,
)
from towtank.identification.kalman.state import (
    C_DURATION,
    C_LIKELIHOOD,
    C_ROWS,
    FilterSettings,
    JointState,
    new_joint_state,
)
from towtank.identification.model.linearisation import N_FIXED
from towtank.identification.model.parameters import DELAY, IN_DELAY, IN_LAG, LAG, MASS, UNTRANSFORMED, FreeParameters

__all__ = [
    "JointFit",
    "fit_of",
    "held_of",
    "informed_or_start",
    "joint_passes",
    "limit_step",
    "log_posterior",
    "one_pass",
    "prior_deviation",
    "uses_biases",
    "with_inflated_variance",
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
        effective_samples: of the disturbance of each axis (6,). state: of the filter at the end of the pass.

    The deviations are those at a disturbance above its estimate, see `variance_inflation`: how little is
    known of it is in them.
    """

    free: FreeParameters
    theta: Array
    covariance: Array
    likely: Array
    levels: NoiseLevels
    likelihood: float
    passes: int
    duration: float
    rows: int
    rejected: Array
    nis: Array
    effective_samples: Array
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
        elif transform == UNTRANSFORMED:
            out[k] = scale[k]
        else:
            out[k] = _WIDE
    return out


def informed_or_start(free: FreeParameters, theta: Array, std: Array, start: Array) -> Array:
    """Return theta (n,), but the start (n,) where nothing was told: what is not known must not drift by passes."""
    return np.asarray(np.where((free.codes[:, 3] != UNTRANSFORMED) & (std > _UNTOLD * _WIDE), start, theta))


def held_of(samples: Samples, free: FreeParameters, theta: Array, delay: float) -> ZeroOrderHold:
    """Return the inputs of a recording with the delay and lag of theta."""
    lag = samples.lag
    for k in range(len(free)):
        if free.codes[k, 0] == IN_DELAY:
            delay = max(0.0, float(theta[k]))
        elif free.codes[k, 0] == IN_LAG:
            lag = np.full(samples.lag.size, np.exp(theta[k]))
    return new_zero_order_hold(samples.shape.shape[1], lag, delay)


def one_pass(
    samples: Sequence[Samples],
    p: Array,
    free: FreeParameters,
    theta: Array,
    deviation: Array,
    levels: NoiseLevels,
    settings: FilterSettings,
    *,
    delay: float = 0.0,
    prior: tuple[Array, Array] | None = None,
    progress: Progress | None = None,
) -> tuple[JointState, ZeroOrderHold]:
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
                levels.disturbance,
                levels.velocity_walk,
                settings,
                biases=biases,
                linearised_at=theta,
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
            if progress is not None:
                progress((done + last) / total)
        done += len(each)
    assert state is not None
    return state, held


def joint_passes(
    samples: Sequence[Samples],
    p: Array,
    free: FreeParameters,
    theta: Array,
    levels: NoiseLevels,
    settings: FilterSettings,
    *,
    scale: Array,
    delay: float = 0.0,
    prior: tuple[Array, Array] | None = None,
    most: int = _PASSES,
    shown: Array | None = None,
    begin: bool = True,
    inflate: bool = True,
    progress: Progress | None = None,
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
    linearised_at = np.array(theta, dtype=np.float64)
    worse = 0
    for k in range(most):
        share = (lambda s, k=k: progress((k + s) / most)) if progress is not None else None
        way = replace(settings, follow=begin and k == 0)
        state, _ = one_pass(
            samples, p, free, linearised_at, deviation, levels, way, delay=delay, prior=prior, progress=share
        )
        fit = fit_of(free, state, levels, k + 1)
        sound = bool(np.isfinite(fit.theta).all() and np.isfinite(fit.std).all() and np.isfinite(fit.likelihood))
        if not sound or (
            best is not None and k > begin and log_posterior(fit, settings) < log_posterior(best, settings) - _WORSE
        ):
            worse += 1
            if sound and best is not None and _settled(fit, best.theta, best.std) and converged(levels, best.levels):
                break
            if best is None:
                deviation = 0.3 * deviation
            elif worse > _TRIES:
                break
            else:
                linearised_at = limit_step(free, best.theta, best.theta)
                levels = midpoint(levels, best.levels)
            continue
        following = adapt_noise(state, levels, settings, shown, neighbours=True)
        still = (k > 0 or not begin) and _settled(fit, linearised_at, fit.std)
        best = fit
        if still and converged(following, levels):
            break
        next_point = limit_step(free, fit.theta, linearised_at, linear=k > 0 or not begin)
        linearised_at, levels = informed_or_start(free, next_point, fit.std, np.asarray(theta)), following
    if best is None:
        return replace(fit, theta=linearised_at)
    return with_inflated_variance(samples, p, best, settings, deviation, delay=delay, prior=prior) if inflate else best


def with_inflated_variance(
    samples: Sequence[Samples],
    p: Array,
    fit: JointFit,
    settings: FilterSettings,
    deviation: Array,
    *,
    delay: float = 0.0,
    prior: tuple[Array, Array] | None = None,
) -> JointFit:
    """Return the fit with deviations at a disturbance above its estimate: one pass more. Arguments as `one_pass`."""
    levels = replace(fit.levels, disturbance=fit.levels.disturbance * variance_inflation(fit.effective_samples))
    about = limit_step(fit.free, fit.theta, fit.theta)
    way = replace(settings, follow=False)
    state, _ = one_pass(samples, p, fit.free, about, deviation, levels, way, delay=delay, prior=prior)
    last = fit_of(fit.free, state, fit.levels, fit.passes + 1)
    sound = bool(np.isfinite(last.std).all() and (last.std > 0.0).all())
    return replace(fit, covariance=last.covariance, passes=last.passes) if sound else fit


def _settled(fit: JointFit, theta: Array, std: Array) -> bool:
    """Whether no coefficient has moved from theta (n,), by its deviations (n,)."""
    return bool(np.all(np.abs(fit.theta - theta) <= _SETTLED * std + 1e-6))


def fit_of(free: FreeParameters, state: JointState, levels: NoiseLevels, passes: int) -> JointFit:
    """Return what a filter has found by the end of a pass with these levels."""
    n = len(free)
    block = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n].copy()
    counted = state.stats[:, 4]
    with np.errstate(invalid="ignore", divide="ignore"):
        nis = np.where(counted > 0.0, state.stats[:, 2] / counted, np.nan)
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
        rejected=rejected_share(state),
        nis=nis,
        effective_samples=state.level[:, 3].copy(),
        state=state,
    )


def log_posterior(fit: JointFit, settings: FilterSettings) -> float:
    """Return the logarithm of the likelihood of what was found, that of the levels under their prior included."""
    return fit.likelihood + log_prior_of_levels(fit.levels, settings)


def limit_step(free: FreeParameters, theta: Array, linearised_at: Array, *, linear: bool = False) -> Array:
    """Return the next point to linearise about: logarithms move by 1 at most, a delay is never negative.

    After a `linear` pass the way of a logarithm is bent as in `kalman.filter`: an inertia acts by its inverse.
    """
    out = np.array(theta)
    for k, name in enumerate(free.names):
        if free.codes[k, 3] != UNTRANSFORMED:
            way = float(theta[k] - linearised_at[k])
            inertia = free.codes[k, 0] == MASS
            if linear and (way < 0.0) == inertia:
                way = float(np.copysign(np.log1p(abs(way)), way))
            out[k] = linearised_at[k] + np.clip(way, -1.0, 1.0)
        if name == DELAY:
            out[k] = max(0.0, out[k])
        if name == LAG:
            out[k] = np.clip(out[k], np.log(5e-3), np.log(2.0))
    return out
