"""What a free run works on: a recording cut into segments, the sums it leaves behind, and its scratch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.layout import N_PARAMETERS
from towtank.core.rk4 import N_STATES
from towtank.identification.transition import N_FIXED, N_MOVING

__all__ = ["FreeRun", "Indices", "NormalEquations", "Workspace", "new_equations", "new_workspace"]

_WIDTH = 8  # columns are padded to whole vectors

Indices = NDArray[np.int64]


class FreeRun(NamedTuple):
    """One recording, cut into segments that each start from a state of their own."""

    t: Array  # (n,) [s]
    values: Array  # (n, 15) as `Samples`
    q: Array  # (n, 4) measured attitude, NaN where not all three angles are
    noise: Array  # (15,) standard deviations
    input_t: Array  # (k,) [s]
    input_force: Array  # (k, m)
    shape: Array  # (6, m)
    lag: Array  # (m,) [s], where it is not free
    first: Indices  # (s,) first row of each segment
    last: Indices  # (s,) one past its last row
    block: Indices  # (n,) block of time of each row


class NormalEquations(NamedTuple):
    """What a run adds up: columns are the initial states that are estimated, then the coefficients, then padding."""

    normal: Array  # (s, c, c) sum of w J J^T of each segment
    scores: Array  # (b, c) sum of w J r of each block of time
    residuals: Array  # (n, 15) in standard deviations of the noise, NaN where nothing was measured
    reach: Array  # (12, c) sum over the segments of the sizes of the sensitivities at their ends


class Workspace(NamedTuple):
    """Scratch of a run; the arrays of one lane are views of those beside them."""

    S: Array  # (12, c) sensitivities
    D: Array  # (12, c) their rate
    E: Array  # (12, c)
    A: Array  # (12, 21 + n)
    J: Array  # (3, c)
    p: Array  # (154,)
    p_lane: Array  # (154, 1)
    x: Array  # (13,) state
    x_lane: Array  # (13, 1)
    middle: Array  # (13,) state at the middle of a step
    middle_lane: Array  # (13, 1)
    rate: Array  # (13,) derivative of the state
    rate_lane: Array  # (13, 1)
    wrench: Array  # (3, 6)
    wrench_lane: Array  # (3, 6, 1)
    pushed: Array  # (3, m)
    gain: Array  # (m,)
    work: Array  # (3, 13, 1)
    scratch: Array  # (6, 6)
    current: Array  # (3,)


def new_equations(segments: int, blocks: int, rows: int, columns: int) -> NormalEquations:
    """Return the empty sums of a run with `columns` estimated initial states and coefficients."""
    c = _padded(columns)
    return NormalEquations(
        normal=np.zeros((segments, c, c)),
        scores=np.zeros((blocks, c)),
        residuals=np.full((rows, 15), np.nan),
        reach=np.zeros((N_MOVING, c)),
    )


def new_workspace(columns: int, n: int, m: int) -> Workspace:
    """Return scratch for `columns` sensitivities, n of them of coefficients, and m inputs."""
    c = _padded(columns)
    p, wrench = np.zeros(N_PARAMETERS), np.zeros((3, 6))
    x, middle, rate = np.zeros(N_STATES), np.zeros(N_STATES), np.zeros(N_STATES)
    return Workspace(
        S=np.zeros((N_MOVING, c)),
        D=np.zeros((N_MOVING, c)),
        E=np.zeros((N_MOVING, c)),
        A=np.zeros((N_MOVING, N_FIXED + n)),
        J=np.zeros((3, c)),
        p=p,
        p_lane=p.reshape(-1, 1),
        x=x,
        x_lane=x.reshape(-1, 1),
        middle=middle,
        middle_lane=middle.reshape(-1, 1),
        rate=rate,
        rate_lane=rate.reshape(-1, 1),
        wrench=wrench,
        wrench_lane=wrench.reshape(3, 6, 1),
        pushed=np.zeros((3, m)),
        gain=np.ones(m),
        work=np.zeros((3, N_STATES, 1)),
        scratch=np.zeros((6, 6)),
        current=np.zeros(3),
    )


def _padded(columns: int) -> int:
    return -(-columns // _WIDTH) * _WIDTH
