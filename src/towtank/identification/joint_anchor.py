"""The anchor of the joint filter: the coefficients that the motion is linearised about.

Between anchors the filter is linear in the coefficients, so that a wide prior cannot lead it astray: early and wild
estimates act to first order only. Once coefficients are known well and far from their anchor, it is moved to them.
"""

from __future__ import annotations

import math

from towtank.core.arrays import kernel
from towtank.identification.held_input import HeldInput
from towtank.identification.joint_state import JointState
from towtank.identification.parameters import IN_DELAY, IN_LAG, MASS, PLAIN, put_parameters
from towtank.identification.transition import N_FIXED

__all__ = ["move_anchor", "wants_anchor"]

_KNOWN = 0.3  # deviation of a logarithm from which on its anchor follows it,
_FAR = 1e-3  # once it is this far away


@kernel
def wants_anchor(state: JointState) -> bool:
    """Whether a coefficient that is known well enough has left its anchor."""
    for k in range(state.theta.shape[0]):
        if math.fabs(state.theta[k] - state.anchor[k]) > _FAR and _known(state, k):
            return True
    return False


@kernel
def _known(state: JointState, k: int) -> bool:
    variance = state.P[N_FIXED + k, N_FIXED + k]
    return bool(state.codes[k, 3] != PLAIN and variance < _KNOWN * _KNOWN)


@kernel
def _bend(state: JointState, k: int, away: float) -> float:
    """Return the way of a logarithm that has the effect which `away` had to first order, and scale its deviation.

    An inertia acts through its inverse, 1/M (1 - away); damping acts as it is, D (1 + away). A way against that law,
    towards a larger inertia or a smaller damping, is taken as it stands.
    """
    if state.codes[k, 0] == MASS:
        if away >= 0.0:
            return away
        slope = 1.0 / (1.0 - away)
        way = -math.log(1.0 - away)
    else:
        if away <= 0.0:
            return away
        slope = 1.0 / (1.0 + away)
        way = math.log(1.0 + away)
    i = N_FIXED + k
    for j in range(state.P.shape[0]):
        state.P[i, j] *= slope
    for j in range(state.P.shape[0]):
        state.P[j, i] *= slope
    return way


@kernel
def move_anchor(state: JointState, held: HeldInput) -> None:
    """Linearise about the present coefficients, where they are known, from here on.

    Couplings of the mass matrix are shrunk where it would not be positive definite.
    """
    n = state.theta.shape[0]
    for k in range(n):
        away = state.theta[k] - state.anchor[k]
        if state.codes[k, 0] == IN_DELAY:
            continue  # commands on their way have their due times already
        if state.codes[k, 3] == PLAIN:
            state.anchor[k] += away
            continue
        if not _known(state, k):
            continue
        state.anchor[k] += _bend(state, k, min(max(away, -20.0), 20.0))
        state.theta[k] = state.anchor[k]
        if state.codes[k, 0] == IN_LAG:
            for j in range(held.lag.shape[0]):
                held.lag[j] = math.exp(state.anchor[k])
    for _ in range(200):
        if put_parameters(state.p, state.codes, state.anchor, state.small):
            return
        for k in range(n):
            if state.codes[k, 0] == MASS and state.codes[k, 1] != state.codes[k, 2]:
                state.anchor[k] *= 0.9
