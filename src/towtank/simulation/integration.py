"""Runge-Kutta runs that the core does not offer: unequal pieces within a step, thrusters that lose to inflow, waves.

The equations of motion are the core's (`towtank.core.rk4.step_into`); here is only the order in which it is called.
States are (13,) [x y z, qw qx qy qz, u v w p q r] with the velocity RELATIVE to the water (`relative_to_water`).
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.forces import add_inflow_damping_into, current_in_body, restoring_wrench
from towtank.core.layout import I_CONSTANT, I_INFLOW, I_LINEAR, I_MOMENT, I_QUADRATIC, I_WEIGHT, N_PARAMETERS
from towtank.core.rk4 import N_STATES, has_extra_terms, is_coupled, step_into

__all__ = [
    "in_body",
    "lifted",
    "relative_to_water",
    "simulate_in_waves",
    "simulate_pieces",
    "simulate_thrusters",
]


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


@kernel
def simulate_in_waves(
    p: Array, state0: Array, push: Array, forces: Array, B: Array, pieces: Array, current: Array, lift: Array
) -> Array:
    """Simulate one vehicle as `simulate_thrusters`, in water that accelerates; states are relative to that water.

    Args:
        lift: acceleration of the water in the middle of each piece, as a share of gravity (n m, 3), NED. The wrench
            that comes of it is held over the piece, in the attitude at its start.
        Others as `simulate_thrusters`; a wrench alone is that of six thrusters with B = 1, which lose nothing.
    """
    m = pieces.shape[0]
    out = np.empty((lift.shape[0] // m + 1, N_STATES))
    out[0] = x = state0
    for i in range(lift.shape[0]):
        piece, k = slice(i, i + 1), i % m
        held = push[piece] + lifted(p, x[3:7], lift[i])
        x = simulate_thrusters(p, x, held, forces[piece], B, pieces[k : k + 1], current)[1]
        if k == m - 1:
            out[i // m + 1] = x
    return out


@kernel
def lifted(p: Array, q: Array, lift: Array) -> Array:
    """Return the wrench (6,) [N, N m] on a body in water that accelerates: that of gravity g(eta) along -dv_w/dt.

    Args:
        q: attitude (4,). lift: dv_w/dt as a share of gravity (3,), NED.
    """
    return restoring_wrench(p[I_WEIGHT], p[I_MOMENT:I_CONSTANT], current_in_body(q, lift)[:3])


def relative_to_water(states: Array, water: Array, sign: float = -1.0) -> Array:
    """Return states (..., 13) with R^T v_w taken from the linear velocity; `sign` = +1 adds it again.

    Args:
        water: its velocity v_w (3,) or (..., 3) [m/s], NED.
    """
    if not water.any():
        return states
    out = states.copy()
    out[..., 7:10] += sign * in_body(states[..., 3:7], water)
    return out


def in_body(q: Array, vectors: Array) -> Array:
    """Return R^T v (..., 3) of vectors (3,) or (..., 3), NED, in the attitudes q (..., 4)."""
    w, x = q[..., :1], -q[..., 1:]  # the conjugate quaternion turns NED into FRD
    t = 2.0 * np.cross(x, vectors)
    out: Array = vectors + w * t + np.cross(x, t)
    return out
