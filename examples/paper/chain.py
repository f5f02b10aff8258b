"""The paper's chain for one axis, link by link, each as it was in the tank or as it should be.

    pose -> velocity by difference -> low-pass -> filtered regressors -> recursive least squares

M nu_dot = -D |nu| nu + F becomes nu_dot = [|nu| nu, F] [-D/M, 1/M]. Both sides pass through 1/(s + a) in the exact
form: what each adds over one sample, then the recursion y[k+1] = exp(-a h) y[k] + increment[k].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from towtank import RecursiveLeastSquares

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """Settings of the chain.

    Attributes:
        a: filter constant of both sides [1/s].
        lowpass: corner [Hz] of two equal first-order low-passes on the velocity; None for none.
        lowpass_thrust: the same low-passes on the thrust. The paper does not mention any.
        delay: from command to thrust, as far as the chain knows [s].
        held_state: take |nu| nu as constant from sample to sample (Euler) instead of the trapezoid.
        joined_commands: join the held commands by straight lines.
    """

    a: float = 0.3
    lowpass: float | None = None
    lowpass_thrust: bool = False
    delay: float = 0.0
    held_state: bool = False
    joined_commands: bool = False

    def velocity(self, t: Array, position: Array) -> Array:
        """Return the velocity (n,) by backward differences of a coordinate (n,); not yet smoothed."""
        return np.concatenate([[0.0], np.diff(position) / np.diff(t)])

    def smooth(self, values: Array, h: float) -> Array:
        """Pass a signal (n,) at steps of h [s] through the low-passes."""
        if self.lowpass is None:
            return values
        keep = math.exp(-2.0 * math.pi * self.lowpass * h)
        for _ in range(2):
            values = lfilter([1.0 - keep], [1.0, -keep], values)
        return values

    def regression(self, t: Array, velocity: Array, force: Array) -> tuple[Array, Array]:
        """Return filtered regressors (n - 1, 2) and left-hand side (n - 1,).

        Args:
            t: times (n,) [s], evenly spaced. velocity: (n,), not smoothed.
            force: (n - 1,), held from each time on.
        """
        h = float(t[1] - t[0])
        late = round(self.delay / h)
        force = np.concatenate([np.zeros(late), force[: force.size - late]])
        if self.joined_commands:
            force = 0.5 * (force + np.append(force[1:], force[-1]))
        nu = self.smooth(velocity, h)
        if self.lowpass_thrust:
            force = self.smooth(force, h)
        drag = np.abs(nu) * nu
        swept = h * drag[:-1] if self.held_state else 0.5 * h * (drag[:-1] + drag[1:])
        keep = math.exp(-self.a * h)
        sides = lfilter([1.0], [1.0, -keep], np.column_stack([swept, h * force, np.diff(nu)]), axis=0)
        return sides[:, :2], sides[:, 2]

    def learn(self, t: Array, velocity: Array, force: Array) -> tuple[float, float]:
        """Return mass and drag M, D at the end of the run."""
        estimator = RecursiveLeastSquares(2)
        estimator.run(*self.regression(t, velocity, force))
        return physical(estimator.theta)

    def history(self, t: Array, velocity: Array, force: Array) -> Array:
        """Return M, D (n - 1, 2) after every sample; NaN while there is no positive mass."""
        estimator = RecursiveLeastSquares(2)
        out = np.full((t.size - 1, 2), np.nan)
        for k, (phi, y) in enumerate(zip(*self.regression(t, velocity, force), strict=True)):
            estimator.update(phi, float(y))
            theta = estimator.theta
            if theta[1] > 0.0:
                out[k] = physical(theta)
        return out


def physical(theta: Array) -> tuple[float, float]:
    """Return mass and drag M, D from [-D/M, 1/M]."""
    return float(1.0 / theta[1]), float(-theta[0] / theta[1])
