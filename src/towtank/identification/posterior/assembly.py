"""What was learned from recordings: the estimate, the model, and everything else that is to be said of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import NoiseLevels, Sources
from towtank.identification.model.parameters import DELAY, LAG
from towtank.identification.model.prior import Prior
from towtank.identification.posterior.estimate import Estimate
from towtank.recording import Grid
from towtank.recording.consistency import Finding
from towtank.vehicle import Vehicle

__all__ = ["Current", "DelayScan", "LogLearning", "Mode"]


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


@dataclass(frozen=True, eq=False)
class Mode:
    """The likeliest values of all unknowns: theta (n,) in the coordinates of the `prior`, and the `levels` of noise and
    disturbance [m/s^2, rad/s^2] with them. looked_at: whether inputs went on between two looks at them.
    """

    prior: Prior
    theta: Array
    levels: NoiseLevels
    looked_at: bool = False


@dataclass(frozen=True, repr=False)
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
        latency: of sensors, value and deviation [s]. places: of sensors in the body likewise, by unknown [m].
        mode: of the posterior, None of the paper's method.
        narrowed: deviation of each unknown as a share of what it was before any data. wave_period: of the water [s],
            NaN where it has no waves.
        findings: what cannot be right, gravest first. driven: axes (6,) that the inputs drove; () where not looked at.
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
    places: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    mode: Mode | None = None
    narrowed: Mapping[str, float] = field(default_factory=dict)
    wave_period: float = math.nan
    findings: tuple[Finding, ...] = ()
    driven: tuple[bool, ...] = ()

    @property
    def prior(self) -> Prior | None:
        """What was supposed, None of the paper's method."""
        return None if self.mode is None else self.mode.prior

    @property
    def together(self) -> tuple[float, float] | None:
        """Sum of delay and lag and its deviation [s], often far surer than either; None where they are not found."""
        posterior = self.model.posterior
        if posterior is None or not {DELAY, LAG} <= set(posterior.names):
            return None
        rows = [posterior.names.index(name) for name in (DELAY, LAG)]
        return self.delay + self.lag, math.sqrt(max(posterior.covariance[np.ix_(rows, rows)].sum(), 0.0))


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
