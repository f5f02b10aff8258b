"""Whether a running joint filter is in order, and how it goes on where it is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.joint_state import (
    C_ROWS,
    O_ADAPT,
    O_BIASES,
    O_FOLLOW,
    O_REST,
    JointState,
    Tuning,
    new_joint_state,
)
from towtank.identification.parameters import PLAIN, FreeParameters
from towtank.identification.transition import N_FIXED

__all__ = ["Sound", "has_moved", "known_to", "mended", "sound_of"]

_MOVED, _KNOWN = 0.2, 0.3  # a logarithm so far from its anchor, and its deviation when it counts as known
_DOUBT = 4.0  # by which the variances of a filter grow that had to be mended


@dataclass(frozen=True, eq=False)
class Sound:
    """What a filter knew when it was last found in order: theta (n,), its covariance (n, n), levels."""

    theta: Array
    covariance: Array
    noise: Array
    sigma: Array
    rough: Array


def sound_of(state: JointState) -> Sound | None:
    """Return what the filter knows; None where a number is not finite or a variance negative."""
    n = state.theta.size
    finite = np.isfinite(state.theta).all() and np.isfinite(state.P).all() and np.isfinite(state.x).all()
    if not (finite and (np.diag(state.P) >= 0.0).all()):
        return None
    block = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n]
    return Sound(state.theta.copy(), block.copy(), state.noise.copy(), state.sigma.copy(), state.rough.copy())


def known_to(state: JointState) -> Array:
    """Return the deviations (n,) of the coefficients."""
    n = state.theta.size
    return np.asarray(np.sqrt(np.maximum(np.diag(state.P)[N_FIXED : N_FIXED + n], 0.0)))


def has_moved(state: JointState, sound: Sound) -> bool:
    """Whether a coefficient has become known far from where the motion is linearised."""
    std = np.sqrt(np.diag(sound.covariance))
    known = (state.codes[:, 3] != PLAIN) & (std < _KNOWN)
    return bool(np.any(known & (np.abs(state.theta - state.anchor) > np.maximum(_MOVED, 2.0 * std))))


def mended(state: JointState, sound: Sound, free: FreeParameters, tuning: Tuning) -> JointState:
    """Return a filter that begins its motion anew with what was known last, and trusts that less."""
    fresh = new_joint_state(
        state.p,
        free,
        sound.theta,
        _DOUBT * sound.covariance,
        state.shape,
        sound.noise,
        np.sqrt(_DOUBT) * sound.sigma,
        sound.rough,
        tuning,
        biases=bool(state.options[O_BIASES]),
    )
    for option in (O_FOLLOW, O_ADAPT, O_REST):
        fresh.options[option] = state.options[option]
    fresh.clock[C_ROWS] = state.clock[C_ROWS]
    fresh.taught[:] = state.taught
    return fresh
