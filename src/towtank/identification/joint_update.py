"""The joint filter at a measurement: sensors gated at 4.5 deviations, then taken one scalar after the other.

The three numbers of one sensor are refused together. Errors are put into the state when a row is done.
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel
from towtank.identification.joint_force import update_specific_force
from towtank.identification.joint_rows import attitude_error, is_upright, residual_of, row_of
from towtank.identification.joint_scalar import inject, innovate, scalar_update
from towtank.identification.joint_state import (
    C_LIKELIHOOD,
    C_RESETS,
    C_SINCE,
    C_TIME,
    O_GATE,
    O_HUBER,
    O_REACQUIRE,
    JointState,
)

__all__ = ["update_row"]

_RETURNED = 8.0  # log likelihood ratio for a sensor that has come back, against one that is still off
_OFFSET_FOLLOWS = 0.1  # least weight of a sample in the mean offset of a sensor that is refused
_LONGEST, _MOST = (math.inf, math.inf, 0.3, 0.03), 3.0  # s and samples that a sensor of speed is refused for at most
_LOOSE = (1.0, 0.1, 0.5, 0.5, 0.0)  # deviation of a state that is taken from its sensor anew


@kernel
def _believed(state: JointState, z: Array, sensor: int, whole: bool) -> bool:
    """Whether all numbers of a sensor lie within the gate, and, after a refusal, have come back.

    While a sensor is refused the gate widens; an offset that stays would slip in, one lucky sample at first. So after a
    refusal it is believed again only when its samples speak for what is expected, and against the offset that it was
    refused for, by a log likelihood ratio summed as in Page's test.
    """
    gate, cap = state.options[O_GATE], state.options[O_HUBER]
    hidden = state.hidden[sensor]
    within = True
    stays = sensor < 2  # a camera that has lost its marker stays wrong; speeds only jump
    ratio, cost = 0.0, 0.0
    for k in range(3):
        if math.isfinite(z[3 * sensor + k]):
            residual = residual_of(state, z, sensor, k, whole)
            row_of(state, sensor, k, whole)
            S = innovate(state, 3 * sensor + k, residual)
            for j in range(state.h.shape[0]):
                if state.h[j] != 0.0:
                    residual -= state.h[j] * state.dx[j]
                    state.h[j] = 0.0
            if residual * residual > gate * gate * S:
                within = False
            ratio += ((residual - hidden[1 + k]) ** 2 - residual * residual) / (2.0 * S)
            cost += math.log(S) + cap * (2.0 * gate - cap)
            state.offset[k] = residual
        else:
            state.offset[k] = hidden[1 + k]
    if hidden[0] == 0.0:
        hidden[4] = 0.0
        for k in range(3):
            hidden[1 + k] = 0.0
    else:
        hidden[4] = max(0.0, hidden[4] + ratio)
    if within and (hidden[0] == 0.0 or hidden[4] > _RETURNED or not stays):
        hidden[0] = 0.0
        return True
    if ratio < 0.0 or hidden[0] == 0.0:
        hidden[0] += 1.0
        share = max(1.0 / hidden[0], _OFFSET_FOLLOWS)
        for k in range(3):
            hidden[1 + k] += (state.offset[k] - hidden[1 + k]) * share
    state.clock[C_LIKELIHOOD] -= 0.5 * cost
    return False


@kernel
def _start_anew(state: JointState, z: Array, sensor: int, whole: bool) -> None:
    """Forget what was believed of the states that a sensor measures, and give them a wide deviation."""
    inject(state)
    first = 3 * sensor if sensor < 4 else 6
    for k in range(3):
        if not math.isfinite(z[3 * sensor + k]):
            continue
        i = first + k
        for j in range(state.P.shape[0]):
            state.P[i, j] = 0.0
            state.P[j, i] = 0.0
        state.P[i, i] = _LOOSE[sensor] ** 2
        state.stats[3 * sensor + k, 13] = 0.0
        if sensor == 0:
            state.x[k] = z[k]
        elif sensor == 2:
            state.x[7 + k] = z[6 + k]
        elif sensor == 3:
            state.x[10 + k] = z[9 + k] - state.bias[k]
    if sensor == 1 and whole:
        ex, ey, ez = attitude_error(state.x[3:7], z[3], z[4], z[5])
        state.dx[3], state.dx[4], state.dx[5] = ex, ey, ez
        inject(state)
    state.clock[C_RESETS] += 1.0


@kernel
def update_row(state: JointState, z: Array, coupled: bool) -> None:
    """Take one row of measurements z (15,), NaN where there is none."""
    now = state.clock[C_TIME]
    for sensor in range(4):
        count = 0
        for k in range(3):
            if math.isfinite(z[3 * sensor + k]):
                count += 1
        if count == 0:
            continue
        whole = count == 3
        if sensor == 1 and not whole and not is_upright(state):
            continue
        state.clock[C_SINCE] = now - state.heard[sensor]
        if not _believed(state, z, sensor, whole):
            for k in range(3):
                if math.isfinite(z[3 * sensor + k]):
                    state.stats[3 * sensor + k, 3] += 1.0
            quiet = now - state.heard[sensor]
            if quiet > state.options[O_REACQUIRE] * (1.0 if sensor == 0 else 3.0):
                _start_anew(state, z, sensor, whole)
                state.hidden[sensor, 0] = 0.0
                state.heard[sensor] = now
            elif quiet <= _LONGEST[sensor] or state.hidden[sensor, 0] < _MOST:
                continue
        else:
            state.heard[sensor] = now
        for k in range(3):
            if math.isfinite(z[3 * sensor + k]):
                residual = residual_of(state, z, sensor, k, whole)
                row_of(state, sensor, k, whole)
                scalar_update(state, 3 * sensor + k, residual)
    if math.isfinite(z[12]) or math.isfinite(z[13]) or math.isfinite(z[14]):
        update_specific_force(state, z, coupled)
    inject(state)
