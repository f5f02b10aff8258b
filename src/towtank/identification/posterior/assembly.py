"""From an estimator's coordinates to what is learned: what a run determined, physical values, deviations, reasons."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import NoiseLevels, Sources
from towtank.identification.model.belief import Belief
from towtank.identification.model.parameters import IN_DELAY, UNTRANSFORMED, FreeParameters
from towtank.identification.model.terms import AXES
from towtank.identification.posterior.estimate import AxisReport, Estimate, SumOfInertias
from towtank.identification.posterior.identifiability import Criteria, Identifiability, identifiability
from towtank.identification.posterior.physical import consistent
from towtank.identification.posterior.statistics import information_of_data
from towtank.identification.posterior.wording import NOT_FREE
from towtank.recording import Grid
from towtank.vehicle import COEFFICIENTS, Vehicle

__all__ = ["Assembled", "Current", "DelayScan", "LogLearning", "Outcome", "Posterior", "assemble", "judge"]


@dataclass(frozen=True)
class Assembled:
    """The estimate, and remarks in plain words."""

    estimate: Estimate
    remarks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Posterior:
    """Free coefficients, their coordinates theta (n,) and the covariance (n, n) of these."""

    free: FreeParameters
    theta: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an estimator has found.

    Attributes:
        to_learn: names of the estimate. unidentified: why a name is not; it keeps the vehicle's value, or 0 if in
            `set_to_zero`, or what was fitted beside the others if in `roughly`.
        axes: how each was learned. duration: time learned from [s]. samples: how many.
    """

    posterior: Posterior
    to_learn: Sequence[str]
    unidentified: Mapping[str, str]
    set_to_zero: Collection[str]
    axes: Sequence[AxisReport]
    duration: float
    samples: int
    roughly: Collection[str] = ()


def judge(
    posterior: Posterior,
    deviation: Array,
    scale: Array,
    *,
    prior: Array | None = None,
    criteria: Criteria | None = None,
) -> Identifiability:
    """Say what a run determined, from the covariance after it less the deviations (n,) that it started from.

    Args:
        scale: size (n,) of coordinates that are no logarithms. prior: information (n, n) that was put in.
    """
    free, theta = posterior.free, posterior.theta
    before = np.diag(deviation**-2.0) if prior is None else np.diag(deviation**-2.0) + prior
    information = information_of_data(posterior.covariance, before)
    log = [bool(free.codes[k, 3] != UNTRANSFORMED) for k in range(len(free))]
    size = np.maximum(np.abs(theta), 0.0)
    for k in range(len(free)):
        if free.codes[k, 0] == IN_DELAY:
            size[k] = max(size[k], 0.05)
        elif not log[k]:
            size[k] = max(size[k], 0.05 * scale[k])
    return identifiability(free.names, theta, information, logarithmic=log, size=size, prior=prior, criteria=criteria)


def assemble(vehicle: Vehicle, outcome: Outcome) -> Assembled:
    """Return the estimate of the names to learn, physical, and what had to be moved for that."""
    free, theta = outcome.posterior.free, outcome.posterior.theta
    unidentified = outcome.unidentified
    rows = [k for k, name in enumerate(free.names) if name in COEFFICIENTS]
    names_free = [free.names[k] for k in rows]
    slopes = free.slopes(theta)[rows]
    values_free = free.values(theta)[rows]
    block = outcome.posterior.covariance[np.ix_(rows, rows)] * np.outer(slopes, slopes)
    known = [name not in unidentified for name in names_free]
    physical = consistent(vehicle, names_free, values_free, block)
    names = [name for name in outcome.to_learn if name in COEFFICIENTS]
    names += [name for name in names_free if name not in names]
    n = len(names)
    values, spread = np.zeros(n), np.full((n, n), np.nan)
    at = [names.index(name) for name in names_free]
    for i, name in enumerate(names):
        values[i] = 0.0 if name in outcome.set_to_zero else vehicle.coefficient(name)
    for a, i in enumerate(at):
        if known[a] or names_free[a] in outcome.roughly:
            values[i] = physical.values[a]
        if not known[a]:
            continue
        for b, j in enumerate(at):
            if known[b]:
                spread[i, j] = physical.covariance[a, b]
    identified = tuple(name in names_free and name not in unidentified for name in names)
    std = np.sqrt(np.where(np.isnan(np.diag(spread)), np.nan, np.maximum(np.diag(spread), 0.0)))
    sums = []
    for axis in AXES:
        if axis.added_mass in names and identified[names.index(axis.added_mass)]:
            i = names.index(axis.added_mass)
            total = float(vehicle.rigid_body_matrix[axis.index, axis.index]) - float(values[i])
            sums.append(SumOfInertias(axis.sum_name, total, float(std[i]), axis.unit))
    verdicts = zip(names, identified, strict=True)
    estimate = Estimate(
        names=tuple(names),
        values=values,
        std=std,
        covariance=spread,
        identified=identified,
        reasons=tuple(None if ok else unidentified.get(name, NOT_FREE) for name, ok in verdicts),
        sums=tuple(sums),
        axes=tuple(outcome.axes),
        duration=outcome.duration,
        samples=outcome.samples,
    )
    return Assembled(estimate, physical.messages)


