"""What a stretch of samples alone says of the coefficients, and how much it speaks for a change of them.

A filter that was split off at t0 with the covariance of its coefficients widened from P0 to A = P0 + Q ends with
theta, P. In the linear case the samples in between have then added the information Lambda = P^-1 - A^-1 and the score
h = P^-1 (theta - theta0) about d, the way of the coefficients from theta0. Any hypothesis on the way, d ~ N(m, C), has
with them the evidence

    log E(m, C) = -1/2 log det(I + Lambda C) + h m - 1/2 m Lambda m + 1/2 r C (I + Lambda C)^-1 r,   r = h - Lambda m,

beside a constant that is common to all, so that one split filter judges every hypothesis: none (0, P0), a step of some
coefficients (0, P0 + Q_S), a known vehicle (theta_c - theta0, C_c). E(0, P0 + Q_S) / E(0, P0) is a Bayes factor. Where
nothing changes it is a martingale with mean 1, so that it ever exceeds B with a probability of 1/B at most (Ville's
inequality): a threshold has a meaning. For a wide Q it is Hausman's test: (theta - theta_s)^T (P - P_s)^-1
(theta - theta_s) between the filter that is free to follow a change and the one that is not.

How much more windows err than the filter's model says: real motion has more to it than noise and a random force.

Where nothing changes, the evidence of a change has a known mean. What it has been on average is the factor by which the
variance of what windows tell is larger; windows count that much less. A single window counts for a few times the
average at most, so that a true change does not hide itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array

__all__ = ["Overdispersion", "Window", "window_between"]

_LEAST = 1e-12  # of the widened covariance, so that what is held at first has an inverse
_FADES = 1.0 / 120.0  # of what was learned, with every window
_NEEDED = 20.0  # sum of expected values before any change is believed
_CLIPPED = 5.0  # times the average that one window counts for at most
_TOLD = 0.05  # least expected value of a window that tells anything


@dataclass(frozen=True, eq=False)
class Window:
    """What the samples of a window say by themselves.

    Attributes:
        theta0, P0: coefficients (n,) and covariance (n, n) when it began.
        information: Lambda (n, n). score: h (n,), both about d = theta - theta0.
    """

    theta0: Array
    P0: Array
    information: Array
    score: Array

    def evidence(self, covariance: Array, mean: Array | None = None) -> float:
        """Return log E of d ~ N(mean (n,), covariance (n, n)), beside a constant common to all hypotheses."""
        held = np.eye(self.score.size) + self.information @ covariance
        _, size = np.linalg.slogdet(held)
        left, said = self.score, 0.0
        if mean is not None:
            pull = self.information @ mean
            left = self.score - pull
            said = float(self.score @ mean - 0.5 * mean @ pull)
        return said - 0.5 * float(size) + 0.5 * float(left @ covariance @ np.linalg.solve(held, left))

    def most(self, steps: Array) -> float:
        """Return what the log Bayes factor of any change within `steps` (n,) is at most: fit alone, at no price."""
        wide, narrow = self._responses(steps)
        return 0.5 * float(self.score @ (wide - narrow) @ self.score)

    def usual(self, steps: Array) -> float:
        """Return what `most` is on average where nothing changes and information and disturbances are as modelled."""
        wide, narrow = self._responses(steps)
        spread = self.information + self.information @ self.P0 @ self.information
        return 0.5 * float(np.trace((wide - narrow) @ spread))

    def tempered(self, overdispersion: float) -> Window:
        """Return the window as it counts when it, and what was known before, err `overdispersion` times as much (variance)."""
        return replace(
            self,
            P0=self.P0 * overdispersion,
            information=self.information / overdispersion,
            score=self.score / overdispersion,
        )

    def _responses(self, steps: Array) -> tuple[Array, Array]:
        """Return C (I + Lambda C)^-1 (n, n) for C = P0 + diag(steps^2) and for C = P0."""
        one = np.eye(self.score.size)
        wide = self.P0 + np.diag(steps**2)
        found = np.linalg.solve(one + wide @ self.information, wide)
        least = np.linalg.solve(one + self.P0 @ self.information, self.P0)
        return np.asarray(found, dtype=np.float64), np.asarray(least, dtype=np.float64)

    def change(self, steps: Array) -> float:
        """Return the log Bayes factor of a step d ~ N(0, diag(steps^2)) (n,) beside P0, against none."""
        return self.evidence(self.P0 + np.diag(steps**2)) - self.evidence(self.P0)

    def way(self, covariance: Array) -> tuple[Array, Array]:
        """Return mean (n,) and covariance (n, n) of d under the hypothesis d ~ N(0, covariance)."""
        gain = np.linalg.solve(np.eye(self.score.size) + covariance @ self.information, covariance)
        return np.asarray(gain @ self.score), np.asarray(0.5 * (gain + gain.T))


def window_between(theta0: Array, P0: Array, steps: Array, theta: Array, P: Array) -> Window:
    """Return what a filter has learned since it was split off.

    Args:
        theta0, P0: before. steps: deviations (n,) by which it was widened. theta, P: now.
    """
    n = theta0.size
    before = P0 + np.diag(steps**2)
    before = 0.5 * (before + before.T)
    scale = np.sqrt(np.maximum(np.diag(before), _LEAST**2))
    root = scale[:, None] * np.linalg.cholesky(before / np.outer(scale, scale) + _LEAST * np.eye(n))
    now = root.T @ np.linalg.solve(0.5 * (P + P.T) + np.diag((_LEAST * scale) ** 2), root)
    values, vectors = np.linalg.eigh(0.5 * (now + now.T) - np.eye(n))
    told = (vectors * np.maximum(values, 0.0)) @ vectors.T
    back = np.linalg.inv(root)
    score = (told + np.eye(n)) @ (back @ (theta - theta0))
    return Window(theta0, P0, np.asarray(back.T @ told @ back), np.asarray(back.T @ score))


class Overdispersion:
    """A running ratio of what windows showed and what was to be expected."""

    def __init__(self) -> None:
        self._shown = self._expected = self._seen = 0.0

    @property
    def factor(self) -> float:
        """Factor to the variance of what windows tell, 1 or more."""
        return max(1.0, self._shown / self._expected) if self._expected > 0.0 else 1.0

    @property
    def known(self) -> bool:
        """Whether enough windows have been seen."""
        return self._seen >= _NEEDED

    @property
    def numbers(self) -> tuple[float, ...]:
        """What was learned, for `restore`."""
        return self._shown, self._expected, self._seen

    def restore(self, numbers: Sequence[float]) -> None:
        """Go on with the numbers of another one."""
        self._shown, self._expected, self._seen = (float(each) for each in numbers)

    def learn(self, window: Window, steps: Array) -> None:
        """Take a window in which nothing is known to have changed."""
        expected = window.usual(steps)
        if not expected > _TOLD:
            return
        shown = window.most(steps)
        if self._seen > 0.25 * _NEEDED:
            shown = min(shown, _CLIPPED * self.factor * expected)
        self._shown += shown - _FADES * self._shown
        self._expected += expected - _FADES * self._expected
        self._seen += expected
