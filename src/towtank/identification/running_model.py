"""The vehicle as known so far: what the couplings and the end corrections of the chain use while it learns."""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.core.layout import I_LINEAR, I_MASS, I_MASS_INVERSE, I_MOMENT, I_QUADRATIC, I_WEIGHT
from towtank.core.least_squares import qr_absorb
from towtank.identification.axes import C_FORCE, C_LHS, C_LINEAR, C_QUADRATIC, C_RESTORING, N_COLUMNS
from towtank.identification.paper_state import PaperState

__all__ = ["refresh_model", "running_estimate_into"]

_TRUSTED = 0.1  # relative deviation of 1/M below which a learned axis enters the model,
_LEAST = 1.0  # s of data that it needs at least


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
