"""Everything that the paper's chain remembers between samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.subspace_forgetting import commit_scratch
from towtank.identification.axes import N_COLUMNS

__all__ = [
    "BOUNDED_GAIN",
    "DIRECTIONAL",
    "EXPONENTIAL",
    "FIRST_BLOCK",
    "N_BLOCKS",
    "PaperState",
    "new_paper_state",
]

N_BLOCKS = 256
EXPONENTIAL, DIRECTIONAL, BOUNDED_GAIN = range(3)
FIRST_BLOCK = 0.25  # s; doubled, and neighbours merged, whenever the blocks are full


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
