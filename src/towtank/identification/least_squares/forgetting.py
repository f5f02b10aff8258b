"""How a row enters the information of one axis, and what is forgotten for it.

Exponential forgetting takes from every direction alike: what is at rest is forgotten too, and noise takes its place
(wind-up). Directional forgetting (`towtank.core.forgetting`) takes only where the data excites. For the latter fixed
coefficients are folded into the force, so that only directions of free ones count: a direction that nobody asks for,
and that is hardly excited, would keep the past of all others alive. Block sums of row products change with the
information: a past row z counts as z (I - F) from then on. While a directional block fills, `triangle` holds it
unforgotten, for the running model; the estimate is read from `directional_information`.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.forgetting import block_length, forget_excited
from towtank.core.least_squares import qr_absorb
from towtank.identification.least_squares.state import PaperState
from towtank.identification.model.terms import C_FORCE, C_LHS, C_MASS, N_COLUMNS

__all__: list[str] = []

_N = N_COLUMNS - 1  # coefficients of an axis
_SIZE = N_COLUMNS * N_COLUMNS
_SHARE = 0.1  # of what would be forgotten, that a direction must bring to count as excited


@kernel
def _turn_sums_into(blocks: Array, F: Array) -> None:
    """Change block sums (b, 36) to those of rows z (I - F); F (36,) is destroyed."""
    for i in range(_SIZE):
        F[i] = -F[i]
    for i in range(N_COLUMNS):
        F[i * N_COLUMNS + i] += 1.0
    half = np.empty(_SIZE)
    for b in range(blocks.shape[0]):
        for i in range(N_COLUMNS):
            for j in range(N_COLUMNS):
                t = 0.0
                for k in range(N_COLUMNS):
                    t += blocks[b, i * N_COLUMNS + k] * F[k * N_COLUMNS + j]
                half[i * N_COLUMNS + j] = t
        for i in range(N_COLUMNS):
            for j in range(N_COLUMNS):
                t = 0.0
                for k in range(N_COLUMNS):
                    t += F[k * N_COLUMNS + i] * half[k * N_COLUMNS + j]
                blocks[b, i * N_COLUMNS + j] = t


@kernel
def _commit_into(
    state: PaperState, axis: int, rows_left: float, kept: Array, blocks: Array, change: Array, work: Array
) -> float:
    """Take the directional block of one axis into `kept` (36,) and `blocks` (b, 36), the last of them its own.

    `rows_left` are the rows not forgotten before; returns those after.
    """
    fresh, sums, rows = state.directional.fresh[axis], state.directional.sums[axis], state.directional.rows[axis]
    forgetting = state.settings.forgetting
    if forget_excited(kept, fresh, _N, forgetting, rows, _SHARE, state.directional.noise, work, change) == 0:
        return rows_left
    _turn_sums_into(blocks, change)
    for i in range(_SIZE):
        blocks[-1, i] += sums[i]
    left: float = forgetting**rows
    return left * rows_left + (1.0 - left) / (1.0 - forgetting)


@inlined_kernel
def _fold_fixed_into(state: PaperState, axis: int, z: Array) -> None:
    """Move the columns of fixed coefficients into the force, and with a fixed inertia that to the left-hand side."""
    for c in range(C_FORCE):
        if state.free[axis, c] <= 0.0:
            z[C_FORCE] += state.known[axis, c] * z[c]
            z[c] = 0.0
    if state.free[axis, C_MASS] <= 0.0:
        z[C_LHS] -= z[C_FORCE] / state.known[axis, C_MASS]
        z[C_FORCE] = 0.0


@inlined_kernel
def _absorb_directional(state: PaperState, axis: int, g: Array, z: Array, block: int) -> None:
    forgetting, own = state.settings.forgetting, state.directional
    fresh, sums, row = own.fresh[axis], own.sums[axis], own.row
    _fold_fixed_into(state, axis, g)
    _fold_fixed_into(state, axis, z)
    scale = math.sqrt(forgetting)
    for i in range(N_COLUMNS):
        row[i] = z[i]
        for j in range(N_COLUMNS):
            sums[i * N_COLUMNS + j] = forgetting * sums[i * N_COLUMNS + j] + g[i] * z[j]
            fresh[i * N_COLUMNS + j] *= scale
    qr_absorb(fresh, row, N_COLUMNS)
    qr_absorb(state.triangle[axis], z, N_COLUMNS)
    own.rows[axis] += 1.0
    if own.rows[axis] < block_length(forgetting):
        return
    kept, blocks = own.kept[axis], state.blocks[axis][: block + 1]
    own.rows_left[axis] = _commit_into(state, axis, own.rows_left[axis], kept, blocks, own.change, own.work)
    own.rows[axis] = 0.0
    for i in range(_SIZE):
        state.triangle[axis, i] = kept[i]
        fresh[i] = 0.0
        sums[i] = 0.0


@kernel
def absorb_row(state: PaperState, axis: int, g: Array, z: Array, block: int) -> None:
    """Absorb the row z (6,) of one axis with its instruments g (6,), in the block of time `block`; both are changed."""
    forgetting = state.settings.forgetting
    if forgetting < 1.0 and state.settings.directional:
        _absorb_directional(state, axis, g, z, block)
        return
    for i in range(N_COLUMNS):
        for j in range(N_COLUMNS):
            state.blocks[axis, block, i * N_COLUMNS + j] += g[i] * z[j]
    if forgetting < 1.0:
        scale = math.sqrt(forgetting)
        for i in range(_SIZE):
            state.triangle[axis, i] *= scale
    qr_absorb(state.triangle[axis], z, N_COLUMNS)


@inlined_kernel
def forget_blocks(state: PaperState, block: int) -> None:
    """Discount all block sums by one row, where forgetting is exponential."""
    forgetting = state.settings.forgetting
    if forgetting < 1.0 and not state.settings.directional:
        for axis in range(6):
            for b in range(block + 1):
                for i in range(_SIZE):
                    state.blocks[axis, b, i] *= forgetting


@kernel
def directional_information(state: PaperState, axis: int) -> tuple[Array, Array, float]:
    """Return triangle (36,), block sums (256, 36) and rows not forgotten of one axis, the block so far taken in.

    The state stays as it is.
    """
    kept, blocks = state.directional.kept[axis].copy(), state.blocks[axis].copy()
    rows_left = state.directional.rows_left[axis]
    if state.directional.rows[axis] > 0.0:
        filled, change = blocks[: int(state.clock.block[0]) + 1], np.empty(_SIZE)
        work = np.empty(state.directional.work.shape[0])
        rows_left = _commit_into(state, axis, rows_left, kept, filled, change, work)
    return kept, blocks, rows_left
