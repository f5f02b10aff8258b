"""All unknowns at once: is the truth where the posterior's covariance says, along every direction, not one by one?

    python benchmarks/studies/together_study.py [--runs 20] [--only supposed] [--output together.json]

A vehicle is drawn from what `learn` supposes of one of its kind (all coefficients, delay, lag, gains); most of those
drawn so are not physical, or on a bound, and are drawn again. It tumbles for 40 s under all its thrusters in water that
stirs it; a camera measures its pose, or a DVL, gyros, depth and attitude its motion. The water forgets in the 2 s that
are `supposed`, or `quick`, in 0.5 s. What is learned is taken as the file has it, mean and covariance of some sixty
unknowns: the squared Mahalanobis distance of the truth follows chi-square of as many degrees of freedom where prior,
filter and file are right. It is larger where any combination of unknowns, however well known, is claimed too narrowly.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import count
from typing import NamedTuple

import numpy as np
from by_case import by_case
from place_study import BY_DVL
from scipy.stats import chi2, kstest
from summary import Check
from tumbling import WATER, named, tumble

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification import learn_recordings
from towtank.identification.model.prior import prior_of
from towtank.identification.posterior.result import with_posterior
from towtank.recording import Recording
from towtank.recording.standard import POSE
from towtank.simulation import Ins, Mocap
from towtank.simulation.sensors.sensor import Sensors
from towtank.vehicle import Vehicle
from towtank.vehicle.names import COEFFICIENTS, KINDS, index
from towtank.vehicle.posterior import DELAY, GAIN_PREFIX, LAG, Posterior, coordinate

CASES: dict[str, tuple[Sensors, Sequence[str], float]] = {  # sensors, what they measure, memory of the water [s]
    "supposed camera": (Mocap(), POSE, 2.0),
    "supposed dvl": (Ins(), BY_DVL, 2.0),
    "quick camera": (Mocap(), POSE, 0.5),
    "quick dvl": (Ins(), BY_DVL, 0.5),
}
SECONDS = 40.0
_DRAWS = 200  # at once


class Distance(NamedTuple):
    """What came of one log.

    Attributes:
        unknowns: that the file states. squared: Mahalanobis distance of the truth. share: of chi-square below it.
        alone: error of the farthest unknowns, in deviations. together: of the farthest of the independent combinations
            of all, and what weighs most in it.
    """

    unknowns: int
    squared: float
    share: float
    alone: dict[str, float]
    together: tuple[float, list[str]]


def flown(case: str, seed: int) -> tuple[Vehicle, Recording]:
    """Return a vehicle such as a learner takes for possible before any data, and its log."""
    sensors, measured, memory = CASES[case]
    for truth in _possible(seed):
        with suppress(InputError):  # a motion that a step of 10 ms cannot follow
            water = replace(WATER, time_constant=memory)
            return truth, tumble(truth, seed=seed, seconds=SECONDS, sensors=sensors, measured=measured, water=water)
    raise AssertionError


def _possible(seed: int) -> Iterator[Vehicle]:
    """Yield vehicles drawn from the prior that are physical, and not on its bounds, where drawing clips them to."""
    supposed = prior_of(named(), commands=True)
    before = with_posterior(named(), supposed, supposed.mean, supposed.covariance)
    damping = [name for name in supposed.names if name in COEFFICIENTS and _damps(name)]
    for more in count():
        for each in before.sample(_DRAWS, 1000 * seed + more):
            inside = each.command_delay > 0.0 and each.thrusters[0].time_constant > 0.0
            if inside and not each.warnings and all(each.coefficient(name) < 0.0 for name in damping):
                yield each


def _damps(name: str) -> bool:
    kind, i, j = index(name)
    return KINDS[kind].damps and i == j


def learned(case: str, seed: int) -> Distance:
    """Return how far the truth is from what is learned of one log."""
    truth, run = flown(case, seed)
    model = learn_recordings(named(), [run]).model
    posterior = model.posterior
    assert posterior is not None
    true = np.array([_true(truth, model, name) for name in posterior.names])
    off = true - np.array(posterior.mean)
    squared = distance(off, posterior.factor)
    return Distance(off.size, squared, float(chi2.cdf(squared, off.size)), *_farthest(posterior, off))


def _farthest(posterior: Posterior, off: Array) -> tuple[dict[str, float], tuple[float, list[str]]]:
    """Return `alone` and `together` of `Distance`; the combinations are eigenvectors of the correlations."""
    size, names = off / np.array(posterior.std), np.array(posterior.names)
    scaled = posterior.factor / np.array(posterior.std)[:, None]
    variances, axes = np.linalg.eigh(scaled @ scaled.T)
    errors = axes.T @ size / np.sqrt(variances)
    k = int(np.argmax(np.abs(errors)))
    first, weights = np.argsort(-np.abs(size))[:4], np.argsort(-np.abs(axes[:, k]))[:4]
    alone = dict(zip(names[first].tolist(), size[first].tolist(), strict=True))
    return alone, (float(abs(errors[k])), names[weights].tolist())


def distance(off: Array, factor: Array) -> float:
    """Return the squared Mahalanobis distance of an error (n,), from a factor (n, n) of the covariance."""
    return float(np.sum(np.linalg.solve(factor, off) ** 2))


def _true(vehicle: Vehicle, model: Vehicle, name: str) -> float:
    """Return the true coordinate of an unknown: of a gain, as a multiple of the model's."""
    if name in COEFFICIENTS:
        return coordinate(vehicle, name)
    if name == DELAY:
        return vehicle.command_delay
    if name == LAG:
        return vehicle.thrusters[0].time_constant
    if name.startswith(GAIN_PREFIX):
        pairs = zip(vehicle.thrusters, model.thrusters, strict=True)
        return next(math.log(true.gain / each.gain) for true, each in pairs if GAIN_PREFIX + each.name == name)
    return 0.0  # sensors are at the origin, and not late


def checks(case: str, found: Sequence[Distance]) -> list[Check]:
    """Return what must hold of one case; of quick water, which is not the filter's, what comes out."""
    shares = np.array([each.share for each in found])
    spread = math.sqrt(2.0 / sum(each.unknowns for each in found))  # of the mean, by chance
    figures = {
        "unknowns of a log": (float(np.median([each.unknowns for each in found])), -math.inf, math.inf),
        "squared distance for each unknown, mean": (
            float(np.mean([each.squared / each.unknowns for each in found])),
            1.0 - 3.0 * spread,
            1.0 + 3.0 * spread,
        ),
        "as chi-square, p of Kolmogorov and Smirnov": (float(kstest(shares, "uniform").pvalue), 0.01, math.inf),
        "logs beyond 99.9 %": (float(np.sum(shares > 0.999)), -math.inf, 1.0),
    }
    if "quick" in case:
        return [Check(f"{case}: {name}", value) for name, (value, _, _) in figures.items()]
    return [Check(f"{case}: {name}", *limits) for name, limits in figures.items()]


def row(found: Distance) -> dict[str, str]:
    """Return a run as its table shows it."""
    return {
        "unknowns": str(found.unknowns),
        "squared distance": f"{found.squared:.1f}",
        "of chi-square below": f"{found.share:.3f}",
        "farthest alone": ", ".join(f"{name} {size:+.1f}" for name, size in found.alone.items()),
        "farthest together": f"{found.together[0]:.1f}: {', '.join(found.together[1])}",
    }


if __name__ == "__main__":
    sys.exit(by_case("together", __doc__ or "", CASES, learned, row, checks))
