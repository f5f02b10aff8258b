"""Runge-Kutta runs that the core does not offer: unequal pieces within a step, thrusters that lose to inflow, waves.

The equations of motion are the core's (`towtank.core.rk4.step_into`); here is only the order in which it is called.
States are (13,) [x y z, qw qx qy qz, u v w p q r] with the velocity RELATIVE to the water (`relative_to_water`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import to_body
from towtank.core.forces import add_inflow_damping_into, pull_into
from towtank.core.layout import I_INFLOW, N_PARAMETERS
from towtank.core.rk4 import N_STATES, has_extra_terms, is_coupled, step_into, step_of_one_into

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
    lane = p.reshape(N_PARAMETERS, 1)
    coupled, extra = is_coupled(lane), has_extra_terms(lane)
    x, work, out = state0.copy(), np.empty((3, N_STATES)), np.empty((n + 1, N_STATES))
    _keep(x, out, 0)
    for i in range(n):
        for k in range(m):
            step_of_one_into(p, x, tau[i * m + k], current, pieces[k], work, coupled, extra)
        _keep(x, out, i + 1)
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
    x, room = state0.copy(), Room(np.empty((3, N_PARAMETERS)), np.empty((3, 6)), np.empty((3, N_STATES)))
    out = np.empty((n + 1, N_STATES))
    _keep(x, out, 0)
    for i in range(n * m):
        _push_into(p, x, push[i], forces[i], B, pieces[i % m], current, room)
        if (i + 1) % m == 0:
            _keep(x, out, (i + 1) // m)
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
    n = forces.shape[0] // m
    x, room = state0.copy(), Room(np.empty((3, N_PARAMETERS)), np.empty((3, 6)), np.empty((3, N_STATES)))
    held, out = np.empty(6), np.empty((n + 1, N_STATES))
    _keep(x, out, 0)
    for i in range(n * m):
        lifted_into(p, x[3:7], lift[i], held)
        for a in range(6):
            held[a] += push[i, a]
        _push_into(p, x, held, forces[i], B, pieces[i % m], current, room)
        if (i + 1) % m == 0:
            _keep(x, out, (i + 1) // m)
    return out


@kernel
def _keep(x: Array, out: Array, row: int) -> None:
    """Write the states x (13,) into a row of `out`."""
    for j in range(N_STATES):
        out[row, j] = x[j]


class Room(NamedTuple):
    """Scratch of a step: parameters (3, 170), wrench (3, 6) and states (3, 13) at its start, middle and end."""

    parameters: Array
    tau: Array
    work: Array


@kernel
def _push_into(p: Array, x: Array, push: Array, forces: Array, B: Array, h: float, current: Array, room: Room) -> None:
    """Advance the states x (13,) by h [s] under a held wrench push (6,) and thrust (3, m) that loses to inflow."""
    parameters, tau = room.parameters, room.tau
    for s in range(3):
        for j in range(N_PARAMETERS):
            parameters[s, j] = p[j]
        add_inflow_damping_into(B, forces[s], p[I_INFLOW], parameters[s])
        for a in range(6):
            tau[s, a] = push[a]
            for j in range(B.shape[1]):
                tau[s, a] += B[a, j] * forces[s, j]
    lanes, wrench, work = parameters.reshape(3, N_PARAMETERS, 1), tau.reshape(3, 6, 1), room.work
    step_into(lanes, x.reshape(N_STATES, 1), wrench, current, h, work.reshape(3, N_STATES, 1), True, True)


@kernel
def lifted_into(p: Array, q: Array, lift: Array, out: Array) -> None:
    """Write the wrench (6,) [N, N m], FRD, on a body in water that accelerates: that of gravity along -dv_w/dt.

    Args:
        q: attitude (4,). lift: dv_w/dt as a share of gravity (3,), NED.
    """
    k0, k1, k2 = to_body(q, lift)
    pull_into(p, -k0, -k1, -k2, out)


def lifted(p: Array, q: Array, lift: Array) -> Array:
    """Return what `lifted_into` writes: a wrench (6,) [N, N m], body FRD, of the same arguments."""
    out = np.empty(6)
    lifted_into(p, q, lift, out)
    return out


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
