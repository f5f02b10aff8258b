"""The kernel's view of a vehicle: one vector of 170 numbers, and where in it each coefficient has its place.

p[0:36]     M    total mass matrix M_RB + M_A, row-major 6x6, symmetric        [kg, kg m, kg m^2]
p[36:72]    its inverse
p[72:108]   L    linear SNAME derivatives, force_i += L_ij nu_j                 (negative dissipates)
p[108:144]  Q    quadratic SNAME derivatives, force_i += Q_ij |nu_j| nu_j       (negative dissipates)
p[144]      W - B                                                               [N]
p[145:148]  b = r_G W - r_B B (BG_x, BG_y, BG_z)                                [N m]
p[148:154]  constant wrench (X_0 .. N_0), fixed in the body: thrusters that differ, a tether   [N, N m]
p[154:163]  forward-speed derivatives, force_i += F_ij u nu_j, those of a hull and wings that are the same to port and
            starboard: Y_uv Y_ur N_uv N_ur K_up Z_uw Z_uq M_uw M_uq             [kg/m, kg, kg m]
p[163:169]  asymmetric drag, force_i += A_i nu_i^2: X_u2 Y_v2 Z_w2 K_p2 M_q2 N_r2     [kg/m, kg m^2]
p[169]      inflow_loss, share of its thrust that a thruster loses per m/s of water that meets it             [s/m]

The loss of thrust is no force by itself: whoever knows the thrusters' forces adds what it comes to, a linear damping,
to L (`towtank.core.forces.add_inflow_damping_into`).

A kind of coefficient is a number, `MASS` to `INFLOW`, and a coefficient its kind, row (force) and column (velocity).
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from towtank.core.arrays import Array

__all__ = [
    "ASYMMETRY",
    "CONSTANT",
    "FORWARD",
    "FORWARD_COLUMNS",
    "FORWARD_ROWS",
    "INFLOW",
    "I_ASYMMETRY",
    "I_CONSTANT",
    "I_EXTRA",
    "I_FORWARD",
    "I_INFLOW",
    "I_LINEAR",
    "I_MASS",
    "I_MASS_INVERSE",
    "I_MOMENT",
    "I_QUADRATIC",
    "I_WEIGHT",
    "LINEAR",
    "MASS",
    "MOMENT",
    "N_EXTRA",
    "N_FORWARD",
    "N_KINDS",
    "N_PARAMETERS",
    "QUADRATIC",
    "WEIGHT",
    "address",
    "pack_parameters",
]

MASS, LINEAR, QUADRATIC, WEIGHT, MOMENT, CONSTANT, FORWARD, ASYMMETRY, INFLOW = range(9)
N_KINDS = 9

I_MASS = 0
I_MASS_INVERSE = 36
I_LINEAR = 72
I_QUADRATIC = 108
I_WEIGHT = 144
I_MOMENT = 145
I_CONSTANT = 148
I_FORWARD = 154
N_FORWARD = 9
I_ASYMMETRY = 163
I_INFLOW = 169
I_EXTRA = I_FORWARD  # forces of the velocity beyond L and Q: forward speed, asymmetric drag
N_EXTRA = I_INFLOW - I_EXTRA
N_PARAMETERS = 170
FORWARD_ROWS = (1, 1, 5, 5, 3, 2, 2, 4, 4)
FORWARD_COLUMNS = (1, 5, 1, 5, 3, 2, 4, 2, 4)


@register_jitable  # type: ignore[untyped-decorator]
def address(kind: int, row: int, column: int) -> int:
    """Return the place of a coefficient in the vector; -1 where there is none. Plain Python, and usable in kernels.

    An added mass has a second place, that of its mirrored element.
    """
    if kind == MASS:
        return I_MASS + 6 * row + column
    if kind == LINEAR:
        return I_LINEAR + 6 * row + column
    if kind == QUADRATIC:
        return I_QUADRATIC + 6 * row + column
    if kind == WEIGHT:
        return I_WEIGHT
    if kind == MOMENT:
        return I_MOMENT + row
    if kind == CONSTANT:
        return I_CONSTANT + row
    if kind == FORWARD:
        for n in range(N_FORWARD):
            if FORWARD_ROWS[n] == row and FORWARD_COLUMNS[n] == column:
                return I_FORWARD + n
    if kind == ASYMMETRY and row == column:
        return I_ASYMMETRY + row
    if kind == INFLOW:
        return I_INFLOW
    return -1


def pack_parameters(
    mass: Array,
    linear: Array,
    quadratic: Array,
    weight: float,
    moment: Array,
    constant: Array | None = None,
    forward: Array | None = None,
    asymmetry: Array | None = None,
) -> Array:
    """Return the kernel vector (170,) of a vehicle without loss of thrust with inflow.

    Args:
        mass: total mass matrix M = M_RB + M_A (6, 6), symmetric, invertible.
        linear, quadratic: SNAME derivatives (6, 6), negative on the diagonal of a physical vehicle.
        weight: W - B [N].
        moment: r_G W - r_B B (3,) [N m], body FRD.
        constant: wrench (6,) [N, N m] that always acts, body FRD; none where omitted.
        forward: forward-speed derivatives (9,) in the order of the vector; none where omitted.
        asymmetry: asymmetric drag (6,); none where omitted.

    Raises:
        numpy.linalg.LinAlgError: the mass matrix is singular.
    """
    p = np.empty(N_PARAMETERS)
    p[I_MASS:I_MASS_INVERSE] = np.asarray(mass, dtype=np.float64).ravel()
    p[I_MASS_INVERSE:I_LINEAR] = np.linalg.inv(mass).ravel()
    p[I_LINEAR:I_QUADRATIC] = np.asarray(linear, dtype=np.float64).ravel()
    p[I_QUADRATIC:I_WEIGHT] = np.asarray(quadratic, dtype=np.float64).ravel()
    p[I_WEIGHT] = weight
    p[I_MOMENT:I_CONSTANT] = moment
    p[I_CONSTANT:I_FORWARD] = 0.0 if constant is None else constant
    p[I_FORWARD:I_ASYMMETRY] = 0.0 if forward is None else forward
    p[I_ASYMMETRY:I_INFLOW] = 0.0 if asymmetry is None else asymmetry
    p[I_INFLOW] = 0.0
    return p
