"""The arrowhead of a free run's normal equations: initial states of many segments, coefficients shared by all.

With H = [X C; C^T T], X block diagonal, the states are eliminated segment by segment (Schur's complement):
T - C^T X^-1 C is the information on the coefficients, and no matrix is larger than one segment's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.output_error_space import Indices

__all__ = ["Arrowhead", "Step", "inverse_information"]

_LOOSE = np.repeat([10.0, 1.0, 1.0, 1.0], 3)  # m, rad, m/s, rad/s: a state that is known no better than this
_TURN = 1.0  # rad, of a step
_RIDGE = 1e-13  # of a unit diagonal
_SMALLEST = 1e-12  # share of an information's largest eigenvalue, each row scaled, that is not rounding


@dataclass(frozen=True, eq=False)
class Step:
    """A step in the coefficients (n,) and the initial errors (s, 12), and by how much it should lower the cost."""

    theta: Array
    states: Array
    decrease: float


@dataclass(frozen=True, eq=False)
class Arrowhead:
    """Normal equations of all segments.

    Attributes:
        X: (s, k, k) initial states. C: (s, k, n) between them and the coefficients. T: (n, n) coefficients, the prior
            included.
        gx: (s, k), g: (n,) right-hand sides.
        estimated: (k,) which of the 12 initial errors.
    """

    X: Array
    C: Array
    T: Array
    gx: Array
    g: Array
    estimated: Indices

    def _eliminated(self, damping: float) -> tuple[Array, Array]:
        """Return X^-1 C (s, k, n) and X^-1 gx (s, k)."""
        k = self.X.shape[1]
        X = self.X.copy()
        places = np.arange(k)
        X[:, places, places] = X[:, places, places] * (1.0 + damping) + _LOOSE[self.estimated] ** -2.0
        scale = 1.0 / np.sqrt(X[:, places, places])
        X *= scale[:, :, None] * scale[:, None, :]
        X[:, places, places] += _RIDGE  # a segment that diverges may leave nothing but rounding errors
        known = np.concatenate([self.C, self.gx[:, :, None]], axis=2)
        solved = scale[:, :, None] * np.linalg.solve(X, scale[:, :, None] * known)
        return solved[:, :, :-1], solved[:, :, -1]

    def step(self, damping: float, least: Array, most: Array) -> Step:
        """Return the damped step within bounds: what would leave them stays on them, the others make the best of it.

        Args:
            damping: Levenberg's and Marquardt's, relative to the diagonal.
            least, most: bounds of the step of each coefficient (n,).
        """
        C, x = self._eliminated(damping)
        T = self.T - np.einsum("ski,skj->ij", self.C, C)
        g = self.g - np.einsum("ski,sk->i", self.C, x)
        told = np.diag(T) > _SMALLEST * np.diag(self.T)
        scale = _scale(T)
        theta, moving = np.zeros(len(g)), told.copy()
        while moving.any():
            fixed = np.where(moving, 0.0, theta)
            scaled = T * np.outer(scale, scale)
            scaled[~moving, :] = scaled[:, ~moving] = 0.0
            scaled[np.diag_indices_from(scaled)] += damping + _SMALLEST
            free = scale * np.linalg.lstsq(scaled, np.where(moving, scale * (g - T @ fixed), 0.0), rcond=None)[0]
            theta = np.where(moving, np.clip(free, least, most), theta)
            beyond = moving & (theta != free)
            if not beyond.any():
                break
            moving &= ~beyond
        x = x - C @ theta
        states = np.zeros((len(self.X), 12))
        states[:, self.estimated] = x
        shorter = 1.0 / max(np.abs(states[:, 3:6]).max(initial=0.0) / _TURN, 1.0)
        slope = float(self.g @ theta + np.sum(self.gx * x))
        bend = theta @ self.T @ theta + np.einsum("sk,skl,sl->", x, self.X, x)
        bend += 2.0 * np.einsum("sk,skn,n->", x, self.C, theta)
        return Step(shorter * theta, shorter * states, slope - 0.5 * float(bend))

    def information(self) -> tuple[Array, Array]:
        """Return the information (n, n) on the coefficients, the states being unknown, and X^-1 C (s, k, n)."""
        C, _ = self._eliminated(0.0)
        T = self.T - np.einsum("ski,skj->ij", self.C, C)
        return 0.5 * (T + T.T), C


def _scale(T: Array) -> Array:
    """Return what scales T (n, n) to a unit diagonal; 1 where there is nothing."""
    diagonal = np.diag(T)
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def inverse_information(information: Array) -> Array:
    """Return the inverse (n, n): very large, not infinite, in directions of which the run says nothing at all."""
    scale = _scale(information)
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    values = np.maximum(values, _SMALLEST * max(float(values[-1]), 1.0))
    inverse: Array = (vectors / values) @ vectors.T * np.outer(scale, scale)
    return inverse
