"""Runge-Kutta runs that the core does not offer: unequal pieces within a step, and thrusters that lose to inflow.

The equations of motion are the core's (`towtank.core.rk4.step_into`); here is only the order in which it is called.
States are (13,) [x y z, qw qx qy qz, u v w p q r] with the velocity RELATIVE to the water (`relative_to_water`).
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.forces import add_inflow_damping_into
from towtank.core.layout import I_INFLOW, I_LINEAR, I_QUADRATIC, N_PARAMETERS
from towtank.core.rk4 import N_STATES, has_extra_terms, is_coupled, step_into

__all__ = ["relative_to_water", "simulate_pieces", "simulate_thrusters"]


@kernel
def simulate_pieces(p: Array, state0: Array, tau: Array, pieces: Array, current: Array) -> Array:
    """Simulate one vehicle in steps that are cut into pieces, each with a smooth wrench.

    Args:
        p: kernel parameters (170,).
        state0: initial state (13,).
        tau: wrench (n m, 3, 6) at the start, the middle and the end of each piece [N, N m], body FRD.
        pieces: lengths (m,) [s] of the pieces of every step.
        current: water velocity (3,) [m/s], NED.

    Returns:
        States (n + 1, 13) at the ends of the steps.
    """
    m = pieces.shape[0]
    n = tau.shape[0] // m
    parameters = np.empty((N_PARAMETERS, 1))
    x = np.empty((N_STATES, 1))
    work = np.empty((3, N_STATES, 1))
    for j in range(N_PARAMETERS):
        parameters[j, 0] = p[j]
    out = np.empty((n + 1, N_STATES))
    for j in range(N_STATES):
        x[j, 0] = state0[j]
        out[0, j] = state0[j]
    coupled, extra = is_coupled(parameters), has_extra_terms(parameters)
    for i in range(n):
        for k in range(m):
            step_into(parameters, x, tau[i * m + k].reshape(3, 6, 1), current, pieces[k], work, coupled, extra)
        for j in range(N_STATES):
            out[i + 1, j] = x[j, 0]
    return out


@kernel
def simulate_thrusters(
    p: Array, state0: Array, push: Array, forces: Array, B: Array, pieces: Array, current: Array
) -> Array:
    """Simulate one vehicle as `simulate_pieces`, by the forces of thrusters of which the water that meets them takes.

    Args:
        push: wrench of all else (n m, 6) [N, N m], held over each piece.
        forces: thrust without inflow (n m, 3, thrusters) [N] at the start, the middle and the end of each piece.
        B: wrench of each thruster's unit force (6, thrusters).
        Others as `simulate_pieces`.
    """
    m = pieces.shape[0]
    n = forces.shape[0] // m
    parameters = np.empty((3, N_PARAMETERS))
    x = np.empty((N_STATES, 1))
    tau = np.empty((3, 6, 1))
    work = np.empty((3, N_STATES, 1))
    out = np.empty((n + 1, N_STATES))
    for s in range(3):
        parameters[s] = p
    for j in range(N_STATES):
        x[j, 0] = state0[j]
        out[0, j] = state0[j]
    for i in range(n * m):
        for s in range(3):
            parameters[s, I_LINEAR:I_QUADRATIC] = p[I_LINEAR:I_QUADRATIC]
            add_inflow_damping_into(B, forces[i, s], p[I_INFLOW], parameters[s])
            for a in range(6):
                tau[s, a, 0] = push[i, a]
                for j in range(B.shape[1]):
                    tau[s, a, 0] += B[a, j] * forces[i, s, j]
        step_into(parameters.reshape(3, N_PARAMETERS, 1), x, tau, current, pieces[i % m], work, True, True)
        if (i + 1) % m == 0:
            for j in range(N_STATES):
                out[(i + 1) // m, j] = x[j, 0]
    return out


def relative_to_water(states: Array, current: Array, sign: float = -1.0) -> Array:
    """Return states (..., 13) with R^T v_c taken from the linear velocity; `sign` = +1 adds it again.

    Args:
        current: water velocity v_c (3,) [m/s], NED.
    """
    if not current.any():
        return states
    w, v = states[..., 3:4], -states[..., 4:7]  # the conjugate quaternion turns NED into FRD
    t = 2.0 * np.cross(v, current)
    out = states.copy()
    out[..., 7:10] += sign * (current + w * t + np.cross(v, t))
    return out
