"""The joint estimator over whole recordings: passes of the filter until coefficients and noise levels agree.

A pass starts from wide deviations about the last pass's coefficients, so that its result owes nothing to them but
the linearisation point. Between passes the levels adapt to the data, see `kalman.noise_adaptation`. The likelihood of
the innovations keeps the best pass, should one not converge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import ZeroOrderHold, new_zero_order_hold
from towtank.identification.data.samples import NoiseLevels, Samples
from towtank.identification.kalman.filter import joint_events, rows_of
from towtank.identification.kalman.noise_adaptation import (
    adapt_noise,
    converged,
    log_prior_of_levels,
    midpoint,
    rejected_share,
    variance_inflation,
)
from towtank.identification.kalman.state import FilterSettings, JointState, coefficient_block, new_joint_state
from towtank.identification.model.parameters import DELAY, IN_DELAY, IN_LAG, LAG, MASS, UNTRANSFORMED, FreeParameters

__all__ = [
    "FilterProblem",
    "JointFit",
    "Prior",
    "fit_of",
    "informed_or_start",
    "inputs_of",
    "joint_passes",
    "limit_step",
    "next_recording",
    "one_pass",
    "prior_deviation",
    "uses_biases",
    "with_inflated_variance",
]

_CHUNK = 4096  # rows between two reports of progress
_PASS_STD = 0.5  # deviation of a logarithm (share of the coefficient) at the start of a pass
_UNINFORMED = 0.8  # share of it above which nothing was learned
_PASS_DELAY_STD = 0.03  # s
_PASSES = 8
_WORSE = 1.0  # of the log posterior
_TRIES = 2  # passes that may be worse
_STILL = 0.1  # deviations that a coefficient may still move
_NARROWER = 0.3  # factor to the deviations of a pass that failed from the start
_LAGS = (5e-3, 2.0)  # s: least and largest time constant of the thrusters
Progress = Callable[[float], None]
Prior = Callable[[FreeParameters], tuple[Array, Array] | None]


@dataclass(frozen=True, eq=False)
class FilterProblem:
    """What passes of the filter are about.

    Attributes:
        samples: of each recording. p: kernel parameters (170,) for all that is fixed. free: the coefficients.
        deviation: how wide a pass starts about its linearisation point (n,), see `prior_deviation`.
        prior: mean (n,) and information (n, n) known beforehand. delay: of the inputs [s] where it is not free.
        own_noise: noise (18,) that the samples show by themselves, by default that of the levels to begin with.
    """

    samples: Sequence[Samples]
    p: Array
    free: FreeParameters
    deviation: Array
    prior: tuple[Array, Array] | None = None
    delay: float = 0.0
    own_noise: Array | None = None


@dataclass(frozen=True, eq=False)
class JointFit:
    """The result of the passes.

    Attributes:
        free: the coefficients. theta, covariance: of their coordinates, see `parameters`; the covariance is that at a
            disturbance above its estimate, see `variance_inflation`: how little is known of it is in there.
            uninflated: the covariance at the levels as the data show them.
        levels: as the data show them. likelihood: log, of the last pass's innovations. passes: how many were run.
        duration [s], rows: learned from. rejected: share of each column's samples that lay beyond the gate (18,).
        nis: mean of innovation^2 / S per column (18,), 1 where noise and model are right.
        effective_samples: of the disturbance of each axis (6,). state: of the filter at the end of the pass.
    """

    free: FreeParameters
    theta: Array
    covariance: Array
    uninflated: Array
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
    """Return whether there is an inertial sensor whose biases show: rates beside an attitude, or specific force."""
    measured = np.any([each.measured for each in samples], axis=0)
    return bool(measured[9:12].any() or measured[12:15].any())


def prior_deviation(free: FreeParameters, scale: Array) -> Array:
    """Return the deviations (n,) that a pass starts from; `scale` (n,) is the size of what is no logarithm."""
    out = np.empty(len(free))
    for k in range(len(free)):
        kind, transform = free.codes[k, 0], free.codes[k, 3]
        if kind == IN_DELAY:
            out[k] = _PASS_DELAY_STD
        elif transform == UNTRANSFORMED:
            out[k] = scale[k]
        else:
            out[k] = _PASS_STD
    return out


def informed_or_start(free: FreeParameters, theta: Array, std: Array, start: Array) -> Array:
    """Return theta (n,), but the start (n,) where nothing was learned: what is not known must not drift by passes."""
    return np.asarray(np.where((free.codes[:, 3] != UNTRANSFORMED) & (std > _UNINFORMED * _PASS_STD), start, theta))


def inputs_of(samples: Samples, free: FreeParameters, theta: Array, delay: float) -> ZeroOrderHold:
    """Return the inputs of a recording with the delay and lag of theta."""
    lag = samples.lag
    for k in range(len(free)):
        if free.codes[k, 0] == IN_DELAY:
            delay = max(0.0, float(theta[k]))
        elif free.codes[k, 0] == IN_LAG:
            lag = np.full(samples.lag.size, np.exp(theta[k]))
    return new_zero_order_hold(samples.B.shape[1], lag, delay)


def next_recording(state: JointState, samples: Samples) -> JointState:
    """Return the filter, to go on with another recording: its motion begins anew."""
    state.clock["started"] = 0.0
    return state._replace(B=np.ascontiguousarray(samples.B), mean_force=np.zeros((3, samples.B.shape[1])))


def one_pass(
    problem: FilterProblem,
    linearised_at: Array,
    levels: NoiseLevels,
    settings: FilterSettings,
    progress: Progress | None = None,
) -> tuple[JointState, ZeroOrderHold]:
    """Run the filter once over all recordings, linearised about these coordinates (n,).

    Returns its state and the inputs' at the end.
    """
    samples, free, start, deviation = problem.samples, problem.free, linearised_at, problem.deviation
    covariance = np.diag(deviation**2)
    if problem.prior is not None:
        mean, information = problem.prior
        precision = np.diag(deviation**-2.0)
        covariance = np.asarray(np.linalg.inv(precision + information), dtype=np.float64)
        start = covariance @ (precision @ linearised_at + information @ mean)
    settings = replace(settings, biases=uses_biases(samples))
    state = new_joint_state(problem.p, free, start, covariance, samples[0].B, levels, settings, linearised_at)
    total = max(sum(len(each) for each in samples), 1)
    done = 0
    for each in samples:
        state = next_recording(state, each)
        held = inputs_of(each, free, linearised_at, problem.delay)
        taken = 0
        for first in range(0, len(each), _CHUNK):
            last = min(first + _CHUNK, len(each))
            taken = joint_events(state, held, rows_of(each), first, last, taken)
            if progress is not None:
                progress((done + last) / total)
        done += len(each)
    return state, held


def joint_passes(
    problem: FilterProblem,
    theta: Array,
    levels: NoiseLevels,
    settings: FilterSettings,
    *,
    most: int = _PASSES,
    begin: bool = True,
    inflate: bool = True,
    progress: Progress | None = None,
) -> JointFit:
    """Run passes from theta (n,) until nothing moves any more.

    Args:
        levels: to begin with. most: passes at most.
        begin: theta may be far off, so that the first pass relinearises; else it comes from an earlier fit.
        inflate: end with a pass for deviations at a level above its estimate.
    """
    free, own_noise = problem.free, levels.noise if problem.own_noise is None else problem.own_noise
    best: JointFit | None = None
    linearised_at = np.array(theta, dtype=np.float64)
    worse = 0
    for k in range(most):
        share = (lambda s, k=k: progress((k + s) / most)) if progress is not None else None
        state, _ = one_pass(problem, linearised_at, levels, replace(settings, relinearise=begin and k == 0), share)
        fit = fit_of(free, state, levels, k + 1)
        finite = bool(np.isfinite(fit.theta).all() and np.isfinite(fit.std).all() and np.isfinite(fit.likelihood))
        if not finite or (
            best is not None and k > begin and log_posterior(fit, settings) < log_posterior(best, settings) - _WORSE
        ):
            worse += 1
            if finite and best is not None and _settled(fit, best.theta, best.std) and converged(levels, best.levels):
                break
            if best is None:
                problem = replace(problem, deviation=_NARROWER * problem.deviation)
            elif worse > _TRIES:
                break
            else:
                linearised_at = limit_step(free, best.theta, best.theta)
                levels = midpoint(levels, best.levels)
            continue
        adapted = adapt_noise(state, levels, settings, own_noise, neighbours=True)
        still = (k > 0 or not begin) and _settled(fit, linearised_at, fit.std)
        best = fit
        if still and converged(adapted, levels):
            break
        next_point = limit_step(free, fit.theta, linearised_at, linear=k > 0 or not begin)
        linearised_at, levels = informed_or_start(free, next_point, fit.std, np.asarray(theta)), adapted
    if best is None:
        return replace(fit, theta=linearised_at)
    return with_inflated_variance(problem, best, settings) if inflate else best


def with_inflated_variance(problem: FilterProblem, fit: JointFit, settings: FilterSettings) -> JointFit:
    """Return the fit with deviations at a disturbance above its estimate: one pass more."""
    levels = replace(fit.levels, disturbance=fit.levels.disturbance * variance_inflation(fit.effective_samples))
    about = limit_step(fit.free, fit.theta, fit.theta)
    state, _ = one_pass(problem, about, levels, replace(settings, relinearise=False))
    last = fit_of(fit.free, state, fit.levels, fit.passes + 1)
    positive = bool(np.isfinite(last.std).all() and (last.std > 0.0).all())
    return replace(fit, covariance=last.covariance, passes=last.passes) if positive else fit


def _settled(fit: JointFit, theta: Array, std: Array) -> bool:
    """Return whether no coefficient has moved from theta (n,), by its deviations (n,)."""
    return bool(np.all(np.abs(fit.theta - theta) <= _STILL * std + 1e-6))


def fit_of(free: FreeParameters, state: JointState, levels: NoiseLevels, passes: int) -> JointFit:
    """Return the result of a pass with these levels from the filter at its end."""
    block, clock = coefficient_block(state).copy(), state.clock[0]
    accepted = state.statistics["accepted"]
    with np.errstate(invalid="ignore", divide="ignore"):
        nis = np.where(accepted > 0.0, state.statistics["nis_sum"] / accepted, np.nan)
    return JointFit(
        free=free,
        theta=state.theta.copy(),
        covariance=block,
        uninflated=block,
        levels=levels,
        likelihood=float(clock.log_likelihood),
        passes=passes,
        duration=float(clock.duration),
        rows=int(clock.rows),
        rejected=rejected_share(state),
        nis=nis,
        effective_samples=state.disturbance_statistics["effective_samples"].copy(),
        state=state,
    )


def log_posterior(fit: JointFit, settings: FilterSettings) -> float:
    """Return the logarithm of the likelihood of a fit, that of the levels under their prior included."""
    return fit.likelihood + log_prior_of_levels(fit.levels, settings)


def limit_step(free: FreeParameters, theta: Array, linearised_at: Array, *, linear: bool = False) -> Array:
    """Return the next point to linearise about: logarithms move by 1 at most, a delay is never negative.

    After a `linear` pass the step of a logarithm is bent as in `kalman.filter`: an inertia acts by its inverse.
    """
    out = np.array(theta)
    for k, name in enumerate(free.names):
        if free.codes[k, 3] != UNTRANSFORMED:
            step = float(theta[k] - linearised_at[k])
            inertia = free.codes[k, 0] == MASS
            if linear and (step < 0.0) == inertia:
                step = float(np.copysign(np.log1p(abs(step)), step))
            out[k] = linearised_at[k] + np.clip(step, -1.0, 1.0)
        if name == DELAY:
            out[k] = max(0.0, out[k])
        if name == LAG:
            out[k] = np.clip(out[k], np.log(_LAGS[0]), np.log(_LAGS[1]))
    return out