@dataclass(frozen=True)
class DelayScan:
    """The delay found [s], its deviation [s] (NaN at an end of the range), and the criterion scanned."""

    delay: float
    std: float
    delays: Array
    cost: Array

    @property
    def at_limit(self) -> bool:
        """The best delay lies at the upper end of the range scanned: the true one may be longer."""
        return bool(self.cost.argmin() == len(self.cost) - 1)


@dataclass(frozen=True)
class LogLearning:
    """What was learned from recordings.

    Attributes:
        estimate: coefficients. model: the vehicle with them put in. delay: found or given [s].
        delay_scan: how the delay was found, None where it was given. grids: the recordings as they were used.
        sources: where velocity and attitude came from, per recording. warnings: in plain words.
        method: that the coefficients come from. delay_std: [s], NaN where given. lag, lag_std: time constant of the
            thrusters, NaN where it was not free. current: of the water, where it was estimated.
        gains: of thrusters where they were free, value and deviation.
        remarks: how it was learned, in plain words. delay_given: whether somebody gave it.
        latency: of sensors, value and deviation [s]. prior: what was supposed, None of the paper's method.
        narrowed: deviation of each unknown as a share of what it was before any data. wave_period: of the water [s],
            NaN where it has no waves.
    """

    vehicle: Vehicle
    estimate: Estimate
    model: Vehicle
    delay: float
    delay_scan: DelayScan | None
    grids: tuple[Grid, ...]
    sources: tuple[Sources, ...]
    warnings: tuple[str, ...]
    method: str = "paper"
    delay_std: float = math.nan
    lag: float = math.nan
    lag_std: float = math.nan
    levels: NoiseLevels | None = None
    current: Current | None = None
    gains: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    delay_given: bool = False
    latency: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    prior: Belief | None = None
    narrowed: Mapping[str, float] = field(default_factory=dict)
    wave_period: float = math.nan


@dataclass(frozen=True, eq=False)
class Current:
    """Velocity of the water (3,) [m/s], NED, at the end of what was learned from, and its deviations (3,).

    gain: of the logarithm of the likelihood, against water at rest; NaN where that was not asked.
    """

    velocity: Array
    std: Array
    gain: float = math.nan

    @property
    def speed(self) -> float:
        """Horizontal speed [m/s]."""
        return float(np.hypot(self.velocity[0], self.velocity[1]))

    @property
    def towards(self) -> float:
        """Heading that the water flows towards [degrees], 0 .. 360."""
        return float(np.degrees(np.arctan2(self.velocity[1], self.velocity[0])) % 360.0)

    @property
    def said(self) -> str:
        """In words: "0.180 ± 0.002 m/s towards 326 degrees"."""
        along = self.velocity[:2] / max(self.speed, 1e-9)
        std = float(np.sqrt(np.sum((along * self.std[:2]) ** 2)))
        return f"{self.speed:.3f} ± {std:.3f} m/s towards {self.towards:.0f}°"
