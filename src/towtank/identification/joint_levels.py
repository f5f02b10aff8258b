"""Levels of noise and disturbance, from what a pass of the joint filter shows: the one tuning that matters.

The noise of each sensor follows from the innovations, E[nu^2] = H P H^T + R, and the disturbance of each axis from
E[d^2] = d_hat^2 + P_dd. The latter alone runs away where coefficients can stand for a disturbance; so it is held by a
usual level, as so many independent looks at it would hold it.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.joint_state import JointState, Tuning
from towtank.identification.log_learning import Levels
from towtank.identification.samples import N_MEASURED

__all__ = ["alike", "caution", "followed", "level_merit"]

_LEVELS_SETTLED = 0.05  # of a level
_USUAL_FOR = 2.0  # independent looks at the disturbance that the usual level counts for
_SWING = 5.0  # by which a level may change from one pass to the next


def followed(state: JointState, levels: Levels, tuning: Tuning) -> Levels:
    """Return the levels that the pass's own innovations and disturbances speak for."""
    noise = levels.noise.copy()
    for j in range(N_MEASURED):
        if state.stats[j, 0] > 50.0:
            shown = state.stats[j, 1] / state.stats[j, 0]
            noise[j] = np.sqrt(np.clip(shown, noise[j] ** 2 / 4.0, noise[j] ** 2 * 4.0))
    sigma = levels.sigma.copy()
    floors = np.array([tuning.floor_force] * 3 + [tuning.floor_moment] * 3)
    usual = np.array(tuning.usual)
    for i in range(6):
        time, square, variance, looks = state.level[i]
        expected = sigma[i] ** 2 * time - variance  # what d_hat^2 should have added up to
        if time > 0.0 and expected > 1e-3 * sigma[i] ** 2 * time:
            ratio = float(np.clip(square / expected, 1.0 / _SWING, _SWING))
            sigma[i] *= np.sqrt(ratio)
        if usual[i] > 0.0:
            weight = looks / (looks + _USUAL_FOR)
            sigma[i] = sigma[i] ** weight * usual[i] ** (1.0 - weight)
    return Levels(noise, np.maximum(sigma, floors))


def alike(new: Levels, old: Levels) -> bool:
    """Whether levels have settled."""
    return bool(
        np.all(np.abs(new.sigma - old.sigma) <= _LEVELS_SETTLED * old.sigma)
        and np.all(np.abs(new.noise - old.noise) <= _LEVELS_SETTLED * old.noise)
    )


def level_merit(levels: Levels, tuning: Tuning) -> float:
    """Return the logarithm of the prior likelihood of the disturbance's level, which is `usual` give or take."""
    usual = np.array(tuning.usual)
    away = np.log(levels.sigma[usual > 0.0] / usual[usual > 0.0])
    return -_USUAL_FOR * float(np.sum(away**2))


def caution(looks: Array) -> Array:
    """Return the factor (6,) to a level of the disturbance 1.8 deviations above its estimate, from its looks (6,)."""
    return np.asarray(np.exp(0.9 * np.sqrt(2.0 / (looks + _USUAL_FOR))))
