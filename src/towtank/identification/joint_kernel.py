"""The joint filter over a stream: rows of measurements and held commands, in the order of time.

One row costs one step of the filter; a log and a live stream go through the same code.
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import quaternion_from_euler
from towtank.identification.held_input import HeldInput, held_means_into, held_push
from towtank.identification.joint_anchor import move_anchor, wants_anchor
from towtank.identification.joint_force import GRAVITY
from towtank.identification.joint_predict import input_wrench, predict
from towtank.identification.joint_state import (
    C_ROWS,
    C_STARTED,
    C_TIME,
    O_FOLLOW,
    O_GAP,
    JointState,
)
from towtank.identification.joint_update import update_row

__all__ = ["begin_motion", "joint_events", "joint_step"]

_START = (0.3, 0.2, 0.3, 0.2)  # deviations at the start where a sensor has said nothing: m, rad, m/s, rad/s


@kernel
def begin_motion(state: JointState, held: HeldInput, t: float, z: Array) -> None:
    """Begin the motion at the row z (15,) of time t [s]; coefficients, biases and current stay as they are."""
    x, P = state.x, state.P
    size = P.shape[0]
    for i in range(18):
        for j in range(size):
            P[i, j] = 0.0
            P[j, i] = 0.0
    for i in range(3):
        x[i] = z[i] if math.isfinite(z[i]) else 0.0
        P[i, i] = _START[0] ** 2 if math.isfinite(z[i]) else 100.0
        if not math.isfinite(z[i]) and state.clock[C_STARTED] > 0.0:
            P[i, i] = 100.0
    phi, theta, psi = z[3], z[4], z[5]
    if not (math.isfinite(phi) and math.isfinite(theta)):
        phi, theta = 0.0, 0.0
        if math.isfinite(z[12]) and math.isfinite(z[13]) and math.isfinite(z[14]) and z[14] < -0.3 * GRAVITY:
            phi = math.atan2(-z[13], -z[14])
            theta = math.atan2(z[12], math.hypot(z[13], z[14]))
    if not math.isfinite(psi):
        psi = 0.0
    x[3], x[4], x[5], x[6] = quaternion_from_euler(phi, theta, psi)
    for i in range(3):
        P[3 + i, 3 + i] = _START[1] ** 2
        measured = math.isfinite(z[6 + i])
        x[7 + i] = z[6 + i] if measured else 0.0
        P[6 + i, 6 + i] = _START[2] ** 2
        measured = math.isfinite(z[9 + i])
        x[10 + i] = z[9 + i] - state.bias[i] if measured else 0.0
        P[9 + i, 9 + i] = _START[3] ** 2
    for i in range(6):
        state.force[i] = 0.0
        P[12 + i, 12 + i] = state.sigma[i] ** 2
    for j in range(size):
        state.dx[j] = 0.0
    for k in range(5):
        state.heard[k] = t
    for k in range(4):
        state.hidden[k, 0] = 0.0
    for j in range(6, 12):
        state.stats[j, 13] = 0.0  # a speed of before the pause is no neighbour
    held_means_into(held, t, state.pushed)
    input_wrench(state)
    state.clock[C_TIME] = t
    state.clock[C_STARTED] = 1.0


@kernel
def joint_step(state: JointState, held: HeldInput, t: float, z: Array, coupled: bool) -> bool:
    """Take the row z (15,) of time t [s]; False where it taught nothing: out of order, or no inputs known yet."""
    now = state.clock[C_TIME]
    started = state.clock[C_STARTED] > 0.0
    if started and not t > now:
        return False
    if not started or t - now > state.options[O_GAP]:
        if held.counters[0] > 0.0:
            begin_motion(state, held, t, z)
            update_row(state, z, coupled)
        return False
    if not predict(state, held, t, coupled):
        state.clock[C_STARTED] = 0.0
        return False
    update_row(state, z, coupled)
    if state.options[O_FOLLOW] > 0.0 and wants_anchor(state):
        move_anchor(state, held)
    state.clock[C_ROWS] += 1.0
    return True


@kernel
def joint_events(
    state: JointState,
    held: HeldInput,
    t: Array,
    values: Array,
    input_t: Array,
    input_force: Array,
    coupled: bool,
    first: int,
    last: int,
    pushed: int,
) -> int:
    """Take rows first .. last of t (n,), values (n, 15), with inputs (k,), (k, m) in time; return the inputs pushed."""
    for i in range(first, last):
        while pushed < input_t.shape[0] and input_t[pushed] <= t[i]:
            held_push(held, input_t[pushed], input_force[pushed])
            pushed += 1
        joint_step(state, held, t[i], values[i], coupled)
    return pushed
