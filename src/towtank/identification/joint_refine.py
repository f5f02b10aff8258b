"""After the joint filter: free runs fitted to the same recordings, and which of the two judges the model better.

The filter is at the bound where its picture of the disturbance is right. On real recordings it may not be: forces that
are no random walk of one time constant, thrusters that answer late, bodies that pull to one side. A free run sees that
plainly, because nothing corrects it. So both sets of coefficients run freely over the recordings, from initial states
fitted alike, and output error takes over where its runs come closer by more than what its freedom explains, or where
what is left of them is white: then nothing but the sensors' noise parts the model from the data.

Where it takes over, and nobody said which coefficients to learn, what the first model left out is tried: constant
forces, the thrusters' lag, the other damping terms, couplings between the axes. A term stays that stands out of its
deviation and brings the runs closer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.free_run_terms import groups_of_terms
from towtank.identification.joint_start import size_of, start_theta
from towtank.identification.output_error import OutputErrorFit, fit_output_error
from towtank.identification.parameters import DELAY, LAG, PLAIN, FreeParameters, free_parameters
from towtank.identification.samples import Samples
from towtank.vehicle import Vehicle

__all__ = ["FreeRuns", "Refined", "refine"]

_KEPT = 2.0  # deviations that a term needs which the first model did not have
_WORTH = 2.0  # what each coefficient must bring, in twice the logarithm of the likelihood,
_MARGIN = 6.0  # and a change of judge on top of that
_GAIN = 0.1  # least decrease of the runs' square error, in its logarithm, that is worth a change of judge
_WHITE = 2.0  # samples that residuals may remember and still count as white
_ADRIFT, _AT_ONCE = 5.0, 20.0  # s: length of a run without a measured attitude, and with one
_SURE = 1e9  # 1/deviation^2 of what is held in a free run
_ITERATIONS = 30
_ROUNDS = 3

Prior = Callable[[FreeParameters], tuple[Array, Array] | None]


@dataclass(frozen=True, eq=False)
class Refined:
    """What free runs say.

    Attributes:
        free, theta, covariance: coefficients. kernel: what is held (154,). delay: [s] where it is not free.
        better: whether free runs are the better judge. white: whether their residuals are.
        gain: 1 - square error of the runs over that of the joint filter's coefficients.
        added: terms that were not free before.
    """

    free: FreeParameters
    theta: Array
    covariance: Array
    kernel: Array
    delay: float
    better: bool
    white: bool
    gain: float
    added: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Recordings that models run over freely.

    Attributes:
        samples: of each recording. noise: (15,). segment: length of a run [s].
    """

    vehicle: Vehicle
    samples: tuple[Samples, ...]
    noise: Array
    segment: float

    @classmethod
    def over(cls, vehicle: Vehicle, samples: Sequence[Samples], noise: Array) -> FreeRuns:
        """Prepare recordings. Specific force is left out where no translation is measured that it could belong to."""
        measured = np.any([each.measured for each in samples], axis=0)
        moving = bool(measured[0:3].any() or measured[6:9].any())
        kept = tuple(each if moving else _without_force(each) for each in samples)
        drifting = bool(measured[9:12].any() and not measured[3:5].all())
        return cls(vehicle, kept, np.array(noise), _ADRIFT if drifting else _AT_ONCE)

    @property
    def duration(self) -> float:
        """Of all recordings [s]."""
        return sum(each.duration for each in self.samples)

    def fit(
        self,
        kernel: Array,
        free: FreeParameters,
        theta: Array,
        *,
        delay: float,
        prior: tuple[Array, Array] | None = None,
        held: bool = False,
    ) -> OutputErrorFit:
        """Fit free runs; with `held` only the states that they start from."""
        if held:
            prior = (np.array(theta), _SURE * np.eye(len(free)))
        return fit_output_error(
            self.samples,
            kernel,
            free,
            theta,
            self.noise,
            prior=prior,
            segment=self.segment,
            delay=delay,
            iterations=_ITERATIONS,
        )

    def closer(self, new: OutputErrorFit, old: OutputErrorFit) -> tuple[float, float]:
        """Return by how much the runs of `new` are closer: twice the log likelihood's gain, and its mean per sample."""
        total = weight = 0.0
        for j in range(12):
            a, b = new.residual_std[j], old.residual_std[j]
            if not (np.isfinite(a) and np.isfinite(b) and a > 0.0 and b > 0.0):
                continue
            memory = np.nanmax([new.correlation_time[j], new.sample_time[j], 1e-3])
            count = self.duration / float(memory)
            total += count * 2.0 * float(np.log(b / a))
            weight += count
        return total, total / weight if weight > 0.0 else 0.0


def _without_force(samples: Samples) -> Samples:
    values = np.array(samples.values)
    if np.isfinite(values[:, :12]).any():
        values[:, 12:] = np.nan
    return replace(samples, values=values)


