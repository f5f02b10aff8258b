"""What samples alone say of the coefficients, and how much that speaks for a change of them.

A filter that was split off at t0 with the covariance of its coefficients widened from P0 to A = P0 + Q ends with
theta, P. In the linear case the samples in between have then added the information Lambda = P^-1 - A^-1 and the score
h = P^-1 (theta - theta0) about d, the distance of the coefficients from theta0. Any hypothesis d ~ N(m, C) has with
them the evidence

    log E(m, C) = -1/2 log det(I + Lambda C) + h m - 1/2 m Lambda m + 1/2 r C (I + Lambda C)^-1 r,   r = h - Lambda m,

beside a constant that is common to all, so that one split filter judges every hypothesis: none (0, P0), a step of some
coefficients (0, P0 + Q_S), a known vehicle (theta_c - theta0, C_c). E(0, P0 + Q_S) / E(0, P0) is a Bayes factor. With
G = (I + Lambda P0)^-1 Lambda and g = (I + Lambda P0)^-1 h, what the samples say of a step alone, it needs no more than
the coefficients that step: log BF = -1/2 log det(I + G Q) + 1/2 g Q (I + G Q)^-1 g, each restricted to them. Where
nothing changes it is a martingale with mean 1, so that it ever exceeds B with a probability of 1/B at most (Ville's
inequality): a threshold has a meaning. For a wide Q it is Hausman's test: (theta - theta_s)^T (P - P_s)^-1
(theta - theta_s) between the filter that is free to change and the one that is not.

Real motion has more to it than noise and a random force. Where nothing changes, the evidence of a change has a known
mean; what it has been on average is the overdispersion, the factor by which the variance of increments is larger, and
they count that much less. A single one counts for a few times the average at most, so that a true change does not hide
itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from towtank.core.arrays import Array

__all__: list[str] = []

_REGULAR = 1e-12  # share of the widened covariance, so that what is known exactly at first has an inverse
_FADES = 1.0 / 120.0  # share of what was learned that every increment takes off
_NEEDED = 20.0  # sum of expected log Bayes factors before any change is accepted
_CLIPPED_RATIO = 5.0  # times the average that one increment counts for at most
_LEAST_EXPECTED = 0.05  # log Bayes factor expected of an increment that says anything


@dataclass(frozen=True, eq=False)
class InformationIncrement:
    """What samples say by themselves since a moment.

    Attributes:
        theta0, P0: coefficients (n,) and covariance (n, n) at that moment.
        information: Lambda (n, n). score: h (n,), both about d = theta - theta0.
    """

    theta0: Array
    P0: Array
    information: Array
    score: Array

    def evidence(self, covariance: Array, mean: Array | None = None) -> float:
        """Return log E of d ~ N(mean (n,), covariance (n, n)), beside a constant common to all hypotheses."""
        spread = np.eye(self.score.size) + self.information @ covariance
        _, size = np.linalg.slogdet(spread)
        left, shift = self.score, 0.0
        if mean is not None:
            pull = self.information @ mean
            left = self.score - pull
            shift = float(self.score @ mean - 0.5 * mean @ pull)
        return shift - 0.5 * float(size) + 0.5 * float(left @ covariance @ np.linalg.solve(spread, left))

    @cached_property
    def of_step(self) -> tuple[Array, Array]:
        """What the samples say of a step beside P0: information G (n, n) = (I + Lambda P0)^-1 Lambda, score (n,)."""
        both = np.column_stack([self.information, self.score])
        known: Array = np.asarray(
            np.linalg.solve(np.eye(self.score.size) + self.information @ self.P0, both), dtype=np.float64
        )
        return 0.5 * (known[:, :-1] + known[:, :-1].T), known[:, -1]

    def _of(self, steps: Array) -> tuple[Array, Array, Array]:
        """Return G and score of the coefficients that step, each in units of its step, and I + G."""
        taken = np.flatnonzero(steps > 0.0)
        G, score = self.of_step
        size = steps[taken]
        gained = G[np.ix_(taken, taken)] * np.outer(size, size)
        return gained, score[taken] * size, np.eye(taken.size) + gained

    def most(self, steps: Array) -> float:
        """Return what the log Bayes factor of any change within `steps` (n,) is at most: fit alone, at no price."""
        _, score, spread = self._of(steps)
        return 0.5 * float(score @ np.linalg.solve(spread, score))

    def usual(self, steps: Array) -> float:
        """Return what `most` is on average where nothing changes and information and disturbances are as modelled."""
        gained, _, spread = self._of(steps)
        return 0.5 * float(np.trace(np.linalg.solve(spread, gained)))

    def tempered(self, overdispersion: float) -> InformationIncrement:
        """Return the increment as it counts when it, and what was known before, have so many times the variance."""
        return replace(
            self,
            P0=self.P0 * overdispersion,
            information=self.information / overdispersion,
            score=self.score / overdispersion,
        )


def of_changes(increments: Sequence[InformationIncrement], steps: Sequence[Array], overdispersion: float) -> Array:
    """Return log Bayes factors (m, h) by m increments, `tempered`, of h steps (n,) d ~ N(0, diag(step^2)) beside P0."""
    information = np.array([each.of_step[0] for each in increments]) / overdispersion
    score = np.array([each.of_step[1] for each in increments]) / overdispersion
    out = np.empty((len(increments), len(steps)))
    for k, each in enumerate(steps):
        taken = np.flatnonzero(each > 0.0)
        size = each[taken]
        spread = np.eye(taken.size) + information[:, taken[:, None], taken] * np.outer(size, size)
        own = score[:, taken] * size
        fit = np.sum(own * np.linalg.solve(spread, own[:, :, None])[:, :, 0], axis=1)
        out[:, k] = 0.5 * (fit - np.linalg.slogdet(spread)[1])
    return out


def increment_between(theta0: Array, P0: Array, steps: Array, theta: Array, P: Array) -> InformationIncrement:
    """Return what a filter has learned since it was split off.

    Args:
        theta0, P0: before. steps: deviations (n,) by which it was widened. theta, P: now.
    """
    n = theta0.size
    before = P0 + np.diag(steps**2)
    before = 0.5 * (before + before.T)
    scale = np.sqrt(np.maximum(np.diag(before), _REGULAR**2))
    root = scale[:, None] * np.linalg.cholesky(before / np.outer(scale, scale) + _REGULAR * np.eye(n))
    now = root.T @ np.linalg.solve(0.5 * (P + P.T) + np.diag((_REGULAR * scale) ** 2), root)
    values, vectors = np.linalg.eigh(0.5 * (now + now.T) - np.eye(n))
    information = (vectors * np.maximum(values, 0.0)) @ vectors.T
    back = np.linalg.inv(root)
    score = (information + np.eye(n)) @ (back @ (theta - theta0))
    return InformationIncrement(theta0, P0, np.asarray(back.T @ information @ back), np.asarray(back.T @ score))


class Overdispersion:
    """A running ratio of what increments showed and what was to be expected."""

    def __init__(self) -> None:
        self._shown = self._expected = self._seen = 0.0

    @property
    def factor(self) -> float:
        """Factor to the variance of increments, 1 or more."""
        return max(1.0, self._shown / self._expected) if self._expected > 0.0 else 1.0

    @property
    def known(self) -> bool:
        """Whether enough increments have been seen."""
        return self._seen >= _NEEDED

    @property
    def numbers(self) -> tuple[float, ...]:
        """What was learned, for `restore`."""
        return self._shown, self._expected, self._seen

    def restore(self, numbers: Sequence[float]) -> None:
        """Go on with the numbers of another one."""
        self._shown, self._expected, self._seen = (float(each) for each in numbers)

    def learn(self, increment: InformationIncrement, steps: Array) -> None:
        """Take an increment over which nothing is known to have changed."""
        expected = increment.usual(steps)
        if not expected > _LEAST_EXPECTED:
            return
        shown = increment.most(steps)
        if self._seen > 0.25 * _NEEDED:
            shown = min(shown, _CLIPPED_RATIO * self.factor * expected)
        self._shown += shown - _FADES * self._shown
        self._expected += expected - _FADES * self._expected
        self._seen += expected
