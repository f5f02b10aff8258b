"""The kernel's view of a vehicle: one vector of 154 numbers.

p[0:36]     M    total mass matrix M_RB + M_A, row-major 6x6, symmetric        [kg, kg m, kg m^2]
p[36:72]    its inverse
p[72:108]   L    linear SNAME derivatives, force_i += L_ij nu_j                 (negative dissipates)
p[108:144]  Q    quadratic SNAME derivatives, force_i += Q_ij |nu_j| nu_j       (negative dissipates)
p[144]      W - B                                                               [N]
p[145:148]  b = r_G W - r_B B (BG_x, BG_y, BG_z)                                [N m]
p[148:154]  constant wrench (X_0 .. N_0), fixed in the body: thrusters that differ, a tether   [N, N m]
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array

__all__ = [
    "I_CONSTANT",
    "I_LINEAR",
    "I_MASS",
    "I_MASS_INVERSE",
    "I_MOMENT",
    "I_QUADRATIC",
    "I_WEIGHT",
    "N_PARAMETERS",
    "pack_parameters",
]

I_MASS = 0
I_MASS_INVERSE = 36
I_LINEAR = 72
I_QUADRATIC = 108
I_WEIGHT = 144
I_MOMENT = 145
I_CONSTANT = 148
N_PARAMETERS = 154


def pack_parameters(
    mass: Array, linear: Array, quadratic: Array, weight: float, moment: Array, constant: Array | None = None
) -> Array:
    """Return the kernel vector (154,) of a vehicle.

    Args:
        mass: total mass matrix M = M_RB + M_A (6, 6), symmetric, invertible.
        linear, quadratic: SNAME derivatives (6, 6), negative on the diagonal of a physical vehicle.
        weight: W - B [N].
        moment: r_G W - r_B B (3,) [N m], body FRD.
        constant: wrench (6,) [N, N m] that always acts, body FRD; none where omitted.

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
    p[I_CONSTANT:] = 0.0 if constant is None else constant
    return p
