"""Water that moves: whether a recording shows a current, and which one.

Drag acts through the water, sensors see the ground. A current of 0.18 m/s that nobody knows of costs 40 % of the drag
of a vehicle that goes to and fro; estimated along, a random walk in north, east and down, it costs nothing. It shows
where the speed over ground, or the position, is measured together with the heading. With water at rest the likelihood
of the innovations gains no more than chance; in a current it gains hundreds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.joint import JointFit, one_pass
from towtank.identification.joint_state import JointState, Tuning
from towtank.identification.samples import Samples

__all__ = ["Current", "current_of", "current_shows", "suspected_current"]

_CURRENT = slice(18, 21)  # of the filter's errors
_GAIN = 20.0  # of the logarithm of the likelihood: far beyond chance with three numbers
_SLOWEST = 0.01  # m/s


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


def current_shows(samples: Sequence[Samples]) -> bool:
    """Whether any recording measures position or speed over ground, and the heading."""
    return any(bool((each.measured[:3].any() or each.measured[6:9].any()) and each.measured[5]) for each in samples)


def current_of(state: JointState) -> Current:
    """Return the current that a filter has estimated."""
    variance = np.diag(state.P)[_CURRENT]
    return Current(state.current.copy(), np.sqrt(np.maximum(variance, 0.0)))


def suspected_current(
    samples: Sequence[Samples],
    p: Array,
    fit: JointFit,
    deviation: Array,
    tuning: Tuning,
    *,
    delay: float,
    prior: tuple[Array, Array] | None,
) -> Current | None:
    """Return the current that would explain the recordings far better than water at rest; None where none does.

    Arguments as `joint.one_pass`; `fit` is what was found with water at rest.
    """
    if not current_shows(samples):
        return None
    found = []
    for flows in (False, True):
        way = replace(tuning, follow=False, current=flows)
        state, _ = one_pass(samples, p, fit.free, fit.theta, deviation, fit.levels, way, delay=delay, prior=prior)
        found.append(state)
    gain = float(found[1].clock[2] - found[0].clock[2])
    current = replace(current_of(found[1]), gain=gain)
    sound = bool(np.isfinite(current.velocity).all() and np.isfinite(gain))
    return current if sound and gain > _GAIN and current.speed > _SLOWEST else None
