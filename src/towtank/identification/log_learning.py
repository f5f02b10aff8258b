"""The outcome of learning from recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.chain import Sources
from towtank.identification.delay import DelayScan
from towtank.identification.estimate import Estimate
from towtank.recording import Grid
from towtank.vehicle import Vehicle

if TYPE_CHECKING:
    from towtank.identification.joint_current import Current

__all__ = ["Levels", "LogLearning"]


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise of the measured columns (15,), levels of the disturbance (6,) [N, N m], and what is rough in the motion.

    rough: random walk (6,) of each speed [m/s^2 sqrt(s), rad/s^2 sqrt(s)] that no force of the model accounts for,
        NaN where nothing tells.
    """

    noise: Array
    sigma: Array
    rough: Array = field(default_factory=lambda: np.zeros(6))


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
        remarks: how it was learned, in plain words.
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
    levels: Levels | None = None
    current: Current | None = None
    gains: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
