"""Restoring forces of gravity and buoyancy for any centres and any net weight.

With k = R^T e_z and b = r_G W - r_B B, Fossen (4.5) is g(eta) = -[(W - B) k ; b x k]. The printed paper's (20), row 4,
has the wrong sign; here a centre of buoyancy above the centre of gravity (BG_z = b_z > 0) rights the vehicle.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel

__all__ = ["restoring_wrench"]


@kernel
def restoring_wrench(weight: float, moment: Array, k: Array) -> Array:
    """Return g(eta) (6,) [N, N m] of (8); the wrench that acts on the vehicle is its opposite.

    Args:
        weight: W - B [N].
        moment: b = r_G W - r_B B (3,) [N m], body FRD.
        k: direction of gravity in the body (3,), see `towtank.core.attitude.gravity_direction`.
    """
    out = np.empty(6)
    for i in range(3):
        out[i] = -weight * k[i]
    out[3] = -(moment[1] * k[2] - moment[2] * k[1])
    out[4] = -(moment[2] * k[0] - moment[0] * k[2])
    out[5] = -(moment[0] * k[1] - moment[1] * k[0])
    return out