def refine(
    vehicle: Vehicle,
    base: Vehicle,
    samples: Sequence[Samples],
    free: FreeParameters,
    starts: Sequence[Array],
    noise: Array,
    *,
    delay: float,
    prior: Prior,
    terms: bool,
    find_lag: bool,
) -> Refined | None:
    """Fit free runs to recordings and say whether they are the better judge; None where they cannot be made.

    Args:
        base: what is held. free: what the joint filter had free.
        starts: thetas (n,) to begin at, the joint filter's first.
        noise: (15,) deviations of the columns. delay: of the inputs [s] where it is not free.
        prior: mean and information of what is free, known beforehand.
        terms: whether others may be added. find_lag: the thrusters' lag too.
    """
    runs = FreeRuns.over(vehicle, samples, noise)
    kernel = np.array(base.parameters)
    try:
        tried = [runs.fit(kernel, free, start, delay=delay, held=True) for start in starts]
    except InputError:
        return None
    sound = [k for k, each in enumerate(tried) if np.isfinite(each.cost) and np.isfinite(each.residual_std).any()]
    if not sound:
        return None
    best = sound[0]
    for k in sound[1:]:
        if runs.closer(tried[k], tried[best])[0] > 0.0:
            best = k
    fit = runs.fit(kernel, free, starts[best], delay=delay, prior=prior(free))
    if not _sound(fit):
        return None
    gained, each = runs.closer(fit, tried[0]) if sound[0] == 0 else (np.inf, np.inf)
    white = bool(np.nanmax(fit.correlation_time[:12] / fit.sample_time[:12], initial=0.0) <= _WHITE)
    better = white or bool(gained > _WORTH * len(free) + _MARGIN and each > _GAIN)
    found = _Found(free, fit, base, delay)
    if better and terms and not white:
        found = _with_terms(runs, found, prior, find_lag)
    found = _without_early_delay(runs, found, prior)
    added = tuple(name for name in found.free.names if name not in free.names)
    gain = 1.0 - float(np.exp(-runs.closer(found.fit, tried[0])[1])) if sound[0] == 0 else 1.0
    return Refined(
        found.free,
        found.fit.theta,
        found.fit.covariance,
        np.array(found.base.parameters),
        found.delay,
        better,
        white,
        gain,
        added,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    free: FreeParameters
    fit: OutputErrorFit
    base: Vehicle
    delay: float


def _sound(fit: OutputErrorFit) -> bool:
    return bool(np.isfinite(fit.theta).all() and np.isfinite(fit.covariance).all() and np.isfinite(fit.cost))


def _with_terms(runs: FreeRuns, found: _Found, prior: Prior, find_lag: bool) -> _Found:
    """Return the fit with those terms of each group in turn that stand out and bring the runs closer."""
    for group in groups_of_terms(runs.vehicle, found.free.names, runs.samples, find_lag=find_lag):
        names = [name for name in group if name not in found.free.names]
        tried = _tried(runs, found, names, prior) if names else None
        if tried is None:
            continue
        more = len(tried.free) - len(found.free)
        if runs.closer(tried.fit, found.fit)[0] > _WORTH * more:
            found = tried
    return found


def _tried(runs: FreeRuns, found: _Found, names: list[str], prior: Prior) -> _Found | None:
    """Return the fit with as many of the names as stand out of their deviations, None where none does."""
    guess = found.fit.theta
    for _ in range(_ROUNDS):
        free, theta = _extended(runs.vehicle, found, names, guess)
        fit = runs.fit(
            np.array(found.base.parameters),
            free,
            theta,
            delay=found.delay,
            prior=_prior_of(runs.vehicle, found.free, free, prior),
        )
        if not _sound(fit):
            return None
        std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
        kept = [name for name in names if _stands_out(free, fit.theta, std, name)]
        if kept == names:
            return replace(found, free=free, fit=fit)
        names = kept
        if not names:
            return None
    return None


def _stands_out(free: FreeParameters, theta: Array, std: Array, name: str) -> bool:
    k = free.names.index(name)
    size = abs(float(theta[k])) if free.codes[k, 3] == PLAIN else 1.0
    return bool(size > _KEPT * std[k])


def _extended(vehicle: Vehicle, found: _Found, names: list[str], guess: Array) -> tuple[FreeParameters, Array]:
    """Return the free parameters with `names` beside them, and where they start (n,)."""
    free = free_parameters(vehicle, (*found.free.names, *names))
    now = dict(zip(found.free.names, guess, strict=True))
    lag = 0.03
    usual = start_theta(vehicle, found.base, free, delay=found.delay, lag=lag)
    theta = np.array([now.get(name, usual[k]) for k, name in enumerate(free.names)])
    if LAG in names and DELAY in now:
        k = free.names.index(DELAY)
        theta[k] = max(0.0, float(theta[k]) - lag)
    return free, theta


def _prior_of(vehicle: Vehicle, old: FreeParameters, free: FreeParameters, prior: Prior) -> tuple[Array, Array]:
    """Return what is known beforehand: the prior, and a usual size for the terms that were added."""
    n = len(free)
    mean, information = prior(free) or (np.zeros(n), np.zeros((n, n)))
    information = np.array(information)
    scale = size_of(vehicle, free)
    for k, name in enumerate(free.names):
        if name not in old.names and free.codes[k, 3] == PLAIN:
            information[k, k] += scale[k] ** -2.0
    return mean, information


def _without_early_delay(runs: FreeRuns, found: _Found, prior: Prior) -> _Found:
    """Return the fit with no delay where thrusters would have to act before they are told."""
    if DELAY not in found.free.names:
        return found
    k = found.free.names.index(DELAY)
    if found.fit.theta[k] >= 0.0:
        return found
    free = found.free.subset([name for name in found.free.names if name != DELAY])
    fit = runs.fit(np.array(found.base.parameters), free, np.delete(found.fit.theta, k), delay=0.0, prior=prior(free))
    return _Found(free, fit, found.base, 0.0) if _sound(fit) else found
