"""Everything that the recursion of the paper's method remembers between samples, and the model that it learns by.

The couplings and the end corrections of the regressors need a model of the vehicle; it is the one known beforehand,
into which each axis' coefficients are put as soon as they are trustworthy.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.forgetting import commit_scratch
from towtank.core.layout import I_LINEAR, I_MASS, I_MASS_INVERSE, I_MOMENT, I_QUADRATIC, I_WEIGHT
from towtank.core.least_squares import qr_absorb
from towtank.identification.model.terms import C_FORCE, C_LHS, C_LINEAR, C_MASS, C_QUADRATIC, C_RESTORING, N_COLUMNS

__all__: list[str] = []

N_BLOCKS = 256
_FIRST_BLOCK = 0.25  # s; doubled, and neighbours merged, whenever the blocks are full
_TRUSTED = 0.1  # relative deviation of 1/M below which a learned axis enters the model,
_LEAST = 1.0  # s of data that it needs at least
_SIZE = N_COLUMNS * N_COLUMNS
_N = N_COLUMNS - 1  # coefficients of an axis


class RecursionSettings(NamedTuple):
    """What does not change while the recursion runs."""

    a: float  # filter constant of both sides [1/s]
    forgetting: float  # factor per sample, 1: nothing is forgotten
    directional: bool  # only directions that the data excites are forgotten, else all alike
    learn_model: bool  # the model takes what the axes have learned so far
    instruments: bool  # rows are weighted by instruments simulated from the commands, not by themselves
    smooth: bool  # inputs are samples of a smooth function, not held commands


class Clock(NamedTuple):
    """Times [s] and counts, (1,) each."""

    block: Array  # the block of time that fills
    block_time: Array  # time in it
    block_length: Array
    since_refresh: Array  # since the model was last refreshed
    learned: Array  # time learned from
    rows: Array  # samples learned from
    rows_left: Array  # less those forgotten


class Instruments(NamedTuple):
    """Motion of the axes simulated from the commands."""

    driven: Array  # (6, 5) coefficients that drive it: linear, quadratic, restoring, constant, mass (0: none)
    velocity: Array  # (6,)
    linear: Array  # (6,) its filtered column
    quadratic: Array  # (6,) likewise
    squared_error: Array  # (6,) integral of its squared distance from the measured velocity


class DirectionalBlock(NamedTuple):
    """The block of rows that fills where forgetting is directional, for each axis."""

    kept: Array  # (6, 36) the triangle that the last full block left
    fresh: Array  # (6, 36) triangle of this block
    sums: Array  # (6, 36) its sums of instrument x row
    rows: Array  # (6,) rows in it
    rows_left: Array  # (6,) all rows less those forgotten
    noise: Array  # (5,) of the regressors, none
    row: Array  # (6,) scratch, as the following
    change: Array  # (36,)
    work: Array


class Scratch(NamedTuple):
    """Room for one interval, so that nothing is allocated per sample."""

    rows: Array  # (6, 6) increments, a row an axis
    z: Array  # (6,) filtered row
    g: Array  # (6,) its instruments
    increments: Array  # (12, 6) see `axis_increments_into`
    forces: Array  # (m,) integrals of the inputs' forces


class PaperState(NamedTuple):
    """Everything the recursion remembers; arrays are changed in place."""

    settings: RecursionSettings
    p: Array  # (170,) the vehicle as known so far
    free: Array  # (6, 5) 1 where a column's coefficient (linear, quadratic, restoring, constant, mass) is free
    known: Array  # (6, 5) its value where it is fixed
    shape: Array  # (6, m) configuration matrix: wrench of each input's force
    filtered: Array  # (6, 6) filtered columns and left-hand side
    triangle: Array  # (6, 36) square root of the information
    blocks: Array  # (6, 256, 36) sums over one block of time of instrument x row
    clock: Clock
    pending: Array  # (6,) wrench integral since the last sample taken
    commanded: Array  # (6,) integral of the commanded force squared
    forced: Array  # (6,) integral of the whole force squared
    recent: Array  # (4, 6) the last four wrenches, oldest first, for inputs that are smooth
    slope: Array  # (6,) their slope within the interval
    instruments: Instruments
    directional: DirectionalBlock
    scratch: Scratch


def new_paper_state(
    p: Array, free: Array, known: Array, shape: Array, settings: RecursionSettings, driven: Array
) -> PaperState:
    """Return a fresh recursion; see the fields of `PaperState` and, for `driven`, of `Instruments`."""
    count = [np.zeros(1) for _ in Clock._fields]
    return PaperState(
        settings=settings,
        p=p.copy(),
        free=np.ascontiguousarray(free, dtype=np.float64),
        known=np.ascontiguousarray(known, dtype=np.float64),
        shape=np.ascontiguousarray(shape, dtype=np.float64),
        filtered=np.zeros((6, N_COLUMNS)),
        triangle=np.zeros((6, _SIZE)),
        blocks=np.zeros((6, N_BLOCKS, _SIZE)),
        clock=Clock(*count)._replace(block_length=np.array([_FIRST_BLOCK])),
        pending=np.zeros(6),
        commanded=np.zeros(6),
        forced=np.zeros(6),
        recent=np.zeros((4, 6)),
        slope=np.zeros(6),
        instruments=Instruments(driven.copy(), *(np.zeros(6) for _ in range(4))),
        directional=DirectionalBlock(
            kept=np.zeros((6, _SIZE)),
            fresh=np.zeros((6, _SIZE)),
            sums=np.zeros((6, _SIZE)),
            rows=np.zeros(6),
            rows_left=np.zeros(6),
            noise=np.zeros(_N),
            row=np.zeros(N_COLUMNS),
            change=np.zeros(_SIZE),
            work=np.zeros(commit_scratch(_N)),
        ),
        scratch=Scratch(
            rows=np.zeros((6, N_COLUMNS)),
            z=np.zeros(N_COLUMNS),
            g=np.zeros(N_COLUMNS),
            increments=np.zeros((12, 6)),
            forces=np.zeros(shape.shape[1]),
        ),
    )


@kernel
def _running_estimate_into(state: PaperState, axis: int, out: Array) -> bool:
    """Write (linear, quadratic, restoring, constant, mass) of one axis into `out` (5,); False while not trustworthy."""
    free, known, R = state.free[axis], state.known[axis], state.triangle[axis]
    columns = 1
    for c in range(4):
        if free[c] > 0.0:
            columns += 1
    if free[C_MASS] <= 0.0 or state.clock.learned[0] < _LEAST - 1e-6:
        return False
    # Rows of R with fixed coefficients folded into the force column, rotated into a triangle of the free columns.
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
    inflation = 1.0 + 2.0 * state.clock.rows[0] / (state.settings.a * state.clock.learned[0])
    residual = small[columns * m + columns] * math.sqrt(inflation / state.clock.rows[0])
    if not residual < _TRUSTED * inverse_mass * math.fabs(small[(columns - 1) * m + columns - 1]):
        return False
    j = 0
    for c in range(4):
        if free[c] > 0.0:
            out[c] = theta[j] / inverse_mass
            j += 1
        else:
            out[c] = known[c]
    out[C_MASS] = 1.0 / inverse_mass
    return True


@kernel
def refresh_model(state: PaperState) -> None:
    """Put what the axes have learned into the model that the couplings and the end corrections use."""
    found = np.empty(_N)
    p = state.p
    changed = False
    for axis in range(6):
        if not _running_estimate_into(state, axis, found):
            continue
        changed = True
        p[I_MASS + 7 * axis] = found[C_MASS]
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
