"""Forgetting in the paper's chain: how a row enters the information of one axis, by scheme.

For directional forgetting held coefficients are folded into the force, so that only directions of free ones count: a
direction that nobody asks for, and that is hardly excited, would keep the past of all others alive. Block sums of row
products change with the information: a past row z counts as z (I - F) from then on. While a directional block fills,
`triangle` holds it unforgotten, for the running model; the estimate is read from `directional_information`.
"""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.bounded_gain import bounded_factor
from towtank.core.least_squares import qr_absorb
from towtank.core.subspace_forgetting import block_length, commit_scratch, forget_excited
from towtank.identification.axes import C_FORCE, C_LHS, N_COLUMNS
from towtank.identification.paper_state import BOUNDED_GAIN, DIRECTIONAL, PaperState

__all__ = ["absorb_row", "directional_information", "forget_blocks"]

_N = N_COLUMNS - 1  # unknowns' columns
_SIZE = N_COLUMNS * N_COLUMNS


@kernel
def _sandwich(blocks: Array, count: int, F: Array) -> None:
    """Change block sums (b, 36), the first `count`, to those of rows z (I - F)."""
    for i in range(_SIZE):
        F[i] = -F[i]
    for i in range(N_COLUMNS):
        F[i * N_COLUMNS + i] += 1.0
    half = np.empty(_SIZE)
    for b in range(count):
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
def _commit(
    forgetting: float,
    share: float,
    kept: Array,
    fresh: Array,
    sums: Array,
    count: Array,
    blocks: Array,
    block: int,
    work: Array,
) -> None:
    """Take a directional block into `kept` (36,) and `blocks` (b, 36); count (2,): rows in it, rows not forgotten."""
    end = commit_scratch(_N)
    F, quiet = work[end : end + _SIZE], work[end + _SIZE : end + _SIZE + _N]
    for i in range(_N):
        quiet[i] = 0.0
    if forget_excited(kept, fresh, _N, forgetting, count[0], share, quiet, work[:end], F) == 0:
        return
    _sandwich(blocks, block + 1, F)
    for i in range(_SIZE):
        blocks[block, i] += sums[i]
    left = forgetting ** count[0]
    count[1] = left * count[1] + (1.0 - left) / (1.0 - forgetting)


@inlined_kernel
def _fold(state: PaperState, axis: int, z: Array) -> None:
    """Move the columns of held coefficients into the force, and with a held inertia that to the left-hand side."""
    for c in range(C_FORCE):
        if state.free[axis, c] <= 0.0:
            z[C_FORCE] += state.known[axis, c] * z[c]
            z[c] = 0.0
    if state.free[axis, C_FORCE] <= 0.0:
        z[C_LHS] -= z[C_FORCE] / state.known[axis, C_FORCE]
        z[C_FORCE] = 0.0


@inlined_kernel
def _directional_row(state: PaperState, axis: int, g: Array, z: Array, block: int) -> None:
    forgetting = state.settings[1]
    fresh, sums, count = state.fresh[axis], state.fresh_sums[axis], state.counted[axis]
    _fold(state, axis, g)
    _fold(state, axis, z)
    scale = math.sqrt(forgetting)
    row = state.forgetting_work[-N_COLUMNS:]
    for i in range(N_COLUMNS):
        row[i] = z[i]
        for j in range(N_COLUMNS):
            sums[i * N_COLUMNS + j] = forgetting * sums[i * N_COLUMNS + j] + g[i] * z[j]
            fresh[i * N_COLUMNS + j] *= scale
    qr_absorb(fresh, row, N_COLUMNS)
    qr_absorb(state.triangle[axis], z, N_COLUMNS)
    count[0] += 1.0
    if count[0] < block_length(forgetting):
        return
    _commit(
        forgetting,
        state.settings[7],
        state.kept[axis],
        fresh,
        sums,
        count,
        state.blocks[axis],
        block,
        state.forgetting_work,
    )
    count[0] = 0.0
    for i in range(_SIZE):
        state.triangle[axis, i] = state.kept[axis, i]
        fresh[i] = 0.0
        sums[i] = 0.0


@kernel
def absorb_row(state: PaperState, axis: int, g: Array, z: Array, block: int) -> None:
    """Absorb the row z (6,) of one axis with its instruments g (6,), in the block of time `block`; both are changed."""
    forgetting = state.settings[1]
    if forgetting < 1.0 and state.settings[6] == DIRECTIONAL:
        _directional_row(state, axis, g, z, block)
        return
    for i in range(N_COLUMNS):
        for j in range(N_COLUMNS):
            state.blocks[axis, block, i * N_COLUMNS + j] += g[i] * z[j]
    if forgetting < 1.0:
        if state.settings[6] == BOUNDED_GAIN:
            inverse = state.forgetting_work[: _N * _N]
            forgetting = bounded_factor(
                state.triangle[axis], _N, forgetting, state.settings[8], state.least[axis], inverse
            )
            for b in range(block + 1):
                for i in range(_SIZE):
                    state.blocks[axis, b, i] *= forgetting
        scale = math.sqrt(forgetting)
        for i in range(_SIZE):
            state.triangle[axis, i] *= scale
    state.counted[axis, 1] = forgetting * state.counted[axis, 1] + 1.0
    qr_absorb(state.triangle[axis], z, N_COLUMNS)


@inlined_kernel
def forget_blocks(state: PaperState, block: int) -> None:
    """Discount all block sums by one row, where forgetting is exponential."""
    forgetting = state.settings[1]
    if forgetting < 1.0 and state.settings[6] != DIRECTIONAL and state.settings[6] != BOUNDED_GAIN:
        for axis in range(6):
            for b in range(block + 1):
                for i in range(_SIZE):
                    state.blocks[axis, b, i] *= forgetting


@kernel
def directional_information(state: PaperState, axis: int) -> tuple[Array, Array, float]:
    """Return triangle (36,), block sums (256, 36) and rows not forgotten of one axis, the block so far taken in.

    The state stays as it is.
    """
    kept, blocks, count = state.kept[axis].copy(), state.blocks[axis].copy(), state.counted[axis].copy()
    if count[0] > 0.0:
        _commit(
            state.settings[1],
            state.settings[7],
            kept,
            state.fresh[axis],
            state.fresh_sums[axis],
            count,
            blocks,
            int(state.clock[0]),
            np.empty(state.forgetting_work.shape[0]),
        )
    return kept, blocks, count[1]
