"""Everything that the paper's chain remembers between samples.

The vehicle as known so far: what the couplings and the end corrections of the chain use while it learns.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.forgetting import commit_scratch
from towtank.core.layout import I_LINEAR, I_MASS, I_MASS_INVERSE, I_MOMENT, I_QUADRATIC, I_WEIGHT
from towtank.core.least_squares import qr_absorb
from towtank.identification.model.terms import C_FORCE, C_LHS, C_LINEAR, C_QUADRATIC, C_RESTORING, N_COLUMNS

__all__ = [
    "BOUNDED_GAIN",
    "DIRECTIONAL",
    "EXPONENTIAL",
    "FIRST_BLOCK",
    "N_BLOCKS",
    "PaperState",
    "new_paper_state",
    "refresh_model",
    "running_estimate_into",
]

N_BLOCKS = 256
EXPONENTIAL, DIRECTIONAL, BOUNDED_GAIN = range(3)
FIRST_BLOCK = 0.25  # s; doubled, and neighbours merged, whenever the blocks are full
_TRUSTED = 0.1  # relative deviation of 1/M below which a learned axis enters the model,
_LEAST = 1.0  # s of data that it needs at least


class PaperState(NamedTuple):
    """Everything the chain remembers; arrays are changed in place."""

    settings: Array  # a [1/s], forgetting, learn the model (0/1), instruments (0/1), gradient gain, smooth (0/1),
    #                  forgetting scheme, share, bound
    p: Array  # (154,) the vehicle as known so far
    free: Array  # (6, 5) 1 where a column's coefficient (linear, quadratic, restoring, constant, mass) is free
    known: Array  # (6, 5) its value where it is held
    shape: Array  # (6, n) thruster configuration: wrench of each held force
    filtered: Array  # (6, 6) filtered columns and left-hand side
    triangle: Array  # (6, 36) square root of the information
    blocks: Array  # (6, 256, 36) sums over one block of time of instrument x row
    clock: Array  # (7,) blocks filled, time in this block, its length, time since refresh, time learned, rows,
    #               rows less those forgotten
    pending: Array  # (6,) wrench integral since the last sample taken
    driven: Array  # (6, 5) coefficients of the simulated instruments
    instrument: Array  # (6, 4) simulated velocity, its filtered linear and quadratic columns, its squared error x time
    energy: Array  # (6, 2) sums of the commanded force squared and of the whole force squared, x time
    gradient: Array  # (6, 5) Theta of the normalised gradient estimator
    recent: Array  # (5, 6) the last four wrenches, oldest first, for inputs that are smooth; their slope
    work: Array  # (32, 6) scratch
    kept: Array  # (6, 36) directional forgetting: the triangle that the last full block left
    fresh: Array  # (6, 36) triangle of the block that fills
    fresh_sums: Array  # (6, 36) its sums of instrument x row
    counted: Array  # (6, 2) rows in it; rows less those forgotten
    least: Array  # (6, 5) bounded gain: smallest variance of each column so far
    forgetting_work: Array  # scratch


def new_paper_state(
    p: Array,
    free: Array,
    known: Array,
    shape: Array,
    *,
    a: float,
    forgetting: float,
    gain: float,
    smooth: bool = False,
    scheme: int = EXPONENTIAL,
    share: float = 0.1,
    bound: float = 100.0,
) -> PaperState:
    """Return a fresh chain; see the fields of `PaperState`."""
    return PaperState(
        settings=np.array([a, forgetting, 1.0, 0.0, gain, float(smooth), float(scheme), share, bound]),
        p=p.copy(),
        free=np.ascontiguousarray(free, dtype=np.float64),
        known=np.ascontiguousarray(known, dtype=np.float64),
        shape=np.ascontiguousarray(shape, dtype=np.float64),
        filtered=np.zeros((6, N_COLUMNS)),
        triangle=np.zeros((6, N_COLUMNS * N_COLUMNS)),
        blocks=np.zeros((6, N_BLOCKS, N_COLUMNS * N_COLUMNS)),
        clock=np.array([0.0, 0.0, FIRST_BLOCK, 0.0, 0.0, 0.0, 0.0]),
        pending=np.zeros(6),
        driven=np.zeros((6, 5)),
        instrument=np.zeros((6, 4)),
        energy=np.zeros((6, 2)),
        gradient=np.zeros((6, 5)),
        recent=np.zeros((5, 6)),
        work=np.zeros((32, 6)),
        kept=np.zeros((6, N_COLUMNS * N_COLUMNS)),
        fresh=np.zeros((6, N_COLUMNS * N_COLUMNS)),
        fresh_sums=np.zeros((6, N_COLUMNS * N_COLUMNS)),
        counted=np.zeros((6, 2)),
        least=np.full((6, N_COLUMNS - 1), np.inf),
        forgetting_work=np.zeros(commit_scratch(N_COLUMNS - 1) + N_COLUMNS * (N_COLUMNS + 2)),
    )


@kernel
def running_estimate_into(state: PaperState, axis: int, out: Array) -> bool:
    """Write (linear, quadratic, restoring, constant, mass) of one axis into `out` (5,); False while not trustworthy."""
    free, known, R = state.free[axis], state.known[axis], state.triangle[axis]
    columns = 1
    for c in range(4):
        if free[c] > 0.0:
            columns += 1
    if free[4] <= 0.0 or state.clock[4] < _LEAST - 1e-6:
        return False
    # Rows of R with held coefficients folded into the force column, rotated into a triangle of the free columns.
    m = columns + 1
    small = np.zeros(m * m)
    row = np.empty(m)
    for i in range(N_COLUMNS):
        j = 0
        force = R[i * N_COLUMNS + C_FORCE]
        for c in range(4):
            if free[c] > 0.0:
                row[j] = R[i * N_COLUMNS + c]
                j += 1
            else:
                force += known[c] * R[i * N_COLUMNS + c]
        row[j] = force
        row[j + 1] = R[i * N_COLUMNS + C_LHS]
        qr_absorb(small, row, m)
    theta = np.empty(columns)
    for back in range(columns):
        i = columns - 1 - back
        d = small[i * m + i]
        if d == 0.0:
            return False
        t = small[i * m + columns]
        for j in range(i + 1, columns):
            t -= small[i * m + j] * theta[j]
        theta[i] = t / d
    inverse_mass = theta[columns - 1]
    if not inverse_mass > 0.0:
        return False
    # The filter makes neighbouring residuals alike: 2/(a h) samples count as one.
    alike = 1.0 + 2.0 * state.clock[5] / (state.settings[0] * state.clock[4])
    residual = small[columns * m + columns] * math.sqrt(alike / state.clock[5])
    if not residual < _TRUSTED * inverse_mass * math.fabs(small[(columns - 1) * m + columns - 1]):
        return False
    j = 0
    for c in range(4):
        if free[c] > 0.0:
            out[c] = theta[j] / inverse_mass
            j += 1
        else:
            out[c] = known[c]
    out[4] = 1.0 / inverse_mass
    return True


@kernel
def refresh_model(state: PaperState) -> None:
    """Put what the axes have learned into the model that the couplings and the end corrections use."""
    found = np.empty(5)
    p = state.p
    changed = False
    for axis in range(6):
        if not running_estimate_into(state, axis, found):
            continue
        changed = True
        p[I_MASS + 7 * axis] = found[4]
        p[I_LINEAR + 7 * axis] = min(0.0, found[C_LINEAR])
        p[I_QUADRATIC + 7 * axis] = min(0.0, found[C_QUADRATIC])
        if axis == 2:
            p[I_WEIGHT] = found[C_RESTORING]
        elif axis == 3 or axis == 4:
            p[I_MOMENT + 2] = found[C_RESTORING]
    if changed:
        inverse = np.linalg.inv(p[I_MASS:I_MASS_INVERSE].reshape(6, 6))
        for i in range(6):
            for j in range(6):
                p[I_MASS_INVERSE + 6 * i + j] = inverse[i, j]
