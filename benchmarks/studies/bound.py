"""Cramer-Rao bounds of the surge experiments: how well anyone could know mass and drag after so many seconds.

The measured position of the axis is y = x(theta) + G d + e: x the noise-free motion, d the random force, e white noise
of sigma, off while a marker is hidden (those samples are dropped). To first order about the noise-free motion y is
Gaussian with covariance C = sigma^2 I + G S G^T, S[i, j] = sigma_d^2 exp(-|i - j| dt / T), and the information on
theta is X^T C^-1 X with X = dx/dtheta. The covariance hardly depends on theta; what it tells is left out.

theta: logarithms of the coefficients (and of the lag), the delay, and the initial position and velocity, which get a
prior: position 1 m (nobody knows it before it is measured), velocity 0.01 m/s (the vehicle begins at rest).
With C = L L^T, the first k rows of L^-1 X depend on the first k samples alone: one factorisation gives all times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from experiments import DT, Experiment
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from sensitivity import pose_sensitivity

from towtank.core.arrays import Array
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate, stream
from towtank.simulation.sensors.mocap import intervals

__all__ = ["Flags", "SurgeBound", "force_covariance", "force_response", "surge_bound", "visible", "whitened"]

PRIOR_POSITION, PRIOR_VELOCITY = 1.0, 0.01  # m, m/s, standard deviations
Flags = NDArray[np.bool_]

_LN_PRIOR = 1e3  # of the logarithms, and of the delay in s: none


@dataclass(frozen=True, eq=False)
class SurgeBound:
    """The bound of a surge experiment.

    Attributes:
        t: times (n,) [s]. unknowns: names (k,).
        white: whitened sensitivities (n, k + 2) to the unknowns and the start.
        covariance: (n, k + 2, k + 2), relative for coefficients and lag, in seconds for the delay.
    """

    t: Array
    unknowns: tuple[str, ...]
    white: Array
    covariance: Array

    @property
    def std(self) -> Array:
        """Least standard deviations (n, k)."""
        std: Array = np.sqrt(np.einsum("nii->ni", self.covariance))[:, : len(self.unknowns)]
        return std

    def at(self, t: float) -> Array:
        """Return the deviations (k,) of the samples up to time t [s]."""
        return np.asarray(self.std[int(np.searchsorted(self.t, t + 1e-9)) - 1])

    def ideal_errors(self, generator: np.random.Generator) -> Array:
        """Return the errors (n, k) of one run of an estimator that is at the bound at every time.

        Its errors are (I + prior)^-1 times the sum of the whitened noises: normal, with exactly the covariance of the
        bound, and correlated from one time to the next as those of a real estimator are.
        """
        drive = np.cumsum(self.white * generator.standard_normal((len(self.t), 1)), axis=0)
        errors: Array = np.einsum("nij,nj->ni", self.covariance, drive)[:, : len(self.unknowns)]
        return errors


def surge_bound(experiment: Experiment, seed: int | None = None) -> SurgeBound:
    """Return the bound of a surge experiment about its motion without random force.

    Args:
        seed: of the run whose hidden samples are dropped; None: every sample is seen.
    """
    unknowns = experiment.unknowns
    X = _sensitivity(experiment)
    t = DT * np.arange(len(X), dtype=np.float64)
    sensors = experiment.sensors
    if not isinstance(sensors, Mocap):
        raise TypeError(f"{experiment.name}: found {type(sensors).__name__}, expected Mocap")
    seen = np.ones(len(t), dtype=np.bool_) if seed is None else visible(sensors, t, seed)
    coloured = None if experiment.disturbance is None else _coloured(experiment)
    white = whitened(X, 1e-3 * sensors.noise_mm, seen, coloured)
    prior = np.diag([_LN_PRIOR**-2] * len(unknowns) + [PRIOR_POSITION**-2, PRIOR_VELOCITY**-2])
    covariance = _inverses(np.cumsum(white[:, :, None] * white[:, None, :], axis=0) + prior)
    return SurgeBound(t, unknowns, white, covariance)


def whitened(X: Array, disturbance: float, seen: Flags, coloured: Array | None = None) -> Array:
    """Return L^-1 X (n, k), C = L L^T; the sums of outer products of its first rows are the information.

    Args:
        X: sensitivities (n, k). sigma: of the white noise. seen: (n,) which samples count; the others give rows of 0.
        coloured: covariance (n, n) of what the random force does to the samples, None for none.
    """
    white = np.zeros_like(X)
    if coloured is None:
        white[seen] = X[seen] / disturbance
    else:
        C = coloured[np.ix_(seen, seen)] + disturbance**2 * np.eye(int(seen.sum()))
        white[seen] = solve_triangular(np.linalg.cholesky(C), X[seen], lower=True)
    return white


def force_response(mass: float, drag: float, u: Array, dt: float) -> Array:
    """Return G (n + 1, n): position at sample i [m] per newton held over step j, M du' = -2 D |u| du + d.

    The damping of every step is that of its mean speed, which is exact to second order in dt.

    Args:
        mass: total [kg]. drag: D > 0 of D |u| u [kg/m]. u: noise-free speed (n + 1,) [m/s].
    """
    n = len(u) - 1
    position, velocity = np.zeros((n + 1, n)), np.zeros(n)
    for k in range(n):
        rate = drag * (abs(u[k]) + abs(u[k + 1])) / mass  # 2 D |u| / M
        a = math.exp(-rate * dt)
        once = -math.expm1(-rate * dt) / rate if rate > 1e-12 else dt  # integral of exp(-rate s)
        twice = (dt - once) / rate if rate > 1e-6 else 0.5 * dt * dt
        position[k + 1] = position[k] + once * velocity
        position[k + 1, k] += twice / mass
        velocity = a * velocity
        velocity[k] += once / mass
    return position


def force_covariance(disturbance: OrnsteinUhlenbeck, n: int, dt: float) -> Array:
    """Return S (n, n) [N^2] of the surge force held over n steps."""
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    covariance: Array = disturbance.deviations[0] ** 2 * np.exp(-apart * dt / disturbance.time_constant)
    return covariance


def visible(sensors: Mocap, t: Array, seed: int) -> Flags:
    """Return (n,) which samples are free of marker jumps in the run of this seed, as the sensors draw them."""
    hidden = intervals(t, sensors.jump_fraction, sensors.jump_s, stream(seed, "mocap", "jumps"))
    return np.asarray(hidden < 0)


@cache
def _sensitivity(experiment: Experiment) -> Array:
    """Return the sensitivities (n + 1, k + 2) of the position to the unknowns and the start."""
    return pose_sensitivity(experiment.truth, experiment.commands, DT, experiment.unknowns, 0)


@cache
def _coloured(experiment: Experiment) -> Array:
    """Return G S G^T (n + 1, n + 1) of the experiment.

    The lag is left out of G: it shapes the thrusters' force, not the random one.
    """
    truth, disturbance = experiment.truth, experiment.disturbance
    if disturbance is None:
        raise ValueError(f"{experiment.name} has no random force")
    u = simulate(truth, commands=experiment.commands, dt=DT)["u"].values
    G = force_response(float(truth.mass_matrix[0, 0]), -truth.coefficient("X_uu"), u, DT)
    return np.asarray(G @ force_covariance(disturbance, G.shape[1], DT) @ G.T)


def _inverses(information: Array) -> Array:
    """Return the inverses (n, k, k) of information matrices, scaled first."""
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", information))
    scaled = information * scale[:, :, None] * scale[:, None, :]
    inverse: Array = np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]
    return inverse
